"""Questions about the participant: asked once, before the first session, and nothing that identifies a person."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from outside import call

from modaltouch.analysis import analyse
from modaltouch.analysis.provenance import describe_record, take_facts
from modaltouch.cli import run
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol import InputError
from modaltouch.protocol.people import PersonField
from modaltouch.record import RecordError, RecordInputError, SessionFolder, audit_session, read_session, survey
from modaltouch.session import Setup, begin, resume, simulate_session, wire_resume, wire_run

SECTION = """
people:
  age: {kind: number, question: "How old are you?", unit: year, lowest: 18, highest: 99}
  sex: {kind: choice, question: "What is your sex?", choices: [female, male, other]}
  remark: {kind: text, question: "Anything to note about your fingers?", required: false}
  consent: {kind: consent, question: "Do you agree that your answers are recorded?"}
"""
ANSWERS: dict[str, Any] = {"age": 24, "sex": "female", "remark": None, "consent": "yes"}
END = "right: [right, num_6]\n"


@pytest.fixture
def protocol(edit: Callable[..., Path]) -> Path:
    """Return a protocol with four questions."""
    return edit("demo.yaml", (END, END + SECTION))


@pytest.fixture
def asking(protocol: Path) -> Preflight:
    """Return the same, checked."""
    return examine(protocol).require()


def person(setup: Setup) -> Setup:
    """Return a setup as for a person at the window, although the answers are simulated."""
    import dataclasses

    facts = {name: value for name, value in setup.facts.items() if name != "people"}
    return dataclasses.replace(setup, facts=facts)


def faults(edit: Callable[..., Path], line: str) -> str:
    """Return the faults of a protocol with one question."""
    with pytest.raises(InputError) as refused:
        examine(edit("demo.yaml", (END, f"{END}people:\n  {line}\n"))).require()
    return str(refused.value)


@pytest.mark.parametrize(
    "name", ["name", "last_name", "birthday", "date_of_birth", "email", "e-mail", "Phone", "home_address", "initials"]
)
def test_identifying_questions_are_refused(edit: Callable[..., Path], name: str) -> None:
    """At their key, with the reason."""
    said = faults(edit, f"{name}: {{kind: text, question: Who are you?}}")
    assert f"people.{name}: given {name}, which identifies a person" in said
    assert "demo.yaml:43:3" in said


def test_identifying_questions_need_an_explicit_key(edit: Callable[..., Path]) -> None:
    """With `identifies: true` they are accepted."""
    line = "people:\n  initials: {kind: text, question: Initials?, identifies: true}\n"
    assert examine(edit("demo.yaml", (END, END + line))).problems == ()


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("sex: {kind: choice, question: Sex?, choices: [x]}", "given 1 choice for a choice"),
        ("sex: {kind: choice, question: Sex?, choices: [x, x, y]}", "given 3 choices for a choice"),
        ("age: {kind: number, question: Age?, choices: [1, 2]}", "people.age.choices"),
        ("age: {kind: number, question: Age?, lowest: 30, highest: 20}", "given bounds for a number, 30 to 20"),
        ("note: {kind: text, question: Note?, lowest: 30}", "given bounds for a text, 30 to any"),
        ("participant_id: {kind: text, question: Code?}", "given participant_id, to which BIDS gives another meaning"),
        ("HED: {kind: text, question: Tags?}", "given HED, to which BIDS gives another meaning"),
    ],
)
def test_invalid_questions_are_refused(edit: Callable[..., Path], line: str, said: str) -> None:
    """Choices and bounds belong to their kinds; the first column of participants.tsv is reserved."""
    assert said in faults(edit, line)


@pytest.mark.parametrize(
    ("field", "words", "answer"),
    [
        ({"kind": "number", "lowest": 18.0}, "24", 24),
        ({"kind": "number"}, " 1,75 ", 1.75),
        ({"kind": "choice", "choices": ("female", "Male")}, "male", "Male"),
        ({"kind": "consent"}, "YES", "yes"),
        ({"kind": "text"}, " a  b ", "a b"),
        ({"kind": "text", "required": False}, "", None),
    ],
)
def test_words_are_read_as_answers(field: dict[str, Any], words: str, answer: object) -> None:
    """Case, spaces and a decimal comma do not matter."""
    assert PersonField(question="?", **field).read(words) == answer


@pytest.mark.parametrize(
    ("field", "words", "allowed"),
    [
        ({"kind": "number", "lowest": 18.0, "highest": 99.0}, "17", "a number of at least 18, at most 99"),
        ({"kind": "number"}, "nan", "a number"),
        ({"kind": "number"}, "0x20", "a number"),
        ({"kind": "choice", "choices": ("a", "b")}, "c", "a, b"),
        ({"kind": "consent"}, "", "yes, no"),
        ({"kind": "text"}, "  ", "text"),
    ],
)
def test_invalid_answers_are_refused(field: dict[str, Any], words: str, allowed: str) -> None:
    """With the allowed answers."""
    with pytest.raises(ValueError, match=f"; allowed: {allowed}$"):
        PersonField(question="?", **field).read(words)


def test_consent_comes_first_and_invalid_answers_are_asked_again(
    asking: Preflight, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without consent nothing else is asked."""
    typed = iter(["maybe", "yes", "12", "24", "Female", ""])
    monkeypatch.setattr(run, "_prompt", lambda words, **how: next(typed))
    assert run.ask_people(asking.experiment.protocol.people, True) == ANSWERS
    assert next(typed, "all asked") == "all asked"
    typed = iter(["no"])
    assert run.ask_people(asking.experiment.protocol.people, True) == {"consent": "no"}


