"""What pyvisa-py leaves undone when the other end of a TCP session is gone, and does for nothing; no import of it."""

from __future__ import annotations

import contextlib
import socket
import struct
import traceback
from typing import Any

KNOCKED = 2.0
"""How long a TCP connection to the instrument may take [s]: a lost packet is sent again after one."""


def knock(address: str) -> None:
    """See whether anybody listens, where a VISA address names a port: a refused socket would be leaked.

    Raises
    ------
    OSError
        If nobody does.
    """
    host, _, port = (address.split("::") + [""])[1].partition(",")
    if address.upper().startswith("TCPIP") and port.isdigit():
        socket.create_connection((host, int(port)), timeout=KNOCKED).close()


def abandon(resource: Any) -> None:
    """Cut a session, so that closing it fails at once.

    Closing says goodbye, and waits five busy seconds for the reply of a peer that has gone politely; and what was
    sent into a dead cable would arrive when the cable lives again, a trigger among it. A reset forgets it. Sessions of
    other backends and interfaces are left to close as they do.
    """
    connection = resource.visalib.sessions[resource.session].interface.sock
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


class _Received(bytes):
    """Bytes that are not spelt out where they are shown."""

    __slots__ = ()

    def __repr__(self) -> str:
        return f"<{len(self)} bytes>"


class _HushedSocket(socket.socket):
    __slots__ = ()

    def recv(self, size: int, flags: int = 0, /) -> bytes:
        return _Received(super().recv(size, flags))


def hush(resource: Any) -> None:
    """Keep pyvisa-py from spelling out every byte that it receives over a socket.

    It does so for a log that is not kept, and takes longer over a record than the record over the wire. Sessions of
    other backends and interfaces are left as they are.
    """
    with contextlib.suppress(AttributeError, KeyError, TypeError):
        received_by = resource.visalib.sessions[resource.session].interface.sock
        if type(received_by) is socket.socket:
            received_by.__class__ = _HushedSocket


def close_leftovers(error: BaseException) -> None:
    """Close the socket of a session that could not be opened: it would count at an instrument of few sessions."""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        interface = getattr(frame.f_locals.get("self"), "interface", None)
        leftover = getattr(interface, "sock", None)
        if isinstance(leftover, socket.socket):
            leftover.close()
