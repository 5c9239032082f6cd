"""A simulated generator as seen by its transport: messages in, replies out, with fault injection."""

from __future__ import annotations

import math
import re
import threading
import time
from dataclasses import dataclass
from typing import Any, Literal

from modaltouch.rig.simulator.common import GeneratorState
from modaltouch.rig.simulator.scpi import CommandTable, ScpiError


@dataclass(frozen=True)
class Reply:
    """The response of an instrument to a message."""

    data: bytes = b""  # response message; empty if the message contained no query
    delay: float = 0.0  # time until it can be read [s]; infinite for a reply that never arrives
    hang_up: bool = False  # whether the connection is reset immediately


Kind = Literal[
    "delayed_reply",
    "lost_reply",
    "garbled_reply",
    "truncated_reply",
    "wrong_reply",
    "dropped_connection",
    "dropped_reply",
    "ignored_message",
    "truncated_upload",
    "garbled_upload",
    "scpi_error",
    "slow_command",
    "power_cycle",
    "front_panel",
]
"""Kinds of fault; each affects the messages that match its pattern.

- ``delayed_reply``: the reply is `value` seconds late; ``lost_reply``: it never arrives
- ``garbled_reply``: its bytes are not ASCII, or its block is malformed
- ``truncated_reply``: only half of it arrives; ``wrong_reply``: the text `value` arrives instead
- ``dropped_connection``: the connection is reset before the message is executed; ``dropped_reply``: after
- ``ignored_message``: the message is not executed, and no reply arrives
- ``truncated_upload``: the second half of the message is lost
- ``garbled_upload``: one code of an uploaded record is wrong
- ``scpi_error``: error number `value` is queued in addition
- ``slow_command``: the message takes `value` seconds
- ``power_cycle``: the instrument restarts instead of executing the message
- ``front_panel``: after the message, the command `value` is entered at the front panel
"""


@dataclass
class Fault:
    """One fault: kind, pattern of the messages affected, their number, and parameter."""

    kind: Kind
    when: re.Pattern[bytes]
    times: int
    value: float | str


class Faults:
    """The injected faults, consumed by the messages that they affect."""

    def __init__(self) -> None:
        self._active: list[Fault] = []
        self._lock = threading.Lock()

    def inject(self, kind: Kind, *, when: str = "", times: int = 1, value: float | str = 0.0) -> None:
        """Inject a fault.

        Parameters
        ----------
        kind : str
            Kind of fault.
        when : str
            Regular expression searched for in each message, ignoring case; an empty one matches every message.
        times : int
            Number of messages affected.
        value : float or str
            Seconds, error number or text, depending on the kind.
        """
        with self._lock:
            self._active.append(Fault(kind, re.compile(when.encode(), re.IGNORECASE), times, value))

    def clear(self) -> None:
        """Remove all faults."""
        with self._lock:
            self._active.clear()

    @property
    def any(self) -> bool:
        """Whether a fault is pending."""
        return bool(self._active)

    def take(self, message: bytes) -> dict[Kind, Fault]:
        """Return the faults that affect a message, at most one of each kind, and count them down."""
        if not self._active:
            return {}
        met: dict[Kind, Fault] = {}
        # Only the head of a message is searched, since the content of a block is irrelevant.
        head = message[:4096]
        with self._lock:
            for fault in self._active:
                if fault.kind not in met and fault.when.search(head):
                    met[fault.kind] = fault
                    fault.times -= 1
            self._active = [fault for fault in self._active if fault.times > 0]
        return met


class SimulatedInstrument:
    """Executes program messages from any link, one at a time."""

    def __init__(self, afg: GeneratorState[Any], table: CommandTable, faults: Faults) -> None:
        self.afg = afg
        self.faults = faults
        self._table = table
        self._busy = threading.RLock()

    def trigger(self, link: int) -> None:
        """Execute a group execute trigger, like ``*TRG``."""
        with self._busy:
            self._run(b"*TRG", link)

    def perform(self, message: bytes) -> Reply:
        """Execute a message as if entered at the front panel, without faults."""
        with self._busy:
            return Reply(_joined(self._run(message, 0)))

    def _run(self, message: bytes, link: int) -> list[bytes]:
        self.afg.link = link
        return self._table.run(message, fail=self.afg.fail)

    def execute(self, message: bytes, link: int = 1) -> Reply:
        """Execute a message received over a link."""
        met = self.faults.take(message)
        with self._busy:
            if "power_cycle" in met:
                self.afg.power_on()
            if "power_cycle" in met or "dropped_connection" in met:
                return Reply(hang_up=True)
            if "ignored_message" in met:
                return Reply(b"lost", delay=math.inf) if b"?" in message[:4096] else Reply()
            if "slow_command" in met:
                time.sleep(float(met["slow_command"].value))
            replies = self._run(_spoil_upload(message, met), link)
            if "scpi_error" in met:
                self.afg.fail(ScpiError(int(float(met["scpi_error"].value))))
            if "front_panel" in met:
                self.perform(str(met["front_panel"].value).encode())
        return _spoil_reply(_joined(replies), met)


class DirectTransport:
    """The transport of a driver in the same process: no network, and no wait for a reply that comes too late."""

    def __init__(self, instrument: SimulatedInstrument) -> None:
        self._instrument = instrument

    def open(self) -> str:
        """Do nothing, and return how other programs are locked out."""
        return "no other program can reach it"

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> bytes:
        """Have a message executed and return the reply, if one is expected."""
        received = self._instrument.execute(message)
        if received.hang_up:
            raise ConnectionResetError("the instrument closed the connection")
        if reply and (not received.data or received.delay > timeout):
            raise TimeoutError(f"no reply within {timeout:g} s")
        return received.data if reply else b""

    def close(self, *, broken: bool) -> None:
        """Do nothing, since nothing is held."""

    def release(self) -> None:
        """Do nothing, since nothing is held."""


def _joined(replies: list[bytes]) -> bytes:
    return b";".join(replies) + b"\n" if replies else b""


def _spoil_upload(message: bytes, met: dict[Kind, Fault]) -> bytes:
    if "truncated_upload" in met:
        return message[: len(message) // 2]
    if "garbled_upload" in met:
        spoiled = bytearray(message)
        spoiled[len(message) // 2] ^= 0x01
        return bytes(spoiled)
    return message


def _spoil_reply(data: bytes, met: dict[Kind, Fault]) -> Reply:
    if "dropped_reply" in met:
        return Reply(hang_up=True)
    if "lost_reply" in met:
        return Reply(data or b"lost", delay=math.inf)
    if "garbled_reply" in met:
        data = b"\xfe\xff" + data[2:]
    if "truncated_reply" in met:
        data = data[: max(len(data) // 2, 1)]
    if "wrong_reply" in met:
        data = str(met["wrong_reply"].value).encode() + b"\n"
    return Reply(data, float(met["delayed_reply"].value) if "delayed_reply" in met else 0.0)
