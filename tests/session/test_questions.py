"""Numbers on a scale, further questions and the final form: recorded, interrupted, resumed, verified, tabulated."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from modaltouch.analysis import analyse
from modaltouch.planning import Observer, designs_for
from modaltouch.preflight import examine
from modaltouch.protocol import InputError
from modaltouch.protocol.questions import RESERVED_COLUMNS, ScaleSection
from modaltouch.record import Session, audit_session, read_session
from modaltouch.record.chain import GENESIS, encode_line
from modaltouch.session import begin, resume, simulate_session, wire_resume, wire_run
from modaltouch.session.console.status import Status, typed_keys
from modaltouch.window.interface import SessionStopped

SHIPPED = Path(__file__).parents[2] / "protocols"
KEYS = "  keys:\n    left: [left, num_4]\n    both: [up, down, num_8]\n    right: [right, num_6]\n"
SCALE = "  scale: {kind: vas, words: [nothing, extremely strong]}\n"
THEN = """\
  then:
    sure: {question: "How sure are you?", keys: {no: [left], yes: [right]}, time_out_s: 0.5}
    pleasant: {question: "How pleasant was it?", scale: {kind: likert, words: [not at all, very]}}
form:
  tired: {question: "How tired are you?", scale: {kind: likert, highest: 5}}
  dizzy: {question: "Do you feel dizzy?", keys: {no: [left], yes: [right]}}
"""
LABELS = ("\nanswers:\n", '\nanswers:\n  "no": "No"\n  "yes": "Yes"\n')
FEW = ("[[A, C], [B, D], [C, E]]", "[[A, C]]"), ("max_same_pair_running: 2", "max_same_pair_running: null")


@pytest.fixture(scope="module")
def protocol(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a protocol of four trials and one of practice, with two further questions and two at the end."""
    folder = tmp_path_factory.mktemp("asked") / "protocols"
    shutil.copytree(SHIPPED, folder)
    changes = {"texts/english.yaml": [LABELS], "demo.yaml": [(KEYS, SCALE + THEN), *FEW]}
    for name, edits in changes.items():
        text = (folder / name).read_text(encoding="utf-8")
        for old, new in edits:
            assert text.count(old) == 1
            text = text.replace(old, new)
        (folder / name).write_text(text, encoding="utf-8")
    return folder / "demo.yaml"


