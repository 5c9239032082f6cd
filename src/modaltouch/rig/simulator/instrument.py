"""A simulated AFG3022B as its transport sees it: messages in, replies out, faults on the way."""

from __future__ import annotations

import math
import threading
import time

from modaltouch.rig.simulator.afg import Afg
from modaltouch.rig.simulator.commands import afg_commands
from modaltouch.rig.simulator.device import Reply
from modaltouch.rig.simulator.faults import Fault, Faults, Kind
from modaltouch.rig.simulator.scpi import ScpiError


class Instrument:
    """Carries out program messages, one at a time whichever link they come from.

    Parameters
    ----------
    afg : Afg
        State of the generator.
    faults : Faults
        What goes wrong.
    """

    def __init__(self, afg: Afg, faults: Faults) -> None:
        self.afg = afg
        self.faults = faults
        self._table = afg_commands(afg)
        self._busy = threading.RLock()

    @property
    def max_sessions(self) -> int:
        """Links accepted at the same time."""
        return self.afg.behaviour.max_sessions

    @property
    def status_byte(self) -> int:
        """Status byte without the message-available bit."""
        return self.afg.status_byte

    def fail(self, error: ScpiError) -> None:
        """Put an error in the queue."""
        self.afg.fail(error)

    def trigger(self, link: int) -> None:
        """Take a group execute trigger, as ``*TRG``."""
        with self._busy:
            self._run(b"*TRG", link)

    def perform(self, message: bytes) -> Reply:
        """Carry out a message as the front panel would, past every fault."""
        with self._busy:
            return Reply(_joined(self._run(message, 0)))

    def _run(self, message: bytes, link: int) -> list[bytes]:
        self.afg.link = link
        return self._table.run(message, fail=self.afg.fail)

    def execute(self, message: bytes, link: int = 1) -> Reply:
        """Carry out a message that came over a link."""
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


def _joined(replies: list[bytes]) -> bytes:
    """Return a response message."""
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
    delay = float(met["delayed_reply"].value) if "delayed_reply" in met else 0.0
    return Reply(data, delay)
