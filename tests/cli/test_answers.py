"""Answers are data: lists that no module hard-codes work from the protocol to the report."""

from __future__ import annotations

import csv
import json
import shutil
from collections import Counter
from contextlib import chdir
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from modaltouch.analysis.exact import multinomial_test
from modaltouch.cli import app

pytestmark = pytest.mark.usefixtures("undrawn")

SHIPPED = Path(__file__).parents[2] / "protocols"
GRADES, SIDES = ("stronger", "weaker"), ("left", "right")
KEYS = {
    "stronger": "[up, num_8]",
    "weaker": "[down, num_2]",
    "left": "[left, num_4]",
    "right": "[right, num_6]",
}


def call(*words: object, cwd: Path) -> Result:
    """Run ``modaltouch`` in a folder and return the result."""
    with chdir(cwd):
        return CliRunner().invoke(app, [*map(str, words)], catch_exceptions=False)


def run(*words: object, cwd: Path) -> str:
    """Return what ``modaltouch`` prints; it must succeed."""
    done = call(*words, cwd=cwd)
    assert done.exit_code == 0, done.output
    return done.stdout


def write_protocol(folder: Path, base: str, name: str, keys: str, labels: dict[str, str]) -> Path:
    """Write a shipped protocol with other answers, and the English texts with their labels."""
    shutil.copytree(SHIPPED, folder, dirs_exist_ok=True)
    text = (folder / f"{base}.yaml").read_text(encoding="utf-8").replace(f"protocol: {base}", f"protocol: {name}")
    file = folder / f"{name}.yaml"
    file.write_text(text[: text.index("  keys:")] + keys, encoding="utf-8")
    if labels:
        texts = folder / "texts" / "english.yaml"
        added = "".join(f"  {answer}: {label}\n" for answer, label in labels.items())
        words = texts.read_text(encoding="utf-8").replace("\nanswers:\n", f"\nanswers:\n{added}")
        texts.write_text(words, encoding="utf-8")
    return file


@pytest.fixture(scope="module", params=[GRADES, SIDES], ids="-".join)
def study(request, tmp_path_factory) -> tuple[tuple[str, ...], Path]:
    """The names of two answers, and a folder with their protocol and four simulated sessions."""
    names, folder = request.param, tmp_path_factory.mktemp("study")
    keys = "  keys:\n" + "".join(f"    {name}: {KEYS[name]}\n" for name in names)
    labels = {name: name.title() for name in names if name in GRADES}
    write_protocol(folder / "protocols", "demo", "two_answers", keys, labels)
    run("simulate", "protocols/two_answers.yaml", "-n", 4, "--results", "results", cwd=folder)
    return names, folder


@pytest.fixture(scope="module")
def found(study) -> dict:
    """The JSON output of the analysis of these sessions."""
    return json.loads(run("analyse", "results", "--out", "out", "--json", cwd=study[1]))


def tables(folder: Path) -> list[dict[str, str]]:
    """Return the rows that count of every BIDS table."""
    rows = []
    for path in sorted((folder / "results").rglob("*_beh.tsv")):
        with path.open(encoding="utf-8", newline="") as file:
            rows += [{"participant": path.name.split("_")[0], **row} for row in csv.DictReader(file, delimiter="\t")]
    return [row for row in rows if row["practice"] == "0"]


def test_recorded_sessions_verify_and_describe_their_answers(study) -> None:
    """The record agrees with its protocol, and the sidecar has a level for each answer."""
    names, folder = study
    assert "12 trials drawn again" in run("verify", "results/simulated/two_answers/sub-sim01/ses-1", cwd=folder)
    (side,) = (folder / "results").rglob("sub-sim01*_beh.json")
    assert set(json.loads(side.read_text(encoding="utf-8"))["response"]["Levels"]) == set(names)
    assert {row["response"] for row in tables(folder)} == set(names)


def test_a_cut_session_is_resumed_with_the_same_answers(study, tmp_path) -> None:
    """A log cut within a trial and resumed has the answers of the complete session."""
    _, folder = study
    whole, cut = (
        folder / "results/simulated/two_answers/sub-sim02/ses-1",
        tmp_path / "simulated" / "two_answers" / "sub-sim02" / "ses-1",
    )
    (cut / "beh").mkdir(parents=True)
    lines = (whole / "beh" / "session.jsonl").read_text(encoding="utf-8").splitlines(keepends=True)
    (cut / "beh" / "session.jsonl").write_text("".join(lines[:40]), encoding="utf-8")
    run("resume", cut, cwd=folder)

    def answers(place: Path) -> list[str]:
        (table,) = (place / "beh").glob("*_beh.tsv")
        with table.open(encoding="utf-8", newline="") as file:
            return [row["response"] for row in csv.DictReader(file, delimiter="\t")]

    assert answers(cut) == answers(whole)


def test_counts_and_exact_tests_agree_with_the_tables(study, found) -> None:
    """Counts are recounted from the BIDS tables; each cell's p value is that of an even split over two answers."""
    names, folder = study
    given = Counter(
        (row["finger_condition"], row["zone_left"], float(row["velocity_mm_s"]), row["response"])
        for row in tables(folder)
    )
    chance = {row["scope"]: row["p"] for row in found["tests"] if row["family"] == "a1"}
    for cell in found["counts"]:
        counts = [given[cell["finger_condition"], cell["zone_left"], cell["velocity_mm_s"], name] for name in names]
        assert [cell[name] for name in names] == counts
        assert cell["n"] == sum(counts) == 4
        scope = f"{cell['finger_condition']} {cell['pair']} {cell['velocity_mm_s']:g} mm/s"
        assert chance[scope] == pytest.approx(multinomial_test(counts).p)
    assert {"counts.csv", "fig_10.csv", "fig_10.svg", "report.html"} <= set(found["files"])


