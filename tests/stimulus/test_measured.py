"""Measured mode shapes: projection by least squares, scaling, and refusals."""

from dataclasses import replace

import numpy as np
import pytest

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier
from modaltouch.stimulus.other_shapes import MeasuredShapes
from modaltouch.stimulus.shapes import mode_shapes
from modaltouch.stimulus.stimulus import design_stimulus
from modaltouch.stimulus.target_field import Projection, TargetField

LABELS = tuple(range(1, 18, 2))


def scan(n_points, factor=1.0, noise=0.0):
    """Return the shipped shapes scanned at some points, in some unit."""
    place = np.linspace(-0.05, 0.05, n_points)
    shape = mode_shapes(LABELS, place, 0.1) * factor
    shape = shape + noise * np.random.default_rng(1).normal(size=shape.shape)
    return MeasuredShapes(LABELS, place, shape, 0.1)


@pytest.mark.parametrize("n_points", [41, 101])
def test_unit_of_the_scan_drops_out(n_points):
    """Shapes have unit mean square and are positive at the right end, whatever the vibrometer's unit and sign."""
    measured = scan(n_points, factor=-3.7e-6)
    assert measured.shape == pytest.approx(mode_shapes(LABELS, measured.position, 0.1), abs=1e-9)


def test_forty_one_points_suffice_for_mode_17():
    """Interpolated between 41 points, all shapes agree with theory within 1e-8."""
    place = np.linspace(-0.05, 0.05, 333)
    assert scan(41).at(place) == pytest.approx(mode_shapes(LABELS, place, 0.1), abs=1e-8)


def test_least_squares_projects_better_than_a_trapezoid_sum():
    """On 21 points trapezoid inner products err by more than 0.15; least squares are exact."""
    place = np.linspace(-0.05, 0.05, 21)
    shape = mode_shapes(LABELS, place, 0.1)
    gram = np.trapezoid(shape[:, None] * shape, place, axis=2) / 0.1
    assert np.abs(gram - np.eye(9)).max() > 0.15
    measured = MeasuredShapes(LABELS, place, shape, 0.1)
    wanted = np.arange(1.0, 10.0)
    found = measured.project(wanted @ measured.shape)
    assert found == pytest.approx(wanted, abs=1e-9)


def test_condition_number_is_reported_and_noise_grows_by_it_at_most():
    """Least squares amplify noise by at most the condition number."""
    measured = scan(41)
    assert 1 <= measured.condition_number < 10
    clean = np.ones(9) @ measured.shape
    noise = 1e-3 * np.random.default_rng(2).normal(size=41)
    error = measured.project(clean + noise) - 1
    assert np.linalg.norm(error) / 3 <= measured.condition_number * np.linalg.norm(noise) / np.linalg.norm(clean)


def test_measured_shapes_give_the_design_of_theory(model):
    """A fine scan of theoretical shapes gives the theoretical stimulus."""
    measured = replace(model, basis=scan(401))
    assert Projection(measured, TargetField()).selected == (1, 3, 5, 7, 11, 13)
    stimulus = design_stimulus(
        measured, TargetField(), Timing(AFG3022B.converter, n_samples=25_000), Amplifier(gain=25.0, limit=250.0)
    )
    assert stimulus.target == pytest.approx(Projection(model, TargetField()).target, abs=3e-3)
    assert stimulus.velocity_at_focus([0.0], 0.2)[0] == pytest.approx(0.2, rel=1e-5)


def test_dependent_shapes_are_refused_with_the_closest_pair():
    """Rank deficiency is refused: the same shape under two labels, or fewer points than modes."""
    place = np.linspace(-0.05, 0.05, 41)
    shape = mode_shapes([1, 3, 5], place, 0.1)
    shape[2] = 2 * shape[1]
    with pytest.raises(ValueError, match=r"linearly dependent .* the closest are modes 3 and 5"):
        MeasuredShapes((1, 3, 5), place, shape, 0.1)
    with pytest.raises(ValueError, match=r"9 shapes on 8 points are linearly dependent"):
        scan(8)


@pytest.mark.parametrize(
    ("place", "shape", "message"),
    [
        ([0.005, 0.003], [1.0, 1.0], r"scan grid runs from 5 to 3 mm; it must increase"),
        ([0.0, 0.07], [1.0, 1.0], r"scan grid runs from 0 to 70 mm; .* on the beam of 100 mm"),
        ([0.0, 0.001], [0.0, 0.0], r"mode 1 is zero at every point"),
    ],
)
def test_impossible_scans_are_refused(place, shape, message):
    """Each message has the fault and what is allowed."""
    with pytest.raises(ValueError, match=message):
        MeasuredShapes((1,), np.array(place), np.array([shape]), 0.1)
