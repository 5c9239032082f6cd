"""Holds the one session with the instrument, and switches the outputs off when its master cannot.

``python -m modaltouch.rig.watchdog ADDRESS`` is a process of its own. The driver asks it for every
exchange through a pipe, so that it can go in at any time: over any interface, those that admit one session (USB)
and those that it has locked (LAN) among them. While armed it expects a sign of life at least every `LIMIT` seconds;
an exchange is one. If none comes, or the pipe ends without `CLEAN` (the master was killed, or its display server
took it along), it switches the outputs off.

A request is a letter, a number that its answer bears, and a length, followed by as many bytes; `OPEN`, `EXCHANGE`
and `CLOSE` are answered, with a letter for how it went and with what came of it.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import struct
import sys
import threading
import time
import typing
from collections.abc import Callable, Iterator

from modaltouch.rig.transport import InUse, Transport, describe_error
from modaltouch.rig.visa import VisaSession

OPEN, EXCHANGE, CLOSE, ARM, BEAT, DISARM, CLEAN = b"O", b"X", b"Z", b"A", b".", b"D", b"C"
DONE, FAILED, TAKEN = b"+", b"-", b"!"

HEAD = struct.Struct(">4scII")
"""What a request or an answer begins with: mark, letter, number, length."""

MARK = b"mtwd"
"""Tells a beginning from bytes that belong elsewhere."""

TERMS = struct.Struct(">d??")
"""Before what an exchange sends, and all that a close sends: time [s], whether a reply is due, whether it is broken."""

LIMIT = 1.0
"""Longest silence of an armed session [s]."""

PERSISTENCE = 30.0
"""How long it keeps trying to reach the instrument [s]."""

REPLY_TIMEOUT = 1.0
OFF = b":OUTP1 OFF;:OUTP2 OFF;:OUTP1?;:OUTP2?\n"


class Watch:
    """Carries out the requests of one master over one transport, and watches over it.

    Parameters
    ----------
    transport : Transport
        The way to the instrument, not open yet.
    limit : float
        Longest silence while armed [s].
    persistence : float
        How long the instrument is tried to be reached [s].
    """

    def __init__(self, transport: Transport, *, limit: float = LIMIT, persistence: float = PERSISTENCE) -> None:
        self._transport = transport
        self._limit = limit
        self._persistence = persistence
        self._busy = threading.Lock()
        self._armed = threading.Event()
        self._reached = False
        self._heard = 0.0

    def serve(self, requests: typing.BinaryIO, answer: Callable[[bytes], object]) -> None:
        """Carry out requests until the pipe ends; the outputs are off then.

        Parameters
        ----------
        requests : binary stream
            From the master.
        answer : callable
            Takes each answer.
        """
        threading.Thread(target=self._patrol, daemon=True, name="patrol").start()
        for letter, number, content in read_frames(requests):
            with self._busy:
                if letter == CLEAN:
                    self._transport.close(broken=False)
                    return
                answered = self._carry_out(letter, content)
                self._heard = time.monotonic()
            if answered is not None:
                # If nobody takes it, the requests end as well.
                with contextlib.suppress(OSError):
                    answer(frame(answered[0], number, answered[1]))
        with self._busy:
            if self._reached:
                self.switch_off()

    def _carry_out(self, letter: bytes, content: bytes) -> tuple[bytes, bytes] | None:
        if letter == ARM:
            self._armed.set()
        elif letter == DISARM:
            self._armed.clear()
        elif letter in (OPEN, EXCHANGE, CLOSE):
            try:
                return DONE, self._use(letter, content)
            # Backends raise VisaIOError, OSError, ValueError and plain Exception.
            except Exception as error:
                in_use = isinstance(error, InUse)
                return (TAKEN, str(error).encode()) if in_use else (FAILED, describe_error(error).encode())
        return None

    def _use(self, letter: bytes, content: bytes) -> bytes:
        if letter == OPEN:
            shut = self._transport.open()
            self._reached = True
            return shut.encode()
        timeout, reply, broken = TERMS.unpack_from(content)
        if letter == CLOSE:
            self._transport.close(broken=broken)
            return b""
        return self._transport.exchange(content[TERMS.size :], timeout=timeout, reply=reply)

    def _patrol(self) -> None:
        """Switch the outputs off when an armed master falls silent, as often as it does."""
        while self._armed.wait():
            time.sleep(self._limit / 20)
            with self._busy:
                if self._armed.is_set() and time.monotonic() - self._heard > self._limit:
                    self._armed.clear()
                    self.switch_off()

    def switch_off(self) -> bool:
        """Switch the outputs off, over new sessions if need be, and return whether the instrument confirms it."""
        started, pause = time.monotonic(), 0.02
        while True:
            with contextlib.suppress(Exception):
                if self._press():
                    return True
            if time.monotonic() - started > self._persistence:
                return False
            # The session that failed is of no use; a new one may be.
            with contextlib.suppress(Exception):
                self._transport.close(broken=True)
            time.sleep(pause)
            pause = min(2 * pause, 1.0)
            with contextlib.suppress(Exception):
                self._transport.open()

    def _press(self) -> bool:
        return self._transport.exchange(OFF, timeout=REPLY_TIMEOUT, reply=True).strip() == b"0;0"


def frame(letter: bytes, number: int, content: bytes = b"") -> bytes:
    """Return a request or an answer as it goes through the pipe."""
    return HEAD.pack(MARK, letter, number, len(content)) + content


def read_frames(stream: typing.BinaryIO) -> Iterator[tuple[bytes, int, bytes]]:
    """Yield letter, number and content until the stream ends, or holds what is none of these."""
    while True:
        head = stream.read(HEAD.size)
        if len(head) < HEAD.size:
            return
        mark, letter, number, length = HEAD.unpack(head)
        content = stream.read(length)
        if mark != MARK or len(content) < length:
            return
        yield letter, number, content


def _import_visa() -> None:
    """Import PyVISA without what only arrays and discovery need: half of its time."""
    for name in ("numpy", "psutil"):
        sys.modules.setdefault(name, None)  # type: ignore[arg-type]
    with contextlib.suppress(ImportError):
        import pyvisa_py  # noqa: F401
    logging.getLogger("pyvisa").disabled = True


def main(address: str) -> int:
    """Run the watchdog for the session at the other end of standard input."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    _import_visa()
    with open(0, "rb", buffering=1 << 18, closefd=False) as requests:
        Watch(VisaSession(address)).serve(requests, _answer)
    return 0


def _answer(data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(1, view) :]


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
