"""Excitation of a probe, a multisine on all outputs with separate frequencies for each, and the measured responses.

Some frequencies are spaced logarithmically, the others lie near the resonances. The frequencies are interleaved over
the outputs, so that one record separates them; the noise is measured at the bins between. Responses are relative to
the commanded voltages, so an error in the gain of generator or amplifier appears as one of the beam, and a design
compensates for it.

The first burst of a trial also serves as a probe: `BurstRecord` relates its spectrum to that of the drive voltages.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.common import ComplexArray, FloatArray, low_pass
from modaltouch.lab.identification.excitation import HEADROOM, OVERSAMPLING, RATE
from modaltouch.lab.laboratory import Laboratory
from modaltouch.protocol import Apparatus
from modaltouch.rig import Acquisition, Recording, RigError, instrument_of
from modaltouch.stimulus import Burst, DiagonalSystem, Finger, ModalModel, Probe, Stimulus

N_SAMPLES = 65_536
"""Samples per period, played at `RATE`: 0.131 s."""

SPACING = RATE / N_SAMPLES
"""Bin spacing [Hz]."""

LOWEST, HIGHEST, N_SPREAD = 60.0, 100e3, 60
"""Lowest and highest of the logarithmically spaced frequencies [Hz], and their number."""

NEAR = (0.96, 0.98, 0.99, 1.0, 1.01, 1.02, 1.04)
"""Frequencies near a resonance, relative to its natural frequency [1]."""

FURTHEST = 115e3
"""Upper limit of all frequencies [Hz]."""

N_RECORDS = 2
"""Number of periods, recorded one by one; they differ if a finger moves."""

GAP = 4
"""Spacing of the frequencies [bins]; separates them in windowed records despite the difference between the clocks."""

EVEN = 0.75
"""Power of the response by which the drive is divided; with 1 the velocity is the same at all frequencies [1]."""

N_SILENT = 25
"""Number of neighbouring silent bins whose median power gives the noise."""

ROOM = 0.8
"""Largest fraction of the amplifier's limit used by a probe [1]."""


