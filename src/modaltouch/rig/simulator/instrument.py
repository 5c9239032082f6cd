"""A simulated generator as seen by its transport: messages in, replies out."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from modaltouch.rig.simulator.common import GeneratorState
from modaltouch.rig.simulator.scpi import CommandTable, ScpiError


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


class DirectTransport:
    """The transport of a driver in the same process: no network, and no wait for a reply that comes too late."""

    def __init__(self, instrument: SimulatedInstrument) -> None:
        self._instrument = instrument
        self._start, self._unread = instrument.n_starts, False

    def open(self) -> str:
        """Begin a connection, and return how other programs are locked out."""
        self._start, self._unread = self._instrument.n_starts, False
        return "no other program can reach it"

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> bytes:
        """Have a message executed and return the reply, if one is expected."""
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

    def close(self, *, broken: bool) -> None:
        """Do nothing, since nothing is held."""

    def release(self) -> None:
        """Do nothing, since nothing is held."""
