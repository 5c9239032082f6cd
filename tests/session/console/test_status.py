"""State of a session and warnings for the experimenter, from the record's events alone."""

from __future__ import annotations

import json
import os
import pty
from io import StringIO, TextIOWrapper
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from modaltouch.protocol import Findings
from modaltouch.protocol.trial import Condition, Trial
from modaltouch.session.console import Console as SilentConsole
from modaltouch.session.console import Experimenter, Request
from modaltouch.session.console.__main__ import (
    LONGEST_NOTE,
    Dialogue,
    describe_trial,
    draw_session,
    read_keys,
    split_keys,
)
from modaltouch.session.console.consoles import LONGEST_LINE, EventLines, PlainLines, open_console
from modaltouch.session.console.status import Status
from modaltouch.session.events import describe_trial as of_trial
from modaltouch.window.interface import SessionStopped


def start(n_trials: int = 24) -> dict[str, Any]:
    """Return a start record with the members that the console reads."""
    return {
        "n": 1,
        "event": "start",
        "participant": "p01",
        "session": 1,
        "mode": "real",
        "protocol": "demo",
        "schedule": {"n_trials": n_trials},
        "rig": {"identity": "TEKTRONIX,AFG3022B,C010101,SCPI:99.0"},
        "clock": 0.0,
    }


def trial(
    index: int,
    answer: str = "both",
    *,
    clock: float = 0.0,
    speeds: tuple[float, float] = (100.0, 100.0),
    **response: Any,
) -> dict[str, Any]:
    """Return a trial event with the members that the console reads."""
    return {
        "n": 10 + index,
        "event": "trial",
        "clock": clock,
        "trial": {"index": index, "practice": False, "block": 1, "condition": {"velocity_mm_s": max(speeds)}},
        "planned": {"speed_left_mm_s": speeds[0], "speed_right_mm_s": speeds[1]},
        "confirmed": {"confirmed": True},
        "response": {"answer": answer, "reaction_time": 0.9, "onset": "first_burst", "question_after": 0.5, **response},
    }


def test_the_time_left_follows_the_pace_of_the_answers() -> None:
    """Ten seconds per trial, 5 of 24 answered: 190 s left; a break of an hour changes nothing."""
    status = Status(seconds_per_trial=5.0)
    status.take(start())
    assert status.facts()["time_left_s"] == 24 * 5
    for index in range(1, 6):
        status.take(trial(index, clock=10.0 * index))
    assert status.facts()["time_left_s"] == 19 * 10
    status.take({"event": "rest"})
    status.take(trial(6, clock=3650.0))
    assert status.facts()["time_left_s"] == 18 * 10


def test_an_answer_that_is_withdrawn_is_not_counted() -> None:
    """Superseded and withdrawn answers do not count, as in the record."""
    status = Status()
    status.take(start())
    for index in (1, 2, 3):
        status.take(trial(index))
    status.take({"event": "withdrawn", "lines": [12, 13], "reason": "x"})
    assert status.facts()["n_answered"] == 1


def test_a_warning_of_lost_masking_noise_lasts_until_it_returns() -> None:
    """With its reason; switching the noise off at the end is not a return."""
    status = Status()
    status.take(start())
    status.take({"event": "masking", "state": "on"})
    assert status.facts()["warnings"] == []
    status.take({"event": "masking_lost", "reason": "the sound device accepts no more samples"})
    lost = ["the beam is not masked: the sound device accepts no more samples"]
    assert status.facts()["warnings"] == lost
    status.take({"event": "masking", "state": "off"})
    assert status.facts()["warnings"] == lost
    status.take({"event": "masking", "state": "on"})
    assert status.facts()["warnings"] == []


