"""One and three fingers: presented, answered, recorded, resumed, verified, analysed and reported."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from modaltouch.analysis import TableFormat, analyse, read_responses
from modaltouch.analysis.columns import label_zones
from modaltouch.planning import Observer, designs_for
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol import InputError
from modaltouch.record import Session, audit_session
from modaltouch.session import resume, simulate_session, wire_resume

ROOT = Path(__file__).resolve().parents[2]
KEYS = "    left: [left, num_4]\n    both: [up, down, num_8]\n    right: [right, num_6]\n"
DESIGNS = {
    "one": (
        "finger_conditions: [tip]\n  fingers: {tip: [right little]}",
        "zones: [[A], [C]]",
        "    felt: [y]\n    none: [n]\n",
    ),
    "three": (
        "finger_conditions: [spread]\n  fingers: {spread: [left index, right index, right ring]}",
        "placements: [mirrored]\n  zones: [[A, C, E], [B, C, D]]",
        "    index: [left]\n    middle: [up]\n    ring: [right]\n    none: [n]\n"
        "  fingers: {index: [left], middle: [between], ring: [right]}\n  ways: {spread: lifting}\n",
    ),
}


def protocol_with(folder: Path, name: str, *changes: tuple[str, str]) -> Path:
    """Return the demonstration with one or three fingers, a catch trial, and two presentations per condition."""
    fingers, zones, keys = DESIGNS[name]
    text = (ROOT / "protocols" / "demo.yaml").read_text(encoding="utf-8")
    shared = (
        ("protocol: demo", f"protocol: {name}"),
        ("finger_conditions: [one_hand, two_hands]", fingers),
        ("zone_pairs: [[A, C], [B, D], [C, E]]", zones),
        (KEYS, keys),
        ("repetitions: 1", "repetitions: 2\n  catch_trials: 1"),
        ("apparatus: apparatus", f"apparatus: {ROOT}/protocols/apparatus"),
        ("texts: texts/english.yaml", "texts: texts.yaml"),
    )
    for old, new in (*shared, *changes):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    texts = YAML(typ="safe").load(ROOT / "protocols" / "texts" / "english.yaml")
    labels = {name: f"{name} label" for name in ("felt", "index", "middle", "ring")}
    YAML().dump(texts | {"answers": {**texts.get("answers", {}), **labels}}, folder / "texts.yaml")
    (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return folder / f"{name}.yaml"


@pytest.fixture(scope="module", params=list(DESIGNS))
def answered(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Preflight, Session]:
    """A simulated session of each design."""
    folder = tmp_path_factory.mktemp(request.param)
    preflight = examine(protocol_with(folder, request.param)).require()
    return preflight, simulate_session(preflight, "p01", folder / "results")


def test_the_record_has_the_speeds_under_each_finger(answered: tuple[Preflight, Session]) -> None:
    """`verify` recomputes order, amplitudes and speeds; the BIDS view has a column per finger."""
    preflight, session = answered
    assert session.complete
    assert audit_session(session).problems == ()
    (table,) = session.path.parent.glob("*_beh.tsv")
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines(), delimiter="\t"))
    described = json.loads(table.with_suffix(".json").read_text(encoding="utf-8"))
    assert set(rows[0]) <= set(described)
    # BIDS: where a column has levels, its values are among them.
    levels = {name: {*column["Levels"], "n/a"} for name, column in described.items() if "Levels" in column}
    assert [(name, row[name]) for row in rows for name in levels if row[name] not in levels[name]] == []
    assert sum(row["catch"] == "1" for row in rows) == 1
    (driven,) = (row for row in rows if row["trial"] == "1" and row["practice"] == "0")
    peaks = preflight.zone_peaks("", float(driven["velocity_mm_s"]))
    sides = ["left", "between", "right"] if preflight.experiment.protocol.protocol == "three" else ["left"]
    for side in sides:
        assert float(driven[f"speed_{side}_mm_s"]) == pytest.approx(1e3 * peaks[driven[f"zone_{side}"]], abs=2e-3)
    if sides == ["left"]:
        assert (driven["zone_right"], driven["finger_right"], driven["speed_right_mm_s"]) == ("n/a",) * 3
        assert "zone_between" not in driven
    else:
        # The beam is turned: its last zone lies on the left.
        assert driven["zone_left"] > driven["zone_between"] > driven["zone_right"]
    fingers = {"one": ["right little"], "three": ["left index", "right index", "right ring"]}
    assert [driven[f"finger_{side}"] for side in sides] == fingers[preflight.experiment.protocol.protocol]


def test_an_interrupted_session_continues_unchanged(answered: tuple[Preflight, Session], tmp_path: Path) -> None:
    """The log ends within a line, as after a kill."""
    _, whole = answered
    log = tmp_path / whole.path.parent.relative_to(whole.path.parents[5]) / whole.path.name
    log.parent.mkdir(parents=True)
    lines = whole.path.read_bytes().splitlines(keepends=True)
    log.write_bytes(b"".join(lines[: len(lines) // 2]) + b'{"n":')
    done = resume(wire_resume(log))
    assert done.complete
    assert audit_session(Session.find(done.path)).problems == ()
    names = ("trial", "zone_left", "zone_between", "zone_right", "response")
    assert [[row[name] for name in names] for row in done.table()] == [
        [row[name] for name in names] for row in whole.table()
    ]


def test_answers_are_counted_under_their_zones(answered: tuple[Preflight, Session], tmp_path: Path) -> None:
    """Alike from the records and from a table; a turned beam is counted with A first."""
    _, session = answered
    labels = {"one": ["A", "C"], "three": ["A-C-E", "B-C-D"]}[session.protocol]
    responses = read_responses(session.path)
    recorded = responses.count()
    assert [pair.label for pair in recorded.pairs] == labels
    assert recorded.counts.sum() == 8
    responses.frame.drop(columns="placement").to_csv(tmp_path / "answers.csv", index=False)
    again = read_responses(tmp_path / "answers.csv", table_format=TableFormat(recorded.answers)).count("C")
    assert [pair.label for pair in again.pairs] == labels
    assert (again.counts == recorded.counts).all()


def test_the_report_shows_three_zones_with_their_speeds(tmp_path: Path) -> None:
    """From left to right, as in the BIDS view."""
    session = simulate_session(protocol_with(tmp_path, "three"), "p01", tmp_path / "results")
    analyse(session.path, tmp_path / "out")
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "A, C and E" in report
    row = next(row for row in session.table() if row["zone_left"] == "E" and row["velocity_mm_s"] == 80)
    speeds = [f"{row[f'speed_{side}_mm_s']:.0f}" for side in ("right", "between", "left")]
    assert " | ".join(speeds) in report


def test_listed_cells_may_mix_one_two_and_three_fingers(tmp_path: Path) -> None:
    """Each finger condition has cells with as many zones; each crossed part is analysed separately."""
    cells = (
        "cells:\n    - {pair: [C], peak_velocities_mm_s: [80], finger_conditions: [tip]}\n"
        "    - {pair: [A, C], peak_velocities_mm_s: [80], finger_conditions: [one_hand]}\n"
        "    - {pair: [B, C, D], peak_velocities_mm_s: [80], finger_conditions: [three]}\n"
    )
    fingers = "[tip, one_hand, three]\n  fingers: {tip: [right index], three: [right index, right middle, right ring]}"
    changes = (
        ("[tip]\n  fingers: {tip: [right little]}", fingers),
        ("zones: [[A], [C]]", cells),
        ("  peak_velocities_mm_s: [80, 200]\n", ""),
        ("  max_same_pair_running: 2\n", ""),
    )
    session = simulate_session(protocol_with(tmp_path, "one", *changes), "p01", tmp_path / "results")
    assert audit_session(session).problems == ()
    frame = read_responses(session.path).frame
    assert set(label_zones(frame)) == {"C", "A-C", "B-C-D"}
    (tmp_path / "one.yaml").write_text(
        (tmp_path / "one.yaml").read_text(encoding="utf-8").replace("pair: [C]", "pair: [C, D]"), encoding="utf-8"
    )
    with pytest.raises(InputError, match=r"conditions.cells\[0\].pair: given \[C, D\] for the one finger of tip"):
        examine(tmp_path / "one.yaml").require()


@pytest.mark.parametrize("name", list(DESIGNS))
def test_planning_refuses_other_numbers_of_fingers(tmp_path: Path, name: str) -> None:
    """`power`, `prereg` and `fit` simulate a comparison of two fingers."""
    preflight = examine(protocol_with(tmp_path, name)).require()
    with pytest.raises(InputError, match="finger_conditions: given (tip|spread), but no observer models"):
        designs_for(preflight, Observer.usual_name(preflight.experiment.protocol))
