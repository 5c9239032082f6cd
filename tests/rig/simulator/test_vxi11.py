"""The VXI-11 server: links, clears, timeouts, and a client other than PyVISA."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import pyvisa

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.common import Behaviour

NO_ERROR = '0,"No error"'


def connect(simulator: Simulator, timeout: float = 0.5) -> Any:
    """Return an open VISA resource."""
    resource = pyvisa.ResourceManager("@py").open_resource(simulator.address)
    resource.timeout = timeout * 1e3
    return resource


@pytest.fixture
def visa(simulator: Simulator) -> Iterator[Any]:
    """Return an open VISA resource."""
    resource = connect(simulator)
    yield resource
    resource.close()


class RawClient:
    """A VXI-11 client written from the standard alone, independent of PyVISA."""

    def __init__(self, address: str) -> None:
        port = int(address.partition(",")[2].partition(":")[0])
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=5)
        self._number = 0

    def call(self, procedure: int, parameters: bytes, *, program: int = 0x0607AF) -> bytes:
        """Call a procedure and return its results."""
        self.ask(procedure, parameters, program=program)
        return self.answer()

    def ask(self, procedure: int, parameters: bytes, *, program: int = 0x0607AF) -> None:
        """Call a procedure."""
        self._number += 1
        call = struct.pack(">10I", self._number, 0, 2, program, 1, procedure, 0, 0, 0, 0) + parameters
        # Two fragments, as RFC 5531 allows.
        half = len(call) // 2 // 4 * 4
        self._socket.sendall(struct.pack(">I", half) + call[:half])
        self._socket.sendall(struct.pack(">I", 0x80000000 | (len(call) - half)) + call[half:])

    def answer(self) -> bytes:
        """Return the results of the procedure that was called."""
        (word,) = struct.unpack(">I", self._receive(4))
        reply = self._receive(word & 0x7FFFFFFF)
        assert struct.unpack(">I", reply[:4])[0] == self._number
        self.status = struct.unpack(">I", reply[20:24])[0]
        return reply[24:]

    def link(self) -> int:
        """Create a link."""
        name = b"inst0"
        results = self.call(10, struct.pack(">iIII", 1, 0, 0, len(name)) + name + bytes(3))
        error, number, _, largest = struct.unpack(">iiII", results)
        assert error == 0
        assert largest >= 1024  # VXI-11, B.6.3: at least 1024 bytes
        return number

    def write(self, link: int, data: bytes, *, end: bool = True) -> tuple[int, int]:
        """Write, and return error and size."""
        return struct.unpack(">iI", self.call(11, written(link, data, end=end)))  # type: ignore[return-value]

    def read(self, link: int, size: int = 1024, *, terminator: int | None = None) -> tuple[int, int, bytes]:
        """Read, and return error, reason and data."""
        flags = 0 if terminator is None else 128
        parameters = struct.pack(">iIIIii", link, size, 300, 300, flags, terminator or 0)
        results = self.call(12, parameters)
        error, reason, length = struct.unpack(">iiI", results[:12])
        return error, reason, results[12 : 12 + length]

    def generic(self, procedure: int, link: int) -> bytes:
        """Call a procedure with generic parameters."""
        return self.call(procedure, struct.pack(">iiII", link, 0, 300, 300))

    def close(self, *, reset: bool = False) -> None:
        """Close the connection, or reset it."""
        if reset:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._socket.close()

    def _receive(self, n: int) -> bytes:
        data = b""
        while len(data) < n:
            data += self._socket.recv(n - len(data))
        return data


def written(link: int, data: bytes, *, end: bool = True) -> bytes:
    """Return the parameters of a write."""
    flags = 8 if end else 0
    return struct.pack(">iIIiI", link, 1000, 1000, flags, len(data)) + data + bytes(-len(data) % 4)


@pytest.fixture
def raw(simulator: Simulator) -> Iterator[RawClient]:
    """Return a client other than PyVISA."""
    client = RawClient(simulator.address)
    yield client
    client.close()


def test_the_server_listens_on_the_loopback_interface_only(simulator: Simulator) -> None:
    """The socket is bound to 127.0.0.1, so that the simulator cannot be reached from the network."""
    listener = simulator.server._listener
    assert listener is not None
    assert listener.getsockname()[0] == "127.0.0.1"


def test_the_port_can_be_chosen(apparatus: Apparatus) -> None:
    """The address is then known to another program beforehand."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with Simulator(apparatus, port=port) as simulator:
        assert simulator.address == f"TCPIP::127.0.0.1,{port}::inst0::INSTR"


