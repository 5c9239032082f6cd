"""What a measurement asks and gives: the velocity of a point of the beam and the drive that it belongs to.

The same three verbs stand for the simulated vibrometer and scope and for real ones::

    with simulator.scope() as scope:
        scope.configure(Acquisition(sampling_rate=500e3, n_samples=131_072, n_records=10, drives=(1,)))
        for position in np.linspace(-0.05, 0.05, 41):
            recording = scope.measure(position)

The generator plays meanwhile, by `modaltouch.rig.interface.Rig`; its trigger starts every record. Its held samples
have images around multiples of their rate: sampled no faster than they are held, the drive folds them onto itself, and
a transfer function lacks their droop and half a sample of delay. Sample a few times faster than the record is played.
"""

from __future__ import annotations

import abc
import contextlib
import ctypes
import importlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol import Apparatus
from modaltouch.rig.interface import RigError

FloatArray = NDArray[np.float64]

INPUT_RANGES = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""Input ranges of a PicoScope 3404 [V, peak]."""

OUTPUTS = (1, 2)
"""Generator outputs whose drive can be measured."""


@dataclass(frozen=True)
class Acquisition:
    """What a measurement asks of vibrometer and scope.

    Attributes
    ----------
    sampling_rate : float
        Samples per second [Hz]; the scope takes the nearest that it has, and the recording says which.
    n_samples : int
        Samples of a record, those before the trigger included.
    n_records : int
        Records, one after the other, each started by the generator's trigger; kept apart, so that a coherence can
        be told from them.
    drives : tuple of int
        Generator outputs whose voltage at the beam is measured beside the velocity.
    start : float
        First sample, from the trigger at the start of a burst [s]; negative for what comes before it.
    velocity_range, drive_range : float, optional
        Highest velocity [m/s] and voltage at the beam [V] to be expected; the smallest input range that holds it
        is taken. None for the whole range of the vibrometer, or of the scope's input.
    """

    sampling_rate: float = 500e3
    n_samples: int = 131_072
    n_records: int = 1
    drives: tuple[int, ...] = (1,)
    start: float = 0.0
    velocity_range: float | None = None
    drive_range: float | None = None

    def __post_init__(self) -> None:
        """Refuse what no scope can do."""
        for name, value, unit in (
            ("sampling_rate", self.sampling_rate, "Hz"),
            ("velocity_range", self.velocity_range, "m/s"),
            ("drive_range", self.drive_range, "V"),
        ):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} is {value} {unit}: give a number above 0")
        for name, number, least in (("n_samples", self.n_samples, 2), ("n_records", self.n_records, 1)):
            if number < least:
                raise ValueError(f"{name} is {number}: give at least {least}")
        if not math.isfinite(self.start):
            raise ValueError(f"start is {self.start} s: give a finite time from the trigger")
        if len(set(self.drives)) < len(self.drives) or not set(self.drives) <= set(OUTPUTS):
            raise ValueError(f"drives are {self.drives}: name each generator output of {OUTPUTS} at most once")

    @property
    def n_channels(self) -> int:
        """Scope inputs in use."""
        return 1 + len(self.drives)


@dataclass(frozen=True, eq=False)
class Recording:
    """What was measured at one position, in SI units.

    Attributes
    ----------
    position : float
        Where, origin at mid-beam [m].
    time : (n_samples,) array
        From the trigger, by the scope's clock [s].
    velocity : (n_records, n_samples) array
        Of the point [m/s].
    drive : (n_records, n_drives, n_samples) array
        Voltage at the beam of each drive that was asked for [V].
    sampling_rate : float
        By the scope's clock [Hz].
    overloaded : tuple of str
        What reached the end of its range in any record: ``velocity``, ``drive 1``, ``drive 2``.
    """

    position: float
    time: FloatArray
    velocity: FloatArray
    drive: FloatArray
    sampling_rate: float
    overloaded: tuple[str, ...]

    def fitting(self, asked: Acquisition, headroom: float = 1.25) -> Acquisition:
        """Return a measurement whose ranges fit what was found here, for more resolution at the next.

        Parameters
        ----------
        asked, headroom
            What to change the ranges of; range over the highest value found here [1].

        Raises
        ------
        RigError
            If something was overloaded here, so that its height is not known.
        """
        if self.overloaded:
            raise RigError(
                f"{', '.join(self.overloaded)} was overloaded at {self.position * 1e3:g} mm: its height is not "
                "known; measure with a wider range or a lower drive first"
            )
        highest = float(np.abs(self.velocity).max())
        drive = float(np.abs(self.drive).max(initial=0.0))
        return replace(
            asked,
            velocity_range=highest * headroom if highest > 0 else asked.velocity_range,
            drive_range=drive * headroom if drive > 0 else asked.drive_range,
        )


class Scope(abc.ABC):
    """A vibrometer with a scope behind it, simulated or real."""

    @staticmethod
    def open(apparatus: Apparatus, aim: Callable[[float], None]) -> Scope:
        """Return the scope of an apparatus, a PicoScope; `aim` brings the vibrometer's spot to a position [m].

        Raises
        ------
        RigError
            If its library or the scope is not found.
        """
        return PicoScope(apparatus, aim)

    @property
    @abc.abstractmethod
    def identity(self) -> str:
        """Model and serial number."""

    @abc.abstractmethod
    def configure(self, acquisition: Acquisition) -> Acquisition:
        """Make the settings, and return them as the scope has them.

        Raises
        ------
        RigError
            If the scope cannot do what is asked.
        """

    @abc.abstractmethod
    def measure(self, position: float) -> Recording:
        """Return velocity and drive at a position [m from mid-beam].

        Raises
        ------
        RigError
            If no trigger comes, or the scope fails.
        """

    @abc.abstractmethod
    def close(self) -> None:
        """Release the scope; never raises."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


