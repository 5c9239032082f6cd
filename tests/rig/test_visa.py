"""Finding instruments, and the VISA backend by which each is reached."""

from __future__ import annotations

import socket
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

import pytest
import pyvisa
from cable import Cable
from pyvisa.ctwrapper import IVIVisaLibrary

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig import visa
from modaltouch.rig.generator import Generator
from modaltouch.rig.interface import InUse, RigError
from modaltouch.rig.simulator import Simulator, vxi11
from modaltouch.rig.visa import VisaSession, find_by, find_instruments


def test_serial_ports_are_not_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The AFG3022B has USB, LAN and GPIB; warnings of a backend during the search are not shown."""

    class Manager:
        def __init__(self, library: str) -> None:
            pass

        def list_resources(self, query: str) -> tuple[str, ...]:
            warnings.warn("discovery needs another package", stacklevel=1)
            return ("ASRL/dev/ttyS0::INSTR", "USB0::0x0699::0x0347::C012345::INSTR", "TCPIP::10.0.0.7::INSTR")

    monkeypatch.setattr(pyvisa, "ResourceManager", Manager)
    assert find_instruments() == ("USB0::0x0699::0x0347::C012345::INSTR", "TCPIP::10.0.0.7::INSTR")
    monkeypatch.setattr(IVIVisaLibrary, "get_library_paths", lambda: ("/usr/lib/libvisa.so",))
    assert find_instruments()[2] == "USB0::0x0699::0x0347::C012345::INSTR@ivi"


def test_a_missing_backend_is_reported() -> None:
    """The message adds that an address works without listing."""
    with pytest.raises(RigError, match="VISA backend '/nowhere/libvisa.so' cannot list instruments .*works without"):
        find_by("/nowhere/libvisa.so")


def test_the_address_selects_the_backend(
    simulator: Simulator, open_generator: Callable[..., Generator], apparatus: Apparatus, guard: Any
) -> None:
    """`@py` is the default; `@ivi` needs a vendor's library, and the error is clear where none is installed."""
    with Generator(f"{simulator.address}@py", apparatus, start_guard=guard) as generator:
        assert generator.address.endswith("INSTR@py")
    with pytest.raises(RigError, match="no generator answers .*Could not open VISA library"):
        Generator(f"{simulator.address}@ivi", apparatus, start_guard=guard)


@pytest.mark.parametrize("way", ["address", "socket_address"])
def test_a_block_that_ends_in_line_feeds_does_not_shift_replies(simulator: Simulator, way: str) -> None:
    """A Keysight's file of a record may end so: over a raw socket every later reply was one message behind."""
    session = VisaSession(getattr(simulator, way))
    session.open()
    try:
        session.exchange(b"DATA EMEM,#14\n\n\n\n\n", timeout=1.0, reply=False)
        assert session.exchange(b"DATA? EMEM\n", timeout=1.0, reply=True) == b"#14\n\n\n\n\n"
        assert session.exchange(b"DATA:POIN? EMEM\n", timeout=1.0, reply=True) == b"2\n"
    finally:
        session.close(broken=False)


def test_a_trigger_into_a_dead_raw_socket_is_an_error(simulator: Simulator) -> None:
    """The write itself succeeds, and the burst, which was never played, would count as played."""
    with Cable(simulator.server.port) as cable:
        session = VisaSession(f"TCPIP::127.0.0.1::{cable.port}::SOCKET")
        session.open()
        try:
            assert session.exchange(b"TRIG:SEQ:IMM\n", timeout=1.0, reply=False) == b""
            assert session.exchange(b"*IDN?\n", timeout=1.0, reply=True).startswith(b"TEKTRONIX"), (
                "no reply is left over"
            )
            cable.cut(new=False)
            with pytest.raises(pyvisa.VisaIOError, match="VI_ERROR_TMO"):
                session.exchange(b"TRIG:SEQ:IMM\n", timeout=0.3, reply=False)
        finally:
            session.release()


@pytest.mark.parametrize("address", ["TCPIP::127.0.0.1,{}::inst0::INSTR", "TCPIP::127.0.0.1::{}::SOCKET"])
def test_the_end_of_a_connection_is_an_error_at_once(address: str) -> None:
    """PyVISA-py itself reads the end again and again until its time limit, which takes a whole processor."""

    def hang_up() -> None:
        for _ in range(1 + ("," in address)):  # the port of VXI-11 is tried first
            connection, _ = listener.accept()
            connection.recv(100)
            connection.close()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        (thread := threading.Thread(target=hang_up)).start()
        session = VisaSession(address.format(listener.getsockname()[1]))

        def identify() -> None:
            session.open()
            session.exchange(b"*IDN?\n", timeout=1.0, reply=True)

        with pytest.raises(ConnectionResetError, match="the instrument closed the connection"):
            identify()
        thread.join(10)
        session.release()


def test_reconnecting_waits_for_an_instrument_to_notice_a_reset(
    single_link: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If it notices a reset 0.3 s late, reopening succeeds; another session is refused immediately."""
    read = vxi11.read_record

    def notice_late(stream, limit):
        try:
            return read(stream, limit)
        except (EOFError, OSError):
            time.sleep(0.3)
            raise

    monkeypatch.setattr(vxi11, "read_record", notice_late)
    session = VisaSession(single_link.address)
    session.open()
    session.close(broken=True)
    session.open()
    monkeypatch.setattr(VisaSession, "_reserve", lambda *_: None)  # the stranger is on another computer
    try:
        with pytest.raises(InUse, match="admits no further session"):
            VisaSession(single_link.address).open()
    finally:
        session.release()


@pytest.mark.parametrize("other", ["TCPIP::{host}::INSTR", "TCPIP0::{host}::inst0::INSTR", "tcpip::{host}::INSTR"])
def test_an_instrument_in_use_is_recognised_by_any_form_of_its_address(
    simulator: Simulator, monkeypatch: pytest.MonkeyPatch, other: str
) -> None:
    """Board number, device name and resource class may be omitted (VPP-4.3, 4.3.1)."""
    monkeypatch.setattr(visa, "LOCK_TIMEOUT", 0.0)
    session = VisaSession(simulator.address)
    session.open()
    try:
        with pytest.raises(InUse, match="another program on this machine is using it"):
            VisaSession(other.format(host=f"127.0.0.1,{simulator.server.port}")).open()
    finally:
        session.release()


def test_an_unknown_host_is_an_error_before_the_backend_makes_it_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """PyVISA-py reports a bad file descriptor."""

    def resolve(host: str, port: None) -> None:
        raise socket.gaierror(socket.EAI_NONAME, f"no host is called {host}")

    monkeypatch.setattr(socket, "getaddrinfo", resolve)
    with pytest.raises(socket.gaierror, match=r"no host is called afg\.lab$"):
        VisaSession("TCPIP::afg.lab::INSTR").open()
    visa.check_port("USB0::0x0699::0x0347::C012345::INSTR")


def test_usb_addresses_match_in_hexadecimal_and_decimal() -> None:
    """PyVISA-py lists 1689 for what the manual calls 0x0699."""
    assert visa.lock_name("USB::0x0699::0x0349::C012345::INSTR") == visa.lock_name("USB0::1689::841::C012345::0::INSTR")
    assert visa.lock_name("USB0::0x0699::0x0349::C012346::INSTR") != visa.lock_name("USB0::0x0699::0x0349::C1::INSTR")
    assert visa.lock_name("no address") == "no address"
