"""Malformed messages cause an error in the queue, never a traceback, a hang, or growing memory."""

from __future__ import annotations

import random
import re
import socket
import struct
import threading
import time
import tracemalloc
from collections.abc import Iterator
from typing import Any

import pytest
import pyvisa

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.afg import afg_twin
from modaltouch.rig.simulator.common import State
from modaltouch.rig.simulator.scpi import TEXTS

NUMERIC = {
    "SOUR1:FREQ": "HZ",
    "SOURCE2:FREQUENCY:CW": "HZ",
    "SOUR2:VOLT:OFFS": "V",
    "SOUR1:VOLT:LIM:HIGH": "V",
    "SOURce1:VOLTage:LIMit:LOW": "V",
    "SOUR2:BURS:TDEL": "S",
    "OUTP2:IMP": "OHM",
    "OUTPut1:IMPedance": "OHM",
    "SOUR1:PHAS": "RAD",
}
"""Commands of a channel with one number, and its unit."""

KEYWORD = {
    "SOUR1:FUNC": "SIN",
    "SOUR2:BURS:MODE": "TRIG",
    "SOUR1:VOLT:UNIT": "VPP",
    "OUTP1:POL": "NORM",
    "TRIG:SOUR": "TIM",
    "OUTP:TRIG:MODE": "SYNC",
}
"""Commands with one keyword, and a valid one."""


def fresh() -> State:
    """Return a generator with nothing behind it."""
    afg, afg.table = afg_twin("AFG3022B", None)
    return afg


def broken(rng: random.Random) -> tuple[str, int]:
    """Return a command with one fault, and the SCPI-99 number of its error."""
    header, unit = rng.choice(list(NUMERIC.items()))
    word, known = rng.choice(list(KEYWORD.items()))
    number = rng.uniform(0.1, 9)
    channel = re.sub(r"\d", str(rng.randint(3, 9)), header)
    return rng.choice(
        [
            (f"{header}{rng.choice('XQZ')} {number}{unit}", -113),
            (f"{header}:{rng.choice(['NO', 'SUCH', 'NODE'])} {number}", -113),
            (f"*{rng.choice(['XYZ', 'IDX', 'RSTT'])}{rng.choice(['', '?'])}", -113),
            (f"{rng.choice(['*CLS', '*TRG', 'ABOR', 'SYST:BEEP'])}?", -113),
            (f"{channel} {number}", -114),
            (f"{header} {number}{unit},{number}", -108),
            (f"{header}? 1,2", -108),
            (f"{word} {known},1", -108),
            (f"{header} ", -109),
            (f"{word}", -109),
            (f"{header} {number},", -109),
            (f"{header} {number}FURLONG", -131),
            (f"{header} {rng.choice(['-', ''])}{number}E30{unit}", -222),
            (f"{header} {'1' * rng.randint(256, 5000)}", -124),
            (f"{header} {rng.choice(['ABC', '1.2.3', '--1', '(1)', '@1'])}", -104),
            (f"{header} #15abcde", -104),
            (f"{word} {rng.choice(['NONSENSE', '12', 'SINE WAVE'])}", -224),
            (f"{word} '{known}", -151),
            (f'{word} "{known}', -151),
            (f"DATA EMEM,#{rng.choice(['15abc', '9999999999', '3100' + 'x' * 50])}", -161),
            (f"DATA EMEM,{rng.choice(['#11x', '#13xxx', '#10'])}", -161),
            (f"{header}{'A' * 300} 1", -112),
            (f"{header} {number}'{unit}'", -102),
            (f"!{header} 1", -102),
        ]
    )


def mutated(rng: random.Random) -> bytes:
    """Return randomly changed commands as bytes."""
    units = [broken(rng)[0] for _ in range(rng.randint(1, 8))]
    units += ["*IDN?", "SYST:ERR?", "DATA? EMEM", "*RST;*OPC?", "DATA:COPY USER1,EMEM"][: rng.randint(0, 5)]
    rng.shuffle(units)
    message = bytearray(";".join(units).encode("latin1"))
    for _ in range(rng.randint(0, 12)):
        place = rng.randrange(len(message) + 1)
        match rng.randrange(5):
            case 0:
                message[place : place + 1] = bytes([rng.randrange(256)])
            case 1:
                del message[place : place + rng.randint(1, 20)]
            case 2:
                message[place:place] = rng.choice([b"\0", b"\n", b";", b":", b"#", b"'", b'"', b"\xff\xfe", b"?", b"*"])
            case 3:
                message[place:place] = message[: rng.randint(0, 60)]
            case 4:
                message[place:place] = b"#" + str(rng.randrange(10)).encode() + rng.randbytes(rng.randint(0, 40))
    return bytes(message)