def test_hasty_answers_doubles_and_false_alarms_cause_warnings() -> None:
    """Each with its count and its last trial; a catch trial has a level of 0."""
    trials = [
        trial(1, reaction_time=0.55),
        trial(2, double=True),
        trial(3, "left", speeds=(0.0, 0.0)),
        trial(4, "none", speeds=(0.0, 0.0)),
        trial(5, reaction_time=0.65),
    ]
    answers = {"keys": {name: [name] for name in ("left", "both", "right", "none")}}
    status = Status()
    status.take({**start(), "design": {"answers": answers}})
    for event in trials:
        status.take(event)
    told = status.facts()["warnings"]
    assert any("once answered within 100 ms of the question, last in trial 1" in sign for sign in told)
    assert any("1 of 2 catch trials answered as if something was felt, last trial 3" in sign for sign in told)
    assert any("two answers at once, last in trial 2" in sign for sign in told)
    status.take({"event": "withdrawn", "lines": [13]})
    told = status.facts()["warnings"]
    assert len(told) == 2 and not any("catch" in sign for sign in told), "a withdrawn answer is no sign"


class Unread(dict[str, Any]):
    """An event that counts how often its members are read."""

    n_reads = 0

    def __getitem__(self, name: str) -> Any:
        type(self).n_reads += 1
        return super().__getitem__(name)


def test_the_cost_of_an_event_does_not_grow() -> None:
    """Earlier trials are not read again, since the window waits for the console at every event."""
    status = Status()
    status.take(start(600))
    for index in range(1, 501):
        status.take(Unread(trial(index)))
    Unread.n_reads = 0
    status.take({"event": "rest"})
    facts = status.facts()
    assert (facts["n_answered"], facts["answers"], Unread.n_reads) == (500, {"both": 500}, 0)


class Asked(SilentConsole):
    """A console with given requests."""

    def __init__(self, *commands: str) -> None:
        self._requests = [Request(command) for command in commands]  # type: ignore[arg-type]

    def requests(self) -> list[Request]:
        requests, self._requests = self._requests, []
        return requests


@pytest.mark.parametrize(
    ("command", "reason", "recorded"),
    [("stop", "experimenter", [("experimenter", {"asks": "stop"})]), ("emergency_stop", "emergency stop", [])],
)
def test_stops_are_raised(command: str, reason: str, recorded: list[Any]) -> None:
    """The record says who stopped; in an emergency nothing is written before the outputs are off."""
    record: list[tuple[str, dict[str, Any]]] = []
    experimenter = Experimenter(Asked(command), lambda event, **facts: record.append((event, facts)))
    with pytest.raises(SessionStopped, match=reason):
        experimenter.attend()
    assert record == recorded


def test_a_repeat_can_be_cancelled() -> None:
    """A second R cancels it; an answer that is withdrawn anyway is not repeated in addition."""
    twice = Experimenter(Asked("repeat", "repeat"))
    twice.tell(start())
    twice.tell(trial(1))
    twice.attend()
    assert twice.take_repeat() is None
    status = Status()
    early = Experimenter(Asked("repeat"), status=status)
    early.tell(start())
    early.attend()
    assert early.take_repeat() is None
    assert status.facts()["nothing_to_repeat"], "a key that does nothing is told to do nothing"
    experimenter = Experimenter(Asked("repeat"))
    experimenter.tell(start())
    experimenter.tell(trial(1))
    experimenter.tell({"event": "withdrawn", "lines": [11]})
    experimenter.attend()
    assert experimenter.take_repeat() is None


