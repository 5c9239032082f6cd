"""Every line of the session log carries a running checksum of all lines before it."""

import hashlib
import json

import pytest

from modaltouch.record.chain import (
    GENESIS,
    RecordError,
    describe_torn,
    encode_line,
    line_check,
    parse_chain,
    read_chain,
)


def chain_of(*events: dict) -> bytes:
    """Return the bytes of a log with these events."""
    data, check = b"", GENESIS
    for event in events:
        line, check = encode_line(event, check)
        data += line
    return data


EVENTS = tuple({"n": n, "event": "trial", "answer": answer} for n, answer in enumerate(("left", "both", "right"), 1))


def test_a_sound_log_is_read_back_without_a_problem():
    """The checksum is SHA-256 of the previous checksum and the line's bytes."""
    chain = parse_chain(chain_of(*EVENTS), "log")
    assert chain.events == EVENTS
    assert chain.problems == ()
    body = json.dumps(EVENTS[0], separators=(",", ":"))[:-1].encode()
    assert chain.checks[0] == hashlib.sha256(GENESIS.encode() + body).hexdigest()


def test_every_single_byte_change_is_detected():
    """Three bit patterns are flipped in each byte of a session log."""
    data = chain_of(*EVENTS)
    for place in range(len(data)):
        for change in (1, 0x20, 0x80):
            changed = data[:place] + bytes([data[place] ^ change]) + data[place + 1 :]
            assert parse_chain(changed, "log").problems, f"byte {place} changed by {change:#x} was not detected"


@pytest.mark.parametrize(
    ("name", "order"),
    [("removed", (0, 2)), ("doubled", (0, 1, 1, 2)), ("reordered", (0, 2, 1)), ("first removed", (1, 2))],
)
def test_removed_duplicated_and_reordered_lines_are_detected(name, order):
    """A line continues only the line that preceded it when it was written."""
    lines = chain_of(*EVENTS).splitlines(keepends=True)
    assert parse_chain(b"".join(lines[i] for i in order), "log").problems, name


def test_a_cut_last_line_is_distinguished_from_damage():
    """A power cut truncates the last line; every line before it stays valid."""
    data = chain_of(*EVENTS)
    chain = parse_chain(data[:-7], "log")
    assert chain.events == EVENTS[:2]
    assert "cut while being written" in chain.problems[0]
    assert chain.torn


def test_a_whole_last_line_without_its_newline_counts():
    """The last answer counts if only its newline is missing."""
    chain = parse_chain(chain_of(*EVENTS)[:-1], "log")
    assert chain.events == EVENTS
    assert "has no newline" in chain.problems[0]
    assert not chain.torn


def test_the_line_after_a_cut_declares_the_remains():
    """The remains of a cut line stay in the file, and changing or removing them is detected."""
    first, check = encode_line(EVENTS[0], GENESIS)
    remains = b'{"n":2,"eve'
    second, _ = encode_line({"n": 2, "event": "resume", "torn": describe_torn(remains)}, check)
    assert parse_chain(first + remains + b"\n" + second, "log").problems == ()
    assert parse_chain(first + remains.replace(b"eve", b"ewe") + b"\n" + second, "log").problems
    assert "missing" in parse_chain(first + second, "log").problems[0]


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_nan_and_infinity_are_refused(value):
    """JSON has neither NaN nor infinity (RFC 8259, section 6)."""
    with pytest.raises(ValueError, match="Out of range float"):
        encode_line({"value": value}, GENESIS)


def test_an_empty_event_is_refused():
    """An event has at least one member."""
    with pytest.raises(ValueError, match="at least one member"):
        encode_line({}, GENESIS)


def test_the_message_about_an_unreadable_log_gives_its_name(tmp_path):
    """The error gives the file name and the reason."""
    with pytest.raises(RecordError, match=r"session.jsonl: cannot be read"):
        read_chain(tmp_path / "session.jsonl")


def test_a_problem_gives_the_file_and_its_first_line():
    """Lines count from 1; only the first invalid line is reported, however many follow it."""
    lines = chain_of(*EVENTS).splitlines(keepends=True)
    changed = lines[1].replace(b"both", b"left")
    broken = "the chain breaks: a line was changed, removed, duplicated or moved"
    assert parse_chain(lines[0] + changed + lines[2], "log").problems == (f"log:2: {broken}",)
    assert parse_chain(changed + lines[2], "log").problems == (f"log:1: {broken}",)
    cut = parse_chain(lines[0] + lines[1][:9], "log")
    assert cut.problems == ("log:2: the last line was cut while being written (9 bytes)",)
    assert cut.torn == lines[1][:9]
    unended = parse_chain(lines[0] + lines[1][:-1], "log")
    assert unended.problems == ("log:2: the last line has no newline, but its content is complete",)
    undeclared, _ = encode_line({"n": 1, "torn": describe_torn(b"gone")}, GENESIS)
    assert parse_chain(undeclared, "log").problems == (
        "log:1: this line declares a cut line, but the remains of that line are missing",
    )


def test_whether_the_file_ends_in_a_newline_is_known():
    """A file that is empty or ends in a newline needs none before the next line."""
    data = chain_of(*EVENTS)
    assert parse_chain(data, "log").ends_in_newline
    assert parse_chain(b"", "log").ends_in_newline
    assert parse_chain(b"", "log").last_check == GENESIS
    assert not parse_chain(data[:-1], "log").ends_in_newline


def test_non_ascii_text_is_not_escaped():
    """The log is readable UTF-8: names and notes are written without escapes."""
    line, check = encode_line({"note": "Zo\u00eb \u2192 C"}, GENESIS)
    assert "Zo\u00eb \u2192 C".encode() in line
    assert parse_chain(line, "log").checks == (check,)


def test_the_remains_of_two_cuts_are_kept_separate():
    """After two power failures in a row, the line after each declares its remains."""
    data, check = encode_line(EVENTS[0], GENESIS)
    for n, remains in ((2, b'{"n":2,"eve'), (3, b'{"n":3')):
        line, check = encode_line({"n": n, "torn": describe_torn(remains)}, check)
        data += remains + b"\n" + line
    chain = parse_chain(data, "log")
    assert chain.problems == ()
    assert len(chain.events) == 3


def test_an_unreadable_line_loses_no_other_answer():
    """Its checksum is valid, so the next line's can be computed: every other answer is read exactly once."""
    first, check = encode_line(EVENTS[0], GENESIS)
    body = b'{"n":2,"answer":left'
    check = line_check(check, body)
    last, _ = encode_line(EVENTS[2], check)
    chain = parse_chain(first + body + b',"check":"' + check.encode() + b'"}\n' + last, "log")
    assert chain.events == (EVENTS[0], EVENTS[2])
    said = "log:2: cannot be read: it is not JSON, is nested too deep, or has a number with too many digits, "
    said += "although its check is correct"
    assert chain.damage == (said,)
