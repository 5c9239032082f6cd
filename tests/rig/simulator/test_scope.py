"""Simulated vibrometer and scope: chirps and bursts through the real driver, and each imperfection in figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.apparatus_sections import FingerSection, ScopeSection, TrueAmplifier, Vibrometer
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.generator import Generator
from modaltouch.rig.interface import RigError
from modaltouch.rig.scope import Acquisition, Recording
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.scope import _moved, motions_of, normal_quantiles
from modaltouch.rig.simulator.timeline import Playback
from modaltouch.stimulus.burst import Burst

QUIET_SCOPE = ScopeSection(
    bits=24, noise_steps=0.0, clock_offset_ppm=0.0, trigger_latency_us=0.0, trigger_jitter_ns=0.0
)
QUIET_VIBROMETER = Vibrometer(bandwidth_kHz=None, delay_us=0.0, noise_um_s_per_sqrt_Hz=0.0, offset_mm=0.0)


def lab(apparatus: Apparatus, **values: Any) -> Apparatus:
    """Return an apparatus with ideal instruments except for the given values."""
    ideal = {"scope": QUIET_SCOPE, "vibrometer": QUIET_VIBROMETER}
    return apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update=ideal | values)})


def sine(hertz: float = 2000.0, amplitude: float = 4.0, *, n: int = 50_000, cycles: int = 100) -> Playback:
    """Return a continuous sine."""
    wave = np.round(8191 + 8191 * np.sin(2 * np.pi * cycles * np.arange(n) / n)).astype(">u2").tobytes()
    return Playback(wave, amplitude, 0.0, cycles / hertz, cycles / hertz, 8191)


@pytest.fixture
def at(apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Recording]]:
    """Return a function that measures a sine at a position, with an acquisition and differences of the twin."""
    opened: list[Simulator] = []

    def measure(
        position: float = 0.02, asked: Acquisition | None = None, playing: tuple[Any, ...] | None = None, **values: Any
    ) -> Recording:
        simulator = Simulator(lab(apparatus, **values))
        opened.append(simulator)
        sent = (sine(), None) if playing is None else playing
        monkeypatch.setattr(Simulator, "playbacks", property(lambda self: sent))
        with simulator.scope() as scope:
            scope.configure(asked or Acquisition(sampling_rate=1e6, n_samples=5000))
            return scope.measure(position)

    yield measure
    for simulator in opened:
        simulator.close()


def chirp_burst(n: int = 131_072, rate: float = 500e3, highest: float = 110e3, volts: float = 0.8) -> Burst:
    """Return a periodic chirp on output 1; output 2 is silent."""
    time = np.arange(n) / rate
    duration = n / rate
    phase = 2 * np.pi * (50 * time + (highest - 50) * time**2 / 2 / duration)
    codes = np.full((2, n), 8191, dtype=np.uint16)
    codes[0] = np.round(8191 + 8191 * np.sin(phase))
    codes[0, [0, -1]] = 8191
    return Burst(codes, duration, 1 / duration, 0.1, (volts, 0.02), AFG3022B.converter)


def test_a_chirp_through_the_driver_gives_the_true_transfer_function(
    apparatus: Apparatus, guard: Any, patience: Any
) -> None:
    """Output over drive spectrum at the nine peaks agrees with the modes' closed form, within 1 % in the complex plane.

    The chirp of 131,072 points at 500 kS/s plays continuously from a USER memory; the scope takes five samples per
    point, so that no image of the held samples is aliased.
    """
    with (
        Simulator(lab(apparatus, amplifier=TrueAmplifier(bandwidth_kHz=300.0, delay_us=1.0))) as simulator,
        Generator(simulator.address, apparatus, patience=patience, repetition="continuous", start_guard=guard) as rig,
        simulator.scope() as scope,
    ):
        rig.load(chirp_burst())
        assert rig.fire(0.1).started
        scope.configure(Acquisition(sampling_rate=2.5e6, n_samples=5 * 131_072, drives=(1, 2)))
        seen = scope.measure(0.05)
        beam = simulator.twin.beam
    assert seen.overloaded == ()
    assert np.abs(seen.drive[0, 1]).max() < 1e-3
    frequency = np.fft.rfftfreq(seen.time.size, 1 / seen.sampling_rate)
    measured = np.fft.rfft(seen.velocity[0]) / np.fft.rfft(seen.drive[0, 0])
    for hertz in beam.table.natural_frequency:
        nearest = int(np.argmin(np.abs(frequency - hertz)))
        omega, own = 2 * np.pi * frequency[nearest], 2 * np.pi * beam.natural_frequency
        dynamic = 1j * omega * beam.modal_gain[:, 0] / (own**2 - omega**2 + 2j * beam.damping_ratio * own * omega)
        exact = beam.shapes(0.05)[:, 0] @ dynamic
        assert measured[nearest] == pytest.approx(exact, rel=0.01)


def test_a_scan_of_the_burst_gives_the_field_at_the_focusing_instant(apparatus: Apparatus, burst: Burst) -> None:
    """At five positions the velocity at an instant is the true one: shapes times true modal velocities.

    Within half a step of 24 bits, 30 nm/s, and 2e-5 of the peak.
    """
    with Simulator(lab(apparatus)) as quiet:
        for number, codes in enumerate(burst.codes, start=1):
            quiet.afg.user[number] = codes.astype(">u2").tobytes()
            quiet.front_panel(f"SOUR{number}:FUNC USER{number};FREQ 20;BURS:STAT ON;:SOUR{number}:VOLT 2")
            quiet.front_panel(f"SOUR{number}:BURS:NCYC 1;:OUTP{number} ON;:TRIG:TIM 0.142857")
        with quiet.scope() as scope:
            scope.configure(Acquisition(sampling_rate=1.25e6, n_samples=62_500))
            for position in (-0.04, -0.02, 0.0, 0.02, 0.04):
                seen = scope.measure(position)
                index = int(np.argmin(np.abs(seen.time - 0.025)))
                state = quiet.true_state(float(seen.time[index]))
                shapes = quiet.twin.beam.shapes(position)[:, 0]
                true = shapes @ np.append(state.velocity, state.unlisted_velocity)
                assert seen.velocity[0, index] == pytest.approx(true, abs=2e-5 * np.abs(seen.velocity).max() + 3e-8)


def test_a_missing_trigger_is_an_error_with_its_cause(simulator: Simulator) -> None:
    """With the outputs off nothing starts a record."""
    with simulator.scope() as scope, pytest.raises(RigError, match="no trigger came .* neither of its outputs plays"):
        scope.measure(0.0)


def test_a_position_off_the_beam_is_refused(at: Callable[..., Recording]) -> None:
    """60 mm from the middle of a beam of 100 mm."""
    with pytest.raises(ValueError, match="position 60 mm is not on the beam"):
        at(0.06)


def test_a_tripped_amplifier_leaves_only_noise(simulator: Simulator, monkeypatch: pytest.MonkeyPatch) -> None:
    """The drive reads only the noise of the converter, and the velocity that of the vibrometer."""
    monkeypatch.setattr(Simulator, "playbacks", property(lambda self: (sine(), None)))
    simulator.twin.tripped = True
    with simulator.scope() as scope:
        scope.configure(Acquisition(n_samples=2000, velocity_range=0.05, drive_range=5.0))
        seen = scope.measure(0.0)
    assert np.abs(seen.drive).max() <= 3 * 5.0 / 127
    assert 0 < np.abs(seen.velocity).max() < 6e-3


@pytest.mark.parametrize("bits", [8, 12])
def test_the_converter_has_its_number_of_bits(at: Callable[..., Recording], bits: int) -> None:
    """Every voltage is a whole number of steps of range / (2^(bits-1) - 1), with an error of half a step at most."""
    asked = Acquisition(sampling_rate=1e6, n_samples=5000, drive_range=100.0)
    coarse = at(asked=asked, scope=QUIET_SCOPE.model_copy(update={"bits": bits}))
    exact = at(asked=asked)
    step = 100.0 / (2 ** (bits - 1) - 1)
    steps = coarse.drive / step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.abs(coarse.drive - exact.drive).max() <= step / 2 + 2e-5


def test_a_signal_beyond_its_range_is_clipped_and_reported(at: Callable[..., Recording]) -> None:
    """50 V in a range of 20 V: clipped there, and reported for the drive, not for the velocity."""
    seen = at(asked=Acquisition(sampling_rate=1e6, n_samples=5000, drive_range=20.0))
    assert seen.overloaded == ("drive 1",)
    assert np.abs(seen.drive).max() == pytest.approx(20.0)


def test_the_vibrometer_has_its_own_range(apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch) -> None:
    """A range of 1 mm/s clips what the scope could still record."""
    knobs = apparatus.acquisition.model_copy(update={"range_mm_s": 1.0, "sensitivity_mm_s_per_V": 0.7})
    monkeypatch.setattr(Simulator, "playbacks", property(lambda self: (sine(), None)))
    with Simulator(lab(apparatus).model_copy(update={"acquisition": knobs})) as simulator, simulator.scope() as scope:
        scope.configure(Acquisition(sampling_rate=1e6, n_samples=5000))
        seen = scope.measure(0.0)
    assert "velocity" in seen.overloaded
    assert np.abs(seen.velocity).max() == pytest.approx(1e-3, rel=1e-5)


@pytest.mark.parametrize("corner", [None, 100.0])
def test_noise_has_the_stated_density(at: Callable[..., Recording], corner: float | None) -> None:
    """Mean of the periodogram below a tenth of the corner: density^2, within its own scatter (3 %)."""
    vibrometer = Vibrometer(bandwidth_kHz=corner, delay_us=0.0, noise_um_s_per_sqrt_Hz=2.0, offset_mm=0.0)
    asked = Acquisition(sampling_rate=2.5e6, n_samples=2**18, drives=())
    noise = at(asked=asked, vibrometer=vibrometer).velocity[0] - at(asked=asked).velocity[0]
    power = np.abs(np.fft.rfft(noise)) ** 2 * 2 / (noise.size * 2.5e6)
    frequency = np.fft.rfftfreq(noise.size, 1 / 2.5e6)
    low = power[(frequency > 100) & (frequency < 10e3)]
    assert np.sqrt(low.mean()) == pytest.approx(2e-6, rel=3 / np.sqrt(low.size) + 0.01)
    if corner is not None:
        at_corner = power[(frequency > 95e3) & (frequency < 105e3)]
        assert np.sqrt(at_corner.mean()) == pytest.approx(2e-6 / np.sqrt(2), rel=0.08)


@pytest.mark.parametrize("corner", [None, 100.0])
def test_noise_of_converter_and_vibrometer_is_added(at: Callable[..., Recording], corner: float | None) -> None:
    """At each frequency the sum of both densities: the converter's is white over the whole band of the scope."""
    vibrometer = Vibrometer(bandwidth_kHz=corner, delay_us=0.0, noise_um_s_per_sqrt_Hz=2.0, offset_mm=0.0)
    asked = Acquisition(sampling_rate=2.5e6, n_samples=2**18, drives=(), velocity_range=0.5)
    noisy = QUIET_SCOPE.model_copy(update={"bits": 12, "noise_steps": 10.0})
    noise = at(asked=asked, vibrometer=vibrometer, scope=noisy).velocity[0] - at(asked=asked).velocity[0]
    power = np.abs(np.fft.rfft(noise)) ** 2 * 2 / (noise.size * 2.5e6)
    frequency = np.fft.rfftfreq(noise.size, 1 / 2.5e6)
    # Including rounding, a twelfth of a step squared.
    white = (10**2 + 1 / 12) * (0.5 / 2047) ** 2 / 1.25e6
    for low, high in ((100, 10e3), (95e3, 105e3), (600e3, 620e3)):
        some = (frequency > low) & (frequency < high)
        behind = 1.0
        if corner is not None:
            pole = np.exp(-2 * np.pi * corner * 1e3 / 2.5e6)
            total = np.pi / 2 * corner * 1e3 / 1.25e6 * (1 - pole**2)
            behind = total / (1 - 2 * pole * np.cos(np.pi * (low + high) / 2.5e6) + pole**2)
        expected = white + (2e-6) ** 2 * behind
        assert power[some].mean() == pytest.approx(expected, rel=4 / np.sqrt(some.sum()) + 0.03)