def test_every_picture_fits_its_terminal() -> None:
    """With long names, long errors and all warnings, the prompts and keys stay visible."""
    status = Status()
    status.take({**start(240), "participant": "p" * 32, "protocol": "with_a_name_that_is_rather_long"})
    for index in range(1, 40):
        status.take(trial(index, "left", double=True, reaction_time=0.5))
    status.take({"event": "exchange", "what": "connection_lost", "reason": "x" * 300})
    described = {
        "number": 100, "practice": True, "block": 2, "velocity_mm_s": 123.456, "predicted_left_mm_s": 1234.5,
        "predicted_right_mm_s": 1234.5, "finger_condition": "two_hands", "placement": "mirrored_swapped",
        "zone_left": "A", "zone_right": "C", "finger_left": "right middle", "finger_right": "right index",
    }  # fmt: skip
    status.take({"event": "trial_next", "trial": described})
    prompt = "stop the session now? y: yes, any other key: no"
    for width, height in ((80, 24), (60, 20), (200, 50), (60, 24), (40, 20), (80, 14), (40, 12)):
        file = StringIO()
        console = Console(file=file, width=width, height=height, force_terminal=False)
        console.print(draw_session(status.facts(), prompt, width=width, height=height))
        lines = file.getvalue().splitlines()
        assert len(lines) <= height - 1
        assert max(map(len, lines)) <= width
        told = " ".join(" ".join(lines).replace("\N{NO-BREAK SPACE}", " ").split())
        for words in ("39 of 240", "EMERGENCY STOP", "q stop", prompt, "39 times"):
            assert words in told, (width, height)
        if width * height >= 80 * 20:
            assert "right middle on A, right index on C (mirrored swapped)" in told


@pytest.mark.parametrize("interval", [{}, {"interval": 1}])
def test_a_replayed_stimulus_is_drawn(interval: dict[str, int]) -> None:
    """`resume` replays the record, which does not announce trials; the console must not end, and its keys with it."""
    status = Status()
    status.take(start(), replayed=True)
    fired = {"event": "fired", "confirmed": {"commanded_amplitude": [5.9, 0.97], "confirmed": False}, **interval}
    status.take(fired, replayed=True)
    shown = StringIO()
    Console(file=shown, width=80).print(draw_session(status.facts(), "", width=80))
    assert "trial on" in shown.getvalue()


def test_the_trial_is_described_with_stimulus_and_small_speeds() -> None:
    """Threshold runs go down to 2 mm/s, which needs decimals; a catch trial has no level."""
    facts = {
        "number": 7, "practice": False, "block": 1, "velocity_mm_s": 2.0, "predicted_left_mm_s": 1.2,
        "predicted_right_mm_s": 2.0, "finger_condition": "one_hand", "placement": "normal", "zone_left": "A",
        "zone_right": "C", "finger_left": "right index", "finger_right": "right middle", "stimulus": "blunt",
    }  # fmt: skip
    (_, told), (_, fingers), (_, predicted) = describe_trial(facts)
    assert told == "7, block 1, blunt at 2 mm/s"
    assert fingers == "right index on A, right middle on C"
    assert predicted == "left 1.2 mm/s, right 2 mm/s"
    (_, told), *_ = describe_trial({**facts, "stimulus": "", "velocity_mm_s": 0.0})
    assert told == "7, block 1, catch trial"
    (_, told), *_ = describe_trial({**facts, "practice": True, "block": 0})
    assert told == "practice 7, blunt at 2 mm/s", "practice belongs to no block"


@pytest.mark.parametrize(
    ("zones", "fingers", "predicted"),
    [
        (("C",), "right ring on C", "left 80 mm/s"),
        (
            ("A", "C", "E"),
            "left index on A, right index on C, right ring on E",
            "left 80 mm/s, between 79 mm/s, right 78 mm/s",
        ),
    ],
)
def test_one_and_three_fingers_are_described_with_zones_and_speeds(
    zones: tuple[str, ...], fingers: str, predicted: str
) -> None:
    """From left to right, from the facts that the session provides."""
    example = Path(__file__).parents[3] / "docs" / "examples" / "protocol_three_fingers.yaml"
    protocol = Findings.read(example).experiment().protocol
    own = {"tip": ("right ring",), **protocol.conditions.fingers}
    conditions = protocol.conditions.model_copy(update={"fingers": own})
    condition = Condition.on(zones, "tip" if len(zones) == 1 else "spread", 80.0)
    speeds = tuple(0.08 - 0.001 * place for place in range(len(zones)))
    facts = of_trial(protocol.model_copy(update={"conditions": conditions}), speeds, Trial(7, 1, condition))
    assert [told for _, told in describe_trial(facts)][1:] == [fingers, predicted]


