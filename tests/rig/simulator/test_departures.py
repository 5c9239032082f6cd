"""A twin that is not linear and constant: drift, softening, hysteresis and dropouts, all off by default."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.apparatus_sections import TwinSection
from modaltouch.rig.scope import Acquisition
from modaltouch.rig.simulator.motion import PLAYS, lagging
from modaltouch.rig.simulator.scope import SimulatedScope
from modaltouch.rig.simulator.timeline import Delays, Playback, Timeline
from modaltouch.rig.simulator.twin import Twin


def frequency(twin: Twin, *playbacks: Playback | None) -> float:
    """Return the first natural frequency during playback, over that of the beam at rest [1]."""
    system = twin.system((), twin.stretch(playbacks))
    return float(np.abs(system.exponent[0]) / np.abs(Twin(twin.apparatus, twin.seed).system().exponent[0]))


def test_the_shipped_twin_is_linear_and_constant() -> None:
    """Drift, softening, hysteresis and dropouts are zero by default."""
    shipped = TwinSection()
    assert (shipped.frequency_drift, shipped.softening, shipped.hysteresis) == (0, 0, 0)
    assert shipped.vibrometer.dropouts_Hz == 0


def test_each_measurement_shifts_the_frequencies(with_twin: Callable[..., Apparatus], apparatus: Apparatus) -> None:
    """By 1e-4 per measurement, whatever is played: by a thousandth after ten measurements."""
    twin = Twin(with_twin(apparatus, frequency_drift=1e-4), 1)
    twin.n_measured = 10
    assert frequency(twin) == pytest.approx(1.001, abs=1e-9)


def test_softening_grows_with_the_square_of_the_amplitude(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """Duffing's law: 1 % at the limit of 250 V is a quarter of that at half the voltage."""
    twin = Twin(with_twin(apparatus, softening=0.01), 1)
    assert frequency(twin, playback(20.0), None) == pytest.approx(0.99, abs=1e-4)
    assert frequency(twin, playback(10.0), None) == pytest.approx(0.9975, abs=1e-4)


def stepped(volts: np.ndarray, share: float, limit: float) -> np.ndarray:
    """Return the hysteresis sample by sample, over two bursts: play operators by their definition."""
    result, reached = [], [0.0] * len(PLAYS)
    for volt in [*volts, *volts]:
        widths = [part * limit for part in PLAYS]
        reached = [max(volt - r, min(volt + r, y)) for r, y in zip(widths, reached, strict=True)]
        result.append((1 - share) * volt + share * np.mean(reached))
    return np.array(result[volts.size :]) - share * np.mean(reached)


def test_hysteresis_agrees_with_play_operators() -> None:
    """Against the definition, sample by sample, on a random walk with plateaus and with frequent and rare reversals."""
    rng = np.random.default_rng(0)
    volts = np.cumsum(rng.integers(-3, 4, 4000)) * 1.5
    volts = np.clip(volts - np.linspace(0, volts[-1], volts.size), -240, 240)
    np.testing.assert_allclose(lagging(volts[None], 0.2, 250.0)[0], stepped(volts, 0.2, 250.0), atol=1e-9)


def test_hysteresis_loops_grow_faster_than_the_voltage() -> None:
    """Rayleigh's law: the response per volt increases with the amplitude, and each cycle dissipates energy."""
    wave = np.sin(2 * np.pi * np.arange(4000) / 1000)

    def of(volts: float) -> tuple[float, float]:
        force = lagging(volts * wave[None], 0.2, 250.0)[0]
        return float(force @ wave / (wave @ wave)) / volts, float(-force @ np.gradient(volts * wave))

    (small, lost_small), (large, lost_large) = of(100.0), of(200.0)
    assert 0.8 <= small < large < 1
    assert 0 < 4 * lost_small < lost_large


def test_the_velocity_with_hysteresis_is_not_proportional_to_voltage(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """Twice the voltage gives more than twice the velocity with hysteresis, and exactly twice without."""
    for share, low, high in ((0.2, 2.01, 2.5), (0.0, 1.999999, 2.000001)):
        twin = Twin(with_twin(apparatus, hysteresis=share), 1)
        one, two = (float(twin.felt((playback(volts), None), [0.0])[0]) for volts in (10.0, 20.0))
        assert low < two / one < high


def test_dropouts_of_the_vibrometer_read_zero_velocity(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """Gaps of 0.2 ms at the given rate: 1,000 per second leave about a fifth of a record without signal."""
    vibrometer = apparatus.twin.vibrometer.model_copy(update={"dropouts_Hz": 1000.0, "noise_um_s_per_sqrt_Hz": 0.0})
    scope_section = apparatus.twin.scope.model_copy(update={"noise_steps": 0.0})
    twin = Twin(with_twin(apparatus, vibrometer=vibrometer, scope=scope_section), 1)
    with SimulatedScope(twin, lambda: (playback(20.0), None), lambda: (), Timeline(Delays())) as scope:
        scope.configure(Acquisition(sampling_rate=1e5, n_samples=3000, n_records=10, start=0.01))
        dark = np.mean(scope.measure(0.0).velocity == 0)
    assert 0.12 < dark < 0.25
    assert twin.n_measured == 1
