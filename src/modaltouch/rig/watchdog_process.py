"""The watchdog: holds the only session with the instrument, triggers bursts, switches the outputs off in an emergency.

``python -m modaltouch.rig.watchdog_process ADDRESS OFF`` runs it as a separate process; OFF is `Instrument.off`. The
driver (the client) makes every exchange via this process, over a pipe, so that the process can switch the outputs off
at any time, even over an interface limited to a single session (USB). While armed it expects a heartbeat at least every
`PATIENCE` seconds; every request counts as one. If none arrives, no further burst is triggered and the outputs are
switched off. The same happens when the pipe ends without `release` (the client was killed, possibly together with its
display server).

A request is a pickled tuple of a number, the name of a method and its arguments; the answer has the same number, and
the result of the method or an exception. The client alone holds the pipe, and awaits an answer before the next request.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import pickle
import signal
import sys
import threading
import typing
from collections.abc import Callable

from modaltouch.rig.interface import InUse, LinkError, Transport, describe_error
from modaltouch.rig.pacing import PATIENCE, Order, Pacer, Report
from modaltouch.rig.visa import VisaSession
from modaltouch.system import SYSTEM_CLOCK, Clock

OF_TRANSPORT = ("open", "exchange", "close")
"""Requests for the transport; all others are for the methods of `WatchdogProcess`."""

PERSISTENCE = 30.0
"""Time for which it keeps trying to reach an instrument that plays only when triggered [s]."""

LONG_PERSISTENCE = 3600.0
"""The same for an instrument that plays until switched off [s]."""

WORD_PERIOD = 10.0
"""Time between two warnings at the terminal that outputs may be on [s]."""

REPLY_TIMEOUT = 1.0

LARGEST = 1 << 20
"""Size of the buffer for a request: larger than any record [bytes]."""


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
        self._armed = threading.Event()
        self._plays_by_itself = False
        self._reached = False
        self._heard = self._held_up = 0.0
        self._pacer: Pacer | None = None
        self._pacing = threading.Thread()

    def serve(self, requests: typing.BinaryIO, answers: typing.BinaryIO) -> None:
        """Serve requests until `release`, or until the pipe ends, and then switch the outputs off."""
        threading.Thread(target=self._watch_client, daemon=True, name="patrol").start()
        # Whatever is no request, or cannot be answered, counts as the end of the pipe.
        with contextlib.suppress(Exception):
            while True:
                number, name, arguments = pickle.load(requests)
                self._heard = self._clock.now()
                if name == "release":
                    with self._busy:
                        self._transport.close(broken=False)
                    return
                pickle.dump((number, self._carry_out(name, arguments)), answers)
                answers.flush()
        self.end()
        with self._busy:
            if self._reached and self.switch_off():
                with contextlib.suppress(Exception):
                    for message in self._last:
                        self._transport.exchange(message, timeout=REPLY_TIMEOUT, reply=False)

    def _carry_out(self, name: str, arguments: dict[str, typing.Any]) -> object:
        if name not in OF_TRANSPORT:
            return getattr(self, name)(**arguments)
        with self._busy:
            try:
                outcome = getattr(self._transport, name)(**arguments)
                self._reached = True
            except InUse as error:
                return error
            # Backends raise VisaIOError, OSError, ValueError and plain Exception.
            except Exception as error:
                return LinkError(describe_error(error))
            finally:
                # Meanwhile the client was waiting, not silent.
                self._heard = self._clock.now()
        return outcome

    def arm(self, *, free_running: bool) -> None:
        """Expect heartbeats, since outputs may be on; if `free_running`, they play until switched off."""
        self.end()
        # The outcome of earlier bursts does not concern the stimulus that begins now.
        self._pacer, self._plays_by_itself, self._held_up = None, free_running, 0.0
        self._armed.set()

    def disarm(self) -> None:
        """Expect no heartbeats, since the outputs are off."""
        self._armed.clear()

    def held_up(self) -> float:
        """Return the longest stall of this process since `arm` [s]."""
        return self._held_up

    def play(self, order: Order) -> None:
        """Start to trigger bursts."""
        self.end()
        if self._pacing.is_alive():
            self._pacing.join()
        message = order.command.encode() + b"\n"

        def trigger() -> None:
            with self._busy:
                self._transport.exchange(message, timeout=order.timeout, reply=False)

        self._pacer = Pacer(order, trigger, self._silence, self._clock)
        self._pacing = threading.Thread(target=self._pacer.run, daemon=True, name="pacer")
        self._pacing.start()

    def look(self) -> Report:
        """Return the report so far."""
        return Report() if self._pacer is None else self._pacer.report

    def end(self) -> None:
        """Trigger no further burst."""
        if self._pacer is not None:
            self._pacer.end()

    def report(self, *, wait: bool) -> Report:
        """End the bursts and return the report; with `wait`, after the end of the last burst."""
        self.end()
        if self._pacing.is_alive():
            self._pacing.join()
        if wait and self._pacer is not None:
            self._clock.sleep(self._pacer.silent_from - self._clock.now())
        return self.look()

    def _watch_client(self) -> None:
        """Switch the outputs off whenever an armed client becomes silent."""
        while self._armed.wait():
            asleep = self._clock.now()
            self._clock.sleep(self._limit / 20)
            self._held_up = max(self._held_up, self._clock.now() - asleep - self._limit / 20)
            if self._silence() <= self._limit:
                continue
            self.end()
            with self._busy:
                if self._armed.is_set() and self._silence() > self._limit:
                    self._armed.clear()
                    self.switch_off()

    def _silence(self) -> float:
        """Return the time since the last request arrived, or an exchange was completed [s]."""
        return self._clock.now() - self._heard

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


def main(address: str, off: str) -> None:
    """Run the watchdog for the client at the other end of standard input and output."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    _import_visa()
    _take_precedence()
    with open(0, "rb", buffering=LARGEST, closefd=False) as requests, open(1, "wb", closefd=False) as answers:
        WatchdogProcess(VisaSession(address), off, say=_say).serve(requests, answers)


def _say(sentence: str) -> None:
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(f"\nmodaltouch: {sentence}\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
