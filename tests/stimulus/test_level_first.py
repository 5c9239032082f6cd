"""Priority `level`: the exact level at the focus, and the nearest field within the amplifier's limit."""

from dataclasses import replace

import numpy as np
import pytest
from forward import modal_history

from modaltouch.stimulus.dynamics import Amplifier
from modaltouch.stimulus.fingers import Finger
from modaltouch.stimulus.stimulus import Stimulus

LEVEL = 0.2
ZONES = np.array([-0.04, -0.02, 0.0, 0.02, 0.04])
HEAVY = (0.25e-3, 1.5, 1500.0)
"""Mass [kg], damping [N s/m] and stiffness [N/m], for which the whole field takes 1,000 V on (A,C)."""


@pytest.fixture(scope="module")
def whole(design, model) -> Stimulus:
    """The whole field under two heavy fingers at A and C."""
    fingers = tuple(Finger(place, *HEAVY) for place in (-0.04, 0.0))
    return design(replace(model, mass=3.3e-3).touched(fingers))


@pytest.fixture(scope="module")
def first(whole) -> Stimulus:
    """The same stimulus with priority `level`."""
    return replace(whole, priority="level")


def test_the_level_is_reached_exactly_at_the_limit(whole, first):
    """The whole field would need about 1,000 V; with priority `level` the peak lies just below 250 V."""
    limit = whole.amplifier.limit
    assert whole.peak_voltage.max() > 3.5 * limit
    assert 0.98 * limit < first.peak_voltage.max() <= limit
    unit = first.volts_per_code(LEVEL)
    assert first.touched(first.model.fingers).velocity_at_focus([0.0], unit)[0] == pytest.approx(LEVEL, rel=1e-6)


def test_the_level_is_reached_exactly_on_an_uneven_clock(first):
    """With 312.5 clocks per sample, every other sample begins late."""
    uneven = replace(first, timing=replace(first.timing, n_samples=40_000))
    assert uneven.timing.clock_error is not None
    unit = uneven.volts_per_code(LEVEL)
    assert uneven.touched(first.model.fingers).velocity_at_focus([0.0], unit)[0] == pytest.approx(LEVEL, rel=1e-6)


def test_the_field_deviates_less_with_a_higher_limit(whole, first):
    """The other zones approach the target field as the limit rises; the slow mode moves less than with it."""
    target = whole.projection.field(ZONES)

    def missed(limit: float) -> float:
        stimulus = replace(first, amplifier=replace(first.amplifier, limit=limit))
        reached = stimulus.touched(stimulus.model.fingers).velocity_at_focus(ZONES, stimulus.volts_per_code(LEVEL))
        return float(np.abs(reached - target).max())

    near, middle, far = (missed(limit) for limit in (800.0, 500.0, 250.0))
    assert 0.002 * LEVEL < near < middle < far < 0.5 * LEVEL
    fingers = whole.model.fingers
    slow = [each.touched(fingers).peak_below(1e3, 0.0, each.volts_per_code(LEVEL)) for each in (whole, first)]
    assert slow[1] < 0.8 * slow[0]


def test_priority_level_changes_nothing_within_the_limit(design, model):
    """The untouched beam needs 184 of the 250 V, so the codes are identical."""
    stimulus = design(model)
    np.testing.assert_array_equal(replace(stimulus, priority="level").burst.codes, stimulus.burst.codes)


def test_the_beam_is_at_rest_at_the_end(first):
    """Braking starts from the state actually reached at the focus."""
    reached = first.system.state_at(first.voltage, first.timing, first.timing.duration)
    assert np.abs(np.concatenate(first.system.read(reached))).max() <= 1e-11 * LEVEL


def test_only_mode_1_moves_below_a_kilohertz(design, model):
    """Mode 1 of Table I, at 229 Hz, is a rigid translation, so its velocity is the same at every point."""
    stimulus = design(model, amplifier=Amplifier(gain=25.0, limit=250.0))
    unit = stimulus.volts_per_code(LEVEL)
    slow = np.abs(modal_history(model, stimulus.voltage_played(LEVEL), stimulus.timing)[0]).max()
    for place in (0.0, 0.03):
        for frequency in (1e3, 2e3):  # mode 3 swings at 2.6 kHz
            assert stimulus.touched(()).peak_below(frequency, place, unit) == pytest.approx(slow, rel=1e-6)