def test_the_events_are_json_lines_with_units(tmp_path: Path) -> None:
    """One complete object per line, so that a reader may join late."""
    file = tmp_path / "events.jsonl"
    experimenter = Experimenter(EventLines(file))
    for event in (start(), trial(1), trial(2)):
        experimenter.tell(event)
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    assert [line["n_answered"] for line in lines] == [0, 1, 2]
    assert {"time", "time_left_s", "elapsed_s", "warnings", "generator", "last"} <= set(lines[-1])
    assert lines[-1]["last"]["reaction_time_s"] == 0.9


def test_an_unread_pipe_does_not_block(tmp_path: Path) -> None:
    """Without a reader, with one that never reads, and with a new one, lines are dropped and counted."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    status = Status()
    status.take(start())
    lines = EventLines(pipe)
    lines.show(status.facts())
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    for _ in range(400):
        lines.show(status.facts())
    data = os.read(reader, 1 << 20)
    assert all(json.loads(line) for line in data.splitlines()), "what was taken was taken whole"
    assert json.loads(data.splitlines()[0])["n_dropped"] == 1
    lines.show(status.facts())
    assert json.loads(os.read(reader, 1 << 20).splitlines()[0])["n_dropped"] > 100
    os.close(reader)
    lines.show(status.facts())
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    lines.show(status.facts())
    assert json.loads(os.read(reader, 1 << 20).splitlines()[-1])["participant"] == "p01"
    os.close(reader)
    lines.close()


def test_a_line_fits_an_atomic_pipe_write(tmp_path: Path) -> None:
    """However long an error message is, a line is valid JSON of at most 4096 bytes."""
    status = Status()
    status.take(start())
    status.take({"event": "exchange", "what": "instrument_errors", "errors": ["é" * 5000]})
    lines = EventLines(tmp_path / "events.jsonl")
    lines.show(status.facts())
    line = (tmp_path / "events.jsonl").read_bytes()
    assert len(line) <= LONGEST_LINE
    assert json.loads(line)["participant"] == "p01"


def test_plain_lines_show_news_and_survive_a_closed_file() -> None:
    """Answers, pauses and each warning once."""
    file = StringIO()
    experimenter = Experimenter(PlainLines(file))
    experimenter.tell(start())
    for index in range(1, 12):
        experimenter.tell(trial(index, "left", double=index in (3, 7, 9)))
    experimenter.tell({"event": "pause", "trial": None})
    text = file.getvalue()
    assert "1 of 24 answered: left, 0.90 s after the first burst (trial 1)" in text
    assert text.count("warning: ") == 1, "although its count rises"
    assert "warning: once two answers at once, last in trial 3" in text
    assert text.endswith("paused\n")
    file.close()
    experimenter.tell(trial(12))


def test_plain_lines_of_a_resumed_session_omit_earlier_events() -> None:
    """Replayed pauses, stops and answers are not printed."""
    file = StringIO()
    experimenter = Experimenter(PlainLines(file))
    for event in (start(), trial(1), trial(2), {"event": "pause"}, {"event": "stop", "reason": "experimenter"}):
        experimenter.tell(event, replayed=True)
    experimenter.tell({"event": "resume", "rig": {"identity": "x"}})
    experimenter.tell(trial(3))
    assert [line[:27] for line in file.getvalue().splitlines()] == [
        "resumed",
        "3 of 24 answered: both, 0.9",
    ]


def test_ending_needs_confirmation_and_notes_take_letters() -> None:
    """Q alone ends nothing; in a note, q and x are letters, but F12 is not."""
    dialogue = Dialogue(("f12",))
    assert dialogue.press("q") is None
    assert dialogue.press("n") is None
    assert dialogue.press("n") is None
    assert [dialogue.press(key) for key in ("q", "x")] == [None, None]
    assert dialogue.press("f12") == Request("emergency_stop")
    assert dialogue.press("enter") == Request("note", "qx")
    assert dialogue.press("q") is None
    assert dialogue.press("y") == Request("stop")


def test_a_full_note_is_reported() -> None:
    """Further characters are ignored, and the prompt says so."""
    dialogue = Dialogue()
    dialogue.press("n")
    for _ in range(LONGEST_NOTE - 1):
        dialogue.press("é")
    assert "full" not in dialogue.prompt
    dialogue.press("é")
    assert f"full at {LONGEST_NOTE} characters" in dialogue.prompt
    dialogue.press("z")
    assert dialogue.press("enter") == Request("note", "é" * LONGEST_NOTE)


@given(st.text(max_size=30))
def test_any_text_splits_into_keys(text: str) -> None:
    """Keys are printable characters or key names."""
    assert all(len(key) == 1 and key.isprintable() or key.isascii() for key in split_keys(text))


@pytest.mark.parametrize("place", range(1, len("\x1b[24~")))
def test_a_sequence_that_arrives_in_pieces_is_one_key(monkeypatch: pytest.MonkeyPatch, place: int) -> None:
    """F12, the emergency stop, over a slow line: wherever it is split, its rest does not count as a 4."""
    pieces = iter(["\x1b[24~"[:place], "\x1b[24~"[place:]])
    with monkeypatch.context() as patch:
        patch.setattr("modaltouch.session.console.__main__.os.read", lambda *_: next(pieces).encode())
        patch.setattr("modaltouch.session.console.__main__.select.select", lambda *_: ([0], [], []))
        keys = read_keys(0, bytes.decode, 0.0)
    assert keys == ["f12"]


def test_unusable_event_files_are_refused(tmp_path: Path) -> None:
    """A missing folder and a file with other contents, before the session begins."""
    with pytest.raises(OSError, match="No such file"):
        EventLines(tmp_path / "absent" / "events.jsonl")
    protocol = tmp_path / "protocol.yaml"
    protocol.write_text("protocol: demo\n")
    with pytest.raises(OSError, match="contains something other"):
        EventLines(protocol)
    assert protocol.read_text() == "protocol: demo\n"


def test_a_terminal_of_another_session_gets_plain_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """As after `setsid`: the terminal can be written, but its keys cannot be read."""
    master, slave = pty.openpty()
    with os.fdopen(slave, "r+b", buffering=0) as raw, TextIOWrapper(raw, write_through=True) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        monkeypatch.setattr("sys.stderr", terminal)
        with open_console(None, ("f12",), plain=False) as console:
            Experimenter(console).tell({"event": "pause"})
        assert os.read(master, 100).strip() == b"paused"
    os.close(master)


def test_a_pause_within_a_break_leads_back_to_the_break() -> None:
    """The console shows the break again, as the participant's screen does."""
    status = Status()
    for event in (start(), trial(1), {"event": "rest"}, {"event": "pause"}, {"event": "continued"}):
        status.take(event)
    assert status.facts()["state"] == "break"


def test_the_console_shows_the_reason_of_a_pause() -> None:
    """For example that the keyboard focus is in another window."""
    status = Status()
    status.take(start())
    for event, words in (
        ({"event": "focus_lost"}, "PAUSED: the window lost the keyboard focus; click in it"),
        ({"event": "pause"}, "PAUSED by the participant"),
        ({"event": "pause", "by": "experimenter"}, "PAUSED by the experimenter"),
    ):
        status.take(event)
        file = StringIO()
        Console(file=file, width=80).print(draw_session(status.facts(), "", width=80))
        assert words in file.getvalue()