def test_the_noise_of_the_vibrometer_is_stationary(at: Callable[..., Recording]) -> None:
    """Of 4,000 records, the first sample scatters like the twentieth: by sqrt(pi/2 * corner) times the density."""
    vibrometer = Vibrometer(bandwidth_kHz=100.0, delay_us=0.0, noise_um_s_per_sqrt_Hz=2.0, offset_mm=0.0)
    asked = Acquisition(sampling_rate=2.5e6, n_samples=20, n_records=4000, drives=())
    noise = at(asked=asked, vibrometer=vibrometer).velocity - at(asked=asked).velocity
    spread = 2e-6 * np.sqrt(np.pi / 2 * 100e3)
    np.testing.assert_allclose(noise.std(axis=0), spread, rtol=4 / np.sqrt(2 * 4000))
    assert np.corrcoef(noise[:, 0], noise[:, 1])[0, 1] == pytest.approx(np.exp(-2 * np.pi * 0.04), abs=0.02)


def test_the_table_of_quantiles_is_normal() -> None:
    """Its distribution is normal to within half a step of 2**-16; variance 1, kurtosis 3 to 1e-3."""
    values = normal_quantiles()
    np.testing.assert_allclose(norm.cdf(values), (np.arange(2**16) + 0.5) / 2**16, atol=2**-17)
    assert values.std() == pytest.approx(1, abs=1e-12)
    assert (values**4).mean() == pytest.approx(3, rel=1e-3)


