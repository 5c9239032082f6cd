"""The simulated vibrometer and the scope that records it, with the imperfections specified in the apparatus file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from modaltouch.rig.interface import RigError
from modaltouch.rig.scope import Acquisition, Recording, Scope
from modaltouch.rig.simulator.motion import AT_ONCE, DriveVoltage, Motion, StateHistory, low_passed
from modaltouch.rig.simulator.timeline import Playback, Timeline
from modaltouch.rig.simulator.true_beam import FloatArray
from modaltouch.rig.simulator.twin import Twin
from modaltouch.stimulus import Finger

ASKED_EVERY = 0.5e-3
"""Time between two polls of a scope over USB for a full record [s]."""

DROPOUT = 0.2e-3
"""Duration of a signal dropout of the vibrometer [s]."""

SMALL_TURN = 0.01
"""Largest phase of the fastest mode within the trigger jitter for which a record is shifted along its slope [rad]."""


@lru_cache(maxsize=1)
def normal_quantiles() -> FloatArray:
    """Return equiprobable quantiles of the standard normal distribution, (65536,) array.

    Choosing one by 16 random bits is cheaper than drawing from the normal distribution. The distribution functions
    differ by at most 2**-17, and the largest value is 4.3.
    """
    from scipy.special import ndtri

    values = ndtri((np.arange(2**16) + 0.5) / 2**16)
    return np.asarray(values / values.std())


class SimulatedScope(Scope):
    """Sampled and noisy velocity and drive of a twin; only the requested position is computed.

    Parameters
    ----------
    twin : Twin
        Amplifier and beam.
    playing : callable
        Returns the current output of each channel.
    touched : callable
        Returns the fingers on the beam.
    timeline : Timeline
        Gives the instant of the latest trigger and the resulting output.
    """

    def __init__(
        self,
        twin: Twin,
        playing: Callable[[], Sequence[Playback | None]],
        touched: Callable[[], Sequence[Finger]],
        timeline: Timeline,
    ) -> None:
        super().__init__(twin.apparatus)
        self.identity = f"simulated scope, seed {twin.seed}"
        self._twin = twin
        self._playing = playing
        self._touched = touched
        self._timeline = timeline
        # A separate random stream, so that measurements do not change the beam.
        self._rng = np.random.Generator(np.random.SFC64([twin.seed, 1]))
        self._noise = np.empty(AT_ONCE)
        self.configure(Acquisition())

    def configure(self, acquisition: Acquisition) -> Acquisition:
        """Apply the settings and return them."""
        scope = self._twin.apparatus.twin.scope
        clock = scope.clock_MHz * 1e6
        acquisition.require_clock(clock)
        room = scope.memory_samples // acquisition.n_channels
        if acquisition.n_samples > room:
            raise RigError(
                f"{acquisition.n_samples} samples of {acquisition.n_channels} channels are asked for: the scope's "
                f"memory holds {room} of each; take fewer samples or a lower sampling rate"
            )
        self._ranges = self._inputs.ranges(acquisition)
        self._divider = max(1, round(clock / acquisition.sampling_rate))
        self._asked = acquisition
        self._rate = clock / self._divider
        return acquisition

    def measure(self, position: float, across: float = 0.0) -> Recording:
        """Measure velocity and drive while the generator plays.

        Parameters
        ----------
        position, across : float
            Measured point, relative to mid-beam and to the mid-line [m].

        Raises
        ------
        RigError
            If no output of the generator is playing, so that no trigger arrives.
        ValueError
            If the position is not on the beam.
        """
        playbacks = self._playing()
        if not any(playbacks):
            raise RigError(
                "no trigger came from the generator: neither of its outputs plays; load a record and fire it, then "
                "measure again"
            )
        return self._recorded(position, across, playbacks, self._asked.n_records)

    def arm(self) -> None:
        """Arm the scope to record the next burst, without waiting for it."""
        self._timeline.caught = None

    def fetch(self, position: float) -> Recording:
        """Return the record of the burst for which the scope was armed, computed from rest."""
        if self._timeline.caught is None:
            raise RigError(
                "no trigger came from the generator since the scope was armed: no burst began; arm it before a burst "
                "is fired, then fetch"
            )
        alone = [each and replace(each, period=math.inf) for each in self._timeline.caught]
        return self._recorded(position, 0.0, alone, 1)

    def _recorded(
        self, position: float, across: float, playbacks: Sequence[Playback | None], n_records: int
    ) -> Recording:
        """Return velocity and drive at a point for given playbacks."""
        asked, true = self._asked, self._twin.apparatus.twin
        self._twin.n_measured += 1
        nominal = asked.start + np.arange(asked.n_samples) / self._rate
        # A fast clock samples early; a sample of the generator reaches the beam after the amplifier's delay.
        elapsed = nominal / (1 + true.scope.clock_offset_ppm * 1e-6) + true.scope.trigger_latency_us * 1e-6
        elapsed -= self._twin.amplifier.delay
        jitter = true.scope.trigger_jitter_ns * 1e-9 * self._rng.standard_normal(n_records)
        late = true.vibrometer.delay_us * 1e-6
        reach = late + float(np.abs(jitter).max())
        motions = motions_of(
            self._twin,
            playbacks,
            position,
            offset=across + true.vibrometer.offset_mm * 1e-3,
            bandwidth=None if true.vibrometer.bandwidth_kHz is None else true.vibrometer.bandwidth_kHz * 1e3,
            touched=self._touched(),
            span=(float(elapsed[0] - reach), float(elapsed[-1] + reach)),
        )
        drives = [drive_voltage(self._twin, playbacks, number - 1) for number in asked.drives]
        velocity = _moved(motions, elapsed - late, jitter)
        voltage = np.zeros((n_records, len(drives), asked.n_samples))
        over = [self._see_velocity(record) for record in velocity]
        overloaded = {"velocity": any(over)}
        for row, (number, drive) in enumerate(zip(asked.drives, drives, strict=True)):
            for shift, record in zip(jitter, voltage[:, row], strict=True):
                for instants, volts in zip(_parts(elapsed), _parts(record), strict=True):
                    volts[:] = 0.0 if drive is None else drive.at(instants + shift)
            over = [self._see_drive(record) for record in voltage[:, row]]
            overloaded[f"drive {number}"] = any(over)
        names = tuple(name for name, over in overloaded.items() if over)
        return Recording(position, nominal, velocity, voltage, self._rate, names)

    def time_trigger(self, send: Callable[[], object]) -> tuple[float, float]:
        """Call `send` and return the earliest and latest onset of its burst, like a periodically polled scope."""
        self._timeline.shown = None
        send()
        began = self._timeline.shown
        if began is None:
            raise RigError("no trigger came from the generator: it waits for none, or its trigger output is off")
        empty = began - self._rng.uniform(0, ASKED_EVERY)
        return empty, empty + ASKED_EVERY

    def _see_velocity(self, values: FloatArray) -> bool:
        """Convert a velocity in place to the recorded values [m/s]; return whether it exceeded a range."""
        limit, over = self._inputs.highest_velocity, False
        often = self._twin.apparatus.twin.vibrometer.dropouts_Hz * values.size / self._rate
        begins = self._rng.integers(values.size, size=self._rng.poisson(often)).tolist() if often else []
        for start in begins:
            values[start : start + max(1, int(DROPOUT * self._rate))] = 0.0
        for some, noise in zip(_parts(values), self._velocity_noise(_parts(values)), strict=True):
            some += noise
            beyond = bool(some.max() > limit or some.min() < -limit)
            if beyond:
                np.clip(some, -limit, limit, out=some)
            over |= self._convert(some, self._inputs.sensitivity, self._ranges[0]) or beyond
        return over

    def _see_drive(self, values: FloatArray) -> bool:
        """Convert a voltage in place to the recorded values [V]; return whether it exceeded the range."""
        deviation, over = self._converter_noise(self._inputs.attenuation, self._ranges[1]), False
        table = normal_quantiles() * deviation
        for some in _parts(values):
            some += self._white_noise(some.size, table)
            over |= self._convert(some, self._inputs.attenuation, self._ranges[1])
        return over

    def _velocity_noise(self, parts: Iterable[FloatArray]) -> Iterator[FloatArray]:
        r"""Yield the noise of vibrometer and converter for each part of a record, as sampled [m/s].

        The noise of the vibrometer is white noise behind its low-pass, with its full power, aliased if necessary:
        :math:`v_n = a v_{n-1} + s e_n`. Together with the converter's white noise of standard deviation c it has the
        spectrum of a process with a single draw per sample, :math:`(1 - a z^{-1}) x = k (1 - b z^{-1}) e` with
        :math:`k^2 (1 + b^2) = s^2 + c^2 (1 + a^2)` and :math:`k^2 b = c^2 a`. Without a low-pass, the band is limited
        by half the scope's sampling rate.
        """
        true = self._twin.apparatus.twin.vibrometer
        density = true.noise_um_s_per_sqrt_Hz * 1e-6
        added = self._converter_noise(self._inputs.sensitivity, self._ranges[0])
        if true.bandwidth_kHz is None:
            table = normal_quantiles() * math.hypot(density * math.sqrt(self._rate / 2), added)
            yield from (self._white_noise(part.size, table) for part in parts)
            return
        corner = true.bandwidth_kHz * 1e3
        decay = 2 * np.pi * corner / self._rate
        spread = density * np.sqrt(np.pi / 2 * corner * -np.expm1(-2 * decay))
        from scipy.signal import lfilter

        pole = math.exp(-decay)
        half = (spread**2 + added**2 * (1 + pole**2)) / 2
        gain = math.sqrt(half + math.sqrt(max(half**2 - (added**2 * pole) ** 2, 0.0)))
        fed_back = -pole * (added / gain) ** 2 if gain else 0.0
        table = normal_quantiles() * gain
        # The initial state is drawn from the stationary distribution of the filter.
        state = self._rng.standard_normal(1) * gain * (pole + fed_back) / math.sqrt(-math.expm1(-2 * decay))
        for part in parts:
            noise, state = lfilter([1.0, fed_back], [1.0, -pole], self._white_noise(part.size, table), zi=state)
            yield noise

    def _converter_noise(self, per_volt: float, input_range: float) -> float:
        """Return the standard deviation of the converter noise, in units of the measured quantity."""
        scope = self._twin.apparatus.twin.scope
        return float(scope.noise_steps * input_range / (2 ** (scope.bits - 1) - 1) * per_volt)

    def _white_noise(self, n: int, table: FloatArray) -> FloatArray:
        """Return normal white noise from a table of its quantiles; the array is reused by the next call."""
        drawn = self._rng.bit_generator.random_raw(-(-n // 4)).view(np.uint16)[:n]
        return np.take(table, drawn, out=self._noise[:n], mode="wrap")

    def _convert(self, values: FloatArray, per_volt: float, input_range: float) -> bool:
        """Convert values in place, with a value per volt and an input range [V]; return whether its end was reached."""
        scope = self._twin.apparatus.twin.scope
        highest = 2 ** (scope.bits - 1) - 1
        step = input_range / highest
        values /= per_volt * step
        np.rint(values, out=values)
        over = bool(values.max() >= highest or values.min() <= -highest)
        if over:
            np.clip(values, -highest, highest, out=values)
        values *= step * per_volt
        return over


def _parts(values: FloatArray) -> Iterator[FloatArray]:
    """Yield cache-sized parts of a record."""
    return (values[start : start + AT_ONCE] for start in range(0, values.size, AT_ONCE))


def _moved(motions: Sequence[Motion], time: FloatArray, shifts: FloatArray) -> FloatArray:
    """Return the velocity at instants shifted by each of `shifts` [s], (n_shifts, n_times) array [m/s]."""
    moved = np.empty((shifts.size, time.size))
    furthest = float(np.abs(shifts).max())
    fastest = max((float(np.abs(motion.exponent.imag).max()) for motion in motions), default=0.0)
    if fastest * furthest > SMALL_TURN:
        for row, shift in zip(moved, shifts, strict=True):
            row[:] = sum((motion.at(time + shift) for motion in motions), np.zeros(time.size))
        return moved
    middle, slope = sum((motion.course(time) for motion in motions), np.zeros((2, time.size)))
    for row, shift in zip(moved, shifts, strict=True):
        np.multiply(slope, shift, out=row)
        row += middle
    return moved


def motions_of(
    twin: Twin,
    playbacks: Sequence[Playback | None],
    position: float,
    *,
    offset: float,
    bandwidth: float | None,
    touched: Sequence[Finger],
    span: tuple[float, float],
) -> list[Motion]:
    """Return the low-passed velocity of a point, one part for each group of channels with equal timing [m/s].

    Parameters
    ----------
    playbacks, touched
        Output of each channel, and the fingers on the beam.
    position, offset : float
        Position along and across the beam, relative to its middle [m].
    bandwidth : float or None
        Corner frequency of the low-pass [Hz]; None for no low-pass.
    span : (float, float)
        First and last instant that will be requested, from the first sample of a burst at the beam [s].
    """
    if twin.tripped:
        return []
    stretch = twin.stretch(playbacks)
    system = twin.system(touched, stretch)
    output = twin.beam.shapes(position, offset)[:, 0] @ system.velocity
    system, output = low_passed(system, output, bandwidth)
    key = tuple(playbacks), tuple(touched), bandwidth, stretch
    # The states describe the whole beam, so they can be reused for the next point of a scan.
    if twin.histories is None or twin.histories[0] != key or not all(h.covers(span) for h in twin.histories[1]):
        twin.histories = key, [StateHistory.of(system, held, span) for held in twin.forces_of(playbacks)]
    return [history.motion(output) for history in twin.histories[1]]


def drive_voltage(twin: Twin, playbacks: Sequence[Playback | None], channel: int) -> DriveVoltage | None:
    """Return the voltage at the beam of a channel, counted from 0; None for an idle channel."""
    alone = [playback if row == channel else None for row, playback in enumerate(playbacks)]
    held = twin.held_of(alone)
    return None if twin.tripped or not held else DriveVoltage.of(held[0], channel, twin.amplifier.bandwidth)
