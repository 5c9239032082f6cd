"""Bursts that identify the rig, and records of free decays in suitable input ranges."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from modaltouch.lab.calibration.plant import DriveDelay
from modaltouch.lab.calibration.plausibility import refuse_implausible_velocity
from modaltouch.lab.common import FloatArray
from modaltouch.lab.laboratory import Laboratory
from modaltouch.rig import Acquisition, Recording, RigError
from modaltouch.stimulus import BlockStates, Burst, DiagonalSystem, ModalModel, Stimulus, Taper, Timing

SHARE = 0.6
"""Fraction of the amplifier and velocity limits used for identification [1]; the mode table may be off by a third."""

RISE, FALL = 1.0e-3, 0.05e-3
"""Tapers of a probe; the end is steep, so that the fastest modes still ring after it [s]."""

SWEEP = 2.0e-3
"""Length of each sweep of the timing burst [s]."""

_GOLDEN = np.pi * (3 - np.sqrt(5))


def probe_voltage(model: ModalModel, timing: Timing, channel: int) -> FloatArray:
    """Return voltages on one channel that leave every modelled mode ringing at the focusing instant.

    Each mode is driven by its time-reversed decay, with an amplitude that decreases with its response.

    Parameters
    ----------
    model, timing
        Approximate modes, and clock of the samples; nothing is played after the focusing instant.
    channel : int
        Channel that is driven, counted from 0.

    Returns
    -------
    (n_channels, n_samples) array
        Voltages, arbitrarily scaled.
    """
    n_before, _ = timing.samples_until(timing.focusing_instant)
    voltage = np.zeros((model.n_channels, timing.n_samples))
    response = np.abs(model.modal_gain).max(axis=1) / -model.exponent.real
    response = np.where(response > 0, response, np.median(response[response > 0]))
    # Phases in steps of the golden angle keep the tones from peaking together.
    amplitude = (response**-0.5 * np.exp(1j * _GOLDEN * np.arange(model.n_modes)))[None, :]
    taper = Taper.fitting(n_before, RISE * timing.sampling_rate, FALL * timing.sampling_rate)
    taper.write(amplitude, model.exponent, timing.hold, voltage[channel : channel + 1, :n_before])
    return voltage


def timing_voltage(model: ModalModel, timing: Timing) -> FloatArray:
    """Return voltages on all channels from which the delay can be measured at the start and the end of a burst.

    Returns
    -------
    (n_channels, n_samples) array
        A tapered sweep over the modes' frequencies in the first and in the last `SWEEP` seconds, arbitrarily scaled.
    """
    n = min(int(SWEEP * timing.sampling_rate), timing.n_samples // 2)
    time = np.arange(n) * timing.hold
    low, high = 0.2 * model.natural_frequency.max(), 1.2 * model.natural_frequency.max()
    high = min(high, timing.sampling_rate / 4)
    phase = 2 * np.pi * (low * time + 0.5 * (high - low) / (n * timing.hold) * time**2)
    sweep = np.sin(phase) * np.sin(np.pi * np.arange(n) / n) ** 2
    voltage = np.zeros((model.n_channels, timing.n_samples))
    voltage[:, :n] = sweep
    voltage[:, timing.n_samples - n :] = sweep
    return voltage


def identifying_burst(voltage: FloatArray, listed: Stimulus, velocity_limit: float) -> Burst:
    """Return a burst of given voltages, scaled as high as the limits allow with a mode table that is off by a third.

    Parameters
    ----------
    voltage : (n_channels, n_samples) array
        Voltages of arbitrary scale.
    listed : Stimulus
        The stimulus designed from the apparatus file, whose modes, clock and amplifier are used.
    velocity_limit : float
        Highest velocity allowed on the beam and by the vibrometer's range [m/s].
    """
    model, timing = listed.model, listed.timing
    points = np.linspace(-0.5, 0.5, 4 * max(model.label) + 1) * model.length
    system = DiagonalSystem.of(model)
    speed = float(BlockStates.of(system, voltage, timing).peak(model.shapes(points).T @ system.velocity).max())
    highest = np.abs(voltage).max(axis=1)
    scale = SHARE * min(listed.amplifier.limit / highest.max(), velocity_limit / max(speed, 1e-30))
    return Burst.holding(
        voltage * scale,
        listed.to_beam,
        speed * scale,
        timing.converter,
        timing.duration,
        timing.repetition_rate,
    )


MARGIN = 40e-6
"""Time from the focusing instant to the first sample, in which drive and vibrometer settle [s]."""

HEADROOM = 1.4
"""Range of the scope relative to the highest value so far [1]."""

N_RECORDS = 10
"""Records averaged at each point."""

N_PAIRS = 4
"""Number of pairs of points symmetric about mid-beam; antisymmetric motion there does not bias symmetric modes."""


def measuring_points(model: ModalModel) -> FloatArray:
    """Return pairs of points about mid-beam at which the least visible mode is most visible.

    Returns
    -------
    (2 * N_PAIRS,) array
        Positions in increasing order [m].
    """
    half = model.length / 2
    candidates = np.arange(0.04, 0.97, 0.04) * half
    power = model.shapes(candidates) ** 2
    rng = np.random.default_rng(0)
    # The best of a few thousand random choices is practically as good as the best of all.
    some = np.array([rng.choice(candidates.size, N_PAIRS, replace=False) for _ in range(4000)])
    inner = np.sort(candidates[some[power[:, some].sum(axis=2).min(axis=0).argmax()]])
    return np.concatenate([-inner[::-1], inner])


@dataclass
class DecayRecorder:
    """Recorder of free decays in suitable input ranges, with progress reports."""

    bench: Laboratory  # generator and scope; each record is reported to its progress callbacks
    model: ModalModel  # approximate modes, which determine the sampling rate and the length of a record
    timing: Timing  # clock of the burst
    highest_velocity: float  # upper end of the vibrometer's range [m/s]
    latency: float  # trigger latency, from the generator's first sample to the scope's [s]
    name: str = ""  # name of the stimulus, if there are several
    # time from the focusing instant to the first sample of a decay [s]
    margin: float = field(default=MARGIN, init=False)
    _forth: bool = field(default=False, init=False)
    _step: str = field(default="", init=False)
    _done: int = field(default=0, init=False)
    _total: int = field(default=0, init=False)
    n_taken: int = field(default=0, init=False)  # number of records taken so far

    def begin(self, step: str, n_records: int) -> None:
        """Start a step of the progress report with its number of records."""
        self._step = f"{self.name}: {step}" if self.name else step
        self._done, self._total = 0, n_records
        self.bench.progress.show(self._step, 0, n_records)

    @property
    def rate(self) -> float:
        """Sampling rate, five samples per cycle of the fastest listed mode [Hz]."""
        return 5 * float(self.model.natural_frequency.max())

    def wait_for(self, drive: DriveDelay) -> None:
        """Delay the start of decay records until the drive at the beam has ended."""
        self.margin = max(MARGIN, drive.delay + 10 * drive.lag + MARGIN / 2)

    def decays(
        self, burst: Burst, level: float, points: FloatArray, highest: float | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Record the free decay after the focusing instant.

        Parameters
        ----------
        burst, level
            A burst without voltage after the focusing instant, and the level at which it is played [m/s].
        points : (n_points,) array
            Positions [m].
        highest : float, optional
            Highest expected speed; the upper end of the vibrometer's range if not given [m/s].

        Returns
        -------
        time : (n_samples,) array
            Times by the scope's clock, from the generator's first sample [s].
        velocity : (n_points, n_samples) array
            Averaged over records [m/s].
        """
        self.bench.load(burst)
        asked = self._decay()
        time, rows = np.zeros(0), dict[int, FloatArray]()
        # Reverse the order each time, so that a spot moved by hand travels less.
        self._forth = not self._forth
        order = np.arange(points.size)[:: 1 if self._forth else -1]
        for place in order.tolist():
            point = float(points[place])
            recording = self._within(point, level, asked, highest)
            refuse_implausible_velocity(recording)
            highest = max(highest or 0.0, float(np.abs(recording.velocity).max()))
            time = recording.time
            rows[place] = recording.velocity.mean(axis=0)
        return time, np.stack([rows[place] for place in range(points.size)])

    def _decay(self, n_records: int = N_RECORDS) -> Acquisition:
        slowest = float(-self.model.exponent.real.max())
        silence = 1 / self.timing.repetition_rate - self.timing.focusing_instant
        length = min(1.2 / slowest, 0.9 * silence)
        return Acquisition(
            sampling_rate=self.rate,
            n_samples=max(256, int(length * self.rate)),
            n_records=n_records,
            drives=(),
            start=self.timing.focusing_instant + self.margin,
        )

    def at_level(self, level: float, point: float) -> tuple[FloatArray, FloatArray, float]:
        """Record the decay of the loaded burst at one point, and the highest speed there over a whole period.

        Returns
        -------
        time, velocity, highest
            Times by the scope's clock [s], (1, n_samples) velocities of the decay, and highest speed [m/s]; means over
            the records.
        """
        whole = replace(self._decay(N_RECORDS // 2), start=0.0, n_samples=int(self.timing.duration * self.rate))
        burst = self._within(point, level, whole, 1.2 * level)
        highest = float(np.abs(burst.velocity.mean(axis=0)).max())
        decay = self._within(point, level, self._decay(2 * N_RECORDS), highest)
        return decay.time, decay.velocity.mean(axis=0, keepdims=True), highest

    def drive(self, burst: Burst, volts: float) -> list[Recording]:
        """Record the drive of all channels in the first and the last `SWEEP` seconds of a burst of at most `volts`."""
        self.bench.load(burst)
        return [self.drive_from(start, burst.velocity, volts) for start in (0.0, self.timing.duration - SWEEP)]

    def drive_from(self, start: float, level: float, volts: float) -> Recording:
        """Record the drive of all channels of the loaded burst for `SWEEP` seconds from a given instant.

        It is counted from the start of the burst, where negative values count as 0 [s]; the level is in m/s, and the
        drive has at most `volts`.
        """
        rate = max(self.rate, 2.0e6)
        drives = tuple(range(1, self.model.n_channels + 1))
        n_samples = int((SWEEP + MARGIN) * rate)
        asked = Acquisition(rate, n_samples, N_RECORDS, drives, max(start, 0.0), drive_range=HEADROOM * volts)
        return self._within(0.0, level, asked, None)

    def _within(self, point: float, level: float, asked: Acquisition, highest: float | None) -> Recording:
        """Take a record without overload, widening the ranges as needed."""
        if highest:
            asked = replace(asked, velocity_range=min(HEADROOM * highest, self.highest_velocity))
        for _ in range(6):
            self.bench.progress.check()
            recording = self.bench.record(point, level, asked)
            if not recording.overloaded:
                self._done += 1
                self.n_taken += 1
                self.bench.progress.show(self._step, self._done, self._total)
                return replace(recording, time=recording.time + self.latency)
            wide = asked.velocity_range is None or asked.velocity_range >= self.highest_velocity
            if "velocity" in recording.overloaded and wide:
                break
            if "velocity" in recording.overloaded and asked.velocity_range is not None:
                asked = replace(asked, velocity_range=min(2 * asked.velocity_range, self.highest_velocity))
            if len(recording.overloaded) > 1 or "velocity" not in recording.overloaded:
                asked = replace(asked, drive_range=None)
        raise RigError(
            f"{', '.join(recording.overloaded)} is overloaded at {point * 1e3:g} mm in the widest range, with up to "
            f"{np.abs(recording.velocity).max() * 1e3:.4g} mm/s; the outputs are off; choose a wider one at the "
            "vibrometer, or a probe with more attenuation, and enter it in the apparatus file; check the unit of a "
            "record from a file"
        )
