"""Delay, lag, gain and clock error from records of a scope, against the twin's true values and closed forms."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest

from modaltouch.lab.calibration.acquisition import DecayRecorder, identifying_burst, timing_voltage
from modaltouch.lab.calibration.plant import VibrometerDelay, fit_drive, fit_vibrometer
from modaltouch.preflight import Preflight
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.apparatus_sections import TrueAmplifier


@pytest.mark.parametrize(("kilohertz", "delay"), [(100.0, 5.0), (300.0, 1.0), (30.0, 20.0)])
def test_amplifier_and_clock_are_found_from_the_drive(
    make_bench: Callable, preflight: Preflight, shipped_apparatus: Apparatus, kilohertz: float, delay: float
) -> None:
    """Delay within 10 ns of the truth less the trigger's 50 ns, corner within 2 %, clock within 0.1 ppm of 5."""
    true = shipped_apparatus.twin.model_copy(
        update={"amplifier": TrueAmplifier(bandwidth_kHz=kilohertz, delay_us=delay)}
    )
    bench = make_bench(shipped_apparatus.model_copy(update={"twin": true}), 4)
    listed = preflight.stimulus
    burst = identifying_burst(timing_voltage(listed.model, listed.timing), listed, velocity_limit=0.5)
    commanded = burst.commanded(listed.amplifier.gain)
    taking = DecayRecorder(bench, listed.model, listed.timing, 0.5, 0.0)
    found = fit_drive(taking.drive(burst, float(np.abs(commanded).max())), commanded, listed.timing)
    assert found.delay == pytest.approx(delay * 1e-6 - 50e-9, abs=10e-9)
    assert found.bandwidth == pytest.approx(kilohertz * 1e3, rel=0.02)
    assert found.clock == pytest.approx(5e-6, abs=1e-7)
    assert found.gain == pytest.approx(tuple(bench.twin._gains / listed.amplifier.gain), rel=2e-3)


@pytest.mark.parametrize(("delay", "lag"), list(product([0.5, 4.0, 15.0], [0.3, 0.64])))
def test_vibrometer_delay_and_lag_are_found_from_phases(preflight: Preflight, delay: float, lag: float) -> None:
    """With real gains of any size, half of them with unknown sign."""
    pole = preflight.stimulus.model.exponent
    true = VibrometerDelay(delay * 1e-6, lag * 1e-6, 0.0)
    rng = np.random.default_rng(3)
    gain = rng.uniform(0.5, 2, (pole.size, 2)) * rng.choice([-1, 1], (pole.size, 2))
    sign = np.sign(gain) * np.array([1, 0])
    ratio = gain * true.response(pole)[:, None] * (1 + 1e-4j * rng.standard_normal(gain.shape))
    found = fit_vibrometer(pole, ratio, 1e-4 * np.abs(ratio), sign)
    assert found.delay == pytest.approx(true.delay, abs=30e-9)
    assert found.lag == pytest.approx(true.lag, abs=30e-9)
    assert (ratio / found.response(pole)[:, None]).real == pytest.approx(gain, rel=0.01)
