"""Exchanges over a link: one error class for every failure, and a log of all messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.controls import MOST_ERRORS, Controls, describe_block, split_reply
from modaltouch.rig.interface import InUse, LinkError, Unconfirmed


class Transport:
    """Answers as told: always the same, or from a list one after the other and then the last for ever."""

    def __init__(self, reply: object) -> None:
        self.replies = list(reply) if isinstance(reply, list) else [reply]
        self.sent: list[str] = []
        self.timeouts: list[float] = []
        self.closed: list[bool] = []

    def open(self) -> str:
        return "locked out"

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> Any:
        assert message.endswith(b"\n")
        self.sent.append(message[:-1].decode("ascii"))
        self.timeouts.append(timeout)
        answer = self.replies.pop(0) if len(self.replies) > 1 else self.replies[0]
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def close(self, *, broken: bool) -> None:
        self.closed.append(broken)


@pytest.fixture
def link(heard: Any) -> Callable[[object], tuple[Controls, Transport]]:
    """Return a function that opens a link over a transport with a given reply."""

    def open_link(reply: object) -> tuple[Controls, Transport]:
        transport = Transport(reply)
        opened = Controls(transport, AFG3022B, revive=Mock(), log=heard, timeout=0.5, copy_timeout=1)
        opened.open()
        return opened, transport

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
def test_every_exception_of_a_backend_becomes_a_link_error(
    link: Callable[..., Any], heard: Any, fault: Exception
) -> None:
    """The kinds seen in practice: each closes the session as broken and is logged."""
    opened, transport = link(fault)
    with pytest.raises(LinkError, match=rf"'\*IDN\?' failed \({type(fault).__name__}"):
        opened.ask("*IDN?")
    assert transport.closed == [True]
    assert heard.of("scpi")[-1]["failed"].startswith(type(fault).__name__)
    with pytest.raises(LinkError, match="the connection is closed"):
        opened.ask("*IDN?")


def test_an_interrupt_propagates_and_closes_the_session(link: Callable[..., Any]) -> None:
    """After Ctrl-C between query and reply, the reply cannot be taken for another one."""
    opened, transport = link(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        opened.ask("*IDN?")
    assert transport.closed == [True]
    with pytest.raises(LinkError, match="the connection is closed"):
        opened.ask("*IDN?")


def test_a_reply_with_control_characters_is_an_error(link: Callable[..., Any]) -> None:
    """Control characters in a reply mean that bytes were lost."""
    opened, _ = link(b"1;\x00;2")
    with pytest.raises(LinkError, match="is not text"):
        opened.ask("OUTP1?")


def test_a_reply_is_stripped_and_logged(link: Callable[..., Any], heard: Any) -> None:
    """The terminator belongs to the transport."""
    opened, _ = link(b"1\n")
    assert opened.ask("OUTP1?") == "1"
    facts = heard.of("scpi")[-1]
    assert (facts["sent"], facts["reply"]) == ("OUTP1?", "1")
    assert facts["seconds"] >= 0


def test_a_longer_timeout_holds_for_one_exchange(link: Callable[..., Any]) -> None:
    """A copy may take 15 s; the next query may not."""
    opened, transport = link(b"1")
    opened.ask("*OPC?", timeout=15)
    opened.ask("*IDN?")
    assert transport.timeouts == [15, 0.5]


def test_the_content_of_a_block_is_returned(link: Callable[..., Any], heard: Any) -> None:
    """The content of a definite-length block; anything after it is ignored (IEEE 488.2, 8.7.9)."""
    opened, _ = link(b"#16" + bytes([0, 1, 0, 2, 0x3F, 0xFE]) + b"\n")
    assert opened.ask_block("DATA?") == bytes([0, 1, 0, 2, 0x3F, 0xFE])
    assert heard.of("scpi")[-1]["reply"].startswith("<6 bytes, blake2b ")
    opened, _ = link(b"#12ab")
    assert opened.ask_block("DATA?") == b"ab", "a transport may have taken the terminator off"


@pytest.mark.parametrize("reply", [b"", b"1", b"#", b"#0", b"#2x1", b"#15ab", b"\xff#12ab"])
def test_an_incomplete_block_is_an_error(link: Callable[..., Any], reply: bytes) -> None:
    """No header, no length, or fewer bytes than it announces."""
    opened, _ = link(reply)
    with pytest.raises(LinkError, match="is not a block|announces 5 bytes, but 2 came"):
        opened.ask_block("DATA?")


NO_ERROR, RANGE, QUEUED = b'0,"No error"', b'-222,"Data out of range"', b'-350,"Queue overflow"'


def test_a_refused_command_is_told_with_all_the_errors_that_wait(link: Callable[..., Any], heard: Any) -> None:
    """The queue is read to its end (SCPI-99, 21.8), each error named once, so that none is told of the next command."""
    opened, transport = link([b"1;" + RANGE, QUEUED, RANGE, NO_ERROR, b"1"])
    with pytest.raises(Unconfirmed, match=r'reports -222,"Data out of range", -350,"Queue overflow"$'):
        opened.complete("ABOR")
    assert transport.sent == [":ABOR;*OPC?;:SYST:ERR?", *["SYST:ERR?"] * 3]
    assert heard.of("instrument_errors")[-1]["errors"] == [QUEUED.decode(), RANGE.decode()]


def test_a_queue_without_end_is_read_a_number_of_times(link: Callable[..., Any]) -> None:
    """An instrument that always reports an error keeps nobody waiting for ever."""
    opened, transport = link(RANGE)
    assert opened.pending_errors() == [RANGE.decode()] * MOST_ERRORS
    assert len(transport.sent) == MOST_ERRORS


def test_the_reply_to_the_completion_is_no_error(link: Callable[..., Any], heard: Any) -> None:
    """Nor are the replies to further queries; one that is missing is told."""
    opened, _ = link([b"1;" + RANGE + b";1000", NO_ERROR])
    with pytest.raises(Unconfirmed, match="to 'DATA:COPY USER1,EMEM' the generator reports -222"):
        opened.complete("DATA:COPY USER1,EMEM", "DATA:POIN? EMEM")
    opened, _ = link(b"1;" + NO_ERROR)
    with pytest.raises(Unconfirmed, match="to 'the upload' the generator answers"):
        opened.complete("", "DATA:POIN? EMEM")
    opened, _ = link(b"1;" + NO_ERROR + b";1000")
    heard.clear()
    assert opened.complete("", "DATA:POIN? EMEM") == ["1000"]
    assert heard.of("instrument_errors") == []


def test_many_settings_are_asked_for_in_messages_that_an_instrument_can_hold(link: Callable[..., Any]) -> None:
    """Twelve queries a message; what differs is named in the order of the settings."""
    levels = [AFG3022B.level(1, volts) for volts in range(1, 26)]
    opened, transport = link([b";".join(b"%d" % n for n in part) for part in ([*range(1, 13)], [*range(13, 25)], [7])])
    assert [each.partition(" reads ")[2] for each in opened.differences(levels)] == ["7, 25VPP was set"]
    assert [message.count("?") for message in transport.sent] == [12, 12, 1]


def test_replies_are_as_many_as_the_queries(link: Callable[..., Any]) -> None:
    """One that is missing or too many would be taken for that of another setting."""
    levels = [AFG3022B.level(1, 5.0), AFG3022B.level(2, 7.0)]
    for replies in (b"5;7", b"5;7;7;" + NO_ERROR):
        opened, _ = link(replies)
        with pytest.raises(Unconfirmed, match="the generator answers"):
            opened.apply(levels)
    for replies in (b"5", b"5;7;7"):
        opened, _ = link(replies)
        with pytest.raises(Unconfirmed, match=r"2 settings were queried, but \d came back"):
            opened.differences(levels)


def test_a_setting_that_reads_otherwise_is_refused(link: Callable[..., Any]) -> None:
    """With what reads otherwise, and everything that was read back."""
    levels = [AFG3022B.level(1, 5.0), AFG3022B.level(2, 7.0)]
    opened, transport = link(b"5;7;" + NO_ERROR)
    assert opened.apply(levels) == ("5", "7")
    assert transport.sent == [":SOUR1:VOLT 5VPP;:SOUR2:VOLT 7VPP;:SOUR1:VOLT?;:SOUR2:VOLT?;:SYST:ERR?"]
    opened, _ = link(b"5;8;" + NO_ERROR)
    with pytest.raises(Unconfirmed, match=r"^SOUR2:VOLT reads 8, 7\.0VPP was set$") as refused:
        opened.apply(levels)
    assert refused.value.read_back == ("5", "8")


def test_a_message_without_a_query_waits_for_no_reply(link: Callable[..., Any], heard: Any) -> None:
    """It is sent and logged once it was accepted."""
    opened, transport = link(b"never read")
    opened.send_block("DATA EMEM", b"ab")
    assert transport.sent == ["DATA EMEM,#12ab"]
    assert ["reply" in facts for facts in heard.of("scpi")] == [False]


def test_a_setting_reported_as_an_error_is_refused_although_it_reads_back(link: Callable[..., Any]) -> None:
    """With what was read back."""
    opened, _ = link([b"5;7;" + RANGE, NO_ERROR])
    with pytest.raises(Unconfirmed, match=r"reports -222") as refused:
        opened.apply([AFG3022B.level(1, 5.0), AFG3022B.level(2, 7.0)])
    assert refused.value.read_back == ("5", "7")


@pytest.mark.parametrize("entry", [b"", b"garbled", b'","'])
def test_an_error_entry_that_cannot_be_read_is_an_error(link: Callable[..., Any], entry: bytes) -> None:
    """Bytes were lost, and nobody knows what it said."""
    opened, _ = link([b"5;" + entry, NO_ERROR])
    with pytest.raises(Unconfirmed, match="the generator reports"):
        opened.apply([AFG3022B.level(1, 5.0)])


def test_outputs_are_off_only_if_both_say_so(link: Callable[..., Any]) -> None:
    """Which were on before, and what the instrument reports, are told; anything else is no confirmation."""
    opened, _ = link(b"1;0;0;0;" + NO_ERROR)
    assert opened.outputs_off() == ((True, False), ())
    opened, _ = link([b"0;1;0;0;" + RANGE, QUEUED, NO_ERROR])
    assert opened.outputs_off() == ((False, True), (RANGE.decode(), QUEUED.decode()))
    for replies in (b"1;1;0;1;", b"1;1;1;0;", b"0;0;0;", b"1;1;0;0;0;", b"1;1;;0;"):
        opened, _ = link(replies + NO_ERROR)
        with pytest.raises(Unconfirmed, match="asked whether its outputs are off, the generator says"):
            opened.outputs_off()


def test_a_link_that_is_opened_again_is_closed_first(link: Callable[..., Any]) -> None:
    """An instrument that admits one session would refuse the second."""
    opened, transport = link(b"1")
    opened.open()
    assert transport.closed == [False]


def test_a_link_logs_whom_it_shut_out_and_how_long_an_exchange_took(
    link: Callable[..., Any], heard: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In seconds, to the microsecond."""
    instants = iter([10.0, 10.25, 20.0, 20.0000014])
    monkeypatch.setattr("modaltouch.rig.controls.time.perf_counter", lambda: next(instants))
    opened, _ = link(b"1")
    opened.ask("*OPC?")
    assert heard.of("link") == [{"did": "open", "others": "locked out", "seconds": 0.25}]
    assert heard.of("scpi") == [{"sent": "*OPC?", "reply": "1", "seconds": 1e-6}]


