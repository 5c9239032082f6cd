"""Slopes, curvatures and the gains of patches."""

import numpy as np
import pytest

from modaltouch.stimulus.other_shapes import patch_gains
from modaltouch.stimulus.shapes import characteristic_root, mode_shapes

LABELS = [1, 2, 3, 4, 5, 12, 17]


@pytest.mark.parametrize("derivative", [1, 2, 3])
def test_derivatives_match_finite_differences(derivative):
    """Central differences of the next lower derivative, with a step of 1e-6 of the length."""
    place, step = np.linspace(-0.0499, 0.0499, 23), 1e-7
    low, high = (mode_shapes(LABELS, place + by, 0.1, derivative - 1) for by in (-step, step))
    numeric = (high - low) / (2 * step)
    exact = mode_shapes(LABELS, place, 0.1, derivative)
    assert exact == pytest.approx(numeric, abs=1e-6 * np.abs(exact).max())


def test_bending_modes_solve_the_beam_equation():
    """Euler-Bernoulli: the fourth derivative is (root / L)^4 times the shape."""
    place = np.linspace(-0.05, 0.05, 11)
    for label in (3, 8, 17):
        factor = (characteristic_root(label - 2) / 0.1) ** 4
        fourth = mode_shapes([label], place, 0.1, 4)
        assert fourth == pytest.approx(factor * mode_shapes([label], place, 0.1), rel=1e-9, abs=1e-9 * factor)


@pytest.mark.parametrize("derivative", [2, 3])
def test_free_ends_carry_neither_moment_nor_force(derivative):
    """Second and third derivatives vanish at a free end."""
    at_ends = mode_shapes([3, 4, 9, 50], [-0.05, 0.05], 0.1, derivative)
    inside = np.abs(mode_shapes([3, 4, 9, 50], np.linspace(-0.05, 0.05, 99), 0.1, derivative)).max(axis=1)
    assert np.abs(at_ends / inside[:, None]).max() < 1e-12


def test_slope_difference_is_the_integral_of_the_curvature():
    """Fundamental theorem, by Gauss-Legendre over the patch."""
    node, weight = np.polynomial.legendre.leggauss(40)
    left, right = -0.008, 0.011
    place = (left + right) / 2 + (right - left) / 2 * node
    integral = mode_shapes(LABELS, place, 0.1, 2) @ weight * (right - left) / 2
    assert patch_gains(LABELS, [(left, right)], 0.1) == pytest.approx(integral, rel=1e-10, abs=1e-9)


def test_symmetric_pairs_drive_only_symmetric_modes():
    """Two patches mirrored at mid-beam and wired together drive neither even nor rigid modes."""
    gain = patch_gains(range(1, 18), [(-0.03, -0.02), (0.02, 0.03)], 0.1)
    assert np.abs(gain[1::2]).max() < 1e-9 * np.abs(gain).max()
    assert gain[0] == 0
    assert (np.abs(gain[2::2]) > 0).all()


def test_impossible_patches_are_refused():
    """A patch must lie on the beam."""
    with pytest.raises(ValueError, match=r"position 60 mm is not on the beam"):
        patch_gains([3], [(0.04, 0.06)], 0.1)