def test_the_report_states_what_does_not_apply(study, found) -> None:
    """There is no dominant zone if no answer has a finger; with both sides the zones are as in the paper."""
    names, folder = study
    report = (folder / "out" / "report.html").read_text(encoding="utf-8")
    questions = {row["question"] for row in found["tests"]}
    rows = (folder / "out" / "fig_10.csv").read_text(encoding="utf-8").splitlines()[1:3]
    assert f"an even split over {names[0]} and {names[1]}" in report
    if names == GRADES:
        refused = call("analyse", "results", "--out", "other", "--model", cwd=folder)
        assert "answers that do not name each of two fingers alone" in refused.stderr and refused.exit_code == 2
        assert "(stronger, weaker) do not name each of two fingers alone, so no zone is dominant" in report
        assert not questions & {"a2", "side", "order", "speed"}
        assert [row.split(",")[1] for row in rows] == ["stronger", "weaker"]
    else:
        assert "no zone is dominant" not in report
        assert {"a2", "side", "order", "speed"} <= questions
        assert [row.split(",")[1] for row in rows] == ["C", "A"]


def test_a_table_of_other_answers_is_read_with_its_protocol(study, found) -> None:
    """The counts equal those of the sessions; answers other than the paper's require their protocol."""
    names, folder = study
    columns = ["participant", "finger_condition", "zone_left", "zone_right", "velocity_mm_s", "response"]
    with (folder / "table.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(tables(folder))
    protocol = ("--protocol", "protocols/two_answers.yaml")
    from_table = json.loads(run("analyse", "table.csv", *protocol, "--out", "t", "--json", cwd=folder))
    assert from_table["counts"] == found["counts"]
    assert "analyse table.csv --protocol PROTOCOL</code>" in (folder / "t" / "report.html").read_text(encoding="utf-8")
    if names == GRADES:
        done = call("analyse", "table.csv", "--out", "u", cwd=folder)
        assert done.exit_code == 2
        assert "response: given 'weaker'" in done.stderr
        assert "or name the protocol that offers other answers with --protocol" in done.stderr


def test_renamed_answers_give_the_same_numbers(tmp_path) -> None:
    """A German list, catch trials included, gives the same draws, counts and p values as the shipped one."""
    keys = (
        "  keys:\n    links: [left]\n    beide: [up]\n    rechts: [right]\n    nirgends: [down]\n"
        "  fingers: {links: [left], beide: [left, right], rechts: [right], nirgends: []}\n"
    )
    german = {"links": "left", "beide": "both", "rechts": "right", "nirgends": "none"}
    write_protocol(
        tmp_path / "protocols", "with_catch_trials", "deutsch", keys, {name: name.title() for name in german}
    )
    found = {}
    for name in ("with_catch_trials", "deutsch"):
        run("simulate", f"protocols/{name}.yaml", "-n", 2, "--results", name, cwd=tmp_path)
        found[name] = json.loads(run("analyse", name, "--out", f"{name}_out", "--json", cwd=tmp_path))
    named, shipped = found["deutsch"], found["with_catch_trials"]
    assert [{german.get(key, key): value for key, value in row.items()} for row in named["counts"]] == shipped["counts"]
    assert [row["p"] for row in named["tests"]] == [row["p"] for row in shipped["tests"]]
    caught = [{german[word]: n for word, n in row["answers"].items()} for row in named["catch_trials"]]
    assert caught == [row["answers"] for row in shipped["catch_trials"]]


def test_a_missing_label_is_reported_where_it_is_needed(tmp_path) -> None:
    """The message names the text and its file; for a misspelt answer it has the right one."""
    keys = "  keys:\n    stronger: [up]\n    weaker: [down]\n    lfet: [left]\n"
    write_protocol(tmp_path / "protocols", "demo", "grades", keys, {"stronger": "Stronger"})
    done = call("check", "protocols/grades.yaml", cwd=tmp_path)
    assert done.exit_code == 2
    assert "answers.keys.weaker: given no text `answers.weaker` in english.yaml, which this needs" in done.stderr
    assert "answers.keys.lfet: given no text `answers.lfet` in english.yaml" in done.stderr
    assert "did you mean 'left'?" in done.stderr


def test_power_refuses_answers_that_are_not_of_two_fingers(study) -> None:
    """Power simulates the comparison of two fingers with its three outcomes; other answers have no meaning there."""
    names, folder = study
    done = call("power", "protocols/two_answers.yaml", "--participants", "6", cwd=folder)
    assert done.exit_code == 2
    assert f"answers.keys: given the answers {', '.join(names)}, which an observer" in done.stderr


def test_check_warns_that_answers_without_fingers_are_simulated_at_random(study) -> None:
    """The warning is given if no answer has a finger, and not otherwise."""
    names, folder = study
    warnings = json.loads(run("check", "protocols/two_answers.yaml", "--json", cwd=folder))["warnings"]
    assert any("simulated participant answers at random" in each for each in warnings) is (names == GRADES)
