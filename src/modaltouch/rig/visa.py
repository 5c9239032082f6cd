"""The one door to PyVISA: an instrument's session, one at a time on this machine, and what can be found."""

from __future__ import annotations

import contextlib
import hashlib
import os
import socket
import struct
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import Any, cast

from modaltouch.rig.interface import RigError
from modaltouch.rig.link import InUse, block_bounds
from modaltouch.system import lock

KNOCKED = 2.0
"""How long a TCP connection to the instrument may take [s]: a lost packet is sent again after one."""


def knock(address: str) -> None:
    """See whether anybody listens, where a VISA address names a port: a refused socket would be leaked."""
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


CHUNK = 1 << 20
"""Bytes asked for in one read: a whole record."""

PURE_PYTHON, VENDOR = "py", "ivi"
"""PyVISA's names of its two backends."""

LOCK_TIMEOUT = 3.0
"""How long another program of this machine is waited for: one that ends just now is gone by then [s]."""

FORGOTTEN = 1.0
"""How long an instrument may count a session of ours that was cut [s]: it learns of the reset when it next looks."""

NO_MORE_SESSIONS = "error creating link: 9"
"""How pyvisa-py says "out of resources" (VXI-11, B.5.2): all the sessions that the instrument admits are taken."""


class VisaSession:
    """A VISA session with one instrument, as a `modaltouch.rig.link.Transport`.

    One program of a machine at a time has an instrument, by a lock of the machine. The instrument's own lock (VXI-11)
    is left alone: one that a dead link holds would keep out whoever comes to switch the outputs off. A program on
    another computer is noticed by its changes, in what the driver reads back.

    Parameters
    ----------
    address : str
        VISA address; ``@ivi`` after it takes the vendor's VISA library (NI-VISA, R&S VISA) instead of pyvisa-py.
    shares : bool
        Whether other programs of this machine may have the instrument at the same time.
    """

    def __init__(self, address: str, *, shares: bool = False) -> None:
        self._address, _, backend = address.partition("@")
        self._visa_library = f"@{backend or PURE_PYTHON}"
        self._resource: Any = None
        self._timeout = 0.0
        self._shares = shares
        self._is_socket = self._address.upper().endswith("SOCKET")
        self._lock: int | None = None
        self._counted_until = 0.0

    def open(self) -> str:
        """Reopen it and return a sentence on how others are kept out.

        Raises
        ------
        InUse
            If another program of this machine has the instrument, or it admits no further session.
        Exception
            Whatever the backend raises: VisaIOError, OSError, ValueError and plain Exception.
        """
        import pyvisa

        self.close(broken=False)
        if self._lock is None and not self._shares:
            self._lock = _take_instrument(self._address)
        knock(self._address)
        resource = None
        while resource is None:
            try:
                resource = pyvisa.ResourceManager(self._visa_library).open_resource(self._address)
            except Exception as error:
                close_leftovers(error)
                if NO_MORE_SESSIONS not in str(error):
                    raise
                if time.monotonic() > self._counted_until:
                    raise InUse("it admits no further session") from error
                time.sleep(0.02)
        message_based = cast("pyvisa.resources.MessageBasedResource", resource)
        message_based.chunk_size = CHUNK
        hush(message_based)
        if self._is_socket:
            message_based.read_termination = "\n"
        self._resource, self._timeout = message_based, 0.0
        return "other programs on this machine are kept out"

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> bytes:
        """Send a message, and return the reply if one is expected, within a time for each [s]."""
        resource = self._resource
        if resource is None:
            raise ConnectionError("the VISA session is closed")
        if timeout != self._timeout:
            resource.timeout, self._timeout = timeout * 1e3, timeout
        resource.write_raw(message)
        data: bytes = resource.read_raw() if reply else b""
        if data[:1] == b"#":
            # On a raw socket a block's line feeds end reads, and what ends the reply still comes after its last byte.
            while len(data) < block_bounds(data)[1] + self._is_socket:
                data += resource.read_raw()
        return data

    def close(self, *, broken: bool) -> None:
        """End it, without a word to the other end if it is broken; never raises."""
        resource, self._resource = self._resource, None
        if resource is None:
            return
        if broken:
            self._counted_until = time.monotonic() + FORGOTTEN
            with contextlib.suppress(Exception):
                abandon(resource)
        with contextlib.suppress(Exception):
            resource.close()

    def release(self) -> None:
        """End it and let other programs have the instrument; never raises."""
        self.close(broken=False)
        descriptor, self._lock = self._lock, None
        if descriptor is not None:
            os.close(descriptor)


def _take_instrument(address: str) -> int:
    """Return a descriptor that keeps other programs of this machine from an instrument until this process ends."""
    name = hashlib.sha256(address.upper().encode()).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / f"modaltouch-{name}.lock"
    # A file of another user's in a shared folder may be opened, but not with the flag that makes it.
    flags = os.O_RDONLY if path.exists() else os.O_RDWR | os.O_CREAT
    descriptor = os.open(path, flags, 0o644)
    try:
        lock(descriptor, LOCK_TIMEOUT)
    except OSError as error:
        os.close(descriptor)
        raise InUse("another program on this machine is using it") from error
    return descriptor


def find_instruments() -> tuple[str, ...]:
    """Return the addresses of what pyvisa-py finds, and of what a vendor's VISA library finds where there is one.

    Raises
    ------
    RigError
        If a library cannot list them.
    """
    from pyvisa.ctwrapper.highlevel import IVIVisaLibrary

    found = find_by(f"@{PURE_PYTHON}")
    if IVIVisaLibrary.get_library_paths():
        found += tuple(f"{address}@{VENDOR}" for address in find_by(f"@{VENDOR}"))
    return found


def find_by(visa_library: str) -> tuple[str, ...]:
    """Return the VISA addresses of the instruments that one backend finds."""
    import pyvisa

    try:
        # What cannot be searched (USB, HiSLIP without their packages) is warned about, and no fault of the user's.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = pyvisa.ResourceManager(visa_library).list_resources("?*::INSTR")
    # Backends raise OSError, ValueError and errors of their own.
    except Exception as error:
        raise RigError(
            f"the VISA backend '{visa_library}' cannot list instruments ({error}); repair or remove that library; a "
            "known address works without it"
        ) from error
    # The series has USB, LAN and GPIB; a serial port is something else's.
    return tuple(address for address in found if not address.upper().startswith("ASRL"))