def test_a_file_of_answers_is_read_with_positions_of_faults(asking: Preflight, tmp_path: Path) -> None:
    """For a lab without a terminal."""
    file = tmp_path / "answers.yaml"
    file.write_text("age: 24\nsex: female\nconsent: yes\n")
    assert asking.experiment.protocol.read_people(file) == ANSWERS
    file.write_text("age: 12\nheight: 180\n")
    with pytest.raises(InputError) as refused:
        asking.experiment.protocol.read_people(file)
    said = str(refused.value).replace(str(file), "file")
    assert "file:1:6: age: given 12; allowed: a number of at least 18, at most 99" in said
    assert "file:2:1: height: given 'height', which is not a key here; allowed: age, sex, remark, consent" in said
    assert "file:1:1: consent: given nothing; allowed: yes, no" in said


def test_nobody_is_asked_twice(asking: Preflight, tmp_path: Path) -> None:
    """Only before the first session; the answers are in the record and, with descriptions, in participants.tsv."""
    setup = person(wire_run(asking, "p01", answers="simulated", results=tmp_path))
    with pytest.raises(RecordInputError, match="has not been asked yet: age, sex, remark, consent"):
        begin(setup)
    assert not list(tmp_path.rglob("*.jsonl"))
    session = begin(setup.with_people(ANSWERS))
    assert session.start["people"] == ANSWERS
    assert audit_session(session).problems == ()
    dataset = session.path.parents[3]
    rows = [line.split("\t") for line in (dataset / "participants.tsv").read_text().splitlines()]
    assert rows == [["participant_id", *ANSWERS], ["sub-p01", "24", "female", "n/a", "yes"]]
    side = json.loads((dataset / "participants.json").read_text())
    assert list(side) == list(ANSWERS)
    assert side["age"] == {"Description": "How old are you?", "Units": "year"}
    assert side["sex"]["Levels"] == {"female": "female", "male": "male", "other": "other"}
    second = person(wire_run(asking, "p01", session=2, answers="simulated", results=tmp_path))
    assert second.to_ask == {}
    assert "people" not in begin(second).start


def test_edits_of_the_list_are_kept(asking: Preflight, tmp_path: Path) -> None:
    """A corrected age, a description, and a column in addition to those of the protocol."""
    place = SessionFolder(tmp_path, "simulated", "demo", "p02")
    place.folder.mkdir(parents=True)
    list_file, side = place.dataset / "participants.tsv", place.dataset / "participants.json"
    list_file.write_text("participant_id\tgroup\tage\nsub-p02\ttrained\t31\n")
    side.write_text('{"age": {"Description": "Age at the visit"}}')
    start = {"people": ANSWERS, "design": asking.experiment.protocol.model_dump(mode="json")}
    place.list_participants(start)
    header, row = (line.split("\t") for line in list_file.read_text().splitlines())
    values = dict(zip(header, row, strict=True))
    assert values == {
        "participant_id": "sub-p02",
        "group": "trained",
        "age": "31",
        "sex": "female",
        "remark": "n/a",
        "consent": "yes",
    }
    assert json.loads(side.read_text())["age"] == {"Description": "Age at the visit"}


