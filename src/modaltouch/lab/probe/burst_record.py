"""A burst as the vibrometer sees it: its spectrum at selected frequencies, and that of the voltages behind it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.arrays import FloatArray
from modaltouch.lab.identification.excitation import RATE
from modaltouch.lab.probe.excitation import FURTHEST, GAP, HEADROOM, LOWEST, N_SILENT, N_SPREAD, noise_level
from modaltouch.rig import Acquisition, Recording, RigError
from modaltouch.stimulus import Probe, Stimulus

OVERSAMPLING = 2
"""Scope samples per generator sample of a probe; the images of the generator's samples are beyond the beam's band."""

RINGS, LISTENS = 0.3, 0.9
"""Fractions of the silence after a burst up to which the beam may ring, and up to which the noise is recorded [1]."""

N_CLOCKS = 1000
"""Number of record lengths tried for the one closest to whole samples of both clocks."""


@dataclass(frozen=True, eq=False)
class BurstRecord:
    """A recording of the first burst of a trial.

    Attributes
    ----------
    stimulus : Stimulus
        The stimulus of the burst.
    velocity : float
        Level at which it is played [m/s].
    near : (n_modes,) array
        Natural frequencies about which its spectrum is evaluated [Hz].
    """

    stimulus: Stimulus
    velocity: float
    near: FloatArray

    def acquisition(self, fastest: float) -> Acquisition:
        """Return the settings of the scope for a highest expected speed [m/s]."""
        rate = OVERSAMPLING * RATE
        n_samples = int(rate * self._until(LISTENS))
        return Acquisition(sampling_rate=rate, n_samples=n_samples, drives=(), velocity_range=HEADROOM * fastest)

    def probe(self, recording: Recording, bandwidth: float | None) -> Probe:
        """Return the record as a probe of the beam.

        Parameters
        ----------
        recording : Recording
            Record of the burst, starting at rest, and the silence after it.
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
        held = round(self._until(RINGS) / hold) + np.arange(N_CLOCKS)
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
        passed = 1.0 if bandwidth is None else 1 + 1j * frequency / bandwidth
        deviation = noise * np.sqrt(seen.size / silence.size / 2) / rate * np.abs(passed)
        voltage = rfft(self.stimulus.voltage_played(self.velocity), n_held, axis=1)[:, bins] * hold
        voltage = voltage * np.sinc(frequency * hold) * np.exp(-1j * np.pi * frequency * hold)
        corner = self.stimulus.amplifier.bandwidth
        drive = voltage if corner is None else voltage / (1 + 1j * frequency / corner)
        return Probe(recording.position, frequency, drive.T, rfft(seen)[bins] / rate * passed, deviation)

    def _until(self, part: float) -> float:
        """Return the time from the start of the burst to a fraction of the silence after it [s]."""
        timing = self.stimulus.timing
        return timing.duration + part * (1 / timing.repetition_rate - timing.duration)

    def _bins(self, span: float) -> NDArray[np.intp]:
        """Return the evaluated frequencies in cycles per span of time [s], increasing."""
        near = np.outer(self.near, np.linspace(0.96, 1.04, 17)).ravel()
        wanted = np.concatenate([np.geomspace(LOWEST, FURTHEST, 5 * N_SPREAD), near[near < FURTHEST]])
        return np.unique(np.round(wanted * span).astype(np.intp))
