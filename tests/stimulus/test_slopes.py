"""Slopes and curvatures of the mode shapes."""

import numpy as np
import pytest

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
