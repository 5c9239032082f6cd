"""The one door to PyVISA: an instrument's session, shut to others where its interface can, and what can be found."""

from __future__ import annotations

import contextlib
import time
import warnings
from typing import Any, cast

from modaltouch.rig.interface import RigError
from modaltouch.rig.quirks import abandon, close_leftovers, hush, knock
from modaltouch.rig.transport import InUse, block_bounds

CHUNK = 1 << 20
"""Bytes asked for in one read: a whole record."""

PURE_PYTHON, VENDOR = "py", "ivi"
"""PyVISA's names of its two backends."""

LOCK_TIMEOUT = 1.0
"""How long another session's lock is waited for: that of one which ends just now is gone by then [s]."""

NO_MORE_SESSIONS = "error creating link: 9"
"""How pyvisa-py says "out of resources" (VXI-11, B.5.2): all the sessions that the instrument admits are taken."""


class VisaSession:
    """A VISA session with one instrument, as a `modaltouch.rig.transport.Transport`.

    Where the interface knows locks (LAN), it is locked for the time that it is open: no other program gets a word
    in. The operating system gives a USB instrument to one program only. Where neither is so (GPIB), a second program
    is noticed by its changes, in what the driver reads back.

    Parameters
    ----------
    address : str
        VISA address; ``@ivi`` after it takes the vendor's VISA library (NI-VISA, R&S VISA) instead of pyvisa-py.
    """

    def __init__(self, address: str) -> None:
        self._address, _, backend = address.partition("@")
        self._visa_library = f"@{backend or PURE_PYTHON}"
        self._resource: Any = None
        self._timeout = 0.0

    @property
    def is_open(self) -> bool:
        """Whether there is a session."""
        return self._resource is not None

    def open(self) -> str:
        """Open it anew and return in words how others are kept out.

        Raises
        ------
        InUse
            If another program has the instrument.
        Exception
            Whatever the backend raises: VisaIOError, OSError, ValueError and plain Exception.
        """
        import pyvisa

        self.close(broken=False)
        knock(self._address)
        try:
            resource = pyvisa.ResourceManager(self._visa_library).open_resource(self._address)
        except Exception as error:
            close_leftovers(error)
            if NO_MORE_SESSIONS in str(error):
                raise InUse("it admits no further session") from error
            raise
        message_based = cast("pyvisa.resources.MessageBasedResource", resource)
        message_based.chunk_size = CHUNK
        hush(message_based)
        if self._address.upper().endswith("SOCKET"):
            message_based.read_termination = "\n"
        try:
            shut = _lock(message_based)
        except InUse:
            message_based.close()
            raise
        self._resource, self._timeout = message_based, 0.0
        return shut

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
            # A termination character may lie within a block, and end a read, on a raw socket.
            while len(data) < block_bounds(data)[1]:
                data += resource.read_raw()
        return data

    def close(self, *, broken: bool) -> None:
        """End it, without a word to the other end if it is broken; never raises."""
        resource, self._resource = self._resource, None
        if resource is None:
            return
        if broken:
            with contextlib.suppress(Exception):
                abandon(resource)
        with contextlib.suppress(Exception):
            resource.close()


def _lock(resource: Any) -> str:
    """Lock an instrument for this session alone, if its interface can, and return what came of it in words."""
    import pyvisa

    deadline = time.monotonic() + LOCK_TIMEOUT
    while True:
        try:
            resource.lock_excl(timeout=LOCK_TIMEOUT * 1e3)
        except pyvisa.errors.VisaIOError as error:
            if error.error_code != pyvisa.constants.StatusCode.error_resource_locked:
                return f"not locked: {error.abbreviation}"
            # pyvisa-py does not wait for locks by itself.
            if time.monotonic() > deadline:
                raise InUse("another program has locked it") from error
            time.sleep(0.02)
        # pyvisa-py has no lock for some interfaces, and no name for some refusals.
        except (NotImplementedError, AttributeError, KeyError) as error:
            return f"not locked: {type(error).__name__}"
        else:
            return "locked out"


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
    """Return the VISA addresses of the instruments that one backend finds.

    Parameters
    ----------
    visa_library : str
        Backend, as PyVISA names it.

    Raises
    ------
    RigError
        If the backend cannot list them.
    """
    import pyvisa

    try:
        # What cannot be searched (USB, HiSLIP without their packages) is warned about, and no fault of the user's.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = pyvisa.ResourceManager(visa_library).list_resources("?*::INSTR")
    # Backends raise OSError, ValueError and errors of their own.
    except Exception as error:
        raise RigError(
            f"the VISA backend '{visa_library}' cannot list instruments ({error}); mend or remove that "
            "library; a known address works without"
        ) from error
    # The series has USB, LAN and GPIB; a serial port is something else's.
    return tuple(address for address in found if not address.upper().startswith("ASRL"))