def errors_of(instrument: State) -> list[str]:
    """Empty the error queue, as a program would."""
    errors = []
    while not (entry := instrument.execute(b"SYST:ERR?\n").data.decode("ascii").strip()).startswith("0,"):
        errors.append(entry)
    return errors


def test_6000_wrong_commands_cause_their_standard_errors() -> None:
    """One fault each, with the number of SCPI-99, 21.8; the settings of channel 1 do not change."""
    rng, instrument = random.Random(488), fresh()
    for _ in range(6000):
        message, number = broken(rng)
        instrument.execute(b"*CLS")
        assert instrument.execute(message.encode()).data == b"", message
        assert [int(error.partition(",")[0]) for error in errors_of(instrument)] == [number], message[:300]
    assert instrument.channels[1] == fresh().channels[1]


def test_4000_corrupted_messages_leave_a_working_instrument() -> None:
    """Random changes of compound messages: known numbers in well-formed entries, no hang, and no memory kept."""
    rng, instrument = random.Random(1999), fresh()

    def send_some(count: int) -> None:
        for _ in range(count):
            message = mutated(rng)
            started = time.thread_time()
            instrument.execute(message)
            assert time.thread_time() - started < 0.25, message
            for error in errors_of(instrument):
                found = re.fullmatch(r'(-\d{3}),"([^"]{1,255})"', error)
                assert found, error
                assert int(found[1]) in TEXTS

    send_some(3400)
    tracemalloc.start()
    try:
        send_some(300)
        settled = tracemalloc.get_traced_memory()[0]
        send_some(300)
        assert tracemalloc.get_traced_memory()[0] < settled + 2e5
    finally:
        tracemalloc.stop()
    assert instrument.execute(b"*RST;*IDN?").data.startswith(b"TEKTRONIX,AFG3022B")


FOUND: list[tuple[bytes, int]] = [
    # messages that broke the simulator, or would have, and the error that they cause
    (b"OUTP1 \xb5", -104),
    (b"OUTP1 1E400", -222),
    (b"SOUR" + b"9" * 5000 + b":VOLT 1", -112),
    (b"SOUR1:VOLT " + b"1" * 1_000_000 + b"!", -124),
    (b"A" * 1_000_000, -112),
    (b"\0" * 1000, -101),
    (b"\xe9:\xff?", -101),
    (b'"' * 1000, -102),
    (b"DATA EMEM,#9999999999", -161),
    (b"DATA EMEM,#0abc", -102),
    (b":VOLT" * 40_000, -112),
    (b"SOUR0:VOLT 1", -114),
    (b'SOUR1:FREQ "1e3"', -104),
    (b"OUTP1 'ON'", -104),
    (b'SOUR1:FUNC "SIN"', -104),
    (b'DATA:DEF EMEM,"100"', -104),
    (b'DATA? "EMEM"', -104),
    (b"*IDN? 3", -108),
    (b"*RST 1", -108),
    (b"ABOR 1", -108),
    (b"SYST:ERR? 1", -108),
    (b"OUTP:TRIG:MODE? 3", -108),
    (b"DATA:CAT? 3", -108),
]


@pytest.mark.parametrize(("message", "number"), FOUND, ids=lambda value: repr(value)[:30])
def test_fixed_cases_stay_fixed(message: bytes, number: int) -> None:
    """Each is an error in the queue within a second, and the next query is answered."""
    instrument = fresh()
    started = time.thread_time()
    assert instrument.execute(message).data == b""
    assert time.thread_time() - started < 1
    assert int(errors_of(instrument)[0].partition(",")[0]) == number
    assert instrument.execute(b"*OPC?").data == b"1\n"


def test_unknown_headers_are_not_cached() -> None:
    """A thousand different ones leave the table of known headers unchanged."""
    instrument = fresh()
    before = len(instrument.table._known)
    for count in range(1000):
        instrument.execute(f"NO{count}:SUCH".encode())
    assert len(instrument.table._known) == before


@pytest.fixture(scope="module")
def standing(apparatus: Apparatus) -> Iterator[Simulator]:
    """Return one simulator for all frames."""
    with Simulator(apparatus) as simulator:
        yield simulator


