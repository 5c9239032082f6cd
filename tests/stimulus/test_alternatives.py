"""Other designs for the same states: what they save, and what they cost."""

import numpy as np
import pytest

from modaltouch.stimulus.alternative_designs import least_norm, least_peak, trade
from modaltouch.stimulus.design import ModalModel, Timing

UNMODELLED = ModalModel((19,), [120e3], [0.015], [[50.0, 50.0]], 0.1)


@pytest.fixture(scope="module")
def small(design):
    """Return the shipped stimulus on few samples, which keeps the linear programme short."""
    return design(timing=Timing(n_samples=12_500))


@pytest.fixture(scope="module")
def designs(small):
    """Return the alternatives by name."""
    return {"2": least_norm(small, 2), "4": least_norm(small, 4), "8": least_norm(small, 8), "peak": least_peak(small)}


def test_norm_of_order_two_is_the_exact_law(small, designs):
    """The least 2-norm is the least energy."""
    own = small.voltage[:, : small.drive.n_before]
    assert designs["2"].voltage == pytest.approx(own, abs=1e-9 * np.abs(own).max())


@pytest.mark.parametrize("name", ["2", "4", "8", "peak"])
def test_every_alternative_meets_the_same_states(designs, name):
    """Issue 3: all states at t_F within 1e-13 of the peak; the first and the last sample at zero volts."""
    assert designs[name].residual <= 1e-13 * 0.2
    assert (designs[name].voltage[:, [0]] == 0).all()


def test_order_four_trades_energy_for_peak_voltage(small, designs):
    """physics.md section 4: p = 4 takes much off the peak voltage for a fifth more energy."""
    hold = small.timing.hold
    assert designs["4"].energy(hold) / designs["2"].energy(hold) == pytest.approx(1.2, abs=0.03)
    assert designs["4"].peak_voltage < 0.65 * designs["2"].peak_voltage


def test_peaks_fall_and_energies_rise_with_the_order(small, designs):
    """Each is the least of its own norm."""
    order = [designs[name] for name in ("2", "4", "8", "peak")]
    peaks = [one.peak_voltage for one in order]
    energies = [one.energy(small.timing.hold) for one in order]
    assert peaks == sorted(peaks, reverse=True)
    assert energies == sorted(energies)


def test_least_norm_is_stationary(small, designs):
    """Optimality of the 4-norm: D (v/D)^3 lies in the row space, so that it is orthogonal to what changes no state."""
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
    slope = designs["4"].voltage[:, inner].ravel() ** 3
    assert abs(other @ slope) < 1e-6 * np.linalg.norm(other) * np.linalg.norm(slope)


def test_bang_bang_shakes_what_the_model_leaves_out(small, designs):
    """physics.md section 4: the least peak shakes unmodelled modes; the trade says by how much."""
    rows = trade(small, [designs["4"], designs["peak"]], UNMODELLED)
    speed = [row["unmodelled_speed"] for row in rows]
    assert [row["name"] for row in rows] == ["exact", "4-norm", "least peak"]
    assert speed[2] > 10 * speed[0]
    assert rows[0]["peak_voltage"] == pytest.approx(small.peak_voltage.max())


def test_senseless_orders_and_steps_are_refused(small):
    """Bounds with remedies."""
    with pytest.raises(ValueError, match=r"norm's order is 1\.5; it must lie between 2 and 16"):
        least_norm(small, 1.5)
    with pytest.raises(ValueError, match=r"9000 held steps; .* at most 8192: take 1024"):
        least_peak(small, 9000)
    with pytest.raises(ValueError, match=r"18 held steps; a linear programme of 18 conditions takes more"):
        least_peak(small, 18)
