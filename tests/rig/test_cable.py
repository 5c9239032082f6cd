"""The cable that tests pull: what passes, what waits, what is lost."""

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
"""How long nothing must arrive to count as nothing [s]."""


@pytest.fixture
def instrument() -> Iterator[socket.socket]:
    """Return a listening socket that stands for the twin."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(5)
        yield listener


@pytest.fixture
def cable(instrument: socket.socket) -> Iterator[Cable]:
    """Return a cable to it."""
    with Cable(instrument.getsockname()[1]) as cable:
        yield cable


@pytest.fixture
def plug(cable: Cable, instrument: socket.socket) -> Iterator[Callable[[], Link]]:
    """Return what connects through the cable."""
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
    """Return whether nothing arrives, no end and no reset either."""
    return not select.select([end], [], [], NOTHING_FOR)[0]


def reset(end: socket.socket) -> None:
    """Close as a driver does that is to leave nothing behind."""
    end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    end.close()


def test_whole_cable_passes_both_ways(plug: Callable[[], Link]) -> None:
    """Bytes, more than a kernel buffers, and the end of a connection."""
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
def test_cut_holds_one_way_or_both_and_healed_it_passes_in_order(
    cable: Cable, plug: Callable[[], Link], direction: str
) -> None:
    """Nothing is lost and nothing is ended: TCP repeats what got no answer."""
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


def test_half_open_link_leaves_new_ones_alone(cable: Cable, plug: Callable[[], Link]) -> None:
    """One link is dead; another one, opened after it, is not."""
    dead, dead_there = plug()
    cable.cut(new=False)
    alive, there = plug()
    alive.sendall(b"question")
    assert there.recv(10) == b"question"
    dead.sendall(b"trigger")
    assert is_silent(dead_there)


def test_pulled_cable_holds_new_links_too(cable: Cable, plug: Callable[[], Link]) -> None:
    """A link that is opened meanwhile is silent until the cable is back."""
    cable.cut()
    driver, there = plug()
    driver.sendall(b"question")
    assert is_silent(there)
    cable.heal()
    assert there.recv(10) == b"question"


def test_reset_behind_a_cut_takes_along_what_waited(cable: Cable, plug: Callable[[], Link]) -> None:
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


def test_close_behind_a_cut_leaves_what_waited(cable: Cable, plug: Callable[[], Link]) -> None:
    """A link that is closed and not reset still delivers, then ends."""
    driver, there = plug()
    cable.cut()
    driver.sendall(b"trigger")
    driver.close()
    cable.heal()
    assert there.recv(10) == b"trigger"
    assert there.recv(10) == b""


def test_reset_passes_a_whole_cable(plug: Callable[[], Link]) -> None:
    """The instrument hears of it."""
    driver, there = plug()
    reset(driver)
    with pytest.raises(ConnectionResetError):
        there.recv(10)