def test_delays_add_up(at: Callable[..., Recording]) -> None:
    """Velocity is late by amplifier and vibrometer, drive by the amplifier, both early by the trigger latency."""
    asked = Acquisition(sampling_rate=1e6, n_samples=5000, start=0.3e-6)
    plain = at(asked=asked, amplifier=TrueAmplifier(delay_us=0.0))
    late = at(
        asked=asked,
        amplifier=TrueAmplifier(delay_us=30.0),
        vibrometer=QUIET_VIBROMETER.model_copy(update={"delay_us": 20.0}),
        scope=QUIET_SCOPE.model_copy(update={"trigger_latency_us": 10.0}),
    )
    np.testing.assert_allclose(late.velocity[0, 40:], plain.velocity[0, :-40], atol=1e-6)
    np.testing.assert_allclose(late.drive[0, 0, 20:], plain.drive[0, 0, :-20], atol=1e-3)


def test_a_fast_clock_of_the_scope_stretches_the_record(at: Callable[..., Recording]) -> None:
    """1000 ppm fast: its sample 50,000 is at the instant of sample 49,950 of a true clock."""
    asked = Acquisition(sampling_rate=1e6, n_samples=50_001)
    fast = at(asked=asked, scope=QUIET_SCOPE.model_copy(update={"clock_offset_ppm": 1000.0}))
    true = at(asked=asked)
    assert fast.velocity[0, 50_000] == pytest.approx(
        np.interp(50_000 / 1.001, np.arange(50_001), true.velocity[0]), rel=1e-3
    )
    assert (fast.time == true.time).all()


