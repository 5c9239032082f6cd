"""The way to one instrument, as a link sees it, and what can fail on it; needs no import that takes time."""

from __future__ import annotations

import typing


class LinkError(Exception):
    """An exchange failed; what the instrument has done is unknown, and so is what it will answer next."""


class InUse(LinkError):  # noqa: N818
    """The instrument belongs to another program for now."""


class TransportError(Exception):
    """What failed at the other end of a transport, already in words."""


class Transport(typing.Protocol):
    """The way to one instrument. Whatever fails raises; the transport is then to be closed and opened anew."""

    def open(self) -> str:
        """Open it anew and return in words how others are kept out.

        Raises
        ------
        InUse
            If another program has the instrument.
        """

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> bytes:
        """Send a message, and return the reply if one is expected, within a time for each [s]."""

    def close(self, *, broken: bool) -> None:
        """End it, without a word to the other end if it is broken."""


def block_bounds(reply: bytes) -> tuple[int, int]:
    """Return where the content of a definite block (IEEE 488.2, 8.7.9) begins and ends.

    Raises
    ------
    ValueError
        If the reply does not begin as one.
    """
    n_digits = reply[1:2]
    length = reply[2 : 2 + int(n_digits)] if n_digits.isdigit() else b""
    if not (reply[:1] == b"#" and length.isdigit()):
        raise ValueError(f"reply {reply[:20]!r} is no block")
    start = 2 + int(n_digits)
    return start, start + int(length)


def describe_error(error: BaseException) -> str:
    """Return kind and text of an error in one line; what comes from a transport is in words already."""
    text = " ".join(str(error).split())[:200]
    if isinstance(error, TransportError):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
