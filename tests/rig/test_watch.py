"""What the watchdog does with requests, silence and the end of its pipe: no process, no instrument."""

from __future__ import annotations

import io
import struct
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from modaltouch.rig import watchdog
from modaltouch.rig.transport import InUse
from modaltouch.rig.watchdog import (
    ARM,
    BEAT,
    CLEAN,
    CLOSE,
    DISARM,
    DONE,
    EXCHANGE,
    FAILED,
    FLAG,
    OFF,
    OPEN,
    REPORT,
    TAKEN,
    TERMS,
    Watch,
    frame,
    read_frames,
)


class Instrument:
    """Notes what is asked of it, and answers as told, the last answer again and again."""

    def __init__(self, *answers: object) -> None:
        self.answers = list(answers) or [b"0;0\n"]
        self.sent: list[bytes] = []
        self.opened = 0

    def open(self) -> str:
        self.opened += 1
        return "locked out"

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> Any:
        self.sent.append(message)
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self, *, broken: bool) -> None:
        self.sent.append(b"broken" if broken else b"closed")


class Pipe:
    """Hands out what is written to it, as a pipe does, until it is closed."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._more = threading.Condition()
        self._closed = False

    def write(self, *requests: bytes) -> None:
        with self._more:
            self._data += b"".join(requests)
            self._more.notify()

    def close(self) -> None:
        with self._more:
            self._closed = True
            self._more.notify()

    def read(self, size: int) -> bytes:
        with self._more:
            self._more.wait_for(lambda: self._closed or len(self._data) >= size, timeout=5)
            data = bytes(self._data[:size])
            del self._data[:size]
            return data


def serve(instrument: Instrument, *requests: bytes) -> list[tuple[bytes, int, bytes]]:
    """Carry out requests until their end, and return the answers."""
    answers = bytearray()
    watch = Watch(instrument, limit=0.05, persistence=0.1)
    watch.serve(io.BytesIO(b"".join(requests)), answers.extend)
    return list(read_frames(io.BytesIO(bytes(answers))))


def request(letter: bytes) -> bytes:
    """Return a request without an interesting content."""
    return frame(letter, 0, FLAG.pack(False) if letter in (ARM, REPORT) else b"")


def ask(number: int, message: bytes) -> bytes:
    """Return the request for an exchange."""
    return frame(EXCHANGE, number, TERMS.pack(1.0, True, False) + message)


@pytest.mark.parametrize(
    ("requests", "pressed"),
    [
        ([], False),
        ([CLEAN], False),
        ([OPEN], True),
        ([OPEN, CLEAN], False),
        ([OPEN, ARM], True),
        ([OPEN, ARM, BEAT], True),
        ([OPEN, ARM, DISARM], True),
        ([OPEN, ARM, DISARM, CLEAN], False),
        ([OPEN, ARM, CLEAN], False),
    ],
)
def test_pipe_that_ends_without_a_clean_end_switches_off(requests: list[bytes], pressed: bool) -> None:
    """Whoever had the instrument and did not say that it ends cleanly is taken for dead (module docstring)."""
    instrument = Instrument()
    serve(instrument, *map(request, requests))
    assert (OFF in instrument.sent) is pressed


def test_answers_bear_the_numbers_of_their_requests() -> None:
    """Done, failed and in use are told apart; the words of an error come along."""
    instrument = Instrument(b"reply\n", TimeoutError("too late"), b"0;0\n")
    answers = serve(
        instrument, frame(OPEN, 7), ask(8, b"*IDN?\n"), ask(9, b"*OPC?\n"), frame(CLOSE, 10, TERMS.pack(0, False, True))
    )
    assert answers == [
        (DONE, 7, b"locked out"),
        (DONE, 8, b"reply\n"),
        (FAILED, 9, b"TimeoutError: too late"),
        (DONE, 10, b""),
    ]
    assert instrument.sent[:3] == [b"*IDN?\n", b"*OPC?\n", b"broken"]


def test_instrument_of_another_program_is_left_alone() -> None:
    """Never opened: nothing is switched off at the end."""

    class Taken(Instrument):
        def open(self) -> str:
            raise InUse("another program has locked it")

    instrument = Taken()
    assert serve(instrument, frame(OPEN, 1)) == [(TAKEN, 1, b"another program has locked it")]
    assert instrument.sent == []


@pytest.mark.parametrize("rubbish", [b"x", bytes(13), b"mtwd", struct.pack(">4scII", b"mtwd", b"X", 1, 99)])
def test_rubbish_in_the_pipe_is_its_end(rubbish: bytes) -> None:
    """What is no request, or half of one: the outputs are switched off."""
    instrument = Instrument()
    serve(instrument, frame(OPEN, 1), rubbish)
    assert instrument.sent == [OFF]


def silent(instrument: Instrument, *letters: bytes, seconds: float = 0.3) -> int:
    """Return how often an instrument was switched off during a silence after some requests."""
    pipe = Pipe()
    watch = Watch(instrument, limit=0.05, persistence=0.1)
    serving = threading.Thread(target=watch.serve, args=(pipe, lambda data: None))
    serving.start()
    pipe.write(*map(request, letters))
    time.sleep(seconds)
    pressed = instrument.sent.count(OFF)
    pipe.write(frame(CLEAN, 0))
    serving.join(5)
    return pressed


@pytest.mark.parametrize(
    ("letters", "pressed"),
    [((OPEN, ARM), 1), ((OPEN, ARM, BEAT), 1), ((OPEN,), 0), ((OPEN, BEAT), 0), ((OPEN, ARM, DISARM), 0)],
)
def test_silence_counts_while_armed(letters: tuple[bytes, ...], pressed: int) -> None:
    """0.3 s without a sign of life at a limit of 0.05 s: off, once; a beat alone does not arm."""
    assert silent(Instrument(), *letters) == pressed


def test_the_longest_silence_is_the_one_that_is_promised() -> None:
    """The README of the rig, which the processes of `test_watchdog.py` are timed against."""
    text = (Path(watchdog.__file__).parent / "README.md").read_text(encoding="utf-8")
    assert f"or falls silent for {watchdog.LIMIT:g} s while outputs may be on" in text


def test_signs_of_life_keep_an_armed_session_on() -> None:
    """A beat every 0.02 s at a limit of half a second: never off."""
    pipe, instrument = Pipe(), Instrument()
    serving = threading.Thread(target=Watch(instrument, limit=0.5).serve, args=(pipe, lambda data: None))
    serving.start()
    pipe.write(request(OPEN), request(ARM))
    for _ in range(15):
        time.sleep(0.02)
        pipe.write(frame(BEAT, 0))
    pressed = instrument.sent.count(OFF)
    pipe.write(frame(CLEAN, 0))
    serving.join(5)
    assert pressed == 0


def test_outputs_that_do_not_go_off_are_tried_again_over_new_sessions() -> None:
    """A lost reply and an output that stays on: off at the third try, each over a session opened anew."""
    instrument = Instrument(TimeoutError("lost"), b"0;1\n", b"0;0\n")
    assert Watch(instrument, persistence=5).switch_off()
    assert instrument.sent == [OFF, b"broken", OFF, b"broken", OFF]
    assert instrument.opened == 2


def test_instrument_that_never_answers_is_given_up() -> None:
    """After the time stated."""
    started = time.monotonic()
    assert not Watch(Instrument(OSError("gone")), persistence=0.1).switch_off()
    assert 0.1 < time.monotonic() - started < 1