def test_trigger_jitter_shifts_whole_records(at: Callable[..., Recording]) -> None:
    """Drive and velocity of a record shift together, by the stated spread: here 2 us over 60 records of a sine."""
    asked = Acquisition(sampling_rate=1e6, n_samples=1000, n_records=60)
    finely = (sine(n=125_000, cycles=10), None)
    seen = at(asked=asked, playing=finely, scope=QUIET_SCOPE.model_copy(update={"trigger_jitter_ns": 2000.0}))
    tone = np.exp(-2j * np.pi * 2000.0 * seen.time)
    moved = [np.unwrap(np.angle(each @ tone)) / (2 * np.pi * 2000.0) for each in (seen.velocity, seen.drive[:, 0])]
    np.testing.assert_allclose(moved[0] - moved[0][0], moved[1] - moved[1][0], atol=5e-8)
    assert np.std(moved[0]) == pytest.approx(2e-6, rel=0.3)


def test_small_jitter_is_approximated_along_the_slope(apparatus: Apparatus) -> None:
    """Against records computed one by one: up to 108 kHz, with a phase shift of 7e-3, within 3e-5 of the peak."""
    simulator = Simulator(lab(apparatus))
    with simulator:
        drive = sine(105e3, cycles=100, n=5000)
        time, shifts = np.arange(200) * 0.4e-6, np.linspace(-1e-8, 1e-8, 5)
        motions = motions_of(
            simulator.twin, [None, drive], 0.05, offset=0.0, bandwidth=None, touched=(), span=(-1e-8, 8e-5)
        )
        together = _moved(motions, time, shifts)
    for moved, shift in zip(together, shifts, strict=True):
        alone = motions[0].at(time + shift)
        np.testing.assert_allclose(moved, alone, atol=3e-5 * np.abs(alone).max())


