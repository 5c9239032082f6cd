"""One session with an instrument over VISA: exchanges, all logged, and one error for all that breaks."""

from __future__ import annotations

import contextlib
import hashlib
import time
import typing
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

Log = Callable[..., None]
"""``log(event, **facts)`` takes one event."""


class LinkError(Exception):
    """An exchange failed; what the instrument has done is unknown, and so is what it will answer next."""


class Resource(typing.Protocol):
    """What a link needs of a VISA resource."""

    timeout: Any

    def write(self, message: str) -> int:
        """Send text."""

    def write_raw(self, message: bytes) -> int:
        """Send bytes."""

    def read(self) -> str:
        """Receive text."""

    def read_raw(self) -> bytes:
        """Receive bytes."""

    def query_binary_values(self, message: str, **options: Any) -> Any:
        """Ask for a block."""

    def close(self) -> None:
        """End the session."""


class Link:
    """Exchanges messages with one instrument.

    Parameters
    ----------
    open_resource : callable
        Opens the VISA resource.
    abandon : callable
        Cuts a resource whose other end may be gone, so that closing it takes no time.
    log : callable
        Takes ``scpi`` events: sent, reply, seconds.
    timeout : float
        Longest wait for a reply [s].
    alive : callable
        Called after each exchange that succeeded.
    """

    def __init__(
        self,
        open_resource: Callable[[], Resource],
        abandon: Callable[[Resource], None],
        *,
        log: Log,
        timeout: float,
        alive: Callable[[], None] = lambda: None,
    ) -> None:
        self._open_resource = open_resource
        self._abandon = abandon
        self._log = log
        self._timeout = timeout
        self._alive = alive
        self._resource: Resource | None = None

    @property
    def is_open(self) -> bool:
        """Whether the session exists and no exchange has failed."""
        return self._resource is not None

    def open(self) -> None:
        """Open the session anew.

        Raises
        ------
        LinkError
            If the instrument cannot be reached.
        """
        self.close()
        started = time.perf_counter()
        try:
            resource = self._open_resource()
            resource.timeout = self._timeout * 1e3
        # Backends raise VisaIOError, OSError, ValueError and plain Exception here.
        except Exception as error:
            self._log("link", did="open", failed=_describe(error), seconds=_since(started))
            raise LinkError(f"it cannot be opened ({_describe(error)})") from error
        self._resource = resource
        self._log("link", did="open", seconds=_since(started))

    def close(self, *, broken: bool = False) -> None:
        """End the session, whatever state it is in; without a word to the other end if it is broken."""
        resource, self._resource = self._resource, None
        if resource is None:
            return
        # The other end may be long gone, and there is nothing left to be done about it.
        if broken:
            with contextlib.suppress(Exception):
                self._abandon(resource)
        with contextlib.suppress(Exception):
            resource.close()

    def ask(self, message: str, *, timeout: float | None = None) -> str:
        """Send a message that contains a query and return the reply.

        Raises
        ------
        LinkError
            If no reply comes in time, or it is not text.
        """
        with self._exchange(message, timeout) as (resource, facts):
            resource.write(message)
            reply = resource.read().strip()
            facts["reply"] = reply
            if not reply.isprintable():
                raise ValueError(f"reply {reply!r} is not text")
        return reply

    def send_block(self, command: str, block: bytes, *, timeout: float) -> None:
        """Send a command whose last argument is a definite block.

        Raises
        ------
        LinkError
            If it cannot be sent.
        """
        length = str(len(block))
        with self._exchange(f"{command},{describe_block(block)}", timeout) as (resource, _):
            resource.write_raw(f"{command},#{len(length)}{length}".encode() + block + b"\n")

    def ask_raw(self, query: str, *, timeout: float) -> bytes:
        """Ask for a reply and return it as it comes, terminator and all.

        Raises
        ------
        LinkError
            If no reply comes in time.
        """
        with self._exchange(query, timeout) as (resource, facts):
            resource.write(query)
            reply = resource.read_raw()
            facts["reply"] = describe_block(reply)
        return reply

    def read_codes(self, query: str, *, timeout: float) -> NDArray[np.uint16]:
        """Ask for a block of codes of two bytes, big-endian, and return them.

        Raises
        ------
        LinkError
            If the reply is no such block.
        """
        with self._exchange(query, timeout) as (resource, facts):
            values = resource.query_binary_values(query, datatype="H", is_big_endian=True, container=np.ndarray)
            codes = np.asarray(values).astype(np.uint16)
            facts["reply"] = describe_block(codes.astype(">u2").tobytes())
        return codes

    @contextlib.contextmanager
    def _exchange(self, message: str, timeout: float | None) -> Iterator[tuple[Resource, dict[str, str]]]:
        """Log an exchange, bound its time, and give the session up if it fails."""
        resource = self._resource
        if resource is None:
            raise LinkError("the connection is closed")
        started = time.perf_counter()
        facts: dict[str, str] = {}
        try:
            if timeout is not None:
                resource.timeout = timeout * 1e3
            yield resource, facts
            if timeout is not None:
                resource.timeout = self._timeout * 1e3
        except Exception as error:
            self.close(broken=True)
            self._log("scpi", sent=message, **facts, failed=_describe(error), seconds=_since(started))
            raise LinkError(f"'{message[:60]}' failed ({_describe(error)})") from error
        except BaseException:
            # Cut by a signal: a reply may still be on its way, so the session is of no more use.
            self.close(broken=True)
            raise
        self._log("scpi", sent=message, **facts, seconds=_since(started))
        self._alive()


def describe_block(block: bytes) -> str:
    """Return length and a short hash of a block, for the log; BLAKE2 takes a fifth of the time of SHA-256."""
    return f"<{len(block)} bytes, blake2b {hashlib.blake2b(block, digest_size=8).hexdigest()}>"


def split_reply(reply: str) -> list[str]:
    """Return the replies of a compound query; semicolons within quotes do not divide."""
    parts, quoted = [""], False
    for letter in reply:
        quoted ^= letter == '"'
        if letter == ";" and not quoted:
            parts.append("")
        else:
            parts[-1] += letter
    return [part.strip() for part in parts]


def _describe(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:200]}" if text else type(error).__name__


def _since(started: float) -> float:
    return round(time.perf_counter() - started, 6)
