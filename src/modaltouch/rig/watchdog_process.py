"""The watchdog: holds the only session with the instrument, triggers bursts, switches the outputs off in an emergency.

``python -m modaltouch.rig.watchdog_process ADDRESS OFF`` runs it as a separate process; OFF is `Instrument.off`. The
driver (the client) makes every exchange via this process, over a pipe, so that the process can switch the outputs off
at any time, even over an interface limited to a single session (USB). While armed it expects a heartbeat at least every
`PATIENCE` seconds; every request counts as one. If none arrives, no further burst is triggered and the outputs are
switched off. The same happens when the pipe ends without `CLEAN` (the client was killed, possibly together with its
display server).

A request consists of a mark, a letter, a number, a length and that number of bytes. `OPEN`, `EXCHANGE`, `CLOSE`,
`PLAY`, `REPORT`, `BEAT` and `LATE` are answered in the same format, with the number of the request and a letter for the
outcome.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import json
import logging
import os
import queue
import signal
import struct
import sys
import threading
import typing
from collections.abc import Callable, Iterator
from dataclasses import asdict

from modaltouch.rig.interface import InUse, Transport, describe_error
from modaltouch.rig.pacing import PATIENCE, Order, Pacer
from modaltouch.rig.visa import VisaSession
from modaltouch.system import SYSTEM_CLOCK, Clock

OPEN, EXCHANGE, CLOSE, ARM, BEAT, DISARM, CLEAN = b"O", b"X", b"Z", b"A", b".", b"D", b"C"
PLAY, END, REPORT, LATE = b"P", b"E", b"R", b"L"
DONE, FAILED, TAKEN = b"+", b"-", b"!"

HEAD = struct.Struct(">4scII")
"""Header of a request or an answer: mark, letter, number, length."""

MARK = b"mtwd"
"""Start of a request or an answer."""

TERMS = struct.Struct(">d??")
"""Parameters of `EXCHANGE` (before its message) and of `CLOSE`: timeout [s], reply expected, session broken."""

FLAG = struct.Struct(">?")
"""Parameter of `ARM` (whether the outputs play until switched off) and `REPORT` (whether to await the last burst)."""

PERSISTENCE = 30.0
"""Time for which it keeps trying to reach an instrument that plays only when triggered [s]."""

LONG_PERSISTENCE = 3600.0
"""The same for an instrument that plays until switched off [s]."""

WORD_PERIOD = 10.0
"""Time between two warnings at the terminal that outputs may be on [s]."""

REPLY_TIMEOUT = 1.0


class WatchdogProcess:
    """Server of the requests of one client over one transport, which also monitors the client.

    Parameters
    ----------
    transport : Transport
        Transport to the instrument.
    off : str
        Message that switches the outputs off and queries the state of each; on a second line, one that is sent after it
        when no client is left.
    limit : float
        Longest silence of an armed client [s].
    persistence : float
        Time for which it keeps trying to switch off outputs that play only when triggered [s]; LONG_PERSISTENCE for
        outputs that play until switched off.
    say : callable
        Called with each sentence for the terminal.
    clock : Clock
        Clock of its waits.
    """

    def __init__(
        self,
        transport: Transport,
        off: str,
        *,
        limit: float = PATIENCE,
        persistence: float = PERSISTENCE,
        say: Callable[[str], object] = lambda sentence: None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._transport = transport
        self._off, *self._last = f"{off}\n".encode("ascii").splitlines(keepends=True)
        self._limit = limit
        self._persistence = persistence
        self._say = say
        self._clock = clock
        self._busy = threading.Lock()
        self._answering = threading.Lock()
        self._armed = threading.Event()
        self._plays_by_itself = False
        self._reached = False
        self._heard = self._served = self._held_up = 0.0
        self._pacer: Pacer | None = None
        self._pacing = threading.Thread()

    def serve(self, requests: typing.BinaryIO, answer: Callable[[bytes], object]) -> None:
        """Serve requests until `CLEAN`, or until the pipe ends, and then switch the outputs off."""

        def reply(letter: bytes, number: int, content: bytes) -> None:
            # If the answer is not read, the requests end as well.
            with self._answering, contextlib.suppress(OSError):
                answer(frame(letter, number, content))

        waiting: queue.SimpleQueue[tuple[bytes, int, bytes] | None] = queue.SimpleQueue()
        threading.Thread(target=self._watch_client, daemon=True, name="patrol").start()
        threading.Thread(target=self._listen, args=(requests, waiting, reply), daemon=True, name="listener").start()
        while (request := waiting.get()) is not None:
            letter, number, content = request
            if letter == CLEAN:
                with self._busy:
                    self._transport.close(broken=False)
                return
            answered = self._carry_out(letter, content, functools.partial(reply, DONE, number))
            self._served = self._clock.now()
            if answered is not None:
                reply(answered[0], number, answered[1])
        # End bursts ordered in the last moment, too.
        self._end_bursts()
        with self._busy:
            if self._reached and self.switch_off():
                with contextlib.suppress(Exception):
                    for message in self._last:
                        self._transport.exchange(message, timeout=REPLY_TIMEOUT, reply=False)

    def _listen(
        self,
        requests: typing.BinaryIO,
        waiting: queue.SimpleQueue[tuple[bytes, int, bytes] | None],
        reply: Callable[[bytes, int, bytes], None],
    ) -> None:
        """Receive requests as they arrive; a heartbeat counts immediately, even during an earlier exchange."""
        try:
            for letter, number, content in read_frames(requests):
                self._heard = self._clock.now()
                if letter == BEAT:
                    reply(DONE, number, self._encoded_report())
                else:
                    waiting.put((letter, number, content))
        finally:
            self._end_bursts()
            waiting.put(None)

    def _carry_out(
        self, letter: bytes, content: bytes, answer_later: Callable[[bytes], None]
    ) -> tuple[bytes, bytes] | None:
        if letter == ARM:
            self._end_bursts()
            # The outcome of earlier bursts does not concern the stimulus that begins now.
            self._pacer, (self._plays_by_itself,), self._held_up = None, FLAG.unpack(content), 0.0
            self._armed.set()
        elif letter == DISARM:
            self._armed.clear()
        elif letter == LATE:
            return DONE, b"%f" % self._held_up
        elif letter == PLAY:
            self._play(Order(**json.loads(content)), answer_later)
        elif letter == END:
            self._end_bursts()
        elif letter == REPORT:
            return DONE, self._report(*FLAG.unpack(content))
        elif letter in (OPEN, EXCHANGE, CLOSE):
            try:
                with self._busy:
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

    def _play(self, order: Order, answer: Callable[[bytes], None]) -> None:
        """Start to trigger bursts; answer with the report when it is known whether the first was played."""
        self._end_bursts()
        if self._pacing.is_alive():
            self._pacing.join()
        message = order.command.encode() + b"\n"

        def trigger() -> None:
            with self._busy:
                self._transport.exchange(message, timeout=order.timeout, reply=False)

        pacer = self._pacer = Pacer(order, trigger, lambda: self._clock.now() - self._heard, self._clock)
        self._pacing = threading.Thread(
            target=pacer.run, args=(lambda: answer(self._encoded_report()),), daemon=True, name="pacer"
        )
        self._pacing.start()

    def _end_bursts(self) -> None:
        if (pacer := self._pacer) is not None:
            pacer.end()

    def _report(self, wait: bool) -> bytes:
        """End the bursts and return the report; with `wait`, after the end of the last burst."""
        if self._pacer is None:
            return self._encoded_report()
        self._pacer.end()
        if self._pacing.is_alive():
            self._pacing.join()
        if wait:
            self._clock.sleep(self._pacer.silent_from - self._clock.now())
        return self._encoded_report()

    def _encoded_report(self) -> bytes:
        # `ARM` may remove the pacer while a heartbeat is answered.
        return b"{}" if (pacer := self._pacer) is None else json.dumps(asdict(pacer.report)).encode()

    def _watch_client(self) -> None:
        """Switch the outputs off whenever an armed client becomes silent."""
        while self._armed.wait():
            asleep = self._clock.now()
            self._clock.sleep(self._limit / 20)
            self._held_up = max(self._held_up, self._clock.now() - asleep - self._limit / 20)
            if self._silence() <= self._limit:
                continue
            self._end_bursts()
            with self._busy:
                if self._armed.is_set() and self._silence() > self._limit:
                    self._armed.clear()
                    self.switch_off()

    def _silence(self) -> float:
        """Return the time since the last request arrived or was completed [s]."""
        return self._clock.now() - max(self._heard, self._served)

    def switch_off(self) -> bool:
        """Switch the outputs off, over new sessions if necessary; return whether the instrument confirmed it."""
        started, pause = self._clock.now(), 0.02
        next_word, warned = started + REPLY_TIMEOUT, False
        while True:
            with contextlib.suppress(Exception):
                reply = self._transport.exchange(self._off, timeout=REPLY_TIMEOUT, reply=True)
                states = reply.strip().upper().split(b";")
                if len(states) == self._off.count(b"?") and {b"0", b"OFF"}.issuperset(states):
                    if warned:
                        self._say("the generator's outputs are off now")
                    return True
            passed = self._clock.now() - started
            gives_up = passed > (LONG_PERSISTENCE if self._plays_by_itself else self._persistence)
            if gives_up or self._clock.now() > next_word:
                next_word, warned = self._clock.now() + WORD_PERIOD, True
                trying = "no further attempt" if gives_up else "still trying"
                self._say(
                    f"the generator does not confirm that its outputs are off ({trying}): SWITCH THE AMPLIFIER OFF"
                )
            if gives_up:
                return False
            # The failed session is unusable, but a new one may work.
            with contextlib.suppress(Exception):
                self._transport.close(broken=True)
            self._clock.sleep(pause)
            pause = min(2 * pause, 0.5)
            with contextlib.suppress(Exception):
                self._transport.open()


def frame(letter: bytes, number: int, content: bytes = b"") -> bytes:
    """Encode a request or an answer for the pipe."""
    return HEAD.pack(MARK, letter, number, len(content)) + content


def read_frames(stream: typing.BinaryIO) -> Iterator[tuple[bytes, int, bytes]]:
    """Yield letter, number and content of each request until the stream ends or is malformed."""
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
    """Import PyVISA without the packages needed only for arrays and discovery, which halves the import time."""
    for name in ("numpy", "psutil"):
        sys.modules.setdefault(name, None)  # type: ignore[arg-type]
    with contextlib.suppress(ImportError):
        import pyvisa_py  # noqa: F401
    logging.getLogger("pyvisa").disabled = True


def _take_precedence() -> None:
    """Raise the priority of this process, if permitted, since bursts may be late otherwise."""
    gc.disable()
    with contextlib.suppress(AttributeError, OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -10)
    # With autogrouping, Linux compares niceness only within a session, and this process has a separate session.
    with contextlib.suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))


def main(address: str, off: str) -> int:
    """Run the watchdog for the client at the other end of standard input and output."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    _import_visa()
    _take_precedence()
    with open(0, "rb", buffering=1 << 18, closefd=False) as requests:
        WatchdogProcess(VisaSession(address), off, say=_say).serve(requests, _answer)
    return 0


def _answer(data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(1, view) :]


def _say(sentence: str) -> None:
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(f"\nmodaltouch: {sentence}\n")
        sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
