"""Switches the outputs off when the session cannot: a process of its own, a VISA session of its own.

``python -m modaltouch.rig.watchdog ADDRESS`` reads single letters from standard input: ``O`` open the instrument,
which the session has reached, ``A`` outputs may go on, ``.`` the session is alive, ``D`` outputs are off, ``C``
the session ends cleanly. While armed it expects a letter at least every `LIMIT` seconds. If none comes, or the
pipe ends without ``C`` (the session was killed, or its display server took it along), it switches the outputs off.
"""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from modaltouch.rig.quirks import close_leftovers, knock

OPEN, ARM, BEAT, DISARM, CLEAN = b"O", b"A", b".", b"D", b"C"

READY, READY_LATE, TRIPPED, FAILED = "ready", "ready late", "tripped", "failed"
"""What it says on standard output: ``ready late`` if the instrument admits no second session."""

LIMIT = 1.0
"""Longest silence of an armed session [s]."""

PERSISTENCE = 30.0
"""How long it keeps trying to reach the instrument [s]."""

MERCY = 1.0
"""How long a stalled session may go on holding an instrument that admits no second one [s]."""

REPLY_TIMEOUT = 1.0
OFF = ":OUTP1 OFF;:OUTP2 OFF;:OUTP1?;:OUTP2?"


class OffSwitch:
    """Switches the outputs off over a VISA session of its own.

    Parameters
    ----------
    address : str
        VISA address.
    visa_library : str
        Backend, as PyVISA names it.
    """

    def __init__(self, address: str, visa_library: str) -> None:
        self._address = address
        self._visa_library = visa_library
        self._resource: Any = None

    def open(self) -> bool:
        """Open the session and return whether it is."""
        import pyvisa

        try:
            knock(self._address)
            manager = pyvisa.ResourceManager(self._visa_library)
            self._resource = manager.open_resource(self._address)
            self._resource.timeout = REPLY_TIMEOUT * 1e3
        # Backends raise VisaIOError, OSError, ValueError and plain Exception here.
        except Exception as error:
            close_leftovers(error)
            self._resource = None
        return self._resource is not None

    def press(self) -> bool:
        """Switch the outputs off once and return whether the instrument says that they are."""
        if self._resource is None and not self.open():
            return False
        try:
            return str(self._resource.query(OFF)).strip() == "0;0"
        except Exception:
            self._close()
            return False

    @property
    def is_open(self) -> bool:
        """Whether there is a session."""
        return self._resource is not None

    def _close(self) -> None:
        with contextlib.suppress(Exception):
            self._resource.close()
        self._resource = None


def insist(press: Callable[[], bool], *, give_up: float, held: Callable[[float], None]) -> bool:
    """Press until it works or time is up, and return whether it worked.

    Parameters
    ----------
    press : callable
        Tries once; returns whether the outputs are off.
    give_up : float
        Longest time [s].
    held : callable
        Called after each failure with the time since the first try [s].
    """
    started, pause = time.monotonic(), 0.02
    while True:
        if press():
            return True
        elapsed = time.monotonic() - started
        if elapsed > give_up:
            return False
        held(elapsed)
        time.sleep(pause)
        pause = min(2 * pause, 1.0)


def watch(letters: queue.Queue[bytes], off: Callable[[bool], bool], *, limit: float = LIMIT) -> None:
    """Follow a session until it ends.

    Parameters
    ----------
    letters : queue of bytes
        What comes through the pipe; empty bytes at its end.
    off : callable
        Switches the outputs off; told whether the session is stalled rather than gone.
    limit : float
        Longest silence while armed [s].
    """
    armed = False
    while True:
        try:
            letter = letters.get(timeout=limit if armed else None)
        except queue.Empty:
            off(True)
            armed = False
            continue
        if letter == CLEAN:
            return
        if letter == b"":
            off(False)
            return
        armed = letter == ARM or (armed and letter != DISARM)


def _read_letters(letters: queue.Queue[bytes]) -> None:
    """Put what comes through standard input in a queue; select does not work on pipes everywhere."""
    while True:
        try:
            received = os.read(0, 4096)
        except OSError:
            received = b""
        if not received:
            letters.put(b"")
            return
        for letter in received:
            letters.put(bytes([letter]))


def _import_visa() -> None:
    """Import PyVISA without what only arrays and discovery need: half of its time."""
    for name in ("numpy", "psutil"):
        sys.modules.setdefault(name, None)  # type: ignore[arg-type]
    import pyvisa
    import pyvisa_py  # noqa: F401

    logging.getLogger(pyvisa.__name__).disabled = True


def _say(word: str) -> None:
    with contextlib.suppress(OSError):
        os.write(1, word.encode() + b"\n")


def main(address: str, visa_library: str = "@py") -> int:
    """Run the watchdog for the session at the other end of standard input."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    session = os.getppid()
    letters: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_read_letters, args=(letters,), daemon=True).start()
    _import_visa()
    if letters.get() != OPEN:
        return 0  # the session has never had the instrument
    switch = OffSwitch(address, visa_library)
    _say(READY if switch.open() else READY_LATE)
    shared = switch.is_open

    def off(stalled: bool) -> bool:  # noqa: FBT001
        def release(elapsed: float) -> None:
            # A stopped process keeps an instrument that admits one session: only its end sets it free.
            if stalled and not shared and not switch.is_open and elapsed > MERCY and os.getppid() == session:
                with contextlib.suppress(OSError):
                    os.kill(session, getattr(signal, "SIGKILL", signal.SIGTERM))

        done = insist(switch.press, give_up=PERSISTENCE, held=release)
        _say(TRIPPED if done else FAILED)
        return done

    watch(letters, off)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
