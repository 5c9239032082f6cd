"""Other designs for the same states: the voltage that they save and the energy that they cost."""

import numpy as np
import pytest

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.drive import Steering
from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.other_drives import least_norm, least_peak

UNMODELLED = ModalModel((19,), [120e3], [0.015], [[50.0, 50.0]], 0.1)


@pytest.fixture(scope="module")
def small(design):
    """Return the shipped stimulus on few samples, which keeps the linear programme short."""
    return design(timing=Timing(AFG3022B.converter, n_samples=12_500))


@pytest.fixture(scope="module")
def steering(small):
    """Return the conditions that its voltages must meet."""
    return Steering(small.model, small.system, small.timing, small.release, *small.corrected_target)


@pytest.fixture(scope="module")
def designs(steering):
    """Return the alternatives by name."""
    return {**{f"{p}": least_norm(steering, p) for p in (2, 4, 8)}, "peak": least_peak(steering)}


def energy(drive):
    """Return the energy until the focus, in samples of V^2."""
    return (drive.before_focus**2).sum()


def test_norm_of_order_two_is_the_exact_law(small, designs):
    """The least 2-norm is the least energy."""
    own = small.drive.before_focus
    assert designs["2"].before_focus == pytest.approx(own, abs=1e-9 * np.abs(own).max())


@pytest.mark.parametrize("name", ["2", "4", "8", "peak"])
def test_every_alternative_meets_the_same_states(designs, name):
    """All states at t_F agree within 1e-13 of the peak; the first sample is at zero volts."""
    assert designs[name].residual <= 1e-13 * 0.2
    assert (designs[name].voltage[:, [0]] == 0).all()


def test_order_four_trades_energy_for_peak_voltage(designs):
    """Order 4 lowers the peak voltage by more than a third for a fifth more energy."""
    assert energy(designs["4"]) / energy(designs["2"]) == pytest.approx(1.2, abs=0.03)
    assert np.abs(designs["4"].before_focus).max() < 0.65 * np.abs(designs["2"].before_focus).max()


def test_peaks_fall_and_energies_rise_with_the_order(designs):
    """Each design minimises its own norm, so the peak falls and the energy rises from order 2 to the least peak."""
    order = [designs[name] for name in ("2", "4", "8", "peak")]
    peaks = [np.abs(one.before_focus).max() for one in order]
    energies = [energy(one) for one in order]
    assert peaks == sorted(peaks, reverse=True)
    assert energies == sorted(energies)


def test_least_norm_is_stationary(small, designs):
    """Optimality of the 4-norm: D (v/D)^3 lies in the row space, orthogonal to changes that keep the states."""
    rng = np.random.default_rng(3)
    n = small.drive.n_before
    ago = np.arange(n)[::-1]
    powers = np.exp(small.system.exponent[:, None] * small.timing.hold * ago)
    read = np.concatenate([small.system.velocity, small.system.displacement])
    held = small.system.held_gain(small.timing.hold)
    inner = slice(400, n - 200)
    rows = np.concatenate([(read @ (held[:, [c]] * powers)).real[:, inner] for c in range(2)], axis=1)
    other = rng.normal(size=rows.shape[1])
    other -= np.linalg.lstsq(rows.T, other, rcond=None)[0] @ rows
    slope = designs["4"].before_focus[:, inner].ravel() ** 3
    assert abs(other @ slope) < 1e-6 * np.linalg.norm(other) * np.linalg.norm(slope)


def test_the_least_peak_excites_unmodelled_modes(small, designs):
    """At the focus it moves a mode of 120 kHz more than ten times as fast as the exact law does."""
    beyond = DiagonalSystem.of(UNMODELLED, small.amplifier)
    exact, least = (
        np.abs(beyond.read(beyond.state_at(drive.before_focus, small.timing, small.timing.focusing_instant))).max()
        for drive in (designs["2"], designs["peak"])
    )
    assert least > 10 * exact
