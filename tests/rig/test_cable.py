"""The cable that tests pull: which data passes, waits or is lost."""

from __future__ import annotations

import select
import socket
import struct
from collections.abc import Callable, Iterator

import pytest
from cable import Cable

Link = tuple[socket.socket, socket.socket]
"""The two ends of a connection through the cable: the driver's and the instrument's."""

NOTHING_FOR = 0.05
"""How long nothing must arrive for an end to count as silent [s]."""


@pytest.fixture
def instrument() -> Iterator[socket.socket]:
    """Return a listening socket in place of the twin."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(5)
        yield listener


@pytest.fixture
def cable(instrument: socket.socket) -> Iterator[Cable]:
    """Return a cable to the socket."""
    with Cable(instrument.getsockname()[1]) as cable:
        yield cable


@pytest.fixture
def plug(cable: Cable, instrument: socket.socket) -> Iterator[Callable[[], Link]]:
    """Return a function that connects through the cable."""
    opened: list[socket.socket] = []

    def connect() -> Link:
        driver = socket.create_connection(("127.0.0.1", cable.port), timeout=5)
        there, _ = instrument.accept()
        there.settimeout(5)
        opened.extend((driver, there))
        return driver, there

    yield connect
    for each in opened:
        each.close()


def is_silent(end: socket.socket) -> bool:
    """Return whether nothing arrives, not even an end or a reset."""
    return not select.select([end], [], [], NOTHING_FOR)[0]


def reset(end: socket.socket) -> None:
    """Close a connection with a reset, as a driver does that must not leave anything behind."""
    end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    end.close()


def test_an_intact_cable_passes_both_directions(plug: Callable[[], Link]) -> None:
    """Data beyond the kernel's buffer size, and the end of a connection."""
    driver, there = plug()
    there.sendall(b"reply")
    assert driver.recv(10) == b"reply"
    upload, came = b"record" * 500_000, bytearray()
    driver.setblocking(False)
    sent = 0
    while len(came) < len(upload):
        readable, writable, _ = select.select([there], [driver] if sent < len(upload) else [], [], 5)
        assert readable or writable
        sent += driver.send(upload[sent:]) if writable else 0
        came += there.recv(1 << 16) if readable else b""
    assert came == upload
    driver.close()
    assert there.recv(10) == b""


@pytest.mark.parametrize("direction", ["to", "from", "both"])
def test_data_waits_during_a_cut_and_arrives_in_order(cable: Cable, plug: Callable[[], Link], direction: str) -> None:
    """Nothing is lost and no connection ends: TCP retransmits what was not acknowledged."""
    driver, there = plug()
    cable.cut(direction)  # type: ignore[arg-type]
    for word in (b"one ", b"two"):
        driver.sendall(word)
        there.sendall(word)
    assert is_silent(there) == (direction != "from")
    assert is_silent(driver) == (direction != "to")
    cable.heal()
    for end in (driver, there):
        words = b""
        while len(words) < 7:
            words += end.recv(10)
        assert words == b"one two"


def test_a_half_open_link_does_not_affect_new_links(cable: Cable, plug: Callable[[], Link]) -> None:
    """One link is dead; another one, opened after it, is not."""
    dead, dead_there = plug()
    cable.cut(new=False)
    alive, there = plug()
    alive.sendall(b"question")
    assert there.recv(10) == b"question"
    dead.sendall(b"trigger")
    assert is_silent(dead_there)


def test_a_pulled_cable_blocks_new_links(cable: Cable, plug: Callable[[], Link]) -> None:
    """A link opened during the cut is silent until the cable is back."""
    cable.cut()
    driver, there = plug()
    driver.sendall(b"question")
    assert is_silent(there)
    cable.heal()
    assert there.recv(10) == b"question"


def test_a_reset_during_a_cut_discards_waiting_data(cable: Cable, plug: Callable[[], Link]) -> None:
    """The reset itself is lost, as a packet is: the instrument's end stays half open until it sends something."""
    driver, there = plug()
    cable.cut()
    driver.sendall(b"trigger")
    reset(driver)
    cable.heal()
    assert is_silent(there)
    there.sendall(b"reply")
    with pytest.raises(ConnectionResetError):
        there.recv(10)


def test_a_close_during_a_cut_keeps_waiting_data(cable: Cable, plug: Callable[[], Link]) -> None:
    """A link that is closed without a reset still delivers its data, then ends."""
    driver, there = plug()
    cable.cut()
    driver.sendall(b"trigger")
    driver.close()
    cable.heal()
    assert there.recv(10) == b"trigger"
    assert there.recv(10) == b""


def test_a_reset_passes_an_intact_cable(plug: Callable[[], Link]) -> None:
    """The instrument's end gets a connection reset."""
    driver, there = plug()
    reset(driver)
    with pytest.raises(ConnectionResetError):
        there.recv(10)
