"""ONC remote procedure calls over TCP: records, call headers, reply headers, opaque data (RFC 5531, RFC 4506)."""

from __future__ import annotations

import io
import struct

SUCCESS, PROGRAM_UNAVAILABLE = 0, 1
"""How an accepted call went."""

_LAST_FRAGMENT = 0x80000000


class HangUp(Exception):  # noqa: N818
    """The connection is to be reset."""


def read_record(stream: io.BufferedIOBase, limit: int) -> bytes:
    """Return one record, its fragments joined.

    Parameters
    ----------
    stream : binary stream
        The connection.
    limit : int
        Longest record [bytes].

    Raises
    ------
    EOFError
        If the connection ends.
    HangUp
        If the record is longer than `limit`: whoever sends it speaks another protocol.
    """
    record = bytearray()
    while True:
        (word,) = struct.unpack(">I", _exactly(stream, 4))
        length = word & ~_LAST_FRAGMENT
        if len(record) + length > limit:
            raise HangUp
        record += _exactly(stream, length)
        if word & _LAST_FRAGMENT:
            return bytes(record)


def _exactly(stream: io.BufferedIOBase, length: int) -> bytes:
    data = stream.read(length)
    if len(data) < length:
        raise EOFError
    return data


def as_record(body: bytes) -> bytes:
    """Return a message as a record of one fragment."""
    return struct.pack(">I", _LAST_FRAGMENT | len(body)) + body


def read_call(call: bytes) -> tuple[int, int, int, bytes]:
    """Return transaction, program, procedure and parameters of a call; credentials are not looked at."""
    transaction, _, _, program, _, procedure = struct.unpack_from(">6I", call)
    at = 24
    for _ in ("credentials", "verifier"):
        (length,) = struct.unpack_from(">I", call, at + 4)
        at += 8 + _padded(length)
    return transaction, program, procedure, call[at:]


def accept(transaction: int, status: int = SUCCESS) -> bytes:
    """Return the header of an accepted reply."""
    return struct.pack(">6I", transaction, 1, 0, 0, 0, status)


def opaque(data: bytes) -> bytes:
    """Return data with its length before it and padding after it."""
    return struct.pack(">I", len(data)) + data + bytes(_padded(len(data)) - len(data))


def _padded(length: int) -> int:
    return (length + 3) // 4 * 4
