"""Rounding to 14 bits: plain, and settled (corrected for its effect at the focus)."""

from dataclasses import replace

import numpy as np
import pytest

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier
from modaltouch.stimulus.quantised import _changes, _Walk
from modaltouch.stimulus.target_field import TargetField


@pytest.fixture(scope="module")
def plain(design):
    """Return the shipped stimulus with every sample rounded to its nearest code."""
    return design(rounding="plain")


def test_plain_rounding_costs_what_its_noise_predicts(plain):
    """A uniform error in every sample has the variance unit^2 / 12 times the sum of squared responses."""
    system, timing = plain.system, plain.timing
    unit = plain.volts_per_code(0.2)
    read = np.concatenate([system.velocity, system.displacement])
    ago = np.arange(plain.drive.n_before)[::-1]
    variance = np.zeros(18)
    for channel in range(2):
        effect = system.held_gain(timing.hold)[:, channel] * unit[channel]
        response = (read @ (effect[:, None] * np.exp(system.exponent[:, None] * timing.hold * ago))).real
        variance += (response**2).sum(axis=1) / 12
    reached, displacement = plain.achieved(0.2)
    error = np.concatenate([reached - plain.target, displacement])
    assert np.abs(error / np.sqrt(variance)).max() < 3
    assert np.abs(error).max() > 1e-6 * 0.2


def test_settled_codes_differ_by_one_at_most(plain, shipped):
    """Fewer than 2000 codes change, each by one."""
    change = shipped.burst.codes.astype(int) - plain.burst.codes.astype(int)
    assert set(np.unique(change)) == {-1, 0, 1}
    assert np.count_nonzero(change) < 2000


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"release": "free"},
        {"timing": Timing(AFG3022B.converter, n_samples=131_072)},
        {"timing": Timing(AFG3022B.converter, n_samples=16_384)},
        {"timing": Timing(AFG3022B.converter, focusing_instant=0.0123456)},
        {"amplifier": Amplifier(gain=25.0, limit=250.0, bandwidth=30e3, delay=7e-6)},
        {"target_field": TargetField(centre=0.02)},
        {"target_field": TargetField(shape="box", base=0.027)},
    ],
    ids=str,
)
def test_settled_rounding_costs_a_millionth_of_the_peak_at_most(design, options):
    """At most 1e-6 of the peak, with codes in range."""
    stimulus = design(**options)
    assert stimulus.worst_modal_error(0.2) <= 1e-6 * 0.2
    assert stimulus.burst.codes.max() <= 16382


def test_settled_rounding_holds_at_all_levels(shipped):
    """All four amplitudes lie on the grid, so the bound of the highest level holds for each."""
    for level in shipped.levels:
        assert shipped.worst_modal_error(level) <= 1e-6 * level


def test_settled_rounding_holds_with_every_mode_on_both_channels(design, crossed_model):
    """Both channels are rounded jointly."""
    assert design(crossed_model).worst_modal_error(0.2) <= 1e-6 * 0.2


def test_paper_law_misses_by_its_own_error_alone(design):
    """The paper's law is rounded plainly; rounding is negligible beside its own error."""
    stimulus = design(law="paper")
    assert stimulus.worst_modal_error(0.2) == pytest.approx(stimulus.drive.residual, abs=1e-4 * 0.2)


def test_rounding_leaves_the_amplitudes(shipped):
    """Plain or settled, the codes span the same full scale."""
    assert replace(shipped, rounding="plain").burst.amplitude == shipped.burst.amplitude


@pytest.mark.parametrize("n_samples", [125_000, 131_072])
def test_the_effect_of_one_code_is_computed_correctly(design, n_samples):
    """On an even and an uneven clock, one changed code moves the states at the focus by the computed amount."""
    stimulus = design(timing=Timing(AFG3022B.converter, n_samples=n_samples))
    system, timing, unit = stimulus.system, stimulus.timing, stimulus.volts_per_code(0.2)
    assert (timing.clock_error is None) == (n_samples == 125_000)
    walk = _Walk(np.zeros((2, n_samples)), unit, system, timing, 1e-9, 300)
    read = np.concatenate([system.velocity, system.displacement])
    for visit in (0, 1, 40, 41, 300):
        voltage = np.zeros((2, n_samples))
        voltage[walk.channel[visit], walk.sample[visit]] = unit[walk.channel[visit]]
        state = system.states_by_channel(voltage, timing, timing.focusing_instant).sum(axis=0)
        moved = (read @ state).real
        assert walk.move[visit] == pytest.approx(moved, rel=1e-6, abs=1e-9 * np.abs(moved).max())


def test_codes_change_only_if_that_reduces_the_error():
    """A code changes by one if the error exceeds half of its effect; later codes take earlier changes into account."""
    together = np.array([[2.0, 0.0, 0.0, 1.9], [0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 2.0, 0.0], [1.9, 0.0, 0.0, 2.0]])
    assert _changes(np.array([3.0, 0.4, -1.5, 2.5]), together, [1.0] * 4) == [1.0, 0.0, -1.0, 0.0]
    assert _changes(np.array([1.0, -1.0]), 2 * np.eye(2), [1.0, 1.0]) == [0.0, 0.0]
    assert _changes(np.array([5.0]), np.array([[2.0]]), [np.inf]) == [0.0]