def test_another_program_that_takes_the_instrument_is_told_apart(link: Callable[..., Any]) -> None:
    """In an exchange as at opening: the link is given up, and no new one is tried."""
    opened, transport = link(InUse("another program has locked it"))
    with pytest.raises(InUse, match="another program has locked it"):
        opened.ask("*IDN?")
    assert transport.closed == [True]


def test_a_reset_restores_the_defaults_and_forgets_what_is_stored(link: Callable[..., Any]) -> None:
    """It may take as long as a copy; an error that it leaves is refused."""
    opened, transport = link([b"1", NO_ERROR])
    opened.stored["USER1"] = "a hash"
    opened.reset()
    assert (transport.sent, transport.timeouts) == (["*RST;*OPC?", "SYST:ERR?"], [1, 0.5])
    assert opened.stored == {}
    opened, _ = link([b"1", RANGE, NO_ERROR])
    with pytest.raises(Unconfirmed, match=r"to '\*RST' the generator reports -222"):
        opened.reset()


@pytest.mark.parametrize(
    ("n_errors", "said"), [(1, "-1$"), (3, "-1, -2, -3$"), (4, "-1, -2, -3, and 1 more$"), (9, "-3, and 6 more$")]
)
def test_of_many_errors_the_first_are_named(link: Callable[..., Any], n_errors: int, said: str) -> None:
    """A queue holds twenty and more."""
    opened, _ = link([b"1;-1"] + [b"%d" % -n for n in range(2, n_errors + 1)] + [NO_ERROR])
    with pytest.raises(Unconfirmed, match=f"to 'ABOR' the generator reports .*{said}"):
        opened.complete("ABOR")