def send(simulator: Simulator, data: bytes, *, wait: float = 0.02) -> None:
    """Send bytes over a separate connection, and close it."""
    port = int(simulator.address.partition(",")[2].partition(":")[0])
    with socket.create_connection(("127.0.0.1", port), timeout=2) as connection:
        connection.settimeout(wait)
        try:
            connection.sendall(data)
            connection.recv(1 << 16)
        except OSError:
            return


def call(procedure: int, parameters: bytes, *, program: int = 0x0607AF) -> bytes:
    """Return an RPC call in one record."""
    body = struct.pack(">10I", 1, 0, 2, program, 1, procedure, 0, 0, 0, 0) + parameters
    return struct.pack(">I", 0x80000000 | len(body)) + body


def frames(rng: random.Random) -> bytes:
    """Return bytes that are nearly VXI-11."""
    link = call(10, struct.pack(">iIII", 1, 0, 50, 5) + b"inst0" + bytes(3))
    body = rng.randbytes(rng.randint(0, 60))
    match rng.randrange(8):
        case 0:
            return rng.randbytes(rng.randint(1, 200))
        case 1:
            return struct.pack(">I", 0x80000000 | rng.randrange(1 << 31)) + body
        case 2:
            return call(rng.randrange(30), body)
        case 3:
            return call(rng.randrange(30), body, program=rng.randrange(1 << 32))
        case 4:
            return link + call(rng.choice([11, 12, 13, 14, 15, 18, 19, 22, 23]), body)
        case 5:
            size = rng.choice([0, 3, 1 << 30, 0xFFFFFFFF])
            return link + call(11, struct.pack(">iIIiI", rng.randrange(99), 1, 1, 8, size) + body)
        case 6:
            return bytes(4) * rng.randint(1, 500) + call(0, b"")
        case _:
            credentials = struct.pack(">10I", 1, 0, 2, 0x0607AF, 1, 11, 0, rng.randrange(1 << 32), 0, 0)
            return struct.pack(">I", 0x80000000 | len(credentials)) + credentials


def n_serving() -> int:
    """Return how many threads serve a connection."""
    return sum(thread.name == "vxi11-link" for thread in threading.enumerate())


def test_malformed_frames_end_only_their_own_connection(standing: Simulator) -> None:
    """After 400 of them no thread has raised (pytest fails otherwise), no link is left, and others are served."""
    rng = random.Random(1831)
    client: Any = pyvisa.ResourceManager("@py").open_resource(standing.address)
    client.timeout = 2000
    for count in range(400):
        send(standing, frames(rng), wait=0.005)
        if count % 40 == 0:
            assert client.query("*IDN?").startswith("TEKTRONIX")
    assert client.query("*IDN?").startswith("TEKTRONIX")
    client.close()
    deadline = time.monotonic() + 5
    while (standing.server.n_links or n_serving()) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert standing.server.n_links == n_serving() == 0


def test_a_link_of_another_connection_is_inaccessible(standing: Simulator) -> None:
    """With its number guessed, it is neither written to nor destroyed (VXI-11 error 4)."""
    client: Any = pyvisa.ResourceManager("@py").open_resource(standing.address)
    number = client.visalib.sessions[client.session].link
    client.write("SOUR1:FREQ 20")
    send(standing, call(11, struct.pack(">iIIiI", number, 1, 1, 8, 4) + b"*RST"), wait=0.5)
    send(standing, call(23, struct.pack(">i", number)), wait=0.5)
    assert float(client.query("SOUR1:FREQ?")) == 20
    client.close()


def test_message_without_end_is_dropped_before_it_fills_the_memory(standing: Simulator) -> None:
    """Writes that never say END: -363, input buffer overrun, after 16 MiB; then all goes on."""
    client: Any = pyvisa.ResourceManager("@py").open_resource(standing.address)
    client.timeout = 2000
    client.query("*CLS;*OPC?")
    session = client.visalib.sessions[client.session]
    for _ in range(17):
        session.interface.device_write(session.link, 1000, 1000, 0, bytes(1 << 20))
    assert (
        sum(len(link.arriving) for links in standing.server._connections.values() for link in links.values()) < 1 << 20
    )
    client.clear()
    assert client.query("SYST:ERR?").startswith('-363,"Input buffer overrun')
    client.close()


def test_a_frame_longer_than_any_message_is_refused(standing: Simulator) -> None:
    """With 4 GiB announced, the connection ends, and no memory is allocated for it."""
    tracemalloc.start()
    send(standing, struct.pack(">I", 0xFFFFFFFF) + b"x" * 1000, wait=0.2)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10e6
