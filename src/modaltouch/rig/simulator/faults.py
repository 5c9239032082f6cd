"""What can go wrong between a session and its generator, to be switched on at run time."""

from __future__ import annotations

import re
import threading
from dataclasses import dataclass
from typing import Literal

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
"""Kinds of fault, each met by the messages that match its pattern:

- ``delayed_reply``: the reply comes `value` seconds late; ``lost_reply``: it never comes
- ``garbled_reply``: its bytes are not ASCII, or its block is no block
- ``truncated_reply``: half of it comes; ``wrong_reply``: the text `value` comes instead
- ``dropped_connection``: the connection is reset before the message is carried out; ``dropped_reply``: after
- ``ignored_message``: nothing is done and nothing is said
- ``truncated_upload``: the tail of a message is lost on the way
- ``garbled_upload``: one code of an uploaded record is wrong
- ``scpi_error``: error number `value` is queued besides
- ``slow_command``: takes `value` seconds
- ``power_cycle``: the instrument restarts before it
- ``front_panel``: somebody at the instrument does `value` after it
"""


@dataclass
class Fault:
    """One fault: its kind, the messages it meets, how often, and its parameter."""

    kind: Kind
    when: re.Pattern[bytes]
    times: int
    value: float | str


class Faults:
    """The faults that are switched on, taken by the messages that meet them."""

    def __init__(self) -> None:
        self._active: list[Fault] = []
        self._lock = threading.Lock()

    def inject(self, kind: Kind, *, when: str = "", times: int = 1, value: float | str = 0.0) -> None:
        """Switch a fault on.

        Parameters
        ----------
        kind : str
            What goes wrong.
        when : str
            Regular expression searched in each message, letter case ignored; empty meets every message.
        times : int
            How many messages it spoils.
        value : float or str
            Seconds, error number or text, as the kind needs.
        """
        with self._lock:
            self._active.append(Fault(kind, re.compile(when.encode(), re.IGNORECASE), times, value))

    def clear(self) -> None:
        """Switch every fault off."""
        with self._lock:
            self._active.clear()

    @property
    def any(self) -> bool:
        """Whether a fault is still to come."""
        return bool(self._active)

    def take(self, message: bytes) -> dict[Kind, Fault]:
        """Return the faults that a message meets, one of a kind, and count them down."""
        if not self._active:
            return {}
        met: dict[Kind, Fault] = {}
        # A block says nothing about what the message asks.
        head = message[:4096]
        with self._lock:
            for fault in self._active:
                if fault.kind not in met and fault.when.search(head):
                    met[fault.kind] = fault
                    fault.times -= 1
            self._active = [fault for fault in self._active if fault.times > 0]
        return met