def test_records_hold_what_a_memory_can(link: Callable[..., Any]) -> None:
    """2 to 131072 points (AFG3000 series programmer manual, DATA:DEFine)."""
    opened, transport = link(b"1")
    opened._instrument = replace(AFG3022B, records=Mock(store=lambda _, records: [len(codes) for _, codes in records]))
    for n_points in (1, 131_073):
        with pytest.raises(Unconfirmed, match=f"a record of {n_points} points: the generator holds 2 to 131072"):
            opened.store([(1, np.zeros(n_points, dtype=np.uint16))])
    assert opened.store([(1, np.zeros(n_points, dtype=np.uint16)) for n_points in (2, 131_072)]) == [2, 131_072]
    assert transport.sent == []


@pytest.mark.parametrize(
    ("fault", "kind", "words"),
    [
        (ConnectionRefusedError(111, "refused"), LinkError, "cannot be opened .*ConnectionRefusedError"),
        (InUse("another program has locked it"), InUse, "another program has locked it"),
    ],
)
def test_a_failure_to_open_is_reported(heard: Any, fault: Exception, kind: type[Exception], words: str) -> None:
    """An absent instrument and one in use are distinguished."""
    transport = Transport(b"")
    transport.open = Mock(side_effect=fault)  # type: ignore[method-assign]
    with pytest.raises(kind, match=words):
        Controls(transport, AFG3022B, revive=Mock(), log=heard, timeout=1, copy_timeout=1).open()
    assert heard.of("link")[0]["failed"].endswith(str(fault))


@pytest.mark.parametrize(
    ("reply", "parts"),
    [
        ("1", ["1"]),
        ('1.5E+00;0,"No error"', ["1.5E+00", '0,"No error"']),
        ('-222,"Data out of range; 5 V";3', ['-222,"Data out of range; 5 V"', "3"]),
        ("", [""]),
    ],
)
def test_a_compound_reply_is_split_outside_quotes(reply: str, parts: list[str]) -> None:
    """Error texts may contain semicolons (SCPI-99, 21.8)."""
    assert split_reply(reply) == parts


def test_a_block_is_described_by_length_and_hash() -> None:
    """BLAKE2b of eight bytes of the empty string is e4a6a0577479b2b4 (RFC 7693's algorithm, b2sum -l 64)."""
    assert describe_block(b"") == "<0 bytes, blake2b e4a6a0577479b2b4>"
