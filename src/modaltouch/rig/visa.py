"""Transport by PyVISA: sessions, one per instrument on this machine, and discovery of instruments."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import socket
import struct
import tempfile
import time
import traceback
import typing
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from modaltouch.rig.interface import InUse, RigError, block_bounds
from modaltouch.system import lock

CONNECT_TIMEOUT = 2.0
"""Timeout of a TCP connection to the instrument [s]; a lost packet is resent after one second."""


def check_port(address: str) -> None:
    """Check that the host in a VISA address is known and its port accepts connections.

    The backend would call the one a bad file descriptor, and leak a socket in the other case.
    """
    host, _, port = (address.split("::") + [""])[1].partition(",")
    if address.upper().startswith("TCPIP"):
        socket.getaddrinfo(host, None)
        if port.isdigit():
            socket.create_connection((host, int(port)), timeout=CONNECT_TIMEOUT).close()


class EndingSocket(socket.socket):
    """A connection that raises when the other end closes it, at which pyvisa-py would read without a pause for seconds.

    At the watchdog's priority this would halt the computer.
    """

    def recv(self, *arguments: Any) -> bytes:
        """Receive at least one byte."""
        data = super().recv(*arguments)
        if not data:
            raise ConnectionResetError("the instrument closed the connection")
        return data


def heed_ends() -> None:
    """Let pyvisa-py connect by `EndingSocket`."""
    from pyvisa_py import tcpip
    from pyvisa_py.protocols import rpc

    for module in (tcpip, rpc):
        module.socket = SimpleNamespace(**vars(socket) | {"socket": EndingSocket})


def abandon(resource: Any) -> None:
    """Reset the TCP connection of a session, so that closing the session fails immediately.

    Data sent while a cable is unplugged, perhaps a trigger, would arrive when it is plugged in again; a reset discards
    them. Sessions of other backends and interfaces raise an error here and close as usual.
    """
    interface = resource.visalib.sessions[resource.session].interface
    connection = getattr(interface, "sock", interface)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def close_leftovers(error: BaseException) -> None:
    """Close the socket of a session that failed to open, which would occupy one of the instrument's few sessions."""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        interface = getattr(frame.f_locals.get("self"), "interface", None)
        leftover = getattr(interface, "sock", None)
        if isinstance(leftover, socket.socket):
            leftover.close()


CHUNK = 1 << 20
"""Bytes requested per read, enough for a whole record."""

PURE_PYTHON, VENDOR = "py", "ivi"
"""PyVISA's names for its two backends."""

LOCK_TIMEOUT = 3.0
"""Longest wait for the lock of another program on this machine, enough for a program that is exiting [s]."""

FORGOTTEN = 1.0
"""Time within which an instrument notices the reset of a session and releases the session [s]."""

IDENTIFY = b"*IDN?\n"
"""Query whose reply contains the serial number of the instrument."""

NO_MORE_SESSIONS = "error creating link: 9"
"""pyvisa-py's message for "out of resources" (VXI-11, B.5.2): all sessions of the instrument are in use."""


