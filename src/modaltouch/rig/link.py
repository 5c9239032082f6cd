"""Logged exchanges with one instrument, with one error type for all failures; independent of VISA and processes."""

from __future__ import annotations

import contextlib
import hashlib
import time
import typing
from collections.abc import Callable

from modaltouch.rig.interface import LinkError


class InUse(LinkError):  # noqa: N818
    """The instrument is in use by another program."""


class TransportError(Exception):
    """A failure at the other end of a transport, already described by its text."""


class Transport(typing.Protocol):
    """A transport to one instrument; every failure raises, and the transport must then be closed and reopened."""

    def open(self) -> str:
        """Reopen the transport; return a sentence on how other programs are locked out.

        Raises
        ------
        InUse
            If another program has the instrument.
        """

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> bytes:
        """Send a message and return the reply, if one is expected; each may take up to `timeout` [s]."""

    def close(self, *, broken: bool) -> None:
        """Close the transport; if broken, without notifying the other end."""


def block_bounds(reply: bytes) -> tuple[int, int]:
    """Return start and end of the content of a definite-length block (IEEE 488.2, 8.7.9).

    Raises
    ------
    ValueError
        If the reply does not begin with a block header.
    """
    n_digits = reply[1:2]
    length = reply[2 : 2 + int(n_digits)] if n_digits.isdigit() else b""
    if not (reply[:1] == b"#" and length.isdigit()):
        raise ValueError(f"reply {reply[:20]!r} is not a block")
    start = 2 + int(n_digits)
    return start, start + int(length)


def describe_error(error: BaseException) -> str:
    """Return type and text of an error in one line; for a TransportError, the text alone."""
    text = " ".join(str(error).split())[:200]
    if isinstance(error, TransportError):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


Log = Callable[..., None]
"""``log(event, **facts)`` logs one event."""

T = typing.TypeVar("T")


class Link:
    """Message exchange with one instrument; failures and timeouts raise LinkError.

    Parameters
    ----------
    transport : Transport
        Transport to the instrument, not yet open.
    log : callable
        Called with ``link`` events and, for each exchange, an ``scpi`` event: sent, reply, seconds.
    timeout, copy_timeout : float
        Longest wait for a reply, and for an upload, a copy between memories or ``*OPC?`` [s].
    """

    def __init__(self, transport: Transport, *, log: Log, timeout: float, copy_timeout: float) -> None:
        self._transport = transport
        self.log = log
        self._timeout = timeout
        self._copy_timeout = copy_timeout
        self._open = False

    def open(self) -> None:
        """Reopen the session.

        Raises
        ------
        InUse
            If another program has the instrument.
        LinkError
            If the instrument cannot be reached.
        """
        self.close()
        started = time.perf_counter()
        try:
            shut = self._transport.open()
        # Backends raise VisaIOError, OSError, ValueError and plain Exception here.
        except Exception as error:
            self.log("link", did="open", failed=describe_error(error), seconds=_since(started))
            if isinstance(error, InUse):
                raise
            raise LinkError(f"it cannot be opened ({describe_error(error)})") from error
        self._open = True
        self.log("link", did="open", others=shut, seconds=_since(started))

    def close(self, *, broken: bool = False) -> None:
        """Close the session in any state; if broken, without notifying the other end."""
        was_open, self._open = self._open, False
        if was_open:
            # The other end may have gone; nothing can be done about it.
            with contextlib.suppress(Exception):
                self._transport.close(broken=broken)

    def ask(self, query: str, *, timeout: float | None = None) -> str:
        """Send a message that contains a query and return the reply."""

        def read(reply: bytes, facts: dict[str, str]) -> str:
            text = reply.decode("ascii").strip()
            facts["reply"] = text
            if not text.isprintable():
                raise ValueError(f"reply {text!r} is not text")
            return text

        return self._exchange(query, query.encode("ascii"), timeout, read)

    def send(self, message: str) -> None:
        """Send a message without a query; return when the instrument has accepted it."""
        self._exchange(message, message.encode("ascii"), None, None)

    def send_block(self, command: str, block: bytes) -> None:
        """Send a command whose last argument is a definite-length block."""
        length = str(len(block))
        message = f"{command},#{len(length)}{length}".encode("ascii") + block
        self._exchange(f"{command},{describe_block(block)}", message, self._copy_timeout, None)

    def ask_block(self, query: str) -> bytes:
        """Query a definite-length block and return its content; the reply may take as long as a copy."""

        def read(reply: bytes, facts: dict[str, str]) -> bytes:
            start, end = block_bounds(reply)
            if len(reply) < end:
                raise ValueError(f"the block announces {end - start} bytes, but {len(reply) - start} came")
            facts["reply"] = describe_block(reply[start:end])
            return reply[start:end]

        return self._exchange(query, query.encode("ascii"), self._copy_timeout, read)

    def _exchange(
        self,
        shown: str,
        message: bytes,
        timeout: float | None,
        read: Callable[[bytes, dict[str, str]], T] | None,
    ) -> T:
        """Carry out and log an exchange within its timeout; a failure closes the session."""
        if not self._open:
            raise LinkError("the connection is closed")
        started = time.perf_counter()
        facts: dict[str, str] = {}
        value: T | None = None
        try:
            limit = self._timeout if timeout is None else timeout
            reply = self._transport.exchange(message + b"\n", timeout=limit, reply=read is not None)
            if read is not None:
                value = read(reply, facts)
        except Exception as error:
            self.close(broken=True)
            self.log("scpi", sent=shown, **facts, failed=describe_error(error), seconds=_since(started))
            raise LinkError(f"'{shown[:60]}' failed ({describe_error(error)})") from error
        except BaseException:
            # After an interruption by a signal a reply may still arrive, so the session is no longer usable.
            self.close(broken=True)
            raise
        self.log("scpi", sent=shown, **facts, seconds=_since(started))
        return typing.cast("T", value)


def describe_block(block: bytes) -> str:
    """Return the length and a short hash of a block, for the log; BLAKE2 is five times as fast as SHA-256."""
    return f"<{len(block)} bytes, blake2b {hashlib.blake2b(block, digest_size=8).hexdigest()}>"


def split_reply(reply: str) -> list[str]:
    """Split the reply to a compound query at semicolons outside quotes."""
    parts, quoted = [""], False
    for letter in reply:
        quoted ^= letter == '"'
        if letter == ";" and not quoted:
            parts.append("")
        else:
            parts[-1] += letter
    return [part.strip() for part in parts]


def _since(started: float) -> float:
    return round(time.perf_counter() - started, 6)