def test_a_port_in_use_is_refused_with_a_remedy(apparatus: Apparatus, simulator: Simulator) -> None:
    """Two twins on one port: the second reports it, and the first still answers."""
    with (
        pytest.raises(RigError, match=f"cannot listen on port {simulator.server.port} .*or give another --port"),
        Simulator(apparatus, port=simulator.server.port) as second,
    ):
        second.address  # noqa: B018
    assert simulator.front_panel("*IDN?").startswith("TEKTRONIX")


def test_another_client_is_served(raw: RawClient) -> None:
    """A message in two writes and a reply in small reads (VXI-11, B.6.4 and B.6.5)."""
    link = raw.link()
    assert raw.write(link, b"*ID", end=False) == (0, 3)
    assert raw.write(link, b"N?\n") == (0, 3)
    error, reason, data = raw.read(link, 4)
    assert (error, reason, data) == (0, 1, b"TEKT")
    error, reason, data = raw.read(link, 1024, terminator=ord(","))
    assert (error, reason, data) == (0, 2, b"RONIX,")
    error, reason, data = raw.read(link)
    assert (error, reason & 4) == (0, 4)
    assert data.endswith(b"\n")


def test_unknown_programs_and_procedures_are_refused(raw: RawClient) -> None:
    """RPC: unknown program 1 (PROG_UNAVAIL); VXI-11: unsupported operation 8; unknown link 4."""
    raw.call(1, b"", program=100_000)
    assert raw.status == 1
    assert struct.unpack(">i", raw.call(22, struct.pack(">i", 1))) == (8,)
    assert raw.write(99, b"*IDN?") == (4, 0)
    assert raw.call(0, b"") == b""


def test_a_read_without_a_query_times_out_and_is_an_error(raw: RawClient) -> None:
    """IEEE 488.2, 6.3.2.2: UNTERMINATED, -420; VXI-11 error 15 after the client's own timeout."""
    link = raw.link()
    started = time.monotonic()
    assert raw.read(link)[0] == 15
    assert time.monotonic() - started > 0.25
    raw.write(link, b"SYST:ERR?")
    assert raw.read(link)[2].startswith(b"-420")


def test_a_query_discards_an_unread_reply(raw: RawClient) -> None:
    """IEEE 488.2, 6.3.2.3: INTERRUPTED, -410; the new reply is sent, the old one discarded."""
    link = raw.link()
    raw.write(link, b"*IDN?")
    raw.write(link, b"SYST:ERR?")
    assert raw.read(link)[2].startswith(b"-410")


def test_device_clear_discards_pending_data(raw: RawClient) -> None:
    """After a clear neither half a message nor an unread reply is left; settings are kept."""
    link = raw.link()
    raw.write(link, b"SOUR1:FREQ 20")
    raw.write(link, b"*IDN?")
    raw.write(link, b"NONSEN", end=False)
    assert struct.unpack(">i", raw.generic(15, link)) == (0,)
    raw.write(link, b"SOUR1:FREQ?;:SYST:ERR?")
    assert raw.read(link)[2] == f"2.00000000000E+01;{NO_ERROR}\n".encode()


def test_the_status_byte_shows_messages_and_errors(raw: RawClient) -> None:
    """Bit 4 message available, bit 2 error queue not empty."""
    link = raw.link()
    assert struct.unpack(">iI", raw.generic(13, link)) == (0, 0)
    raw.write(link, b"*IDN?")
    assert struct.unpack(">iI", raw.generic(13, link))[1] == 16
    raw.read(link)
    raw.write(link, b"NONSENSE")
    assert struct.unpack(">iI", raw.generic(13, link))[1] == 4


def test_locks_are_refused(raw: RawClient) -> None:
    """VXI-11 error 8: the twin has no locks, at the creation of a link or later (B.6.1, B.6.11)."""
    name = struct.pack(">iIII", 1, 1, 0, 5) + b"inst0" + bytes(3)
    assert struct.unpack(">i", raw.call(10, name)[:4]) == (8,)
    assert struct.unpack(">i", raw.call(18, struct.pack(">iiI", raw.link(), 0, 0))) == (8,)


def test_a_vxi_11_trigger_is_accepted(raw: RawClient, simulator: Simulator) -> None:
    """device_trigger is *TRG: an error unless a channel is in burst mode."""
    link = raw.link()
    raw.generic(14, link)
    assert simulator.front_panel("SYST:ERR?").startswith("-211")


