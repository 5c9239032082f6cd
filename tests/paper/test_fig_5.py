"""Figure 5 and section IV-A: spot, duration and speeds of the focus, for the shipped field."""

import numpy as np
import pytest
from forward import velocity_history


@pytest.fixture(scope="module")
def history(shipped):
    """Return velocities at 41 points along the beam during the burst [m/s]."""
    return velocity_history(shipped.model, shipped.voltage, shipped.timing, np.linspace(-0.05, 0.05, 41))


def test_spot_measures_roughly_one_and_a_half_centimetres(shipped):
    """Section IV-A: "a spot measuring roughly 1.5 cm"; 14 mm at 80 % of the peak."""
    assert shipped.projection.width(0.8) == pytest.approx(0.015, abs=0.0015)


def test_peak_lasts_roughly_twenty_microseconds(shipped, history):
    """Section IV-A: held "for roughly 20 us"; above 90 % for 16 us."""
    centre = history[20]
    assert np.count_nonzero(centre > 0.9 * 0.2) * shipped.timing.hold == pytest.approx(16e-6, abs=3e-6)


def test_speed_at_the_focus_peaks_at_the_focusing_instant(shipped, history):
    """Section IV-A: 200 mm/s at 25 ms in the middle of the beam."""
    centre = history[20]
    assert centre[62_500] == pytest.approx(0.2, rel=1e-12)
    assert abs(int(np.abs(centre).argmax()) - 62_500) * shipped.timing.hold < 2e-6


def test_neighbours_reach_roughly_half(history):
    """Section V-C: extrema of roughly half the speed at +-25 mm (printed 0.025 mm) before and after."""
    near = slice(62_500 - 2500, 62_500 + 2500)
    for place in (10, 30):
        assert np.abs(history[place, near]).max() == pytest.approx(0.1, abs=0.02)


def test_overall_process_lasts_fifty_milliseconds(shipped, history):
    """Section IV-A: "the overall process lasts 50 ms": braked, the beam is at rest at its end."""
    assert shipped.timing.duration == 0.05
    assert np.abs(history[:, -1]).max() < 1e-6
