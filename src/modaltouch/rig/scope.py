"""The scope that records the vibrometer: common interface of simulated and real scopes, and a PicoScope 3000 driver."""

from __future__ import annotations

import abc
import contextlib
import ctypes
import functools
import importlib
import operator
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol import Apparatus
from modaltouch.rig.acquisition import INPUT_RANGES, Acquisition, Inputs, Recording
from modaltouch.rig.interface import RigError
from modaltouch.system import SYSTEM_CLOCK


class Scope(contextlib.AbstractContextManager["Scope"]):
    """A vibrometer and the scope that records it, simulated or real.

    Attributes
    ----------
    slowest : float
        Time beyond the duration of a record after which recording and fetching it counts as stalled [s].
    """

    slowest = 120.0

    @staticmethod
    def open(apparatus: Apparatus) -> Scope:
        """Return the scope of an apparatus, a PicoScope.

        Raises
        ------
        RigError
            If its library or the scope is not found.
        """
        return PicoScope(apparatus)

    @property
    @abc.abstractmethod
    def identity(self) -> str:
        """Model and serial number."""

    @abc.abstractmethod
    def configure(self, acquisition: Acquisition) -> Acquisition:
        """Apply the settings and return them.

        Raises
        ------
        RigError
            If the scope does not support these settings.
        """

    @abc.abstractmethod
    def measure(self, position: float, across: float = 0.0) -> Recording:
        """Measure velocity and drive at a point: position along the beam from mid-beam, across from the mid-line [m].

        Raises
        ------
        RigError
            If no trigger arrives, or the scope fails.
        """

    def arm(self) -> None:
        """Arm the scope to record the next burst, without waiting for it.

        Raises
        ------
        RigError
            If the scope fails or does not support arming.
        """
        raise RigError(f"{self.identity}: it cannot wait for a single burst; use a PicoScope")

    def fetch(self, position: float) -> Recording:
        """Return the record of the burst for which the scope was armed.

        Parameters
        ----------
        position : float
            Measured point, origin at mid-beam [m].

        Raises
        ------
        RigError
            If no trigger arrived, or the scope fails.
        """
        raise RigError(f"{self.identity}: it was not armed for a burst")

    def time_trigger(self, send: Callable[[], object]) -> tuple[float, float]:
        """Call `send`, which triggers one burst, and return the earliest and latest instant of its onset [s].

        Raises
        ------
        RigError
            If no trigger arrives, or the scope cannot time it.
        """
        raise RigError(f"{self.identity}: cannot tell when a burst began; use a PicoScope")

    @abc.abstractmethod
    def close(self) -> None:
        """Release the scope; never raises."""

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

CLOCK = 125e6
"""Clock rate [Hz]; for time bases from 3, sampling rates are integer fractions of it."""

ALL_INPUTS = (0, 1, 2, 3)

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

    Raises
    ------
    RigError
        If the library or the scope is not found.
    """

    identity = ""

    def __init__(
        self,
        apparatus: Apparatus,
        *,
        trigger_wait: float = 2.0,
        driver: Any = None,
    ) -> None:
        self._driver = load_driver() if driver is None else driver
        self._trigger_wait = trigger_wait
        knobs = apparatus.acquisition
        self._inputs = Inputs(knobs.sensitivity_mm_s_per_V * 1e-3, knobs.range_mm_s * 1e-3, knobs.probe_attenuation)
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
        if acquisition.sampling_rate > CLOCK:
            raise RigError(
                f"{acquisition.sampling_rate:g} samples per second are asked for: at most {CLOCK:g}; lower the "
                "sampling rate"
            )
        self._disarm()
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
        asked, counts = self._asked, np.array([each for each, _ in records])
        over = functools.reduce(operator.or_, (each for _, each in records))
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
        self._open = True
        if status in (POWER_NOT_CONNECTED, NOT_A_USB3_PORT):
            self._call("ChangePowerSource", status)
        elif status != OK:
            self._open = False
            raise RigError(f"the PicoScope does not open (status {status} of Pico's library): reconnect it")

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
            raise RigError(
                f"{asked.n_samples} samples were requested from the PicoScope, but {came.value} came: measure again"
            )
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
