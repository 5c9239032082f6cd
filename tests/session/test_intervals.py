"""Trials of several intervals: presented, recorded, resumed, verified and tabulated."""

from __future__ import annotations

import copy
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from modaltouch.preflight import examine
from modaltouch.protocol import Trial
from modaltouch.record import Session, audit_session, read_session
from modaltouch.rig import Generator, RigError, Simulator
from modaltouch.session import simulate_session
from modaltouch.session.console.status import Status
from modaltouch.session.markers import Markers
from modaltouch.session.resumption import resume, wire_resume
from modaltouch.session.setup import begin
from modaltouch.session.wiring import wire_run

SHIPPED = Path(__file__).parents[2] / "protocols"
SHORT = (("repetitions: 8", "repetitions: 1"), ("practice_trials: 4", "practice_trials: 1"))


def write(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write a short version of the shipped comparison with other changes."""
    text = (SHIPPED / "comparison_2ifc.yaml").read_text(encoding="utf-8")
    for old, new in (*SHORT, *changes):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    for name in ("apparatus", "texts"):
        text = text.replace(f"{name}: {name}/", f"{name}: {SHIPPED / name}/")
    file = folder / "comparison_2ifc.yaml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A short session of the shipped comparison."""
    folder = tmp_path_factory.mktemp("comparison")
    return simulate_session(write(folder), "p01", folder)


def of(session: Session, *kinds: str) -> list[dict[str, Any]]:
    """Return the lines of some kinds."""
    return [event for event in session.events if event["event"] in kinds]


def test_each_interval_is_fired_confirmed_and_recorded(recorded: Session) -> None:
    """Levels in the order of the trial, five whole bursts each, amplitudes in proportion to the level."""
    assert recorded.complete
    for event in of(recorded, "trial"):
        trial, levels = Trial.from_dict(event["trial"]), [100.0, 100.0]
        levels[trial.interval - 1] = trial.condition.velocity_mm_s
        told = event["intervals"]
        assert [each["planned"]["velocity_mm_s"] for each in told] == levels
        assert [each["bursts"]["whole"] for each in told] == [5, 5]
        assert all(each["confirmed"]["confirmed"] for each in told)
        one, other = (each["commanded"]["amplitude_Vpp"][0] for each in told)
        assert one / other == pytest.approx(levels[0] / levels[1], rel=2e-3)
        # The line itself is about the comparison, so that tables of other designs read it as their own.
        assert event["bursts"] == told[trial.interval - 1]["bursts"]
        assert event["commanded"] == told[trial.interval - 1]["commanded"]
    assert [event["interval"] for event in of(recorded, "fired")] == [1, 2] * 7


def test_the_gap_passes_with_the_outputs_off(recorded: Session) -> None:
    """At least 0.5 s, and less than a second more, from the end of the fifth burst to the next first burst."""
    for event in of(recorded, "trial"):
        first, second = (each["confirmed"]["onset"] for each in event["intervals"])
        assert 0.499 <= second - (first + 4 / 7 + 0.05) < 1.5
        assert event["response"]["onset"] == "question"
    sent = [each["sent"] for line in of(recorded, "rig") for each in line["exchanges"] if "sent" in each]
    switched = ["ON" if ":OUTP1 ON" in each else "OFF" for each in sent if ":OUTP1 O" in each]
    assert [state for state, _ in groupby(switched)] == [*["OFF", "ON"] * 14, "OFF"]


def test_intervals_are_verified_and_tabulated(recorded: Session) -> None:
    """Order, levels, amplitudes, bursts and instants of all intervals are recomputed."""
    assert audit_session(recorded).problems == ()
    rows = [row for row in recorded.table() if not row["practice"]]
    assert sorted(row["velocity_mm_s"] for row in rows) == [70, 80, 90, 110, 125, 140]
    assert sorted(row["interval"] for row in rows) == [1, 1, 1, 2, 2, 2]
    for row in rows:
        assert row["standard_mm_s"] == 100
        stronger = row["interval"] if row["velocity_mm_s"] > 100 else 3 - row["interval"]
        assert row["correct"] is (row["response"] == ("first", "second")[stronger - 1])
    (table,) = recorded.path.parent.glob("*_beh.tsv")
    assert {"interval", "standard_mm_s", "correct"} <= set(table.read_text().splitlines()[0].split("\t"))


def test_an_interval_changed_after_the_answer_is_detected(recorded: Session) -> None:
    """The line of the finished trial must repeat the earlier intervals of the answer's line."""
    events = copy.deepcopy(recorded.events)
    place, trial = next((n, each) for n, each in enumerate(events, start=1) if each["event"] == "trial")
    assert trial["intervals"][0]["bursts"]["whole"] > 0
    trial["intervals"][0]["bursts"]["uncertainty_s"] += 1e-4
    problems = audit_session(replace(recorded, events=events)).problems
    assert any(f":{place}: " in each and "where it was answered, in interval" in each for each in problems), problems


@pytest.mark.parametrize("interval", [1, 2])
def test_a_session_killed_in_an_interval_repeats_that_trial(recorded: Session, tmp_path: Path, interval: int) -> None:
    """With all its intervals in the same order."""
    results = recorded.path.parents[5]
    shutil.copytree(results / "simulated", tmp_path / "simulated")
    log = tmp_path / recorded.path.relative_to(results)
    cut = next(e["n"] for e in of(recorded, "fired") if e["trial"]["index"] == 3 and e["interval"] == interval)
    log.write_bytes(b"".join(log.read_bytes().splitlines(keepends=True)[:cut]))
    for view in log.parent.glob("*_beh.*"):
        view.unlink()
    session = resume(wire_resume(log))
    assert session.complete and audit_session(session).problems == ()
    (gone,) = of(session, "trial_cut")
    assert gone["trial"]["index"] == 3
    assert [e["trial"] for e in of(session, "trial")] == [e["trial"] for e in of(recorded, "trial")]
    assert [e["response"]["answer"] for e in of(session, "trial")] == [
        e["response"]["answer"] for e in of(recorded, "trial")
    ]


def test_an_unconfirmed_interval_causes_the_trial_to_be_repeated(tmp_path: Path) -> None:
    """A knob is turned in the first interval of the second trial; both intervals are repeated."""
    preflight = examine(write(tmp_path)).require()
    turned: list[int] = []
    setup = wire_run(preflight, "p01", answers="simulated", results=tmp_path)
    with Simulator(preflight.experiment.apparatus, clock=setup.clock) as simulator:

        def window(tick: Callable[[], Any], log: Callable[..., None]) -> Any:
            opened = setup.open_window(tick, log)
            feel = opened.feel

            def turn(trial: Trial, *rest: Any) -> None:
                if trial.index == 2 and not trial.practice and not turned:
                    turned.append(1)
                    simulator.front_panel("SOUR1:VOLT 1.0VPP")
                feel(trial, *rest)

            opened.feel = turn  # type: ignore[method-assign]
            return opened

        def rig(log: Callable[..., None]) -> Any:
            return Generator(apparatus=preflight.experiment.apparatus, log=log, **simulator.driver_options)

        begin(replace(setup, open_rig=rig, open_window=window))
    session = read_session(setup.place.log)
    assert session.complete and audit_session(session).problems == ()
    (cut,) = of(session, "trial_cut")
    assert cut["interval"] == 1 and "SOUR1:VOLT" in cut["reason"]
    (answered,) = [e for e in of(session, "trial") if e["trial"]["index"] == 2 and not e["trial"]["practice"]]
    assert answered["presentation"] == 2


def test_the_session_ends_if_the_outputs_cannot_be_switched_off(tmp_path: Path) -> None:
    """Without waiting for the gap, since the beam may still move."""
    file = write(tmp_path, ("gap_s: 0.5", "gap_s: 30.0"))
    setup, failed = wire_run(examine(file).require(), "p01", answers="simulated", results=tmp_path), list[float]()

    @contextmanager
    def rig(log: Callable[..., None]) -> Iterator[Any]:
        with setup.open_rig(log) as opened:
            stop = opened.stop

            def fail(**how: bool) -> None:
                if opened.firing is not None and not failed:
                    failed.append(setup.clock.now())
                    raise RigError("the outputs cannot be switched off")
                stop(**how)

            opened.stop = fail  # type: ignore[method-assign]
            yield opened

    with pytest.raises(RigError, match="cannot be switched off"):
        begin(replace(setup, open_rig=rig))
    (cut,) = of(read_session(setup.place.log), "trial_cut")
    assert cut["interval"] == 1
    assert cut["clock"] - failed[0] < 5


def test_silence_is_an_interval_without_bursts(tmp_path: Path) -> None:
    """Detection: the interval with the vibration is right, and at these levels the observer names it."""
    levels = ("peak_velocities_mm_s: [70, 80, 90, 110, 125, 140]", "peak_velocities_mm_s: [90, 150]")
    silent = ("standard: {velocity_mm_s: 100}", "standard: {velocity_mm_s: 0}")
    file = write(tmp_path, levels, silent, ("asked: stronger", "asked: comparison"))
    session = simulate_session(file, "p01", tmp_path)
    assert audit_session(session).problems == ()
    assert session.start["observer"]["name"] == "fingertip"
    for event in of(session, "trial"):
        asked = [each["bursts"]["asked"] for each in event["intervals"]]
        assert asked == ([5, 0] if event["trial"]["interval"] == 1 else [0, 5])
    assert [row["correct"] for row in session.table()] == [True] * 3


def test_the_odd_one_of_three_intervals_is_recognised(tmp_path: Path) -> None:
    """A blunt field among sharp ones, at one level."""
    stimuli = "stimuli:\n  sharp: {}\n  blunt: {field: {shape: raised_cosine, base_mm: 110}}\n\nconditions:"
    file = write(
        tmp_path,
        ("\nconditions:", f"\n{stimuli}"),
        ("peak_velocities_mm_s: [70, 80, 90, 110, 125, 140]", "peak_velocities_mm_s: [100]"),
        ("\n  number: 2\n", "\n  number: 3\n"),
        ("standard: {velocity_mm_s: 100}", "standard: {stimulus: sharp}"),
        ("asked: stronger", "asked: comparison"),
        ("keys: {first: [left, num_1], second: [right, num_2]}", "keys: {first: ['1'], second: ['2'], third: ['3']}"),
        ("intervals: {first: 1, second: 2}", "intervals: {first: 1, second: 2, third: 3}"),
    )
    session = simulate_session(file, "p01", tmp_path)
    assert audit_session(session).problems == ()
    for row in session.table():
        assert row["correct"] is (None if row["stimulus"] == "sharp" else True)
        assert row["standard_mm_s"] == 100


def markers_of(sent: list[tuple[str, float]]) -> Markers:
    """Return markers that go into a list, with a clock of LSL 1000 s ahead."""
    markers = Markers.__new__(Markers)
    vars(markers).update(_offset=1000.0, _outlet=Mock(push_sample=lambda words, at: sent.append((words[0], at))))
    return markers


def test_the_marker_of_the_question_is_that_of_its_trial(recorded: Session) -> None:
    """With the level of the comparison, also where the standard was presented last."""
    sent = list[tuple[str, float]]()
    markers = markers_of(sent)
    for event in of(recorded, "fired", "answered"):
        if event["event"] == "answered":
            markers.send_question(event["clock"])
        markers.follow(event)
    spans = (event["instants"]["answer"] for event in of(recorded, "answered"))
    instants = ((span["earliest_s"] + span["latest_s"]) / 2 for span in spans)
    for trial in zip(*[iter(sent)] * 4, strict=True):
        words = [marker.split("/") for marker, _ in trial]
        assert [each[0] for each in words] == ["stimulus", "stimulus", "question", "answer"]
        about = words[2][1:]
        assert trial[3][1] - 1000.0 == pytest.approx(next(instants), abs=1e-6)
        assert [words[0][1:], words[1][1:]] == [[*about, "interval_1"], [*about, "interval_2"]]
        assert words[3][1:-1] == about
    assert len(sent) == 4 * 7


def test_markers_of_a_further_question_count_from_the_last_interval(recorded: Session) -> None:
    """Wherever the comparison stands, the marker is at the instant at which the question was shown."""
    sent = list[tuple[str, float]]()
    markers = markers_of(sent)
    for event in of(recorded, "trial"):
        further = {"answer": "rated", "value": 3.0, "reaction_time": 1.0, "question_after": 2.0}
        markers.follow({**event, "response": {**event["response"], "further": {"sure": further}}})
        shown = event["intervals"][-1]["confirmed"]["onset"] + 2.0
        assert [words.partition("/")[0] for words, _ in sent] == ["question", "answer"]
        assert [words.rpartition("/sure")[2] for words, _ in sent] == ["", "/3"]
        assert [at - 1000.0 for _, at in sent] == pytest.approx([shown, shown + 1.0], abs=1e-6)
        sent.clear()
    assert {event["trial"]["interval"] for event in of(recorded, "trial")} == {1, 2}


def test_the_console_tells_which_interval_plays(recorded: Session) -> None:
    """From the events of a session whose trials are announced."""
    status, plays = Status(), list[int]()
    status.take({"event": "trial_next", "trial": {"way": "free_hand"}})
    for event in recorded.events:
        status.take(event)
        if event["event"] == "fired":
            plays.append(status.facts()["trial"]["plays"])
    assert plays == [1, 2] * 7


@pytest.mark.parametrize("rule", ["correct", "second"])
def test_a_run_follows_right_answers_or_a_given_answer(tmp_path: Path, rule: str) -> None:
    """Verification recomputes every level; a success never raises it, a failure never lowers it."""
    places = "[1, 2]" if rule == "correct" else "[2]"
    run = f"adaptive: {{method: staircase, trials: 8, start_mm_s: 130, success: {rule}, guess_rate: 0.5, "
    file = write(
        tmp_path,
        ("peak_velocities_mm_s: [70, 80, 90, 110, 125, 140]", "peak_velocities_mm_s: [100, 150]"),
        ("schedule:\n  repetitions: 1", run + "staircase: {down_after: 2, steps_dB: [1]}}\n\nschedule:"),
        ("asked: stronger", f"comparison_in: {places}\n  asked: comparison"),
    )
    session = simulate_session(file, "p01", tmp_path)
    verdict = audit_session(session)
    assert verdict.problems == ()
    assert "levels follow from the answers before them" in verdict.lines
    rows = [row for row in session.table() if not row["practice"]]
    succeeded = [row["correct"] is True if rule == "correct" else row["response"] == rule for row in rows]
    for before, after, success in zip(rows, rows[1:], succeeded, strict=False):
        change = after["velocity_mm_s"] - before["velocity_mm_s"]
        assert change <= 0 if success else change >= 0
