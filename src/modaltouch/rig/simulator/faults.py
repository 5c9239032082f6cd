"""Faults of a simulated instrument, injected on purpose; loaded when the first one is."""

from __future__ import annotations

import math
import re
import threading
import time
from dataclasses import dataclass
from typing import Literal

from modaltouch.rig.simulator.common import Reply, State
from modaltouch.rig.simulator.scpi import ScpiError

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
    """The injected faults of an instrument, consumed by the messages that they affect."""

    def __init__(self, instrument: State) -> None:
        self._instrument = instrument
        instrument.intercept = self._execute
        self._active: list[Fault] = []
        self._lock = threading.Lock()

    def inject(self, kind: Kind, *, when: str = "", times: int = 1, value: float | str = 0.0) -> None:
        """Inject a fault into the next messages that match a regular expression, ignoring case.

        An empty one matches every message; `value` is in seconds, an error number or a text, depending on the kind.
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

    def _execute(self, message: bytes, link: int) -> Reply | None:
        """Execute a message that a fault affects; return None for any other."""
        met = self.take(message)
        if not met:
            return None
        instrument = self._instrument
        with instrument.lock:
            if "power_cycle" in met:
                instrument.power_on()
            if "power_cycle" in met or "dropped_connection" in met:
                return Reply(hang_up=True)
            if "ignored_message" in met:
                return Reply(b"lost", delay=math.inf) if b"?" in message[:4096] else Reply()
            if "slow_command" in met:
                time.sleep(float(met["slow_command"].value))
            reply = instrument.run(_spoil_upload(message, met), link)
            if "scpi_error" in met:
                instrument.fail(ScpiError(int(float(met["scpi_error"].value))))
            if "front_panel" in met:
                instrument.run(str(met["front_panel"].value).encode(), 0)
        return _spoil_reply(reply.data, met)


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
