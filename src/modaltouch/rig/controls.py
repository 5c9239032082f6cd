"""Logged exchanges with the generator, and its settings, each read back; sessions and safety are handled elsewhere."""

from __future__ import annotations

import contextlib
import hashlib
import re
import time
import typing
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.instrument import Instrument, Setting
from modaltouch.rig.interface import (
    InUse,
    LinkError,
    Transport,
    Unconfirmed,
    block_bounds,
    describe_error,
)

NO_ERROR = 0
QUERIES_PER_MESSAGE = 12
MOST_ERRORS = 64

Log = Callable[..., None]
"""``log(event, **facts)`` logs one event."""

T = typing.TypeVar("T")


class Controls:
    """Exchanges with one generator: applies settings with read-back and uploads records.

    Failures and timeouts raise LinkError, replies that do not confirm a command Unconfirmed. Each exchange is logged as
    an ``scpi`` event: sent, reply, seconds. After a failed one, `revive` reopens the connection, outputs off. `timeout`
    and `copy_timeout` are the longest waits for a reply, and for an upload, a copy or ``*OPC?`` [s]. `stored` holds the
    hash of the record in each memory with known content.
    """

    def __init__(
        self,
        transport: Transport,
        instrument: Instrument,
        *,
        revive: Callable[[], object],
        log: Log,
        timeout: float,
        copy_timeout: float,
    ) -> None:
        self._transport = transport
        self.log = log
        self._timeout = timeout
        self._copy_timeout = copy_timeout
        self._open = False
        self._instrument = instrument
        self._table = instrument.commands
        self.revive = revive
        self.stored: dict[str, str] = {}

    def open(self) -> None:
        """Reopen the session; raises InUse if another program has the instrument, LinkError if none answers."""
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
            text = reply.decode("latin1").strip()
            if not (text.isascii() and text.isprintable()):
                raise LinkError(f"reply {text[:100]!r} is not text")
            facts["reply"] = text
            return text

        return self._exchange(query, query.encode("ascii"), timeout, read)

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
        self, shown: str, message: bytes, timeout: float | None, read: Callable[[bytes, dict[str, str]], T] | None
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
            if isinstance(error, InUse):
                raise
            raise LinkError(f"'{shown[:60]}' failed ({describe_error(error)})") from error
        except BaseException:
            # After an interruption by a signal a reply may still arrive, so the session is no longer usable.
            self.close(broken=True)
            raise
        self.log("scpi", sent=shown, **facts, seconds=_since(started))
        return typing.cast("T", value)

    def clear_errors(self) -> None:
        """Clear the error queue and the status registers, without reading them."""
        self.ask("*CLS;*OPC?")

    def reset(self) -> None:
        """Restore the defaults, outputs off; memories keep their records but are read back before use."""
        self.stored.clear()
        self.ask("*RST;*OPC?", timeout=self._copy_timeout)
        self._refuse_errors("*RST", self.pending_errors())

    def outputs_off(self) -> tuple[tuple[bool, ...], tuple[str, ...]]:
        """Switch both outputs off with confirmation; return which were on, and the errors reported."""
        outputs = self._instrument.on_all(self._table.output)
        asked = ";".join(f":{output.query}" for output in outputs)
        off = ";".join(f":{output.off.command}" for output in outputs)
        replies = split_reply(self.ask(f"{asked};{off};{asked};:SYST:ERR?"))
        n = len(outputs)
        are_off = [output.off.confirmed_by(reply) for output, reply in zip(2 * outputs, replies, strict=False)]
        if len(replies) != 2 * n + 1 or not all(are_off[n:]):
            raise Unconfirmed(f"asked whether its outputs are off, the generator says {replies[n : 2 * n]}")
        errors: list[str] = []
        if _error_number(replies[-1]) != NO_ERROR:
            errors = [replies[-1], *self.pending_errors()]
        return tuple(not is_off for is_off in are_off[:n]), tuple(errors)

    def apply(self, settings: Sequence[Setting]) -> tuple[str, ...]:
        """Apply settings in one message, read each back, check the error queue, and return the values read back."""
        commands = ";:".join(setting.command for setting in settings)
        queries = ";:".join(setting.query for setting in settings)
        replies = split_reply(self.ask(f":{commands};:{queries};:SYST:ERR?"))
        if len(replies) != len(settings) + 1:
            raise Unconfirmed(f"to '{commands}' the generator answers {replies}")
        read_back = tuple(replies[:-1])
        self._refuse_errors(commands, replies[-1:], read_back)
        wrong = _differences(settings, replies)
        if wrong:
            raise Unconfirmed("; ".join(wrong), read_back)
        return read_back

    def apply_each(self, settings: Iterable[Setting]) -> None:
        """Apply settings one by one."""
        for setting in settings:
            self.apply([setting])

    def differences(self, settings: Sequence[Setting]) -> list[str]:
        """Describe the settings that no longer read back as applied."""
        wrong = []
        for start in range(0, len(settings), QUERIES_PER_MESSAGE):
            part = settings[start : start + QUERIES_PER_MESSAGE]
            replies = split_reply(self.ask(":" + ";:".join(setting.query for setting in part)))
            if len(replies) != len(part):
                raise Unconfirmed(f"{len(part)} settings were queried, but {len(replies)} came back: {replies}")
            wrong += _differences(part, replies)
        return wrong

    def store(self, records: Sequence[tuple[int, NDArray[np.uint16]]]) -> list[str]:
        """Store the codes for each channel, if not yet stored; verify them, and return the names of their memories.

        Raises Unconfirmed if a record is too short or too long, or cannot be verified after two uploads.
        """
        most = self._instrument.converter.max_points
        for _, codes in records:
            if not 2 <= codes.size <= most:
                raise Unconfirmed(f"a record of {codes.size} points: the generator holds 2 to {most}")
        return self._instrument.records.store(self, records)

    def upload_twice(self, memory: str, upload: Callable[[], None]) -> None:
        """Call `upload`, and repeat it once if it is not confirmed."""
        try:
            upload()
        except Unconfirmed as error:
            self.log("upload_repeated", memory=memory, reason=str(error))
            upload()

    def complete(self, command: str = "", *queries: str) -> list[str]:
        """Wait until a command is completed, or an upload; check the errors, and return replies to further queries."""
        what = command or "the upload"
        whole = ";:".join([f":{command};*OPC?" if command else "*OPC?", "SYST:ERR?", *queries])
        replies = split_reply(self.ask(whole, timeout=self._copy_timeout))
        if len(replies) != len(queries) + 2:
            raise Unconfirmed(f"to '{what}' the generator answers {replies}")
        self._refuse_errors(what, replies[1:2])
        return replies[2:]

    def pending_errors(self) -> list[str]:
        """Drain the error queue and return its entries."""
        errors = []
        for _ in range(MOST_ERRORS):
            reply = self.ask("SYST:ERR?")
            if _error_number(reply) == NO_ERROR:
                break
            errors.append(reply)
        if errors:
            self.log("instrument_errors", errors=errors)
        return errors

    def _refuse_errors(self, what: str, replies: Sequence[str], read_back: tuple[str, ...] = ()) -> None:
        errors = [reply for reply in replies if _error_number(reply) != NO_ERROR]
        if errors:
            errors += self.pending_errors()
            first, *further = dict.fromkeys(error or "an empty error" for error in errors)
            reported = ", ".join([first, *further[:2], *([f"and {len(further) - 2} more"] if further[2:] else [])])
            raise Unconfirmed(f"to '{what[:80]}' the generator reports {reported}", read_back)


def _differences(settings: Sequence[Setting], replies: Sequence[str]) -> list[str]:
    return [
        f"{setting.query.replace('?', '')} reads {reply}, {setting.value}{setting.unit} was set"
        for setting, reply in zip(settings, replies, strict=False)
        if not setting.confirmed_by(reply)
    ]


def _error_number(reply: str) -> int:
    """Return the number of an error-queue entry; a malformed entry counts as a device error."""
    try:
        return int(reply.partition(",")[0])
    except ValueError:
        return -300


def describe_block(block: bytes) -> str:
    """Return the length and a short hash of a block, for the log; BLAKE2 is five times as fast as SHA-256."""
    return f"<{len(block)} bytes, blake2b {hashlib.blake2b(block, digest_size=8).hexdigest()}>"


def split_reply(reply: str) -> list[str]:
    """Split the reply to a compound query at semicolons outside quotes."""
    # A semicolon outside quotes is followed by an even number of them.
    return [part.strip() for part in re.split(r';(?=(?:[^"]*"[^"]*")*[^"]*$)', reply)]


def _since(started: float) -> float:
    return round(time.perf_counter() - started, 6)
