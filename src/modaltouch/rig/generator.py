"""The arbitrary function generator over PyVISA: AFG3022B and its relatives.

The outputs are off whenever no stimulus is wanted, whatever happens: after every failure they are switched off
and asked whether they are, and a watchdog process does it where this one cannot. After a failed exchange an
answer may belong to an earlier question, so the session is opened anew, the instrument identified, its outputs
switched off and every setting made again.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Literal, Self, cast

from modaltouch.apparatus import Apparatus
from modaltouch.rig.connection import Connection, Found, Patience
from modaltouch.rig.controls import CHANNELS, Unconfirmed
from modaltouch.rig.guard import Guard, Watchdog
from modaltouch.rig.interface import Firing, RigError
from modaltouch.rig.link import LinkError, Log, Resource
from modaltouch.rig.settings import (
    ARMED,
    STOPPED,
    Setting,
    amplitudes,
    burst_settings,
    continuous_codes,
    continuous_settings,
    guarded_settings,
    level_setting,
    record_peaks,
    timer_setting,
)
from modaltouch.stimulus.burst import Burst

CHUNK = 1 << 20
"""Bytes asked for in one read: a whole record."""


def _ignore(event: str, **facts: Any) -> None:
    """Take an event and forget it."""


class Generator:
    """A generator with its two outputs, as a `modaltouch.rig.interface.Rig`.

    Parameters
    ----------
    address : str
        VISA address.
    apparatus : Apparatus
        Model, load, amplifier and limits.
    log : callable
        ``log(event, **facts)`` takes every exchange and event.
    patience : Patience
        How long to wait.
    visa_library : str
        Backend, as PyVISA names it: ``@py``, or empty for the vendor's.
    repetition : str
        ``burst``: one record at each tick of the trigger timer; ``continuous``: one record that holds burst and
        silence, for an instrument whose burst mode cannot be used.
    start_guard : callable
        Starts the watchdog for an address and a backend.

    Raises
    ------
    RigError
        If there is no such instrument at the address.
    """

    def __init__(
        self,
        address: str,
        apparatus: Apparatus,
        *,
        log: Log = _ignore,
        patience: Patience | None = None,
        visa_library: str = "@py",
        repetition: Literal["burst", "continuous"] = "burst",
        start_guard: Callable[[str, str], Guard] = Watchdog,
    ) -> None:
        self._log = log
        self._repetition = repetition
        self._burst: Burst | None = None
        self._peaks: tuple[float, ...] = ()
        self._settings: tuple[Setting, ...] = ()
        self._levels: tuple[Setting, ...] = ()
        self._firing: Firing | None = None
        self._on = False
        self._closed = False
        self._connection = Connection(
            address,
            apparatus,
            lambda: open_resource(address, visa_library),
            abandon,
            start_guard=lambda: start_guard(address, visa_library),
            log=log,
            patience=patience or Patience(),
        )
        try:
            self._connection.open()
        except BaseException:
            # No output was ever on, so the watchdog has nothing to do.
            self._connection.close(clean=True)
            raise

    @property
    def identity(self) -> str:
        """Reply to ``*IDN?``."""
        return self._connection.identity

    @property
    def address(self) -> str:
        """VISA address."""
        return self._connection.address

    @property
    def firing(self) -> Firing | None:
        """The latest firing; unconfirmed if `stop` found settings or outputs no longer as set."""
        return self._firing

    def load(self, burst: Burst) -> None:
        """Have both channels' records in the instrument, verified, and set everything but the level.

        Parameters
        ----------
        burst : Burst
            One record for each of the two outputs.

        Raises
        ------
        RigError
            If the instrument does not confirm it; the outputs are off.
        """
        if burst.codes.shape[0] != len(CHANNELS):
            raise RigError(
                f"the burst has {burst.codes.shape[0]} channels: the generator has {len(CHANNELS)}; the "
                "outputs are off; give each output an actuator set in the apparatus file"
            )
        self.stop()
        with self._off_after_a_failure("loading the stimulus"):
            self._burst, self._peaks = burst, record_peaks(burst)
            try:
                self._replay()
            except LinkError:
                self._connection.restore("loading the stimulus", (), self._replay)

    def fire(self, velocity: float) -> Firing:
        """Set the level, switch the outputs on and repeat the burst until `stop`.

        Parameters
        ----------
        velocity : float
            Peak velocity at the focus [m/s].

        Returns
        -------
        Firing
            Not confirmed, and the outputs off, if the instrument did not confirm a setting, or the connection
            was lost and found again: the trial is to be offered again.

        Raises
        ------
        RigError
            If nothing is loaded, the level is beyond a limit, or the instrument is lost; the outputs are off.
        """
        if self._burst is None:
            raise RigError("fire was called before load; the outputs are off; load a burst first")
        commanded = amplitudes(self._burst, self._peaks, velocity, self._connection.limits)
        if self._on:
            self.stop()
        with self._off_after_a_failure("starting the stimulus"):
            self._connection.guard.arm()
            self._on = True
            try:
                firing = self._start(commanded, 1 / self._burst.repetition_rate)
            except (Unconfirmed, LinkError) as error:
                firing = _unconfirmed(commanded, error)
                self._log("unconfirmed", reason=firing.reason)
                self._switch_off("starting the stimulus")
                if isinstance(error, Unconfirmed):
                    # Whoever changed a setting is to find it as it was for the next try.
                    self._connection.restore("starting the stimulus", (), self._replay)
        self._firing = firing
        return firing

    def stop(self) -> None:
        """Switch both outputs off, confirm it, and see whether everything still was as set.

        Raises
        ------
        RigError
            If the instrument cannot be brought to confirm it.
        """
        was_on = self._on
        found = self._switch_off("switching the outputs off")
        if was_on and found.faults and self._firing is not None:
            reason = "; ".join(found.faults) + " when the stimulus ended"
            self._firing = replace(self._firing, confirmed=False, reason=reason)
            self._log("unconfirmed", reason=reason)
        if was_on and found.differences:
            self._connection.restore("making the settings again", (), self._replay)

    def heartbeat(self) -> None:
        """Tell the watchdog that the session is alive; costs well under a microsecond between two beats.

        Raises
        ------
        RigError
            If the watchdog is gone while outputs may be on; they have been switched off.
        """
        try:
            self._connection.guard.beat()
        except RigError:
            self._switch_off("going on without a watchdog")
            raise

    def close(self) -> None:
        """Switch the outputs off and release the instrument; never raises.

        If the outputs cannot be confirmed off, the watchdog stays and keeps trying.
        """
        if self._closed:
            return
        self._closed = True
        off = False
        try:
            self.stop()
            off = True
        except RigError as error:
            self._log("close_failed", reason=str(error))
        finally:
            self._connection.close(clean=off)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _switch_off(self, doing: str) -> Found:
        """Switch the outputs off and stop the trigger; return how they were found."""
        was_on, self._on = self._on, False
        expected = [*self._settings, *self._levels, *self._trigger(ARMED)] if was_on else []
        found = self._connection.switch_off(doing, expected, self._replay)
        if was_on:
            with contextlib.suppress(LinkError, Unconfirmed):
                self._connection.controls.apply_each(self._trigger(STOPPED))
        return found

    @contextlib.contextmanager
    def _off_after_a_failure(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (LinkError, Unconfirmed) as error:
            self._switch_off(doing)
            raise RigError(
                f"{doing} failed: {error}; the outputs are off; see `modaltouch rig check`, then go on with "
                "`modaltouch resume`"
            ) from error
        except RigError:
            raise
        except BaseException:
            self._switch_off(doing)
            raise

    def _replay(self) -> None:
        """Have the records in the instrument and make every setting but the level."""
        self._settings = self._levels = ()
        if self._burst is None:
            return
        controls, continuous = self._connection.controls, self._repetition == "continuous"
        codes = continuous_codes(self._burst) if continuous else self._burst.codes
        make = continuous_settings if continuous else burst_settings
        slots: list[int] = []
        settings: list[Setting] = []
        for channel, record in zip(CHANNELS, codes, strict=True):
            slots.append(controls.store(record, channel, slots))
            settings += make(channel, slots[-1], self._burst)
        settings += [] if continuous else [timer_setting(self._burst)]
        controls.apply_each(settings)
        self._settings = (*guarded_settings(self._connection.limits), *settings)

    def _start(self, commanded: tuple[float, ...], period: float) -> Firing:
        """Set both levels with the trigger stopped, switch on, let the trigger go."""
        controls = self._connection.controls
        self._levels = tuple(level_setting(n, amplitude) for n, amplitude in zip(CHANNELS, commanded, strict=True))
        read_back = self.set_levels(commanded)
        changed = controls.differences([*self._settings, *self._trigger(STOPPED)])
        if changed:
            raise Unconfirmed("; ".join(changed), read_back)
        if self._repetition == "continuous":
            controls.command("SOUR1:PHAS:INIT")
        started = time.perf_counter()
        controls.outputs_on()
        if self._repetition == "burst":
            started = time.perf_counter()
            controls.apply([ARMED])
        took = time.perf_counter() - started
        return Firing(commanded, _numbers(read_back), True, started, took + period)

    def set_levels(self, amplitudes: tuple[float, ...]) -> tuple[str, ...]:
        """Set both amplitudes in one message, read them and the error queue back: all that a level change is.

        Parameters
        ----------
        amplitudes : tuple of float
            Of each channel, open circuit [V peak to peak].

        Returns
        -------
        tuple of str
            What was read back.
        """
        levels = [level_setting(n, amplitude) for n, amplitude in zip(CHANNELS, amplitudes, strict=True)]
        return self._connection.controls.apply(levels)

    def _trigger(self, setting: Setting) -> tuple[Setting, ...]:
        return (setting,) if self._repetition == "burst" else ()


def _unconfirmed(commanded: tuple[float, ...], error: Exception) -> Firing:
    read_back = _numbers(error.read_back) if isinstance(error, Unconfirmed) else ()
    return Firing(commanded, read_back, False, time.perf_counter(), 0.0, str(error))


def _numbers(replies: tuple[str, ...]) -> tuple[float, ...]:
    """Return what was read back as numbers; empty if it was not numbers."""
    try:
        return tuple(float(reply) for reply in replies)
    except ValueError:
        return ()


def open_resource(address: str, visa_library: str) -> Resource:
    """Return an open VISA resource.

    Parameters
    ----------
    address : str
        VISA address.
    visa_library : str
        Backend, as PyVISA names it.
    """
    import pyvisa

    _knock(address)
    resource = pyvisa.ResourceManager(visa_library).open_resource(address)
    message_based = cast("pyvisa.resources.MessageBasedResource", resource)
    message_based.chunk_size = CHUNK
    if address.upper().endswith("SOCKET"):
        message_based.read_termination = message_based.write_termination = "\n"
    return cast("Resource", message_based)


def _knock(address: str) -> None:
    """See whether anybody listens, where the address names a port: pyvisa-py leaks a refused socket."""
    host, _, port = (address.split("::") + [""])[1].partition(",")
    if address.upper().startswith("TCPIP") and port.isdigit():
        socket.create_connection((host, int(port)), timeout=5).close()


def abandon(resource: Resource) -> None:
    """Cut a session of pyvisa-py over TCP, so that closing it fails at once.

    Closing says goodbye, and pyvisa-py waits five busy seconds for the reply of a peer that has gone politely.
    Other backends are left to close as they do.
    """
    session = cast("Any", resource).visalib.sessions[cast("Any", resource).session]
    session.interface.sock.shutdown(socket.SHUT_RDWR)


def find_instruments(visa_library: str = "@py") -> tuple[str, ...]:
    """Return the VISA addresses of the instruments that can be found.

    Parameters
    ----------
    visa_library : str
        Backend, as PyVISA names it.

    Raises
    ------
    RigError
        If the backend cannot list them.
    """
    import pyvisa

    try:
        return tuple(pyvisa.ResourceManager(visa_library).list_resources("?*::INSTR"))
    # Backends raise OSError, ValueError and errors of their own.
    except Exception as error:
        raise RigError(
            f"the VISA backend '{visa_library}' cannot list instruments ({error}); use '@py', or install the "
            "vendor's VISA library"
        ) from error