@dataclass(frozen=True, eq=False)
class Excitation:
    """The sines of a probe."""

    burst: Burst  # one period of the excitation
    bins: NDArray[np.intp]  # (n_lines,): frequencies in units of `SPACING`, increasing
    channel: NDArray[np.intp]  # (n_lines,): output that plays each frequency, counted from 0
    line: ComplexArray  # (n_lines,): voltage at the beam at each frequency, as half the complex amplitude [V]

    @classmethod
    def of(
        cls,
        apparatus: Apparatus,
        model: ModalModel,
        placements: Sequence[Sequence[Finger]],
        laser: float,
        speed: float,
    ) -> Excitation:
        """Design sines that keep the speed of the beam within a limit, with and without fingers.

        Parameters
        ----------
        apparatus, model
            Amplifier and generator, and an approximate model of the beam.
        placements : sequence of sequences of Finger
            Expected fingers of each placement.
        laser, speed : float
            Position of the vibrometer's spot [m], and highest speed there and at the fingers [m/s].
        """
        bins, channel = _lines(model)
        places = [laser, *dict.fromkeys(finger.position for fingers in placements for finger in fingers)]
        responses = [_responses(model.touched(tuple(fingers)), places, bins) for fingers in ((), *placements)]
        # Drive the beam less where it responds more, so that all frequencies rise above the noise.
        size = np.abs(responses[0][0][channel, np.arange(bins.size)]) ** -EVEN
        line = size * np.exp(1j * np.pi * np.arange(bins.size) ** 2 / bins.size)
        own = np.where(channel == np.arange(model.n_channels)[:, None], line, 0)
        moved = np.array(
            [
                [_wave(each, line, bins) for each, line in zip(place, own, strict=True)]
                for beam in responses
                for place in beam
            ]
        )
        # Scale the outputs to move the beam equally.
        share = 1 / np.abs(moved).max(axis=(0, 2))
        voltage = np.stack([_wave(1.0, row, bins) for row in own]) * share[:, None]
        # The generator starts and ends at zero, so start the period where the voltages are lowest.
        quietest = int((np.abs(voltage) + np.abs(np.roll(voltage, 1, axis=1))).max(axis=0).argmin())
        voltage = np.roll(voltage, -quietest, axis=1)
        highest = float(np.abs(np.tensordot(share, moved, (0, 1))).max())
        limit = ROOM * apparatus.amplifier.limit_V
        voltage *= np.minimum(speed / highest, limit / np.abs(voltage).max(axis=1))[:, None]
        converter = instrument_of(apparatus).converter
        burst = Burst.holding(voltage, apparatus.to_beam, speed, converter, N_SAMPLES / RATE, SPACING)
        return cls(burst, bins, channel, _at_beam(apparatus, burst, bins)[channel, np.arange(bins.size)])

    def probe(self, laboratory: Laboratory, laser: float, speed: float, bandwidth: float | None) -> list[Probe]:
        """Measure the responses at a point of the beam, one probe per period.

        Parameters
        ----------
        laser, speed : float
            Position of the vibrometer's spot [m], and highest expected speed there [m/s].
        bandwidth : float or None
            Corner of the vibrometer's low-pass [Hz].

        Raises
        ------
        ValueError
            If an input was overloaded.
        RigError
            If the rig fails.
        """
        laboratory.rig.load(self.burst, repetition="continuous")
        widest = laboratory.apparatus.acquisition.range_mm_s * 1e-3
        # A beam with fingers may move faster than the expected ones let it.
        for expected in (HEADROOM * speed, 2 * HEADROOM * speed):
            asked = Acquisition(
                sampling_rate=OVERSAMPLING * RATE,
                n_samples=int(OVERSAMPLING * N_SAMPLES),
                n_records=N_RECORDS,
                drives=(),
                velocity_range=min(expected, widest),
            )
            recording = laboratory.record(laser, self.burst.velocity, asked)
            if not recording.overloaded:
                return [self._response(recording, number, bandwidth) for number in range(N_RECORDS)]
            if expected >= widest:
                break
        raise ValueError(
            f"{', '.join(recording.overloaded)} is overloaded; check that nothing knocks on the beam or touches it "
            "but the fingers, choose a wider range at the vibrometer, and enter it in the apparatus file; or give "
            "`fingers probe` a lower --speed-mm-s"
        )

    def _response(self, recording: Recording, number: int, bandwidth: float | None) -> Probe:
        from scipy.signal import zoom_fft

        n, n_bins = recording.time.size, int(self.bins[-1]) + 2 * N_SILENT
        window = 1 - np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)
        # A file may hold other than whole samples of a period, and begin within a sample.
        band, rate = [0.0, n_bins * SPACING], recording.sampling_rate
        velocity = zoom_fft(recording.velocity[number] * window, band, n_bins, fs=rate) / n
        velocity = velocity * np.exp(-2j * np.pi * SPACING * recording.time[0] * np.arange(n_bins))
        frequency = np.asarray(self.bins * SPACING, dtype=float)
        per_volt = 1 / (low_pass(frequency, bandwidth) * self.line)
        near = self.bins[:, None] + np.arange(1 - GAP, GAP)
        silent = np.setdiff1d(np.arange(GAP, n_bins), near)
        deviation = noise_level(velocity, silent, self.bins) * np.abs(per_volt) / np.sqrt(2)
        drive = np.eye(len(self.burst.codes))[self.channel]
        return Probe(recording.position, frequency, drive, velocity[self.bins] * per_volt, deviation)


