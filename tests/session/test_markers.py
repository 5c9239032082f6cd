"""Markers of the Lab Streaming Layer: sent by a session and received by an inlet on this machine."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from modaltouch.preflight import examine
from modaltouch.protocol import InputError
from modaltouch.record import Session
from modaltouch.session.markers import Markers
from modaltouch.session.setup import Setup, begin
from modaltouch.session.wiring import wire_run
from modaltouch.system import SYSTEM_CLOCK

DEMO = Path(__file__).parents[2] / "protocols" / "demo.yaml"


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Setup:
    """A demonstration with markers, answered by an observer in virtual time."""
    folder = tmp_path_factory.mktemp("markers")
    for name in ("apparatus", "texts"):
        (folder / name).symlink_to(DEMO.parent / name)
    file = folder / "demo.yaml"
    file.write_text(DEMO.read_text(encoding="utf-8") + "\nmarkers: {lsl: true}\n", encoding="utf-8")
    return wire_run(examine(file).require(), "p01", answers="simulated", results=folder / "results")


@pytest.fixture(scope="module")
def received(demo: Setup, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Session, list[Any], list[str]]]:
    """The recorded session, and every received marker with its time on the LSL clock [s]."""
    with pytest.MonkeyPatch.context() as patch:
        config = tmp_path_factory.mktemp("lsl") / "lsl_api.cfg"
        # Nobody beyond this machine is asked.
        config.write_text("[multicast]\nResolveScope = machine\n[log]\nlevel = -3\n", encoding="ascii")
        patch.setenv("LSLAPICFG", str(config))
        import pylsl

        markers = Markers("demo/p01/1", demo.clock)
        (found,) = pylsl.resolve_byprop("source_id", "demo/p01/1", timeout=60)
        inlet = pylsl.StreamInlet(found)
        inlet.open_stream(timeout=60)
        session = begin(replace(demo, open_markers=lambda: markers))
        samples = []
        while len(samples) < 2 * len(session.trials):
            (words,), instant = inlet.pull_sample(timeout=60)
            samples.append((words, instant))
        told = session.trials[1]
        fired = {"event": "fired", "trial": told["trial"], "confirmed": told["confirmed"]}
        for event in (fired | {"interval": 2}, fired | {"event": "trial_cut", "clock": 1.0}):
            markers.follow(event)
        yield session, samples, [inlet.pull_sample(timeout=60)[0][0] for _ in range(2)]
        inlet.close_stream()


def test_every_stimulus_and_answer_is_received_with_its_time(
    received: tuple[Session, list[Any], list[str]],
) -> None:
    """Conditions and times of the record, shifted by the recorded offset of the clocks."""
    session, samples, _ = received
    offset = session.start["markers"]["lsl"]["clock_offset_s"]
    expected = []
    for event in session.trials:
        trial, instants = event["trial"], event["instants"]
        condition, practice = trial["condition"], "practice/" if trial["practice"] else ""
        place = f"{condition['finger_condition']}/{condition['zone_left']}{condition['zone_right']}"
        about = f"{practice}{trial['index']}/{place}/{condition['velocity_mm_s']:g}"
        answered = (instants["answer"]["earliest_s"] + instants["answer"]["latest_s"]) / 2
        expected += [
            (f"stimulus/{about}", event["confirmed"]["onset"]),
            (f"answer/{about}/{event['response']['answer']}", answered),
        ]
    assert [words for words, _ in samples] == [words for words, _ in expected]
    assert [instant - offset for _, instant in samples] == pytest.approx([instant for _, instant in expected], abs=1e-5)


def test_markers_of_intervals_and_interruptions(received: tuple[Session, list[Any], list[str]]) -> None:
    """The words of the trial's stimulus, with the number of the interval, or marked as cut."""
    _, samples, (interval, cut) = received
    words = samples[2][0]
    assert words.startswith("stimulus/1/")
    assert (interval, cut) == (f"{words}/interval_2", words.replace("stimulus", "cut", 1))


def test_a_session_in_virtual_time_sends_nothing(demo: Setup) -> None:
    """Its times would be meaningless."""
    assert demo.open_markers() is None


def test_without_pylsl_the_session_is_refused(demo: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the line of the protocol and the extra to install."""
    monkeypatch.setitem(sys.modules, "pylsl", None)
    parts = demo.open_markers.__self__  # type: ignore[attr-defined]
    monkeypatch.setitem(parts.__dict__, "clock", SYSTEM_CLOCK)
    with pytest.raises(InputError, match=r"demo.yaml:\d+:16: markers.lsl: given true, but pylsl cannot") as told:
        parts.open_markers()
    assert "pip install 'modaltouch[lsl]'" in str(told.value)


@pytest.mark.parametrize(
    ("value", "said"), [(1234567.0, "1234567"), (12345.678, "12345.678"), (0.1, "0.1"), (50.0, "50")]
)
def test_a_marker_has_every_digit_of_a_typed_number(value: float, said: str) -> None:
    """Six significant digits would make 1.23457e+06 of seven."""
    sent: list[tuple[str, ...]] = []
    markers = object.__new__(Markers)  # without an outlet
    markers._send = lambda event, trial, instant, detail="": sent.append((event, detail))  # type: ignore[method-assign]
    instants = {"answer": {"earliest_s": 1.0, "latest_s": 1.0}}
    response = {"answer": "rated", "value": value}
    markers.follow({"event": "answered", "trial": {}, "instants": instants, "response": response})
    assert sent == [("answer", said)]
