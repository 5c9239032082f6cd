"""Hash chain of a log: each line carries a SHA-256 check of itself and the previous line.

A session log is a file of JSON objects, one per line. The last member of each is ``check``, the SHA-256 of the previous
line's check followed by the line's bytes up to that member. A changed, removed, duplicated or reordered line breaks the
chain. A line truncated while being written (power failure, full disk) stays in the file: the next line declares its
length and hash under ``torn``, so that even the remains are checked; if that line is truncated as well, the one after
it declares both.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

GENESIS = "0" * 64
"""The check that precedes the first line."""

TAIL = re.compile(rb',"check":"([0-9a-f]{64})"\}\Z')
"""End of a line, which contains its check."""

_TAIL_BYTES = len(',"check":""}') + 64


class RecordError(Exception):
    """A record is damaged, in use, or would be overwritten."""


class RecordInputError(RecordError):
    """The input does not name a valid participant id or a session; no record is at risk."""


class RecordExistsError(RecordError):
    """The session to be recorded exists already, or is being recorded."""


class UnreadableLineError(Exception):
    """A line is not a readable JSON object, although its check may be correct."""


@dataclass(frozen=True)
class Chain:
    """The contents of a log."""

    events: tuple[dict[str, Any], ...] = ()  # valid lines in order, without their checks
    checks: tuple[str, ...] = ()  # check of each of these lines
    problems: tuple[str, ...] = ()  # all problems; empty for an intact file
    # problems other than an incomplete last line; a log with any of these cannot be continued
    damage: tuple[str, ...] = ()
    torn: bytes = b""  # incomplete last line; empty if there is none
    ends_in_newline: bool = True  # whether the last line is terminated

    @property
    def last_check(self) -> str:
        """Check of the last line, from which that of the next line is computed."""
        return self.checks[-1] if self.checks else GENESIS


def encode_line(event: dict[str, Any], previous: str) -> tuple[bytes, str]:
    """Return an event as a line of the log, in UTF-8 with a newline, and its check of 64 hexadecimal digits.

    `previous` is the check of the previous line. Raises ValueError if the event is empty or contains a value that JSON
    cannot represent, such as NaN.
    """
    if not event:
        raise ValueError("an event needs at least one member, given none")
    body = json.dumps(event, ensure_ascii=False, separators=(",", ":"), allow_nan=False)[:-1].encode()
    check = line_check(previous, body)
    return body + b',"check":"' + check.encode() + b'"}\n', check


def read_chain(path: Path) -> Chain:
    """Read the valid lines of a log and its problems; raises RecordError if the file cannot be read."""
    return parse_chain(read_log(path), str(path))


def read_log(path: Path) -> bytes:
    """Return the bytes of a log, whether valid or not; raises RecordError if the file cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        remedy = "give the session.jsonl of a session, or look for a copy of it"
        raise RecordError(f"{path}: cannot be read ({error.strerror}); {remedy}") from error


def parse_chain(data: bytes, name: str) -> Chain:
    """Parse the bytes of a log; each problem begins with `name`."""
    events: list[dict[str, Any]] = []
    checks: list[str] = []
    damage: list[str] = []
    cut: list[str] = []
    pending = b""
    pending_line = 0
    previous = GENESIS
    # bytes.splitlines would also split at a single carriage return in a damaged line.
    for number, line in enumerate(io.BytesIO(data), start=1):
        event, check, fault = decode_line(line.removesuffix(b"\n"), previous)
        if fault:
            # The check is correct, so the following lines can still be checked.
            damage.append(f"{name}:{number}: {fault}, although its check is correct")
            previous = check
            continue
        if event is None or (pending and event.get("torn") != describe_torn(pending.removesuffix(b"\n"))):
            pending = pending + line if pending else line
            pending_line = pending_line or number
            continue
        if not pending and "torn" in event:
            damage.append(f"{name}:{number}: this line declares a cut line, but the remains of that line are missing")
        pending, pending_line = b"", 0
        events.append(event)
        checks.append(check)
        previous = check
    if pending and (converted := conversion(data)):
        damage.append(f"{name}:1: {converted}")
    elif b"\n" in pending and (any(map(TAIL.search, pending.split(b"\n"))) or not (events and pending.strip())):
        damage.append(f"{name}:{pending_line}: the chain breaks: a line was changed, removed, duplicated or moved")
    elif pending:
        cut.append(f"{name}:{pending_line}: the last line was cut while being written ({len(pending)} bytes)")
    elif events and not data.endswith(b"\n"):
        cut.append(f"{name}:{len(events)}: the last line has no newline, but its content is complete")
    return Chain(
        tuple(events),
        tuple(checks),
        problems=(*damage, *cut),
        damage=tuple(damage),
        torn=pending.removesuffix(b"\n"),
        ends_in_newline=data.endswith(b"\n") or not data,
    )


BYTE_ORDER_MARK = b"\xef\xbb\xbf"
"""Prefix that some text editors add to UTF-8 files; this program never writes it."""


def conversion(data: bytes) -> str:
    """Describe a conversion of the whole log by another program; empty if there is none."""
    if 0 < data.count(b"\n") == data.count(b"\r\n"):
        return "every line ends in CR LF: a program that converts line ends changed the file"
    return "it begins with a byte order mark: a text editor changed the file" * data.startswith(BYTE_ORDER_MARK)


def describe_torn(torn: bytes) -> dict[str, Any]:
    """Return the declaration of an incomplete line for the next line."""
    return {"bytes": len(torn), "sha256": hashlib.sha256(torn).hexdigest()}


def line_check(previous: str, body: bytes) -> str:
    """Return the check of a line: SHA-256 of the previous check and the line's bytes before its own check."""
    return hashlib.sha256(previous.encode() + body).hexdigest()


def decode_line(line: bytes, previous: str) -> tuple[dict[str, Any] | None, str, str]:
    """Return a line's event, its check, and why it cannot be read, each empty unless the check is correct."""
    tail = TAIL.match(line, max(0, len(line) - _TAIL_BYTES))
    if tail is None or line_check(previous, line[: tail.start()]) != tail.group(1).decode():
        return None, "", ""
    try:
        return read_object(line[: tail.start()] + b"}"), tail.group(1).decode(), ""
    except UnreadableLineError as error:
        return None, tail.group(1).decode(), str(error)


def read_object(line: bytes) -> dict[str, Any]:
    """Parse the JSON object in a line; raises UnreadableLineError if it is none, or too deep or long to read."""
    try:
        # json.loads would guess the encoding of bytes anew for every line, which is slow for a whole results tree.
        value = json.loads(line.decode("utf-8", "surrogatepass"))
    except (ValueError, RecursionError) as error:
        reason = "it is not JSON, is nested too deep, or has a number with too many digits"
        raise UnreadableLineError(f"cannot be read: {reason}") from error
    if not isinstance(value, dict):
        raise UnreadableLineError("cannot be read: it is not a JSON object")
    return value