def noise_level(spectrum: ComplexArray, silent: NDArray[np.intp], places: FloatArray | NDArray[np.intp]) -> FloatArray:
    """Return the root mean square of a spectrum's noise at fractional bins, interpolated from its silent bins."""
    near = silent[: silent.size // N_SILENT * N_SILENT].reshape(-1, N_SILENT)
    power = np.median(np.abs(spectrum[near]) ** 2, axis=1) / np.log(2)
    return np.asarray(np.sqrt(np.interp(places, near.mean(axis=1), power)))


def _lines(model: ModalModel) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the bins that are played, increasing, and the output that plays each."""
    near = np.outer(model.natural_frequency, NEAR).ravel()
    wanted = np.concatenate([np.geomspace(LOWEST, HIGHEST, N_SPREAD), near[(near > LOWEST) & (near < FURTHEST)]])
    n = model.n_channels
    first = np.unique(np.round(wanted / (SPACING * GAP * n)).astype(np.intp)) * GAP * n
    return (first[:, None] + GAP * np.arange(n)).ravel(), np.tile(np.arange(n), first.size)


def _responses(model: ModalModel, places: Sequence[float], bins: NDArray[np.intp]) -> ComplexArray:
    """Return the velocity per volt, (n_places, n_channels, n_lines) array [m/s per V]."""
    system, s = DiagonalSystem.of(model), 2j * np.pi * SPACING * bins
    read = model.shapes(places).T @ system.velocity
    parts = [
        np.einsum("pk,kc,lk->pcl", r, b, 1 / (s[:, None] - pole), optimize=True)
        for r, b, pole in (
            (read, system.input_gain, system.exponent),
            (read.conj(), system.input_gain.conj(), system.exponent.conj()),
        )
    ]
    return np.asarray((parts[0] + parts[1]) / 2)


def _wave(response: ComplexArray | float, line: ComplexArray, bins: NDArray[np.intp]) -> FloatArray:
    """Return one period of sines multiplied by a response."""
    spectrum = np.zeros(N_SAMPLES // 2 + 1, dtype=complex)
    spectrum[bins] = response * line
    return np.asarray(np.fft.irfft(spectrum, N_SAMPLES))


def _at_beam(apparatus: Apparatus, burst: Burst, bins: NDArray[np.intp]) -> ComplexArray:
    """Return the spectrum of the commanded voltage, with sample and hold, (n_channels, n_lines) array [V]."""
    spectrum = np.fft.rfft(burst.commanded(apparatus.to_beam))[:, bins] / N_SAMPLES
    held = np.sinc(bins / N_SAMPLES) * np.exp(-1j * np.pi * bins / N_SAMPLES)
    return np.asarray(spectrum * held * low_pass(SPACING * bins, apparatus.amplifier_values().bandwidth))


RINGS, LISTENS = 0.3, 0.9
"""Ends of the beam's ringing and of the noise record, as fractions of the silence after a burst [1]."""


@dataclass(frozen=True, eq=False)
class BurstRecord:
    """A recording of the first burst of a trial."""

    stimulus: Stimulus  # the stimulus of the burst
    velocity: float  # level at which it is played [m/s]
    near: FloatArray  # (n_modes,): natural frequencies near which its spectrum is evaluated [Hz]

    def acquisition(self, fastest: float) -> Acquisition:
        """Return the scope settings for the highest expected speed [m/s]."""
        # Spectral images of the generator's held samples lie above the beam's band.
        rate = 2 * RATE
        n_samples = int(rate * self._until(LISTENS))
        return Acquisition(sampling_rate=rate, n_samples=n_samples, drives=(), velocity_range=HEADROOM * fastest)

    def probe(self, recording: Recording, bandwidth: float | None) -> Probe:
        """Convert a record to a probe of the beam.

        Parameters
        ----------
        recording : Recording
            Record of the burst, starting at rest, and of the silence after it.
        bandwidth : float or None
            Corner of the vibrometer's low-pass [Hz].

        Raises
        ------
        ValueError
            If the silence is too short to measure the noise.
        RigError
            If the velocity exceeded the range.
        """
        from scipy.fft import rfft

        if recording.overloaded:
            highest = float(np.abs(recording.velocity).max()) * 1e3
            raise RigError(
                f"the record of the burst is clipped at {highest:.0f} mm/s, the end of the vibrometer's range: choose "
                "a wider range at the vibrometer, and enter it as acquisition.range_mm_s in the apparatus file"
            )
        hold, rate = self.stimulus.timing.hold, recording.sampling_rate
        # Of a thousand lengths, the one closest to whole samples of both clocks is used.
        held = round(self._until(RINGS) / hold) + np.arange(1000)
        n_held = int(held[np.abs(held * hold * rate - np.round(held * hold * rate)).argmin()])
        seen, silence = np.split(recording.velocity[0], [round(n_held * hold * rate)])
        if silence.size < 4 * N_SILENT:
            lasts, least = (n / rate * 1e3 for n in (silence.size, 4 * N_SILENT))
            raise ValueError(
                f"the pause after a burst, in which the noise is measured, lasts {lasts:.2g} ms, but at least "
                f"{least:.2g} are needed: lower repetition_rate_Hz"
            )
        bins = self._bins(n_held * hold)
        frequency = bins / (n_held * hold)
        noise = noise_level(rfft(silence), np.arange(GAP, silence.size // 2), bins * silence.size / seen.size)
        passed = low_pass(frequency, bandwidth)
        deviation = noise * np.sqrt(seen.size / silence.size / 2) / rate / np.abs(passed)
        voltage = rfft(self.stimulus.voltage_played(self.velocity), n_held, axis=1)[:, bins] * hold
        voltage = voltage * np.sinc(frequency * hold) * np.exp(-1j * np.pi * frequency * hold)
        drive = voltage * low_pass(frequency, self.stimulus.amplifier.bandwidth)
        return Probe(recording.position, frequency, drive.T, rfft(seen)[bins] / rate / passed, deviation)

    def _until(self, part: float) -> float:
        """Return the time from the start of the burst to a fraction of the silence after it [s]."""
        timing = self.stimulus.timing
        return timing.duration + part * (1 / timing.repetition_rate - timing.duration)

    def _bins(self, span: float) -> NDArray[np.intp]:
        """Return the evaluated frequencies in cycles per span of time [s], increasing."""
        near = np.outer(self.near, np.linspace(0.96, 1.04, 17)).ravel()
        wanted = np.concatenate([np.geomspace(LOWEST, FURTHEST, 5 * N_SPREAD), near[near < FURTHEST]])
        return np.unique(np.round(wanted * span).astype(np.intp))
