"""A cable between a driver and a twin that can be pulled: TCP connections stay open, and nothing passes.

::

    with Cable(port_of_the_twin) as cable:
        rig = Generator(cable.address, apparatus)
        cable.cut()           # like a pulled cable: both directions, later links included
        cable.cut("to")       # nothing reaches the instrument
        cable.cut("from")     # a mute link: requests are carried out, but no reply returns
        cable.cut(new=False)  # a half-open link: existing links are dead, new ones work
        cable.heal()          # data sent meanwhile arrives, as TCP retransmits it
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
from dataclasses import dataclass, field
from typing import Literal, Self

Direction = Literal["both", "to", "from"]
"""Towards the instrument, from it, or both."""

HELD = 1 << 16
"""Bytes read at a time; more from a sender waits in the kernel [bytes]."""


@dataclass(eq=False)
class _Way:
    """One direction of a connection."""

    direction: Direction
    source: socket.socket
    target: socket.socket
    cut: bool = False
    ended: bool = False
    waiting: bytearray = field(default_factory=bytearray)

    @property
    def reads(self) -> bool:
        return not (self.cut or self.ended or self.waiting)

    @property
    def writes(self) -> bool:
        return bool(self.waiting) and not self.cut


class Cable:
    """Relay connections to a port of this machine.

    A connection opened while the cable is cut is accepted, as by TCP on one machine, but silent.

    A reset during a cut is lost, as the packet would be: data still waiting never arrives, and the other
    side stays half open until it sends something.

    Parameters
    ----------
    port : int
        Of the twin.
    """

    def __init__(self, port: int) -> None:
        self._twin = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._bell, self._rope = socket.socketpair()
        self._lock = threading.Lock()
        self._ways: list[_Way] = []
        self._cut: Direction | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._keep_passing, daemon=True, name="cable")
        self._thread.start()

    @property
    def address(self) -> str:
        """VISA address of the twin at the other end."""
        return f"TCPIP::127.0.0.1,{self.port}::inst0::INSTR"

    def cut(self, direction: Direction = "both", *, new: bool = True) -> None:
        """Stop all traffic; nothing passes after this returns.

        Parameters
        ----------
        direction : str
            ``to`` the instrument, ``from`` it, or ``both``.
        new : bool
            Whether connections opened later are cut as well.
        """
        with self._lock:
            self._cut = direction if new else None
            for way in self._ways:
                way.cut = way.cut or direction in ("both", way.direction)

    def heal(self) -> None:
        """Let everything pass again, beginning with what was sent during the cut."""
        with self._lock:
            self._cut = None
            for way in [way for way in self._ways if way.cut]:
                way.cut = False
                if way.source.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                    way.waiting.clear()
                    way.ended = True
        self._ring()

    def close(self) -> None:
        """Reset every connection and end the thread."""
        self._closing = True
        self._ring()
        self._thread.join()
        for way in self._ways:
            _reset(way.source)
        for each in (self._listener, self._bell, self._rope):
            each.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _ring(self) -> None:
        """Wake the thread so that it checks again what it may pass."""
        self._rope.send(b"!")

    def _keep_passing(self) -> None:
        while not self._closing:
            with self._lock:
                sources = [way.source for way in self._ways if way.reads]
                targets = [way.target for way in self._ways if way.writes]
            readable, writable, _ = select.select([self._listener, self._bell, *sources], targets, [])
            if self._bell in readable:
                self._bell.recv(HELD)
            # Connections that were cut during the wait are skipped.
            with self._lock:
                for way in list(self._ways):
                    if way not in self._ways:
                        continue
                    if way.reads and way.source in readable:
                        self._take(way)
                    if way.writes and (way.target in writable or way.source in readable):
                        self._give(way)
                if self._listener in readable:
                    self._connect()

    def _connect(self) -> None:
        client, _ = self._listener.accept()
        try:
            instrument = socket.create_connection(("127.0.0.1", self._twin))
        except OSError:
            _reset(client)
            return
        for each in (client, instrument):
            each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            each.setblocking(False)
        for way in (_Way("to", client, instrument), _Way("from", instrument, client)):
            way.cut = self._cut in ("both", way.direction)
            self._ways.append(way)

    def _take(self, way: _Way) -> None:
        try:
            way.waiting += (data := way.source.recv(HELD))
        except BlockingIOError:
            return
        except OSError:
            self._end(way)
            return
        if not data:
            way.ended = True
            with contextlib.suppress(OSError):
                way.target.shutdown(socket.SHUT_WR)
            if all(each.ended for each in self._ways if way.source in (each.source, each.target)):
                self._end(way)

    def _give(self, way: _Way) -> None:
        try:
            del way.waiting[: way.target.send(way.waiting)]
        except BlockingIOError:
            return
        except OSError:
            way.ended = True
            self._end(next(each for each in self._ways if each.source is way.target))

    def _end(self, way: _Way) -> None:
        """Reset both sides after the source has reset its own; a cut hides the reset from the other side."""
        way.ended = True
        way.waiting.clear()
        if not way.cut:
            self._ways = [each for each in self._ways if way.source not in (each.source, each.target)]
            _reset(way.source)
            _reset(way.target)


def _reset(connection: socket.socket) -> None:
    with contextlib.suppress(OSError):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()