def test_equal_seeds_give_equal_recordings(apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two scopes with one seed agree, another seed differs; two records of one scope differ."""
    monkeypatch.setattr(Simulator, "playbacks", property(lambda self: (sine(), None)))
    seen = []
    for seed in (3, 3, 4):
        with Simulator(apparatus, seed) as simulator, simulator.scope() as scope:
            scope.configure(Acquisition(n_samples=500, n_records=2))
            seen.append(scope.measure(0.01).velocity)
    assert (seen[0] == seen[1]).all()
    assert not np.allclose(seen[0], seen[2])
    assert not np.allclose(seen[0][0], seen[0][1])


def test_the_sampling_rate_is_a_whole_fraction_of_the_clock(at: Callable[..., Recording]) -> None:
    """For 900 kHz from 125 MHz the nearest is 125/139 MHz, and the recording has that rate."""
    seen = at(asked=Acquisition(sampling_rate=900e3, n_samples=100))
    assert seen.sampling_rate == pytest.approx(125e6 / 139, rel=1e-12)
    assert seen.time[1] == pytest.approx(139 / 125e6, rel=1e-12)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (
            Acquisition(sampling_rate=2e8),
            "2e\\+08 samples per second are asked for: the scope takes at most 1.25e\\+08",
        ),
        (Acquisition(n_samples=1_500_000, drives=(1, 2)), "1500000 samples of 3 channels .* memory holds 1333333"),
    ],
)
def test_impossible_acquisitions_are_refused(simulator: Simulator, asked: Acquisition, words: str) -> None:
    """Rate and memory; the message gives the limits."""
    with simulator.scope() as scope, pytest.raises(RigError, match=words):
        scope.configure(asked)


def test_samples_before_the_trigger_show_the_previous_burst(at: Callable[..., Recording]) -> None:
    """Bursts every 60 ms: 10 ms before a trigger is 50 ms after the last one."""
    wave = np.round(8191 + 8191 * np.sin(np.pi * np.arange(20_000) / 20_000) ** 2).astype(">u2").tobytes()
    burst = Playback(wave, 4.0, 0.0, 0.05, 0.06, 8191)
    before = at(asked=Acquisition(sampling_rate=1e6, n_samples=20_000, start=-0.01), playing=(burst, None))
    after = at(asked=Acquisition(sampling_rate=1e6, n_samples=70_000), playing=(burst, None))
    np.testing.assert_allclose(before.velocity[0, :10_000], after.velocity[0, 50_000:60_000], atol=1e-8)
    np.testing.assert_allclose(before.velocity[0, 10_000:], after.velocity[0, :10_000], atol=1e-8)


def test_fingers_on_the_beam_change_the_measurement(apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch) -> None:
    """Laid on A and C they reduce the velocity; after lifting, it is as before."""
    monkeypatch.setattr(Simulator, "playbacks", property(lambda self: (sine(229.0, cycles=10), None)))
    heavy = lab(apparatus, fingers=FingerSection(mass_g=0.2, damping_N_s_per_m=1.0))
    speeds = []
    with Simulator(heavy) as simulator, simulator.scope() as scope:
        scope.configure(Acquisition(sampling_rate=1e6, n_samples=40_000))
        for places in ((), ("A", "C"), ()):
            simulator.touch(places)
            speeds.append(np.abs(scope.measure(0.0).velocity).max())
    assert speeds[1] < 0.9 * speeds[0]
    assert speeds[2] == speeds[0]
