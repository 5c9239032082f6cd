"""A VXI-11 server on the loopback interface for one simulated instrument, which also accepts raw sockets.

It serves the core channel over ONC RPC (RFC 5531) without a portmapper: the address contains the port,
``TCPIP::127.0.0.1,<port>::inst0::INSTR``. A connection that begins with text carries SCPI line by line,
``TCPIP::127.0.0.1::<port>::SOCKET``; no accepted RPC record begins with such a byte.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import re
import socket
import struct
import sys
import threading
import time
import typing
from dataclasses import dataclass, field

from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator.common import Reply, State
from modaltouch.rig.simulator.scpi import ScpiError

SUCCESS, PROGRAM_UNAVAILABLE = 0, 1
"""Status of an accepted call."""

_LAST_FRAGMENT = 0x80000000


class HangUp(Exception):  # noqa: N818
    """The connection is to be reset."""


def read_record(stream: io.BufferedIOBase, limit: int) -> bytes:
    """Read one RPC record and join its fragments."""
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


_BLOCK = re.compile(rb"#(?:" + b"|".join(b"%d(\\d{%d})" % (n, n) for n in range(1, 10)) + rb")")


def read_message(stream: io.BufferedIOBase) -> bytes:
    """Read one program message up to its line feed; line feeds within a definite-length block do not end it."""
    message, searched = bytearray(stream.readline(LARGEST_MESSAGE)), 0
    while found := _BLOCK.search(message, searched):
        searched = found.end() + int(found[found.lastindex or 0])
        if len(message) <= searched:
            message += _exactly(stream, searched - len(message)) + stream.readline(LARGEST_MESSAGE)
    if not message.endswith(b"\n"):
        raise EOFError
    return bytes(message[:searched] + message[searched:].rstrip(b"\r\n"))


def read_call(call: bytes) -> tuple[int, int, int, bytes]:
    """Parse a call: transaction, program, procedure and parameters; credentials are ignored."""
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
    """Encode data as opaque: preceded by its length and followed by padding."""
    return struct.pack(">I", len(data)) + data + bytes(_padded(len(data)) - len(data))


def _padded(length: int) -> int:
    return (length + 3) // 4 * 4


LARGEST_WRITE = 1 << 20
"""Largest write, as announced to the client [bytes]."""

LARGEST_MESSAGE = 1 << 24
"""Largest program message [bytes]: a Keysight's longest record, 1,048,576 points, written in up to 15 digits each."""

LONGEST_WAIT = 30.0
"""Longest wait for a reply, even if a client requests a longer one [s]."""

INSTRUMENT = "inst0"
"""Device name of the instrument."""

_CREATE_LINK, _WRITE, _READ, _READ_STATUS, _TRIGGER, _CLEAR = 10, 11, 12, 13, 14, 15
_REMOTE, _LOCAL, _ENABLE_SERVICE, _DESTROY_LINK = 16, 17, 20, 23
_NO_ERROR, _NOT_ACCESSIBLE, _INVALID_LINK, _NOT_SUPPORTED, _OUT_OF_RESOURCES = 0, 3, 4, 8, 9
_TIMEOUT = 15
_FLAG_END, _FLAG_TERMINATOR = 8, 128
_REASON_COUNT, _REASON_TERMINATOR, _REASON_END = 1, 2, 4


@dataclass
class _Link:
    number: int
    arriving: bytearray = field(default_factory=bytearray)
    leaving: bytes = b""
    ready_at: float = 0.0


Links = dict[int, _Link]
"""Links of a connection, by number; those of other connections are not accessible."""


class _Refused(Exception):  # noqa: N818
    """A call is rejected with an error code (VXI-11, B.5.2)."""


CORE_PROGRAM = 0x0607AF


