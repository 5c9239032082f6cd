"""Front ends, against signals whose features are known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modaltouch.planning.felt import CUT_OFF, sense

RATE = 50_000.0
TIME = np.arange(5000) / RATE
WINDOW = np.sin(np.pi * TIME / TIME[-1]) ** 2


def tone(frequency: float, amplitude: float = 1.0) -> np.ndarray:
    """Return a tone that fades in and out, at rest at both ends."""
    return amplitude * WINDOW * np.sin(2 * np.pi * frequency * TIME)


def test_the_root_mean_square_is_that_of_a_sine() -> None:
    """It is 1/sqrt(2) over whole periods."""
    sine = np.sin(2 * np.pi * 200 * TIME)
    assert sense("rms", sine, RATE)[0] == pytest.approx(1 / math.sqrt(2), rel=1e-6)


@pytest.mark.parametrize(("frequency", "passes"), [(200.0, 1.0), (CUT_OFF, 1 / math.sqrt(2)), (4000.0, 4.0**-4)])
def test_below_1_khz_has_a_butterworth_response(frequency: float, passes: float) -> None:
    """The gain is 1 / sqrt(1 + (f / 1 kHz)^8), in closed form."""
    felt = sense("below_1_khz", tone(frequency), RATE)[0]
    assert felt == pytest.approx(passes * float(np.abs(tone(frequency)).max()), rel=0.02, abs=1e-4)


def test_the_envelope_follows_vibration_above_1_khz() -> None:
    """It is 2/pi of the amplitude, the mean of a rectified sine; the front end below 1 kHz gives nothing."""
    fast = tone(6000.0)
    assert sense("envelope", fast, RATE)[0] == pytest.approx(2 / math.pi, rel=0.02)
    assert sense("below_1_khz", fast, RATE)[0] < 0.001


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(["rms", "below_1_khz", "envelope"]), st.floats(1e-3, 1e3))
def test_every_front_end_scales_with_the_level(front_end: str, level: float) -> None:
    """Each front end is linear in velocity; the cache of levels relies on it."""
    history = np.stack([tone(230.0) + 0.4 * tone(2500.0), tone(230.0, 0.5)])
    once = sense(front_end, history, RATE)  # type: ignore[arg-type]
    assert sense(front_end, level * history, RATE) == pytest.approx(level * once, rel=1e-9)  # type: ignore[arg-type]
