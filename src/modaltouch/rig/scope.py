"""The scope that records vibrometer and drive: settings, results, interface, and a PicoScope 3000 driver.

While the generator plays, its trigger starts every record. The zero-order hold of its samples produces images around
multiples of the sample rate. If the scope samples no faster than the generator, these alias onto the drive, and a
transfer function lacks the droop and the half-sample delay of the hold: sample a few times faster.
"""

from __future__ import annotations

import abc
import contextlib
import ctypes
import importlib
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol import Apparatus
from modaltouch.rig.interface import RigError
from modaltouch.system import SYSTEM_CLOCK

FloatArray = NDArray[np.float64]

INPUT_RANGES = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""Input ranges of a PicoScope 3404 [V, peak]."""


@dataclass(frozen=True)
class Acquisition:
    """Settings of vibrometer and scope for a measurement.

    Attributes
    ----------
    sampling_rate : float
        Samples per second [Hz]; the scope uses its nearest available rate, which is stated in the recording.
    n_samples : int
        Samples per record, including those before the trigger.
    n_records : int
        Number of consecutive records, each started by the generator's trigger; their coherence needs every one.
    drives : tuple of int
        Generator outputs, 1 or 2, whose voltage at the beam is measured together with the velocity.
    start : float
        Time of the first sample relative to the trigger at the start of a burst [s]; negative for pre-trigger samples.
    velocity_range, drive_range : float, optional
        Highest expected velocity [m/s] and voltage at the beam [V]; the smallest sufficient input range is used.
        None for the full range of the vibrometer or of the scope input.
    """

    sampling_rate: float = 500e3
    n_samples: int = 131_072
    n_records: int = 1
    drives: tuple[int, ...] = (1,)
    start: float = 0.0
    velocity_range: float | None = None
    drive_range: float | None = None

    def require_clock(self, rate: float) -> None:
        """Raise RigError if the sampling rate exceeds the clock rate of the scope [Hz]."""
        if self.sampling_rate > rate * (1 + 1e-9):
            raise RigError(
                f"{self.sampling_rate:g} samples per second are asked for: the scope takes at most {rate:g}; lower the "
                "sampling rate"
            )

    @property
    def n_channels(self) -> int:
        """Scope inputs in use."""
        return 1 + len(self.drives)


@dataclass(frozen=True, eq=False)
class Recording:
    """A measurement at one position, in SI units.

    Attributes
    ----------
    position : float
        Position along the beam, origin at mid-beam [m].
    time : (n_samples,) array
        Time since the trigger, on the clock of the scope [s].
    velocity : (n_records, n_samples) array
        Velocity of the point [m/s].
    drive : (n_records, n_drives, n_samples) array
        Voltage at the beam of each measured drive [V].
    sampling_rate : float
        Sampling rate on the clock of the scope [Hz].
    overloaded : tuple of str
        Signals that reached their full scale in any record: ``velocity``, ``drive 1``, ``drive 2``.
    """

    position: float
    time: FloatArray
    velocity: FloatArray
    drive: FloatArray
    sampling_rate: float
    overloaded: tuple[str, ...]


@dataclass(frozen=True)
class Inputs:
    """Scale factors of the scope inputs, and the choice of input ranges.

    Attributes
    ----------
    sensitivity, highest_velocity : float
        Sensitivity of the vibrometer [m/s per V] and its full scale [m/s].
    attenuation : float
        Attenuation of the probes that measure the drive [V at the beam per V].
    """

    sensitivity: float
    highest_velocity: float
    attenuation: float

    def ranges(self, acquisition: Acquisition) -> tuple[float, float]:
        """Return the input ranges for velocity and drive [V, peak at the input]; RigError if none is wide enough."""
        wanted = acquisition.velocity_range or self.highest_velocity
        if wanted > self.highest_velocity * (1 + 1e-9):
            raise RigError(
                f"a velocity of {wanted * 1e3:g} mm/s is to be measured, but the vibrometer's range ends at "
                f"{self.highest_velocity * 1e3:g} mm/s; choose a wider range at the vibrometer, and enter it in the "
                "apparatus file"
            )
        velocity = self._smallest(wanted / self.sensitivity, f"{wanted * 1e3:g} mm/s")
        if acquisition.drive_range is None:
            return velocity, INPUT_RANGES[-1]
        return velocity, self._smallest(acquisition.drive_range / self.attenuation, f"{acquisition.drive_range:g} V")

    @staticmethod
    def _smallest(volts: float, what: str) -> float:
        fitting = [each for each in INPUT_RANGES if each >= volts * (1 - 1e-9)]
        if not fitting:
            raise RigError(
                f"{what} is {volts:g} V at the scope's input: at most {INPUT_RANGES[-1]:g} V; use another sensitivity "
                "or a probe with more attenuation, and enter it in the apparatus file"
            )
        return fitting[0]


class Scope(contextlib.AbstractContextManager["Scope"]):
    """A vibrometer and the scope that records it, simulated or real.

    Usage::

        scope.configure(Acquisition(sampling_rate=500e3, n_samples=131_072, n_records=10, drives=(1,)))
        recordings = [scope.measure(position) for position in np.linspace(-0.05, 0.05, 41)]

    Its methods raise RigError if the scope is not found, does not support what is asked, fails, or gets no trigger.

    Attributes
    ----------
    identity : str
        Model and serial number.
    slowest : float
        Time beyond the duration of a record after which recording and fetching it counts as stalled [s].
    """

    identity = ""
    slowest = 120.0

    def __init__(self, apparatus: Apparatus) -> None:
        knobs = apparatus.acquisition
        self._inputs = Inputs(knobs.sensitivity_mm_s_per_V * 1e-3, knobs.range_mm_s * 1e-3, knobs.probe_attenuation)

    @staticmethod
    def open(apparatus: Apparatus) -> Scope:
        """Return the scope of an apparatus, a PicoScope."""
        return PicoScope(apparatus)

    @abc.abstractmethod
    def configure(self, acquisition: Acquisition) -> Acquisition:
        """Apply the settings and return them."""

    @abc.abstractmethod
    def measure(self, position: float, across: float = 0.0) -> Recording:
        """Measure velocity and drive at a point, `position` along the beam and `across` it from its middle [m]."""

    def arm(self) -> None:
        """Arm the scope to record the next burst, without waiting for it."""
        raise RigError(f"{self.identity}: it cannot wait for a single burst; use a PicoScope")

    def fetch(self, position: float) -> Recording:
        """Return the record of the burst for which the scope was armed, at a `position` as in `measure`."""
        raise RigError(f"{self.identity}: it was not armed for a burst")

    def time_trigger(self, send: Callable[[], object]) -> tuple[float, float]:
        """Call `send`, which triggers one burst, and return the earliest and latest instant of its onset [s]."""
        raise RigError(f"{self.identity}: cannot tell when a burst began; use a PicoScope")

    def close(self) -> None:
        """Release the scope, if there is anything to release; never raises."""

    def __exit__(self, *exc: object) -> None:
        self.close()


OK, NOT_FOUND = 0, 3
POWER_NOT_CONNECTED, NOT_A_USB3_PORT = 282, 286
"""Status codes of the Pico library for a scope on USB power alone."""

VARIANT, SERIAL = 3, 4
"""Pico's codes for information about a unit."""