class Vxi11Server:
    """Server of an instrument for any number of connections, each in a separate thread.

    Locks are not supported, since no driver uses them.

    Parameters
    ----------
    device : GeneratorState
        The instrument.
    port : int
        TCP port on 127.0.0.1; 0 for any free port.
    """

    def __init__(self, device: State, port: int = 0) -> None:
        self.device = device
        self._connections: dict[socket.socket, Links] = {}
        self._guard = threading.RLock()
        self._closing = threading.Event()
        self._numbers = itertools.count(1)
        # Each procedure with the number of bytes after its error code, which are zero for a rejected call.
        self._procedures: dict[int, tuple[typing.Callable[[_Link, bytes], bytes | None], int]] = {
            _WRITE: (self._write, 4),
            _READ: (self._read, 8),
            _READ_STATUS: (lambda link, _: struct.pack(">I", device.status_byte | (16 if link.leaving else 0)), 4),
            _TRIGGER: (lambda link, _: device.run(b"*TRG", link.number).data, 0),
            _CLEAR: (self._clear, 0),
            **dict.fromkeys((_REMOTE, _LOCAL, _ENABLE_SERVICE, _DESTROY_LINK), (lambda link, _: None, 0)),
        }
        self._listener: socket.socket | None = None
        self.port = port
        self.listen()

    @property
    def address(self) -> str:
        """VISA address of the instrument."""
        return f"TCPIP::127.0.0.1,{self.port}::{INSTRUMENT}::INSTR"

    def listen(self) -> None:
        """Accept connections.

        Raises
        ------
        RigError
            If another program listens on the port, or it is reserved.
        """
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if sys.platform != "win32":  # there it would let two programs share a port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(("127.0.0.1", self.port))
            listener.listen(16)
        except OSError as error:
            listener.close()
            raise RigError(
                f"the twin cannot listen on port {self.port} ({error.strerror}): stop the program that does, or give "
                "another --port, 0 for any free one"
            ) from error
        self.port = listener.getsockname()[1]
        self._listener = listener
        threading.Thread(target=self._accept, args=(listener,), daemon=True, name="vxi11-accept").start()

    def refuse(self) -> None:
        """Reject new connections until `listen`."""
        listener, self._listener = self._listener, None
        if listener is not None:
            # shutdown wakes the accepting thread; close alone leaves it, and the port, open.
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            listener.close()

    def drop_connections(self) -> None:
        """Reset every open connection, as if unplugged."""
        with self._guard:
            connections, self._connections = self._connections, {}
        for connection in connections:
            # Wakes the serving thread, which closes the connection; the client sees a reset.
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RD)

    def close(self) -> None:
        """Stop serving."""
        self._closing.set()
        self.refuse()
        self.drop_connections()

    def _accept(self, listener: socket.socket) -> None:
        while not self._closing.is_set():
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            # A close is a reset, as if unplugged.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            links: Links = {}
            with self._guard:
                self._connections[connection] = links
            threading.Thread(target=self._serve, args=(connection, links), daemon=True, name="vxi11-link").start()

    def _serve(self, connection: socket.socket, links: Links) -> None:
        try:
            with connection, connection.makefile("rb") as stream:
                if b"\t" <= connection.recv(1, socket.MSG_PEEK) < b"\x80":
                    self._serve_text(connection, stream, self._open(links))
                while True:
                    call = read_record(stream, 4 * LARGEST_WRITE)
                    # A call over a connection being reset from either side is ignored.
                    was_reset = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
                    if connection not in self._connections or was_reset:
                        return
                    body = self._answer(call, links)
                    connection.sendall(struct.pack(">I", _LAST_FRAGMENT | len(body)) + body)  # a record of one fragment
        except (HangUp, _Refused, struct.error, OSError, EOFError, ValueError):
            return
        finally:
            with self._guard:
                self._connections.pop(connection, None)

    def _serve_text(self, connection: socket.socket, stream: io.BufferedIOBase, link: int) -> None:
        while True:
            message = read_message(stream)
            # A request of a web browser to this port would otherwise leave an error in the queue.
            reply = Reply(hang_up=True) if b" HTTP/1." in message else self.device.execute(message, link)
            if reply.hang_up:
                raise HangUp
            if reply.delay <= LONGEST_WAIT:
                self._closing.wait(reply.delay)
                connection.sendall(reply.data)

    def _answer(self, call: bytes, links: Links) -> bytes:
        transaction, program, procedure, parameters = read_call(call)
        if program != CORE_PROGRAM:
            return accept(transaction, PROGRAM_UNAVAILABLE)
        if procedure == 0:
            return accept(transaction)
        return accept(transaction) + self.call(procedure, parameters, links)

    def call(self, procedure: int, parameters: bytes, links: Links) -> bytes:
        """Return the results of a procedure for the links of a connection: an error code and its return values."""
        if procedure != _CREATE_LINK and procedure not in self._procedures:
            return struct.pack(">i", _NOT_SUPPORTED)
        carry_out, size = self._procedures.get(procedure, (None, 12))
        try:
            if carry_out is None:
                return struct.pack(">i", _NO_ERROR) + self._create_link(parameters, links)
            (number,) = struct.unpack_from(">i", parameters)
            if number not in links:
                raise _Refused(_INVALID_LINK)
            link = links.pop(number) if procedure == _DESTROY_LINK else links[number]
            return struct.pack(">i", _NO_ERROR) + (carry_out(link, parameters) or b"")
        except _Refused as refused:
            return struct.pack(">i", *refused.args) + bytes(size)

    @property
    def n_links(self) -> int:
        """Number of open links."""
        return sum(map(len, list(self._connections.values())))

    def _open(self, links: Links) -> int:
        """Add a link to those of a connection and return its number."""
        with self._guard:
            if self.n_links >= self.device.behaviour.max_sessions:
                raise _Refused(_OUT_OF_RESOURCES)
            number = next(self._numbers)
            links[number] = _Link(number)
        return number

    def _create_link(self, parameters: bytes, links: Links) -> bytes:
        _, lock, _, length = struct.unpack_from(">iIII", parameters)
        if parameters[16 : 16 + length] != INSTRUMENT.encode():
            raise _Refused(_NOT_ACCESSIBLE)
        if lock:
            raise _Refused(_NOT_SUPPORTED)
        return struct.pack(">iII", self._open(links), 0, LARGEST_WRITE)

    def _write(self, link: _Link, parameters: bytes) -> bytes:
        *_, flags, length = struct.unpack_from(">iIIiI", parameters)
        data = parameters[20 : 20 + length]
        link.arriving += data
        if len(link.arriving) > LARGEST_MESSAGE:
            link.arriving.clear()
            self.device.fail(ScpiError(-363))
        elif flags & _FLAG_END:
            message, link.arriving = bytes(link.arriving), bytearray()
            self._carry_out(link, message)
        return struct.pack(">I", len(data))

    def _carry_out(self, link: _Link, message: bytes) -> None:
        if link.leaving:
            self.device.fail(ScpiError(-410))
            link.leaving = b""
        reply = self.device.execute(message, link.number)
        if reply.hang_up:
            raise HangUp
        link.leaving, link.ready_at = reply.data, time.monotonic() + reply.delay

    def _read(self, link: _Link, parameters: bytes) -> bytes:
        _, size, io_timeout, _, flags, terminator = struct.unpack_from(">iIIIii", parameters)
        if not link.leaving:
            self.device.fail(ScpiError(-420))
            link.ready_at = float("inf")
        wait = link.ready_at - time.monotonic()
        if wait > 0:
            patience = min(io_timeout / 1000, LONGEST_WAIT)
            self._closing.wait(min(wait, patience))
            if wait > patience:
                raise _Refused(_TIMEOUT)
        data, reason = link.leaving[:size], _REASON_COUNT
        if flags & _FLAG_TERMINATOR and terminator in data:
            data, reason = data[: data.index(terminator) + 1], _REASON_TERMINATOR
        link.leaving = link.leaving[len(data) :]
        if not link.leaving:
            reason |= _REASON_END
        return struct.pack(">i", reason) + opaque(data)

    def _clear(self, link: _Link, parameters: bytes) -> None:
        link.arriving, link.leaving = bytearray(), b""
