"""Exchanges: one error for everything that breaks, and a log of all that was said."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from modaltouch.rig.link import Link, LinkError, describe_block, split_reply


class Resource:
    """Answers as told."""

    def __init__(self, reply: object) -> None:
        self.reply = reply
        self.timeout = 0.0
        self.closed = False

    def write(self, message: str) -> int:
        return len(message)

    def write_raw(self, message: bytes) -> int:
        if isinstance(self.reply, BaseException):
            raise self.reply
        return len(message)

    def read(self) -> Any:
        if isinstance(self.reply, BaseException):
            raise self.reply
        return self.reply

    def query_binary_values(self, message: str, **options: Any) -> Any:
        return self.read()

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def link(heard: Any) -> Callable[[object], tuple[Link, Resource, list[object]]]:
    """Return what opens a link to a resource that answers as told."""

    def open_link(reply: object) -> tuple[Link, Resource, list[object]]:
        resource, cut = Resource(reply), []
        opened = Link(lambda: resource, cut.append, log=heard, timeout=0.5)
        opened.open()
        return opened, resource, cut

    return open_link


@pytest.mark.parametrize(
    "fault",
    [
        OSError("gone"),
        ConnectionResetError(104, "reset"),
        TimeoutError(),
        ValueError("bad block"),
        UnicodeDecodeError("ascii", b"\xff", 0, 1, "not ASCII"),
        RuntimeError("backend"),
        Exception("error creating link: 3"),
    ],
)
def test_every_exception_of_a_backend_is_one_error(link: Callable[..., Any], heard: Any, fault: Exception) -> None:
    """The kinds seen in practice (instruments.md, faults): each poisons the session and is logged."""
    opened, resource, cut = link(fault)
    with pytest.raises(LinkError, match=rf"'\*IDN\?' failed \({type(fault).__name__}"):
        opened.ask("*IDN?")
    assert resource.closed
    assert cut == [resource]
    assert not opened.is_open
    assert heard.of("scpi")[-1]["failed"].startswith(type(fault).__name__)
    with pytest.raises(LinkError, match="the connection is closed"):
        opened.ask("*IDN?")


def test_interrupt_passes_and_poisons_the_session(link: Callable[..., Any]) -> None:
    """Ctrl-C between question and reply: not swallowed, and the reply can no longer be mistaken for another."""
    opened, resource, _ = link(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        opened.ask("*IDN?")
    assert not opened.is_open
    assert resource.closed


def test_reply_that_is_no_text_is_an_error(link: Callable[..., Any]) -> None:
    """Control characters in a reply mean that bytes were lost."""
    opened, _, _ = link("1;\x00;2")
    with pytest.raises(LinkError, match="is not text"):
        opened.ask("OUTP1?")


def test_reply_is_stripped_and_logged(link: Callable[..., Any], heard: Any) -> None:
    """The terminator belongs to the transport."""
    opened, _, _ = link("1\n")
    assert opened.ask("OUTP1?") == "1"
    facts = heard.of("scpi")[-1]
    assert (facts["sent"], facts["reply"]) == ("OUTP1?", "1")
    assert facts["seconds"] >= 0


def test_longer_wait_holds_for_one_exchange(link: Callable[..., Any]) -> None:
    """A copy may take 15 s; the next question may not."""
    opened, resource, _ = link("1")
    opened.ask("*OPC?", timeout=15)
    assert resource.timeout == 500


def test_codes_come_as_an_array(link: Callable[..., Any], heard: Any) -> None:
    """Whatever container the backend uses."""
    opened, _, _ = link([1, 2, 16382])
    codes = opened.read_codes("DATA?", timeout=1)
    assert codes.dtype == np.uint16
    assert codes.tolist() == [1, 2, 16382]
    assert heard.of("scpi")[-1]["reply"].startswith("<6 bytes, blake2b ")


def test_failure_to_open_is_told(heard: Any) -> None:
    """Nobody there."""

    def refuse() -> Any:
        raise ConnectionRefusedError(111, "refused")

    with pytest.raises(LinkError, match="cannot be opened .*ConnectionRefusedError"):
        Link(refuse, lambda resource: None, log=heard, timeout=1).open()


@pytest.mark.parametrize(
    ("reply", "parts"),
    [
        ("1", ["1"]),
        ('1.5E+00;0,"No error"', ["1.5E+00", '0,"No error"']),
        ('-222,"Data out of range; 5 V";3', ['-222,"Data out of range; 5 V"', "3"]),
        ("", [""]),
    ],
)
def test_compound_reply_is_divided_outside_quotes(reply: str, parts: list[str]) -> None:
    """Error texts may hold semicolons (SCPI-99, 21.8)."""
    assert split_reply(reply) == parts


def test_block_is_named_by_length_and_hash() -> None:
    """BLAKE2b of eight bytes of the empty string is e4a6a0577479b2b4 (RFC 7693's algorithm, b2sum -l 64)."""
    assert describe_block(b"") == "<0 bytes, blake2b e4a6a0577479b2b4>"
