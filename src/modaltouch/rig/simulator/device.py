"""What a transport needs of a simulated instrument."""

from __future__ import annotations

import typing
from dataclasses import dataclass

from modaltouch.rig.simulator.scpi import ScpiError


@dataclass(frozen=True)
class Reply:
    """What an instrument makes of a message.

    Attributes
    ----------
    data : bytes
        Response message; empty if nothing was asked.
    delay : float
        Time until it can be read [s]; infinite for a reply that never comes.
    hang_up : bool
        Whether the connection is reset at once.
    """

    data: bytes = b""
    delay: float = 0.0
    hang_up: bool = False


class Device(typing.Protocol):
    """What the server needs of an instrument."""

    @property
    def max_sessions(self) -> int:
        """Links accepted at the same time."""

    @property
    def status_byte(self) -> int:
        """Status byte without the message-available bit."""

    def execute(self, message: bytes, link: int) -> Reply:
        """Carry out one message that came over a link of this number."""

    def perform(self, message: bytes) -> Reply:
        """Carry out one message as the front panel would, past every fault."""

    def fail(self, error: ScpiError) -> None:
        """Put an error in the instrument's queue."""

    def trigger(self, link: int) -> None:
        """Take a group execute trigger that came over a link of this number, 0 for the front panel."""
