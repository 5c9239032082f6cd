"""Mode shapes against sixty-digit arithmetic, and orthonormal up to mode 1000."""

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modaltouch.stimulus.shapes import characteristic_root, mode_shapes
from modaltouch.stimulus.target_field import quadrature


def textbook_shape(label, y):
    """Return the free-free shape by the textbook formula, which needs sixty digits or more."""
    n = label - 2
    mpmath.mp.dps = 60 + int(3 * n)
    root = mpmath.findroot(lambda x: mpmath.cos(x) - mpmath.sech(x), (2 * n + 1) * mpmath.pi / 2)
    x = root * (mpmath.mpf(y) + mpmath.mpf(1) / 2)
    ratio = (mpmath.cosh(root) - mpmath.cos(root)) / (mpmath.sinh(root) - mpmath.sin(root))
    shape = mpmath.cosh(x) + mpmath.cos(x) - ratio * (mpmath.sinh(x) + mpmath.sin(x))
    # The textbook shape is positive at the left end; here, at the right end.
    return shape * (1 if n % 2 else -1)


@pytest.mark.parametrize(
    ("bending", "root"), [(1, "4.7300407448627040"), (2, "7.8532046240958376"), (5, "17.278759657399")]
)
def test_roots_agree_with_published_tables(bending, root):
    """Roots of cos(l) cosh(l) = 1 as tabulated by Blevins (Formulas for Natural Frequency, table 8-1)."""
    assert characteristic_root(bending) == pytest.approx(float(root), rel=1e-13)


@pytest.mark.parametrize("label", [3, 4, 5, 8, 12, 13, 14, 17, 30, 61, 100, 150, 199, 200])
def test_shapes_match_sixty_digits(label):
    """Within 2e-13 of the textbook formula in at least sixty digits, up to mode 200."""
    places = [-0.5, -0.4375, -0.25, -0.1, 0.0, 0.03125, 0.375, 0.5]
    expected = [float(textbook_shape(label, y)) for y in places]
    assert mode_shapes([label], np.array(places), 1.0)[0] == pytest.approx(expected, abs=2e-13)


def test_rigid_modes_are_translation_and_rotation():
    """1 and sqrt(12) y, each of unit mean square."""
    assert mode_shapes([1, 2], [-0.05, 0.0, 0.05], 0.1) == pytest.approx(
        np.array([[1, 1, 1], [-(3**0.5), 0, 3**0.5]]), abs=1e-15
    )


@pytest.mark.parametrize("labels", [range(1, 51), range(900, 1001)])
def test_shapes_are_orthonormal(labels):
    """Normalisation of equation (2) for uniform density: the Gram matrix is the identity within 1e-12."""
    position, weight = quadrature([-0.5, 0.5], 2 * np.pi * (max(labels) + 1))
    shapes = mode_shapes(list(labels), position, 1.0)
    gram = (shapes * weight) @ shapes.T
    assert gram == pytest.approx(np.eye(len(gram)), abs=1e-12)


@given(label=st.integers(1, 1000), y=st.floats(-0.5, 0.5))
def test_shapes_are_even_or_odd_and_bounded(label, y):
    """Odd modes are symmetric, even ones antisymmetric; the maximum is at the ends."""
    left, right, end = mode_shapes([label], [-y, y, 0.5], 1.0)[0]
    assert left == pytest.approx(right if label % 2 else -right, abs=1e-13)
    assert abs(right) <= end + 1e-12
    assert np.isfinite(right)


def test_point_off_the_beam_is_refused():
    """A beam of 100 mm spans -50 to 50 mm."""
    with pytest.raises(ValueError, match=r"position 60 mm is not on the beam, which spans -50 to 50 mm"):
        mode_shapes([1], [0.06], 0.1)
    with pytest.raises(ValueError, match=r"position nan mm is not on the beam"):
        mode_shapes([1], [float("nan")], 0.1)