def test_sessions_are_independent(simulator: Simulator) -> None:
    """Four sessions query at the same time, a hundred times each, and each gets its own replies."""
    wrong: list[str] = []

    def ask(number: int) -> None:
        resource = connect(simulator, timeout=5)
        for i in range(100):
            reply = resource.query(f"DATA:DATA:VAL? EMEM,{number * 100 + i + 1}").strip()
            if reply != str(8000 + (number * 100 + i) % 100 + number):
                wrong.append(reply)
        resource.close()

    codes = [8000 + i % 100 + i // 100 for i in range(400)]
    simulator.afg.write_edit(b"".join(code.to_bytes(2, "big") for code in codes))
    threads = [threading.Thread(target=ask, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_sessions_are_counted_and_freed(apparatus: Apparatus) -> None:
    """An instrument of one session refuses the second until the first is closed (error 9)."""
    with Simulator(apparatus, behaviour=Behaviour(max_sessions=1)) as simulator:
        first, second = RawClient(simulator.address), RawClient(simulator.address)
        mine = first.link()
        name = struct.pack(">iIII", 1, 0, 0, 5) + b"inst0" + bytes(3)
        assert struct.unpack(">i", second.call(10, name)[:4]) == (9,)
        first.call(23, struct.pack(">i", mine))
        assert second.link() > mine
        first.close()
        second.close()


def test_a_record_is_sent_and_read_back(visa: Any) -> None:
    """131072 points with every byte value, through PyVISA's own block functions."""
    codes = [i % 16383 for i in range(131_072)]
    visa.write_binary_values("DATA:DATA EMEM,", codes, datatype="H", is_big_endian=True)
    assert visa.query("DATA:POIN? EMEM;:SYST:ERR?").strip() == f"131072;{NO_ERROR}"
    assert visa.query_binary_values("DATA? EMEM", datatype="H", is_big_endian=True) == codes


def test_a_truncated_block_is_an_error_without_a_hang(visa: Any) -> None:
    """END before the announced length: -161, and the session continues."""
    visa.write_raw(b"DATA EMEM,#41000abc\n")
    assert visa.query("SYST:ERR?").startswith("-161")
    assert visa.query("*OPC?").strip() == "1"


def test_a_late_reply_is_not_taken_for_the_next_one(visa: Any, simulator: Simulator) -> None:
    """After a timeout the next query gets its own reply."""
    visa.timeout = 100
    simulator.faults.inject("delayed_reply", when="IDN", value=0.4)
    with pytest.raises(pyvisa.VisaIOError, match="Timeout"):
        visa.query("*IDN?")
    time.sleep(0.5)
    assert visa.query("*OPC?").strip() == "1"


def test_garbage_on_the_port_ends_only_that_connection(simulator: Simulator, visa: Any) -> None:
    """An HTTP request from a browser is disconnected; sessions continue."""
    port = int(simulator.address.partition(",")[2].partition(":")[0])
    with socket.create_connection(("127.0.0.1", port), timeout=5) as stray:
        stray.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        with contextlib.suppress(ConnectionResetError):
            assert stray.recv(100) == b""
    assert visa.query("*OPC?").strip() == "1"


def test_a_closed_simulator_refuses_connections(apparatus: Apparatus) -> None:
    """After close the port is no longer open."""
    simulator = Simulator(apparatus)
    port = int(simulator.address.partition(",")[2].partition(":")[0])
    simulator.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), timeout=1)


@pytest.mark.parametrize(("reset", "links"), [(True, [2]), (False, [1, 2])])
def test_a_frozen_twin_plays_triggers_of_closed_but_not_of_reset_links(
    tmp_path: Path, reset: bool, links: list[int]
) -> None:
    """Stopped, triggered, left by its client, and continued; a real instrument may play both."""
    file = tmp_path / "played"
    command = [sys.executable, "-m", "modaltouch", "rig", "simulate", "--played", str(file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline()
            first = RawClient(address)
            link = first.link()
            first.write(link, b"DATA:DEF EMEM,100;:DATA:COPY USER1;:TRIG:SOUR EXT;:SOUR1:FUNC USER1;FREQ 20")
            # The shortest burst that is listed: the second trigger must not fall into the first one.
            first.write(link, b"SOUR1:FREQ 1000;:SOUR1:BURS:STAT ON;NCYC 1;:OUTP1 ON")
            time.sleep(0.1)  # for the relay, by the twin's own clock
            process.send_signal(signal.SIGSTOP)
            os.waitpid(process.pid, os.WUNTRACED)
            first.ask(11, written(link, b"TRIG:SEQ:IMM"))
            first.close(reset=reset)
            process.send_signal(signal.SIGCONT)
            second = RawClient(address)
            link = second.link()
            time.sleep(0.1)  # until the first has played, if it does
            second.write(link, b"TRIG:SEQ:IMM")
            time.sleep(0.1)
            second.close()
        finally:
            process.send_signal(signal.SIGCONT)
            process.terminate()
    assert [json.loads(line)["link"] for line in file.read_text().splitlines()] == links