@dataclass(frozen=True)
class Inputs:
    """What a volt at a scope's inputs stands for, and how many of them each channel takes.

    Attributes
    ----------
    sensitivity, highest_velocity : float
        Of the vibrometer [m/s per V]; end of its range [m/s].
    attenuation : float
        Of the drive's probes [V at the beam per V].
    """

    sensitivity: float
    highest_velocity: float
    attenuation: float

    def ranges(self, acquisition: Acquisition) -> tuple[float, float]:
        """Return the input ranges for velocity and drive [V, peak at the input].

        Raises
        ------
        RigError
            If no range of the scope or the vibrometer is wide enough.
        """
        wanted = acquisition.velocity_range or self.highest_velocity
        if wanted > self.highest_velocity * (1 + 1e-9):
            raise RigError(
                f"a velocity of {wanted * 1e3:g} mm/s is to be measured: the vibrometer's range ends at "
                f"{self.highest_velocity * 1e3:g} mm/s; choose a wider one there, and say so in the apparatus file"
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
                f"{what} is {volts:g} V at the scope's input: at most {INPUT_RANGES[-1]:g} V; use another "
                "sensitivity or a probe of more attenuation, and say so in the apparatus file"
            )
        return fitting[0]


OK, NOT_FOUND = 0, 3
POWER_NOT_CONNECTED, NOT_A_USB3_PORT = 282, 286
"""Statuses of Pico's library; with the last two a scope goes on, fed by USB."""

VARIANT, SERIAL = 3, 4
"""What is asked of a unit."""

DC, RISING, EXTERNAL = 1, 2, 4
EXTERNAL_THRESHOLD = 6553
"""1 V of the external trigger's 5 V, in counts of 32767."""

FIRST_RANGE = 2
"""Pico's number of the range of 50 mV, the first of INPUT_RANGES."""

CLOCK = 125e6
"""Sampling rates are whole fractions of it, by time bases from 3 on [Hz]."""

ALL_INPUTS = (0, 1, 2, 3)


