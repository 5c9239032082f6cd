"""The simulated vibrometer and the scope behind it, as far from ideal as the apparatus file says."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.acquisition import Acquisition, Inputs, Recording, Scope
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator.motion import DriveVoltage, Motion
from modaltouch.rig.simulator.timeline import Playback
from modaltouch.rig.simulator.twin import Twin

FloatArray = NDArray[np.float64]

FORGOTTEN = 1e-9
"""Correlation below which noise counts as new [1]."""

SMALL_TURN = 0.01
"""Phase of the fastest mode within the trigger's jitter up to which a record is moved along its slope [rad]."""


class SimulatedScope(Scope):
    """Velocity and drive of a twin, sampled, with noise; computes only the position asked for.

    Parameters
    ----------
    twin : Twin
        Amplifier and beam.
    playing : callable
        Returns what each generator output sends now.
    touched : callable
        Returns where fingers lie [m].
    """

    def __init__(
        self,
        twin: Twin,
        playing: Callable[[], Sequence[Playback | None]],
        touched: Callable[[], Sequence[float]],
    ) -> None:
        self._twin = twin
        self._playing = playing
        self._touched = touched
        knobs = twin.apparatus.acquisition
        self._inputs = Inputs(
            sensitivity=knobs.sensitivity_mm_s_per_V * 1e-3,
            highest_velocity=knobs.range_mm_s * 1e-3,
            attenuation=knobs.probe_attenuation,
        )
        # A stream of its own: what is measured leaves the beam as it is.
        self._rng = np.random.default_rng([twin.seed, 1])
        self.configure(Acquisition())

    @property
    def identity(self) -> str:
        """Model and serial number."""
        return f"simulated scope, seed {self._twin.seed}"

    def configure(self, acquisition: Acquisition) -> Acquisition:
        """Make the settings, and return them."""
        scope = self._twin.apparatus.twin.scope
        clock = scope.clock_MHz * 1e6
        if acquisition.sampling_rate > clock * (1 + 1e-9):
            raise RigError(
                f"{acquisition.sampling_rate:g} samples per second are asked for: the scope takes at most {clock:g}; "
                "lower the sampling rate"
            )
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

    def measure(self, position: float) -> Recording:
        """Return velocity and drive while the generator plays.

        Parameters
        ----------
        position : float
            Where the vibrometer aims, origin at mid-beam [m].

        Raises
        ------
        RigError
            If no output of the generator plays, so that no trigger comes.
        ValueError
            If the position is not on the beam.
        """
        asked, true = self._asked, self._twin.apparatus.twin
        playbacks = self._playing()
        if not any(playbacks):
            raise RigError(
                "no trigger came from the generator: neither of its outputs plays; load a record and fire it, then "
                "measure again"
            )
        nominal = asked.start + np.arange(asked.n_samples) / self._rate
        # A fast clock takes its samples early; the beam hears of a sample after the amplifier's delay.
        elapsed = nominal / (1 + true.scope.clock_offset_ppm * 1e-6) + true.scope.trigger_latency_us * 1e-6
        elapsed -= self._twin.amplifier.delay
        jitter = true.scope.trigger_jitter_ns * 1e-9 * self._rng.standard_normal(asked.n_records)
        late = true.vibrometer.delay_us * 1e-6
        reach = late + float(np.abs(jitter).max())
        motions = self._twin.motions(
            playbacks,
            position,
            offset=true.vibrometer.offset_mm * 1e-3,
            bandwidth=None if true.vibrometer.bandwidth_kHz is None else true.vibrometer.bandwidth_kHz * 1e3,
            touched=self._touched(),
            span=(float(elapsed[0] - reach), float(elapsed[-1] + reach)),
        )
        drives = [self._twin.drive(playbacks, number - 1) for number in asked.drives]
        velocity = np.empty((asked.n_records, asked.n_samples))
        voltage = np.zeros((asked.n_records, len(drives), asked.n_samples))
        overloaded: dict[str, bool] = {}
        for record, exact in enumerate(_moved(motions, elapsed - late, jitter)):
            velocity[record], over = self._velocity(exact)
            overloaded["velocity"] = overloaded.get("velocity", False) or over
            for row, (number, drive) in enumerate(zip(asked.drives, drives, strict=True)):
                voltage[record, row], over = self._voltage(drive, elapsed + jitter[record])
                name = f"drive {number}"
                overloaded[name] = overloaded.get(name, False) or over
        names = tuple(name for name, over in overloaded.items() if over)
        return Recording(position, nominal, velocity, voltage, self._rate, names)

    def close(self) -> None:
        """Release the scope, which holds nothing."""

    def _velocity(self, exact: FloatArray) -> tuple[FloatArray, bool]:
        """Return the velocity as the scope has it [m/s], and whether its range was passed."""
        limit = self._inputs.highest_velocity
        seen = exact + self._vibrometer_noise(exact.size)
        volts, over = self._convert(np.clip(seen, -limit, limit) / self._inputs.sensitivity, self._ranges[0])
        return volts * self._inputs.sensitivity, over or bool(np.abs(seen).max() > limit)

    def _voltage(self, drive: DriveVoltage | None, time: FloatArray) -> tuple[FloatArray, bool]:
        """Return the voltage at the beam as the scope has it [V], and whether its range was passed."""
        exact = np.zeros(time.size) if drive is None else drive.at(time)
        volts, over = self._convert(exact / self._inputs.attenuation, self._ranges[1])
        return volts * self._inputs.attenuation, over

    def _vibrometer_noise(self, n_samples: int) -> FloatArray:
        """Return white noise behind the vibrometer's low-pass, as sampled [m/s]: all its power, folded where it must.

        Without a low-pass the scope's own rate bounds the band.
        """
        true = self._twin.apparatus.twin.vibrometer
        density = true.noise_um_s_per_sqrt_Hz * 1e-6
        if true.bandwidth_kHz is None:
            return np.asarray(density * np.sqrt(self._rate / 2) * self._rng.standard_normal(n_samples))
        corner = true.bandwidth_kHz * 1e3
        decay = 2 * np.pi * corner / self._rate
        spread = density * np.sqrt(np.pi / 2 * corner * -np.expm1(-2 * decay))
        # What is older than the lead is forgotten. Sample + c * sample before + ... is a product of sums of two.
        lead = int(-np.log(FORGOTTEN) / decay)
        noise = spread * self._rng.standard_normal(lead + n_samples)
        step = 1
        while step <= lead:
            noise[step:] += np.exp(-decay * step) * noise[:-step]
            step *= 2
        return np.asarray(noise[lead:])

    def _convert(self, volts: FloatArray, input_range: float) -> tuple[FloatArray, bool]:
        """Return what the converter makes of an input [V], and whether it reached its end."""
        scope = self._twin.apparatus.twin.scope
        highest = 2 ** (scope.bits - 1) - 1
        step = input_range / highest
        noise = scope.noise_steps * self._rng.standard_normal(volts.size) if scope.noise_steps else 0.0
        steps = np.clip(np.round(volts / step + noise), -highest, highest)
        return steps * step, bool(np.abs(steps).max() >= highest)


def _moved(motions: Sequence[Motion], time: FloatArray, shifts: FloatArray) -> Iterator[FloatArray]:
    """Yield the velocity at instants moved by each shift in turn [m/s]."""

    def exact(when: FloatArray) -> FloatArray:
        return np.asarray(sum((motion.at(when) for motion in motions), np.zeros(when.size)))

    furthest = float(np.abs(shifts).max())
    fastest = max((float(np.abs(motion.exponent.imag).max()) for motion in motions), default=0.0)
    if furthest > 0 and (shifts.size <= 3 or fastest * furthest > SMALL_TURN):
        for shift in shifts:
            yield exact(time + shift)
        return
    # Many records of a small jitter share three computations.
    middle = exact(time)
    slope = (exact(time + furthest) - exact(time - furthest)) / (2 * furthest) if furthest > 0 else 0.0
    for shift in shifts:
        yield middle + shift * slope