@pytest.mark.parametrize("text", ["{", "[]"])
def test_a_faulty_side_file_is_reported_by_its_name(asking: Preflight, tmp_path: Path, text: str) -> None:
    """The list of participants beside it is valid."""
    place = SessionFolder(tmp_path, "simulated", "demo", "p02")
    place.folder.mkdir(parents=True)
    (place.dataset / "participants.json").write_text(text)
    start = {"people": ANSWERS, "design": asking.experiment.protocol.model_dump(mode="json")}
    with pytest.raises(RecordError, match=r"participants.json: cannot be read .*repair it or move it away"):
        place.list_participants(start)


def test_without_consent_nothing_is_stored(protocol: Path, tmp_path: Path) -> None:
    """Neither the session nor the answers given before."""
    file, results = tmp_path / "answers.yaml", tmp_path / "results"
    file.write_text("age: 24\nsex: female\nconsent: no\n")
    line = f"run {protocol} -p p01 --rig simulated --yes --results {results}"
    done = call(f"{line} --people {file}")
    assert done.status == 2
    assert "no consent was given: the session does not begin, and nothing is recorded" in done.stderr
    done = call(line)
    assert done.status == 2
    assert "give a YAML file with --people" in done.stderr
    assert not results.exists()


def test_simulated_participants_give_allowed_answers(asking: Preflight, tmp_path: Path, undrawn: None) -> None:
    """The report has n, mean and range of the ages, and the number of each sex, as section V of the paper."""
    sessions = [simulate_session(asking, f"p0{number}", tmp_path) for number in (1, 2, 3)]
    ages = [session.start["people"]["age"] for session in sessions]
    assert all(18 <= age <= 99 for age in ages)
    assert len(set(ages)) > 1
    record = describe_record([take_facts(session) for session in sessions])
    assert record is not None
    told = f"age [year]: mean {sum(ages) / 3:.1f}, range {min(ages)} to {max(ages)} (n = 3)"
    assert record["people"][0] == told
    assert record["people"][1].startswith("sex: ")
    assert len(record["people"]) == 2  # neither free words nor consents
    files = analyse(tmp_path, tmp_path / "out").files
    assert told in files["report.html"].read_text(encoding="utf-8")
    rows = (tmp_path / "simulated" / "demo" / "participants.tsv").read_text().splitlines()
    assert [row.split("\t")[1] for row in rows[1:]] == [str(age) for age in ages]


def test_answers_are_kept_with_the_session(asking: Preflight, tmp_path: Path) -> None:
    """Resumed, restarted, or recovered from a damaged record, without asking again."""
    whole = simulate_session(asking, "p01", tmp_path)
    lines = whole.path.read_bytes().splitlines(keepends=True)
    whole.path.write_bytes(b"".join(lines[:20]))
    for view in whole.path.parent.glob("*_beh.*"):
        view.unlink()
    anew = wire_resume(whole.path, restart=True)
    assert anew.facts["people"] == whole.start["people"]
    done = resume(wire_resume(whole.path))
    assert done.complete
    assert all("people" not in event for event in done.events[1:])
    again = read_session(survey(done.path).write(tmp_path / "recovered"))
    assert again.start["people"] == whole.start["people"]
    row = (again.path.parents[3] / "participants.tsv").read_text().splitlines()[1].split("\t")
    assert row[1] == str(whole.start["people"]["age"])


def test_a_protocol_without_the_section_asks_nothing(tmp_path: Path) -> None:
    """No columns, no side file, no key in the record."""
    session = simulate_session("demo", "p01", tmp_path)
    assert "people" not in session.start
    assert "people" not in session.start["design"]
    assert (session.path.parents[3] / "participants.tsv").read_text() == "participant_id\nsub-p01\n"
    assert not (session.path.parents[3] / "participants.json").exists()
