"""A VXI-11 server on the loopback interface, for one simulated instrument.

Serves the core channel (`links`) over ONC RPC (RFC 5531) without a portmapper: clients name
the port in their address, ``TCPIP::127.0.0.1,<port>::inst0::INSTR``.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading

from modaltouch.rig.simulator.device import Device
from modaltouch.rig.simulator.links import INSTRUMENT, LARGEST_MESSAGE, Links
from modaltouch.rig.simulator.rpc import PROGRAM_UNAVAILABLE, HangUp, accept, as_record, read_call, read_record

CORE_PROGRAM = 0x0607AF


class Vxi11Server:
    """Serves an instrument to any number of connections, each in a thread of its own.

    Parameters
    ----------
    device : Device
        The instrument.
    port : int
        TCP port on 127.0.0.1; 0 takes a free one.
    """

    def __init__(self, device: Device, port: int = 0) -> None:
        self.device = device
        self._connections: set[socket.socket] = set()
        self._guard = threading.RLock()
        self._closing = threading.Event()
        self._links = Links(device, self._closing)
        self._listener: socket.socket | None = None
        self.port = port
        self.listen()

    @property
    def address(self) -> str:
        """VISA address of the instrument."""
        return f"TCPIP::127.0.0.1,{self.port}::{INSTRUMENT}::INSTR"

    @property
    def n_links(self) -> int:
        """Links that are open."""
        return len(self._links)

    def listen(self) -> None:
        """Accept connections."""
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", self.port))
        listener.listen(16)
        self.port = listener.getsockname()[1]
        self._listener = listener
        threading.Thread(target=self._accept, args=(listener,), daemon=True, name="vxi11-accept").start()

    def refuse(self) -> None:
        """Refuse new connections until `listen`."""
        listener, self._listener = self._listener, None
        if listener is not None:
            # shutdown wakes the accepting thread; close alone leaves it, and the port, open.
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            listener.close()

    def drop_connections(self) -> None:
        """Reset every open connection, as pulling the plug does."""
        with self._guard:
            connections, self._connections = self._connections, set()
        for connection in connections:
            _reset(connection)

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
            # A close is a reset, as when the plug is pulled.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            with self._guard:
                self._connections.add(connection)
            threading.Thread(target=self._serve, args=(connection,), daemon=True, name="vxi11-link").start()

    def _serve(self, connection: socket.socket) -> None:
        own: set[int] = set()
        try:
            with connection, connection.makefile("rb") as stream:
                while True:
                    call = read_record(stream, 4 * LARGEST_MESSAGE)
                    # What still arrives over a connection that is being reset, from either side, is not heard.
                    if connection not in self._connections or _was_reset(connection):
                        return
                    body = self._answer(call, own)
                    connection.sendall(as_record(body))
        except (HangUp, struct.error, OSError, EOFError, ValueError):
            return
        finally:
            with self._guard:
                self._connections.discard(connection)
            self._links.forget(own)

    def _answer(self, call: bytes, own: set[int]) -> bytes:
        """Return the RPC reply to an RPC call."""
        transaction, program, procedure, parameters = read_call(call)
        if program != CORE_PROGRAM:
            return accept(transaction, PROGRAM_UNAVAILABLE)
        if procedure == 0:
            return accept(transaction)
        return accept(transaction) + self._links.call(procedure, parameters, own)


def _was_reset(connection: socket.socket) -> bool:
    """Return whether the client has reset a connection, of which requests may be left to read."""
    return connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) != 0


def _reset(connection: socket.socket) -> None:
    """Wake the thread that serves a connection, which closes it; the client sees a reset."""
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RD)