class VisaSession:
    """A VISA session with one instrument, as a `Transport`.

    Lock files ensure that only one program on this machine uses an instrument at a time: one for its address, and one
    for its serial number once it has answered ``*IDN?``, since an instrument may have several addresses. The VXI-11
    lock of the instrument is not used, since a lock held by a dead link would prevent any program from switching the
    outputs off. Interference from another computer is detected by reading back changed settings.

    Parameters
    ----------
    address : str
        VISA address; the suffix ``@ivi`` selects the vendor's VISA library (NI-VISA, R&S VISA) instead of pyvisa-py.
    """

    def __init__(self, address: str) -> None:
        self._address, _, backend = address.partition("@")
        self._visa_library = f"@{backend or PURE_PYTHON}"
        self._resource: Any = None
        self._timeout = 0.0
        self._is_socket = self._address.upper().endswith("SOCKET")
        self._acknowledges = not self._is_socket and "HISLIP" not in self._address.upper()
        self._locks: dict[str, int] = {}
        self._counted_until = 0.0

    def open(self) -> str:
        """Reopen the session; return a sentence on how other programs are locked out.

        Raises
        ------
        InUse
            If another program on this machine uses the instrument, or all its sessions are in use.
        Exception
            Any error of the backend: VisaIOError, OSError, ValueError or plain Exception.
        """
        import pyvisa

        heed_ends()
        self.close(broken=False)
        self._reserve(lock_name(self._address))
        check_port(self._address)
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
        message_based = typing.cast("pyvisa.resources.MessageBasedResource", resource)
        message_based.chunk_size = CHUNK
        if self._is_socket:
            message_based.read_termination = "\n"
        self._resource, self._timeout = message_based, 0.0
        return "other programs on this machine are kept out"

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> bytes:
        """Send a message and return the reply, if one is expected; each may take up to `timeout` [s].

        Without a reply, return when the instrument has accepted the message. A link without acknowledgement is polled
        with an additional query, unless the message contains a block.

        Raises
        ------
        InUse
            If another program on this machine uses the instrument under another address.
        Exception
            Any error of the backend.
        """
        if not (reply or self._acknowledges or b"#" in message):
            self.exchange(message.rstrip() + b";*STB?\n", timeout=timeout, reply=True)
            return b""
        resource = self._resource
        if resource is None:
            raise ConnectionError("the VISA session is closed")
        if timeout != self._timeout:
            resource.timeout, self._timeout = timeout * 1e3, timeout
        resource.write_raw(message)
        data: bytes = resource.read_raw() if reply else b""
        if data[:1] == b"#":
            # On a raw socket, reads end at line feeds within a block, and a line feed follows the block.
            while len(data) < block_bounds(data)[1] + self._is_socket:
                data += resource.read_raw()
        if message == IDENTIFY:
            self._reserve(serial_number(data))
        return data

    def _reserve(self, name: str) -> None:
        """Lock an instrument by one of its names; an empty name reserves nothing."""
        if name and name not in self._locks:
            self._locks[name] = _take_instrument(name)

    def close(self, *, broken: bool) -> None:
        """Close the session; if broken, without notifying the other end. Never raises."""
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
        """Close the session and release the instrument to other programs; never raises."""
        self.close(broken=False)
        while self._locks:
            os.close(self._locks.popitem()[1])


def lock_name(address: str) -> str:
    """Return one name for every spelling of an address; PyVISA-py lists the numbers of a USB address as decimals."""
    from pyvisa import rname

    with contextlib.suppress(rname.InvalidResourceName):
        address = rname.to_canonical_name(address)
    return re.sub("0x[0-9a-f]+", lambda number: str(int(number[0], 16)), address.lower())


def serial_number(identity: bytes) -> str:
    """Return maker, model and serial number of a reply to ``*IDN?``; empty if it does not tell one unit from another.

    A serial number of zeros stands for none (IEEE 488.2, 10.14.3), and all twins are called SIMULATED.
    """
    fields = [field.strip() for field in identity.decode("latin1").lower().split(",")[:3]]
    return ",".join(fields) if len(fields) == 3 and fields[2].strip("0") not in ("", "simulated") else ""


def _take_instrument(name: str) -> int:
    """Return the descriptor of a lock file that reserves an instrument on this machine until closed."""
    path = Path(tempfile.gettempdir()) / f"modaltouch-{hashlib.sha256(name.encode()).hexdigest()[:16]}.lock"
    # Another user's file in a shared folder may be opened, but not with the flag O_CREAT.
    flags = os.O_RDONLY if path.exists() else os.O_RDWR | os.O_CREAT
    descriptor = os.open(path, flags, 0o644)
    try:
        lock(descriptor, LOCK_TIMEOUT)
    except OSError as error:
        os.close(descriptor)
        raise InUse("another program on this machine is using it") from error
    return descriptor


def find_instruments() -> tuple[str, ...]:
    """Return the addresses of the instruments found by pyvisa-py and by a vendor's VISA library, if any.

    Raises
    ------
    RigError
        If a library cannot list its instruments.
    """
    from pyvisa.ctwrapper.highlevel import IVIVisaLibrary

    found = find_by(f"@{PURE_PYTHON}")
    if IVIVisaLibrary.get_library_paths():
        found += tuple(f"{address}@{VENDOR}" for address in find_by(f"@{VENDOR}"))
    return found


def find_by(visa_library: str) -> tuple[str, ...]:
    """Return the VISA addresses of the instruments found by one backend."""
    import pyvisa

    try:
        # PyVISA warns about interfaces that it cannot search (USB, HiSLIP without their packages), irrelevant to users.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = pyvisa.ResourceManager(visa_library).list_resources("?*::INSTR")
    # Backends raise OSError, ValueError and custom errors.
    except Exception as error:
        raise RigError(
            f"the VISA backend '{visa_library}' cannot list instruments ({error}); repair or remove that library; a "
            "known address works without it"
        ) from error
    # These generators have USB, LAN and GPIB; a serial port must belong to another device.
    return tuple(address for address in found if not address.upper().startswith("ASRL"))
