"""Corrections of a calibration, at measured levels and between them."""

import numpy as np
import pytest

from modaltouch.stimulus.burst import Correction, corrected


def test_corrected_targets_hold_in_proportion_at_other_levels():
    """The beam is linear: at half the level the targets are halved."""
    correction = Correction(np.array([0.1, -0.02]), np.array([0.004, 0.0]), reference=0.2)
    velocity, displacement = correction.at(0.1)
    assert velocity == pytest.approx([0.05, -0.01])
    assert displacement == pytest.approx([0.002, 0.0])
    velocity, displacement = correction.at(0.2)
    assert (velocity == correction.velocity).all()
    assert (displacement == correction.displacement).all()


def test_level_corrections_are_interpolated():
    """A level between two measured ones has the geometric interpolation; levels outside stay uncorrected."""
    corrections = ((0.08, 1.02), (0.2, 0.99))
    assert corrected(0.08, corrections) == pytest.approx(0.0816)
    assert corrected(200 * 1e-3, corrections) == pytest.approx(0.198)
    assert corrected((0.08 * 0.2) ** 0.5, corrections) == pytest.approx((0.08 * 0.2) ** 0.5 * 1.005)
    assert corrected(0.0801, corrections) == pytest.approx(0.0801 * 1.02, rel=1e-4)
    assert (corrected(0.07, corrections), corrected(0.21, corrections)) == (0.07, 0.21)
    assert corrected(0.1, ()) == 0.1