DC, RISING, EXTERNAL = 1, 2, 4
EXTERNAL_THRESHOLD = 6553
"""Threshold of 1 V in counts; the 5 V of the external trigger correspond to 32767."""

FIRST_RANGE = 2
"""Pico's code for the 50 mV range, the first of INPUT_RANGES."""

CLOCK, N_INPUTS = 125e6, 4
"""Clock rate [Hz], of which sampling rates are integer fractions for time bases from 3; number of inputs."""

SHORT = Acquisition(sampling_rate=1e6, n_samples=100, drives=())
"""A short record, whose end indicates the instant of its trigger."""

ARMED = 0.02
"""Time from arming the scope until it is ready for a trigger [s]."""


class PicoScope(Scope):
    """PicoScope 3000 of series A, B or D, for velocity and drive.

    Parameters
    ----------
    apparatus : Apparatus
        The apparatus, with the sensitivities in its section ``acquisition``.
    trigger_wait : float
        Longest wait for the generator's trigger [s].
    driver : object, optional
        Object with the functions of the Pico library; by default the installed library.
    """

    def __init__(self, apparatus: Apparatus, *, trigger_wait: float = 2.0, driver: Any = None) -> None:
        super().__init__(apparatus)
        self._driver = load_driver() if driver is None else driver
        self._trigger_wait = trigger_wait
        self._handle = ctypes.c_int16()
        self._open = self._waits = False
        self._start()
        try:
            self.identity = f"PicoScope {self._about(VARIANT)}, serial {self._about(SERIAL)}"
            highest = ctypes.c_int16()
            self._call("MaximumValue", ctypes.byref(highest))
            self._full_scale = highest.value
            self.configure(Acquisition())
        except BaseException:
            self.close()
            raise

    def configure(self, acquisition: Acquisition) -> Acquisition:
        """Apply the settings and return them."""
        acquisition.require_clock(CLOCK)
        self._disarm()
        velocity_range, drive_range = self._inputs.ranges(acquisition)
        wanted = {0: velocity_range} | dict.fromkeys(acquisition.drives, drive_range)
        for channel in range(N_INPUTS):
            number = INPUT_RANGES.index(wanted.get(channel, INPUT_RANGES[-1])) + FIRST_RANGE
            self._call("SetChannel", channel, int(channel in wanted), DC, number, 0.0)
        time_base = round(CLOCK / acquisition.sampling_rate) + 2
        interval, room = ctypes.c_float(), ctypes.c_int32()
        failing = f"{acquisition.n_samples} samples of {acquisition.n_channels} channels do not fit its memory"
        given = time_base, acquisition.n_samples, ctypes.byref(interval), 1, ctypes.byref(room), 0
        self._call("GetTimebase2", *given, failing=failing)
        rate = 1e9 / interval.value
        delay = max(0, round(acquisition.start * rate))
        self._call("SetSimpleTrigger", 1, EXTERNAL, EXTERNAL_THRESHOLD, RISING, delay, 0)
        self._asked, self._time_base, self._ranges, self._rate = acquisition, time_base, wanted, rate
        return acquisition

    def measure(self, position: float, across: float = 0.0) -> Recording:
        """Measure velocity and drive at the vibrometer's spot, which must already be at `position` [m]."""
        counts = []
        for _ in range(self._asked.n_records):
            self.arm()
            counts.append(self._counts())
        return self._recording(position, counts)

    def arm(self) -> None:
        """Arm the scope to record the next burst, without waiting for it."""
        n_samples = self._asked.n_samples
        n_before = min(n_samples, max(0, -round(self._asked.start * self._rate)))
        self._disarm()
        self._waits = True
        self._call("RunBlock", n_before, n_samples - n_before, self._time_base, 1, None, 0, None, None)

    def fetch(self, position: float) -> Recording:
        """Return the record of the burst for which the scope was armed."""
        return self._recording(position, [self._counts()])

    def _recording(self, position: float, records: Sequence[tuple[NDArray[np.int16], int]]) -> Recording:
        """Convert records from counts and overload bits to SI units."""
        asked, (counts, overs) = self._asked, map(np.array, zip(*records, strict=True))
        scale = {0: self._inputs.sensitivity} | dict.fromkeys(asked.drives, self._inputs.attenuation)
        values = [
            counts[:, row].astype(float) * (self._ranges[channel] / self._full_scale * scale[channel])
            for row, channel in enumerate(self._used)
        ]
        names = ("velocity", *(f"drive {number}" for number in asked.drives))
        cut = {
            name for name, channel in zip(names, self._used, strict=True) if np.bitwise_or.reduce(overs) >> channel & 1
        }
        if np.abs(values[0]).max() > self._inputs.highest_velocity:
            cut.add("velocity")
        return Recording(
            position=position,
            time=(round(asked.start * self._rate) + np.arange(asked.n_samples)) / self._rate,
            velocity=values[0],
            drive=np.stack(values[1:], axis=1) if asked.drives else np.empty((len(counts), 0, asked.n_samples)),
            sampling_rate=self._rate,
            overloaded=tuple(name for name in names if name in cut),
        )

    def time_trigger(self, send: Callable[[], object]) -> tuple[float, float]:
        """Call `send` and bound the onset of its burst by the last poll before the record was full and the next one."""
        self.configure(SHORT)
        self.arm()
        SYSTEM_CLOCK.sleep(ARMED)
        with ThreadPoolExecutor(1) as beside:
            sent = beside.submit(send)
            try:
                empty, full = self._wait(self._trigger_wait, pause=0.0)
            finally:
                sent.result()  # raises any failure to send the command, the reason for the missing trigger
        lasted = SHORT.n_samples / self._rate
        return empty - lasted, full - lasted

    def close(self) -> None:
        """Release the scope; never raises."""
        if self._open:
            self._open = False
            for name in ("Stop", "CloseUnit"):
                with contextlib.suppress(RigError, OSError):
                    self._call(name)

    @property
    def _used(self) -> tuple[int, ...]:
        """Inputs in use: that of the vibrometer, then one per drive."""
        return (0, *self._asked.drives)

    def _start(self) -> None:
        status = self._driver.ps3000aOpenUnit(ctypes.byref(self._handle), None)
        if status == NOT_FOUND:
            raise RigError("no PicoScope 3000 is found: connect it by USB, and close other programs that use it")
        if status not in (OK, POWER_NOT_CONNECTED, NOT_A_USB3_PORT):
            raise RigError(f"the PicoScope does not open (status {status} of Pico's library): reconnect it")
        self._open = True
        if status != OK:
            self._call("ChangePowerSource", status)

    def _about(self, what: int) -> str:
        text, needed = ctypes.create_string_buffer(32), ctypes.c_int16()
        self._call("GetUnitInfo", text, len(text), ctypes.byref(needed), what)
        return text.value.decode("ascii", "replace")

    def _counts(self) -> tuple[NDArray[np.int16], int]:
        """Return one record, (n_channels, n_samples) array of counts, and the overload bits of the inputs."""
        asked = self._asked
        self._wait(self._trigger_wait + abs(asked.start) + asked.n_samples / self._rate)
        counts = np.zeros((asked.n_channels, asked.n_samples), dtype=np.int16)
        for channel, row in zip(self._used, counts, strict=True):
            buffer = row.ctypes.data_as(ctypes.POINTER(ctypes.c_int16))
            self._call("SetDataBuffer", channel, buffer, asked.n_samples, 0, 0)
        came, over = ctypes.c_uint32(asked.n_samples), ctypes.c_int16()
        self._call("GetValues", 0, ctypes.byref(came), 1, 0, 0, ctypes.byref(over))
        if came.value != asked.n_samples:
            raise RigError(f"the PicoScope sent {came.value} samples of {asked.n_samples}: measure again")
        return counts, over.value

    def _wait(self, longest: float, pause: float = 1e-3) -> tuple[float, float]:
        """Wait for a full record; return the last instant before it was full and the first when it was [s]."""
        ready, empty = ctypes.c_int16(), SYSTEM_CLOCK.now()
        deadline = empty + longest
        while True:
            asked = SYSTEM_CLOCK.now()
            self._call("IsReady", ctypes.byref(ready))
            if ready.value:
                self._waits = False
                return empty, SYSTEM_CLOCK.now()
            empty = asked
            if empty > deadline:
                self._disarm()
                raise RigError(
                    f"no trigger came within {longest:g} s: wire the generator's trigger output to the scope's EXT "
                    "input, and let the generator play"
                )
            time.sleep(pause)

    def _disarm(self) -> None:
        """Stop waiting for a burst that never came, since an armed unit accepts no settings."""
        if self._waits:
            self._waits = False
            self._call("Stop")

    def _call(self, name: str, *arguments: Any, failing: str = "") -> None:
        """Call a function of the Pico library for this scope; raise RigError unless it succeeds."""
        status = getattr(self._driver, f"ps3000a{name}")(self._handle, *arguments)
        if status != OK:
            why = failing or "reconnect it, and look up the status in Pico's list"
            raise RigError(f"the PicoScope refuses {name} (status {status} of Pico's library): {why}")


def load_driver() -> Any:
    """Return the object with the functions of the Pico library."""
    try:
        return importlib.import_module("picosdk.ps3000a").ps3000a
    # If the native library is missing, the package raises custom errors, even on import.
    except Exception as error:
        raise RigError(
            f"a PicoScope cannot be used here ({error}): install the package picosdk and Pico's PicoSDK, or measure "
            "on the simulated rig"
        ) from error