@pytest.fixture(scope="module")
def recorded(protocol: Path, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Return a session of it."""
    return simulate_session(protocol, "p01", tmp_path_factory.mktemp("results"))


def lines(session: Session, kind: str) -> list[dict[str, Any]]:
    """Return the events of a kind."""
    return [event for event in session.events if event["event"] == kind]


def table(session: Session, name: str) -> list[dict[str, str]]:
    """Return the rows of one of the session's two tables."""
    (file,) = session.path.parent.glob(f"*_task-{name}_beh.tsv")
    with file.open(encoding="utf-8") as text:
        return list(csv.DictReader(text, delimiter="\t"))


def test_all_answers_are_recorded_and_verified(recorded: Session) -> None:
    """The first answer is written before a further question is asked; tables have a column for each."""
    session = recorded
    assert session.complete and not audit_session(session).problems
    answered, trials = lines(session, "answered"), lines(session, "trial")
    assert all("further" not in event["response"] for event in answered)
    for event in trials:
        response, further = event["response"], event["response"]["further"]
        assert response["answer"] == "rated" and 0 <= response["value"] <= 100
        assert list(further) == ["sure", "pleasant"] and further["pleasant"]["value"] in range(1, 8)
        late = further["sure"]["reaction_time"] >= 0.5
        assert further["sure"]["answer"] in (("time_out",) if late else ("no", "yes"))
    strong = {80.0: set[float](), 200.0: set[float]()}
    for event in trials:
        strong[event["trial"]["condition"]["velocity_mm_s"]].add(event["response"]["further"]["pleasant"]["value"])
    assert max(strong[80.0]) < min(strong[200.0]), "what was felt is remembered when the beam is at rest"
    status = Status()
    for event in session.events:
        status.take(event)
    assert status.facts()["last"]["answer"] == f"rated {trials[-1]['response']['value']:g}"
    rows = table(session, "demo")
    assert [float(row["value"]) for row in rows] == [event["response"]["value"] for event in trials]
    assert [row["sure"] for row in rows] == [event["response"]["further"]["sure"]["answer"] for event in trials]
    assert {"sure_time", "pleasant", "pleasant_time"} <= set(rows[0]) and rows[0]["response"] == "rated"
    ((tired, dizzy),) = [tuple(row.values()) for row in table(session, "demoform")]
    assert float(tired) == session.form["tired"]["value"] and dizzy == session.form["dizzy"]["answer"]
    (side,) = session.path.parent.glob("*demoform_beh.json")
    described = json.loads(side.read_text(encoding="utf-8"))
    assert described["TaskName"] == "demo form" and described["TaskDescription"].startswith("Questions")
    assert set(described["dizzy"]["Levels"]) == {"no", "yes", "time_out"}
    (side,) = session.path.parent.glob("*demo_beh.json")
    told = json.loads(side.read_text(encoding="utf-8"))
    assert told["TaskDescription"] == session.start["design"]["title"] != ""
    assert told["Instructions"].endswith("You rest two fingers on it and tell us, each time, how strong it felt.")
    assert (session.start["question"], session.start["language"]) == ("How strong was the vibration?", "English")
    known = set(session.row(session.trials[0])) - {"sure", "sure_time", "pleasant", "pleasant_time"}
    assert known <= RESERVED_COLUMNS


def cut_short(protocol: Path, results: Path, name: str, number: int) -> None:
    """Run a session that is interrupted at a question, at its n-th occurrence."""
    setup = wire_run(examine(protocol).require(), "p01", answers="simulated", results=results)
    left = [number]

    def opened(tick: Any, log: Any) -> Any:
        window = setup.open_window(tick, log)
        ask = window.ask_further

        def stops(question: str, *how: Any) -> Any:
            left[0] -= question == name
            if left[0] == 0:
                raise SessionStopped("window closed")
            return ask(question, *how)

        window.ask_further = stops  # type: ignore[method-assign]
        return window

    with pytest.raises(SessionStopped):
        begin(replace(setup, open_window=opened))


def test_a_trial_interrupted_in_a_further_question_is_repeated(protocol: Path, tmp_path: Path) -> None:
    """Its answer stays in the log and is superseded: a trial needs all its answers."""
    cut_short(protocol, tmp_path / "results", "pleasant", 3)
    (log,) = (tmp_path / "results").rglob("session.jsonl")
    before = read_session(log)
    (unfinished,) = [event for event in before.trials if event["event"] == "answered"]
    assert not audit_session(before).problems and before.n_answered == 1
    session = resume(wire_resume(log))
    (again,) = [event for event in lines(session, "trial") if event["trial"] == unfinished["trial"]]
    assert again["presentation"] == 2 and list(again["response"]["further"]) == ["sure", "pleasant"]
    assert session.complete and len(session.trials) == 5
    assert not audit_session(session).problems


def test_the_form_is_in_the_report_in_json_and_in_a_table(recorded: Session, tmp_path: Path) -> None:
    """The number and the word of its only session."""
    done = analyse(recorded.path.parent, tmp_path / "report")
    tired, dizzy = done.as_dict()["form"]
    assert tired["median"] == recorded.form["tired"]["value"]
    assert dizzy["answers"] == {recorded.form["dizzy"]["answer"]: 1}
    assert '<th scope="row">dizzy</th>' in done.files["report.html"].read_text(encoding="utf-8")
    with done.files["form.csv"].open(encoding="utf-8", newline="") as lines:
        (row,) = csv.DictReader(lines)
    assert float(row["tired"]) == tired["median"] and row["dizzy"] in dizzy["answers"]


def test_an_interrupted_form_continues_with_its_next_question(protocol: Path, tmp_path: Path) -> None:
    """A session is complete only with its form; answered questions are not repeated."""
    cut_short(protocol, tmp_path / "results", "dizzy", 1)
    (log,) = (tmp_path / "results").rglob("session.jsonl")
    before = read_session(log)
    assert before.n_answered == 4 and list(before.form) == ["tired"]
    assert before.unfit == "incomplete: the form at the end is not filled in (continue with `modaltouch resume`)"
    assert table(before, "demoform")[0]["dizzy"] == "n/a"
    session = resume(wire_resume(log))
    assert session.complete and [event["name"] for event in lines(session, "form")] == ["tired", "dizzy"]
    assert session.form["tired"] == before.form["tired"] and not audit_session(session).problems


@pytest.mark.parametrize(
    ("kind", "change", "fault"),
    [
        ("trial", {"value": 100.5}, "was answered 'rated' 100.5; allowed: 0 to 100 by 1, time_out"),
        ("trial", {"further": {}}, "answers the further questions -, but sure, pleasant were asked"),
        ("form", {"name": "hungry"}, "the form has no question 'hungry'"),
        ("form", {"answer": "perhaps"}, "dizzy of the form: was answered 'perhaps'; allowed: no, yes, time_out"),
    ],
)
def test_impossible_answers_are_detected(
    recorded: Session, tmp_path: Path, kind: str, change: dict[str, Any], fault: str
) -> None:
    """With the line, although the checksums are right."""
    events, (check, text) = [dict(event) for event in recorded.events], (GENESIS, b"")
    last = next(event for event in reversed(events) if event["event"] == kind)
    last |= change if "name" in change else {"response": last["response"] | change}
    for event in events:
        line, check = encode_line({name: value for name, value in event.items() if name != "check"}, check)
        text += line
    log = tmp_path / "session.jsonl"
    log.write_bytes(text)
    assert any(fault in problem for problem in audit_session(read_session(log)).problems)


@pytest.mark.parametrize(
    ("section", "fault"),
    [
        ("", "answers.keys: given nothing; allowed: a mapping; add the missing key `keys`, or describe a `scale`"),
        (KEYS + SCALE, "answers.keys: given keys together with a scale; allowed: answers with keys, or a scale"),
        (
            "  scale: {kind: vas, step: 0.3}\n",
            "given 333.333 steps of 0.3 from 0 to 100; allowed: 1 to 1000 whole steps",
        ),
        ("  scale: {kind: likert, highest: 12}\n", "given 11 steps of 1 from 1 to 12; allowed: 1 to 10 whole steps"),
        ("  scale: {kind: vas, lowest: 5, highest: 5}\n", "given a scale from 5 to 5; allowed: lowest below highest"),
        ("  scale: {kind: likert, words: [a, b, c]}\n", "given 3 words for a likert scale; allowed: 2 or 7, or none"),
        ("  scale: {kind: number, step: 1}\n", "given a step or words for a typed number; allowed: neither"),
        ("  scale: {kind: vas, keys: {lower: [f12]}}\n", "given 'f12', which already switches the outputs off"),
        ("  emergency_keys: [up]\n  scale: {kind: vas}\n", "given 'up', which means higher on the scale answers.scale"),
        (
            KEYS + "  then: {sure: {question: Sure?}}\n",
            "then.sure: given neither keys nor a scale; allowed: one of them",
        ),
        (
            KEYS + "  then: {trial: {scale: {kind: vas}}}\n",
            "then.trial: given trial, which has another meaning in the table of answers",
        ),
        (
            KEYS + "  then: {level: {scale: {kind: vas}}}\n",
            "then.level: given level, which has another meaning in the table of answers",
        ),
        (
            KEYS + "  then: {stim_file: {scale: {kind: vas}}}\n",
            "then.stim_file: given stim_file, which has another meaning in the table of answers",
        ),
        (KEYS + "  then: {sure: {scale: {kind: vas}}}\n", "then.sure: given no text `further.sure` in english.yaml"),
        (
            KEYS + "  then: {confidence: {keys: {felt: [a]}}}\n",
            "confidence.keys: given 1 answer; allowed: 2 to 7 answers",
        ),
        (
            KEYS + "  then: {confidence: {keys: {felt: [a], certain: [a]}}}\n",
            "keys.certain[0]: given 'a', which already means felt; allowed: a key with no other meaning",
        ),
        (KEYS + "  question: magnitud\n", "or the words here; did you mean 'magnitude'? Else add it"),
        (
            SCALE + "adaptive: {start_mm_s: 100, trials: 9}\n",
            "given focus_named, but the answers do not name each finger",
        ),
    ],
)
def test_impossible_questions_are_refused(edit: Callable[..., Path], section: str, fault: str) -> None:
    """With position, given and allowed values, and the remedy."""
    with pytest.raises(InputError) as refused:
        examine(edit("demo.yaml", (KEYS, section))).require()
    assert any(fault in str(problem) for problem in refused.value.problems), refused.value


def test_the_console_accepts_the_keys_of_a_further_question() -> None:
    """Only while it is asked; for a scale, all keys except the console's own."""
    status = Status()
    status.take({"event": "question_next", "keys": {"no": ["left"], "yes": ["right"]}, "rates": False})
    assert (status.answer_by("right"), status.answer_by("1")) == ("yes", "no")
    keys = {name: list(keys) for name, keys in ScaleSection(kind="number").actions.items()}
    status.take({"event": "question_next", "keys": keys, "rates": True})
    assert [status.answer_by(key) for key in ("7", ".", "backspace", "enter")] == ["7", ".", "back", None]
    assert "confirm" not in typed_keys(keys, None)
    status.take({"event": "form"})
    assert status.answer_by("7") is None


def test_the_console_accepts_a_further_question_again_after_a_pause() -> None:
    """The window asks it again; during the pause the console does not answer."""
    status = Status()
    status.take({"event": "question_next", "keys": {"no": ["left"], "yes": ["right"]}, "rates": False})
    status.take({"event": "pause", "by": "experimenter"})
    assert status.answer_by("right") is None
    status.take({"event": "continued"})
    assert status.answer_by("right") == "yes"
    status.take({"event": "form"})
    for event in ("pause", "continued"):
        status.take({"event": event})
    assert status.answer_by("right") is None, "answered before that pause"


def test_power_refuses_a_scale() -> None:
    """It simulates the comparison of two fingers."""
    with pytest.raises(
        InputError,
        match="answers.scale: given a scale, .* analyse those, as `modaltouch prereg` does",
    ):
        designs_for(examine("magnitude").require(), Observer.read("paper"))


@pytest.mark.parametrize(("bounds", "numbers"), [
    ({"lowest": -5, "highest": 5}, [-4.9, -2.5, 4.9]),
    ({"lowest": 0, "highest": 100}, [1, 25, 99]),
    ({}, [0.101, 3.33, 990]),
])  # fmt: skip
def test_a_simulated_number_reaches_every_part_of_its_scale(bounds, numbers) -> None:
    """1, 25 and 99 % of the way from lowest to highest; without bounds s / (1 - s) times a modulus of 10."""
    scale = ScaleSection.model_validate({"kind": "number", **bounds})
    assert [scale.at(share) for share in (0.01, 0.25, 0.99)] == pytest.approx(numbers)
    assert all(scale.takes(scale.at(share)) for share in (1e-9, 1 - 1e-9))