class PicoScope(Scope):
    """Velocity and drive through a PicoScope 3000 of series A, B or D.

    Parameters
    ----------
    apparatus : Apparatus
        Its section ``acquisition`` says what a volt stands for.
    aim : callable
        Brings the vibrometer's spot to a position [m from mid-beam] and returns when it is there: a stage, or a person
        who is asked.
    trigger_wait : float
        Longest wait for the generator's trigger [s].
    driver : object, optional
        What has the functions of Pico's library; looked for where it is left out.

    Raises
    ------
    RigError
        If the library or the scope is not found.
    """

    def __init__(
        self,
        apparatus: Apparatus,
        aim: Callable[[float], None],
        *,
        trigger_wait: float = 2.0,
        driver: Any = None,
    ) -> None:
        self._driver = load_driver() if driver is None else driver
        self._aim = aim
        self._trigger_wait = trigger_wait
        knobs = apparatus.acquisition
        self._inputs = Inputs(knobs.sensitivity_mm_s_per_V * 1e-3, knobs.range_mm_s * 1e-3, knobs.probe_attenuation)
        self._handle = ctypes.c_int16()
        self._open = False
        self._start()
        try:
            self._identity = f"PicoScope {self._about(VARIANT)}, serial {self._about(SERIAL)}"
            highest = ctypes.c_int16()
            self._call("MaximumValue", ctypes.byref(highest))
            self._full_scale = highest.value
            self.configure(Acquisition())
        except BaseException:
            self.close()
            raise

    @property
    def identity(self) -> str:
        """Model and serial number."""
        return self._identity

    def configure(self, acquisition: Acquisition) -> Acquisition:
        """Make the settings, and return them."""
        if acquisition.sampling_rate > CLOCK:
            raise RigError(
                f"{acquisition.sampling_rate:g} samples per second are asked for: at most {CLOCK:g}; lower the "
                "sampling rate"
            )
        velocity_range, drive_range = self._inputs.ranges(acquisition)
        wanted = {0: velocity_range} | dict.fromkeys(acquisition.drives, drive_range)
        for channel in ALL_INPUTS:
            number = INPUT_RANGES.index(wanted.get(channel, INPUT_RANGES[-1])) + FIRST_RANGE
            self._call("SetChannel", channel, int(channel in wanted), DC, number, 0.0)
        time_base = round(CLOCK / acquisition.sampling_rate) + 2
        interval, room = ctypes.c_float(), ctypes.c_int32()
        self._call(
            "GetTimebase2",
            time_base,
            acquisition.n_samples,
            ctypes.byref(interval),
            1,
            ctypes.byref(room),
            0,
            failing=f"{acquisition.n_samples} samples of {acquisition.n_channels} channels do not fit its memory",
        )
        rate = 1e9 / interval.value
        delay = max(0, round(acquisition.start * rate))
        self._call("SetSimpleTrigger", 1, EXTERNAL, EXTERNAL_THRESHOLD, RISING, delay, 0)
        self._asked, self._time_base, self._ranges, self._rate = acquisition, time_base, wanted, rate
        return acquisition

    def measure(self, position: float) -> Recording:
        """Return velocity and drive at a position [m from mid-beam]."""
        self._aim(position)
        asked = self._asked
        counts = np.zeros((asked.n_records, asked.n_channels, asked.n_samples), dtype=np.int16)
        over = 0
        for record in counts:
            over |= self._record(record)
        first = round(asked.start * self._rate)
        scale = {0: self._inputs.sensitivity} | dict.fromkeys(asked.drives, self._inputs.attenuation)
        values = [
            counts[:, row].astype(float) * (self._ranges[channel] / self._full_scale * scale[channel])
            for row, channel in enumerate(self._used)
        ]
        names = ("velocity", *(f"drive {number}" for number in asked.drives))
        cut = {name for name, channel in zip(names, self._used, strict=True) if over >> channel & 1}
        if np.abs(values[0]).max() > self._inputs.highest_velocity:
            cut.add("velocity")
        return Recording(
            position=position,
            time=(first + np.arange(asked.n_samples)) / self._rate,
            velocity=values[0],
            drive=np.stack(values[1:], axis=1) if asked.drives else np.empty((asked.n_records, 0, asked.n_samples)),
            sampling_rate=self._rate,
            overloaded=tuple(name for name in names if name in cut),
        )

    def close(self) -> None:
        """Release the scope; never raises."""
        if self._open:
            self._open = False
            for name in ("Stop", "CloseUnit"):
                with contextlib.suppress(RigError, OSError):
                    self._call(name)

    @property
    def _used(self) -> tuple[int, ...]:
        """Inputs in use: that of the vibrometer, then one to each drive."""
        return (0, *self._asked.drives)

    def _start(self) -> None:
        status = self._driver.ps3000aOpenUnit(ctypes.byref(self._handle), None)
        if status == NOT_FOUND:
            raise RigError("no PicoScope 3000 is found: connect it by USB, and close other programs that use it")
        self._open = True
        if status in (POWER_NOT_CONNECTED, NOT_A_USB3_PORT):
            self._call("ChangePowerSource", status)
        elif status != OK:
            self._open = False
            raise RigError(f"the PicoScope does not open (status {status} of Pico's library): connect it anew")

    def _about(self, what: int) -> str:
        text, needed = ctypes.create_string_buffer(32), ctypes.c_int16()
        self._call("GetUnitInfo", text, len(text), ctypes.byref(needed), what)
        return text.value.decode("ascii", "replace")

    def _record(self, counts: NDArray[np.int16]) -> int:
        """Take one record, (n_channels, n_samples) array of counts, and return which inputs were overloaded."""
        n_samples = self._asked.n_samples
        n_before = min(n_samples, max(0, -round(self._asked.start * self._rate)))
        self._call("RunBlock", n_before, n_samples - n_before, self._time_base, 1, None, 0, None, None)
        self._wait(self._trigger_wait + abs(self._asked.start) + n_samples / self._rate)
        for channel, row in zip(self._used, counts, strict=True):
            buffer = row.ctypes.data_as(ctypes.POINTER(ctypes.c_int16))
            self._call("SetDataBuffer", channel, buffer, n_samples, 0, 0)
        came, over = ctypes.c_uint32(n_samples), ctypes.c_int16()
        self._call("GetValues", 0, ctypes.byref(came), 1, 0, 0, ctypes.byref(over))
        if came.value != n_samples:
            raise RigError(f"{n_samples} samples were asked of the PicoScope, {came.value} came: measure again")
        return over.value

    def _wait(self, longest: float) -> None:
        ready, deadline = ctypes.c_int16(), time.monotonic() + longest
        while True:
            self._call("IsReady", ctypes.byref(ready))
            if ready.value:
                return
            if time.monotonic() > deadline:
                self._call("Stop")
                raise RigError(
                    f"no trigger came within {longest:g} s: wire the generator's trigger output to the scope's EXT "
                    "input, and let the generator play"
                )
            time.sleep(1e-3)

    def _call(self, name: str, *arguments: Any, failing: str = "") -> None:
        """Call a function of Pico's library for this scope, and refuse every status but success."""
        status = getattr(self._driver, f"ps3000a{name}")(self._handle, *arguments)
        if status != OK:
            why = failing or "connect it anew, and see Pico's list of statuses"
            raise RigError(f"the PicoScope refuses {name} (status {status} of Pico's library): {why}")


def load_driver() -> Any:
    """Return what has the functions of Pico's library."""
    try:
        return importlib.import_module("picosdk.ps3000a").ps3000a
    # The package raises errors of its own where the native library is missing, already at import.
    except Exception as error:
        raise RigError(
            f"a PicoScope cannot be used here ({error}): install the package picosdk and Pico's PicoSDK, or measure "
            "on the simulated rig"
        ) from error
