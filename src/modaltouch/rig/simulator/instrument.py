"""A simulated generator as seen by its transport, messages in, replies out; in virtual time, by the driver itself."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from modaltouch.rig.pacing import Order, Pacer, Report
from modaltouch.rig.simulator.common import GeneratorState
from modaltouch.rig.simulator.scpi import CommandTable, ScpiError
from modaltouch.system import VirtualClock


@dataclass(frozen=True)
class Reply:
    """The response of an instrument to a message."""

    data: bytes = b""  # response message; empty if the message contained no query
    delay: float = 0.0  # time until it can be read [s]; infinite for a reply that never arrives
    hang_up: bool = False  # whether the connection is reset immediately


class SimulatedInstrument:
    """Executes program messages from any link, one at a time."""

    def __init__(self, afg: GeneratorState[Any], table: CommandTable) -> None:
        self.afg = afg
        self.busy = threading.RLock()  # held while a message is executed
        # Executes a message that a fault affects; returns None for one that no fault affects.
        self.intercept: Callable[[bytes, int], Reply | None] = lambda message, link: None
        self.n_starts = 0  # power-ons after the first, each of which ends all connections
        self._table = table

    def execute(self, message: bytes, link: int = 1) -> Reply:
        """Execute a message received over a link."""
        return self.intercept(message, link) or self.run(message, link)

    def run(self, message: bytes, link: int) -> Reply:
        """Execute a message without faults; link 0 is the front panel."""
        with self.busy:
            self.afg.link = link
            replies = self._table.run(message, fail=self.afg.fail)
        return Reply(b";".join(replies) + b"\n" if replies else b"")


ROUNDING = 1e-9
"""Tolerance for rounding in sums of virtual times [s]."""


class LocalClient:
    """Watchdog client of a driver in the same process, in virtual time: no network, and no process to watch.

    It cannot outlive its process and is therefore only for a twin in the same process.
    """

    def __init__(self, instrument: SimulatedInstrument, clock: VirtualClock) -> None:
        self._instrument = instrument
        self._clock = clock
        self._pacer: Pacer | None = None
        self._start, self._unread = instrument.n_starts, False

    def open(self) -> str:
        """Begin a connection, and return how other programs are locked out."""
        self._start, self._unread = self._instrument.n_starts, False
        return "no other program can reach it"

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> bytes:
        """Have a message executed and return the reply, if one is expected, without waiting for one that is late."""
        if self._unread:
            self._instrument.afg.fail(ScpiError(-410))
        is_open = self._start == self._instrument.n_starts
        received = self._instrument.execute(message) if is_open else Reply(hang_up=True)
        self._unread = bool(received.data) and not reply
        if received.hang_up:
            raise ConnectionResetError("the instrument closed the connection")
        if reply and (not received.data or received.delay > timeout):
            raise TimeoutError(f"no reply within {timeout:g} s")
        return received.data if reply else b""

    def do_nothing(self, **_: bool) -> None:
        """Do nothing, since nothing is held and no other process watches this one."""

    arm = disarm = close = release = do_nothing

    def held_up(self) -> float:
        """Return 0, since nothing stalls in virtual time."""
        return 0.0

    def beat(self) -> str:
        """Return the reason if the bursts ended without a request, else an empty string."""
        return self.look().lost

    def play(self, order: Order) -> Report:
        """Schedule bursts, advance the time until the first is played, and return the report."""
        message = order.command.encode() + b"\n"

        def trigger() -> None:
            self.exchange(message, timeout=order.timeout, reply=False)

        def step() -> None:
            pacer.step()
            if pacer.due is not None:
                self._clock.call_at(pacer.due, step)

        pacer = self._pacer = Pacer(order, trigger, self.held_up, self._clock)
        self._clock.call_at(order.first, step)
        self._clock.sleep(order.first - self._clock.now() + ROUNDING)
        return pacer.report

    def look(self) -> Report:
        """Return the report so far."""
        return Report() if self._pacer is None else self._pacer.report

    def end(self) -> None:
        """Trigger no further burst."""
        if self._pacer is not None:
            self._pacer.end()

    def report(self, *, wait: bool) -> Report:
        """Trigger no further burst and return the report; with `wait`, after the end of the last burst."""
        if self._pacer is not None:
            self._pacer.close()
            if wait:
                self._clock.sleep(self._pacer.silent_from - self._clock.now())
        return self.look()
