"""What pyvisa-py leaves undone when the other end of a TCP session is gone; needs no import of it."""

from __future__ import annotations

import socket
import traceback
from typing import Any


def knock(address: str) -> None:
    """See whether anybody listens, where a VISA address names a port: a refused socket would be leaked.

    Raises
    ------
    OSError
        If nobody does.
    """
    host, _, port = (address.split("::") + [""])[1].partition(",")
    if address.upper().startswith("TCPIP") and port.isdigit():
        socket.create_connection((host, int(port)), timeout=5).close()


def abandon(resource: Any) -> None:
    """Cut a session, so that closing it fails at once.

    Closing says goodbye, and waits five busy seconds for the reply of a peer that has gone politely. Sessions of
    other backends and interfaces are left to close as they do.
    """
    session = resource.visalib.sessions[resource.session]
    session.interface.sock.shutdown(socket.SHUT_RDWR)


def close_leftovers(error: BaseException) -> None:
    """Close the socket of a session that could not be opened: it would count at an instrument of few sessions."""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        interface = getattr(frame.f_locals.get("self"), "interface", None)
        leftover = getattr(interface, "sock", None)
        if isinstance(leftover, socket.socket):
            leftover.close()
