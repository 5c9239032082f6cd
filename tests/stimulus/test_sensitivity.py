"""Sensitivities against finite differences of the forward model, and their figures."""

from dataclasses import replace

import numpy as np
import pytest

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem
from modaltouch.stimulus.sensitivity import focus_sensitivity, scatter
from modaltouch.stimulus.timing import Timing

PARAMETERS = ("natural_frequency", "damping_ratio", "modal_gain")


@pytest.fixture(
    scope="module",
    params=[(None, 25_000), (30e3, 25_000), (30e3, 32_768)],
    ids=["wide amplifier", "amplifier of 30 kHz", "uneven clock"],
)
def stimulus(design, crossed_model, request):
    """Return a design in which every mode hangs on both channels."""
    bandwidth, n_samples = request.param
    amplifier = Amplifier(gain=25.0, limit=250.0, bandwidth=bandwidth, delay=1.1e-6)
    return design(crossed_model, timing=Timing(AFG3022B.converter, n_samples=n_samples), amplifier=amplifier)


def state_of(stimulus, model):
    """Return velocities and displacements of another beam under the same voltages, (2, n_modes) array."""
    system = DiagonalSystem.of(model, stimulus.amplifier)
    state = system.states_by_channel(stimulus.voltage, stimulus.timing, 0.025).sum(axis=0)
    return np.stack([(system.velocity @ state).real, (system.displacement @ state).real])


@pytest.mark.parametrize("parameter", PARAMETERS)
def test_derivatives_match_finite_differences(stimulus, parameter):
    """Central differences of the forward model, of the fourth order, relative step 1e-5."""
    model, step = stimulus.model, 1e-5
    analytic = getattr(focus_sensitivity(stimulus), parameter).sum(axis=2)  # all modes together

    def moved(by, channel=None):
        values = getattr(model, parameter).copy()
        if channel is None:
            values *= 1 + by
        else:
            values[:, channel] *= 1 + by
        return state_of(stimulus, replace(model, **{parameter: values}))

    def difference(channel=None):
        near = moved(step, channel) - moved(-step, channel)
        far = moved(2 * step, channel) - moved(-2 * step, channel)
        return (8 * near - far) / (12 * step)

    numeric = np.stack([difference(0), difference(1)], axis=2) if parameter == "modal_gain" else difference()
    assert analytic == pytest.approx(numeric, abs=2e-8)


def test_gain_moves_its_mode_in_proportion(shipped):
    """Linear in the gain: the relative derivative of a mode's velocity is its target."""
    found = focus_sensitivity(shipped).modal_gain.sum(axis=3)
    assert found[0] == pytest.approx(np.diag(shipped.target), abs=1e-13)
    assert found[1] == pytest.approx(0, abs=1e-13)


def test_errors_of_five_per_cent_move_the_field_by_millimetres_per_second(shipped):
    """+5 % G moves the field by about 3 mm/s, +5 % xi by 1.4, +0.1 % f by 0.5."""
    places = np.linspace(-0.05, 0.05, 101)
    shapes = shipped.model.shapes(places)
    rows = focus_sensitivity(shipped).table(shapes)
    worst = {name: max(r["field"] for r in rows if r["parameter"] == name) for name in PARAMETERS}
    assert 2e-3 < worst["modal_gain"] < 7e-3
    assert 0.5e-3 < worst["damping_ratio"] < 4e-3
    assert 0.05e-3 < worst["natural_frequency"] < 1.5e-3
    assert rows[0]["field"] == max(r["field"] for r in rows)


def test_scatter_agrees_with_the_derivatives(shipped):
    """First-order propagation of independent deviations against drawn beams."""
    spread = {"natural_frequency": 1e-4, "damping_ratio": 5e-3, "modal_gain": 5e-3}
    drawn = scatter(shipped, [0.0, 0.02], n_draws=400, **spread)
    slopes = focus_sensitivity(shipped)
    shapes = shipped.model.shapes([0.0, 0.02])
    variance = sum(
        ((getattr(slopes, name)[0].reshape(9, 9, -1).sum(axis=2).T @ shapes * spread[name]) ** 2).sum(axis=0)
        for name in PARAMETERS
    )
    assert drawn.deviation == pytest.approx(np.sqrt(variance), rel=0.12)
    assert (drawn.modal_error > 0).all()


def test_senseless_spreads_are_refused(shipped):
    """A deviation is 0 or above; a scatter has two beams or more."""
    with pytest.raises(ValueError, match=r"relative deviation of the gain is -0\.1; it must be 0 or above"):
        scatter(shipped, [0.0], modal_gain=-0.1)
    with pytest.raises(ValueError, match=r"1 beams are drawn; a scatter needs at least 2"):
        scatter(shipped, [0.0], n_draws=1)
