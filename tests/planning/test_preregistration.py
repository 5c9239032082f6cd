"""A preregistration, and analyses compared with it."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from modaltouch.analysis import analyse
from modaltouch.analysis.crossed import Analysis
from modaltouch.analysis.preregistration import read_preregistration
from modaltouch.cli import app
from modaltouch.protocol import InputError
from modaltouch.session import simulate_session

pytestmark = pytest.mark.usefixtures("undrawn")

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "protocols" / "demo.yaml"


def run(*words: object) -> Result:
    """Run the command line in this process."""
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the preregistration of the demonstration for three participants."""
    file = tmp_path_factory.mktemp("prereg") / "demo.prereg.md"
    done = run("prereg", DEMO, "-n", 3, "--experiments", 20, "--out", file, "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout) == {"file": str(file)}
    return file


@pytest.fixture(scope="module")
def analysis(page: Path, tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    """Return the analysis of three simulated sessions, compared with the preregistration."""
    results = tmp_path_factory.mktemp("results")
    assert run("simulate", DEMO, "-n", 3, "--results", results).exit_code == 0
    found = analyse(results, prereg=page)
    assert isinstance(found, Analysis)
    return found


def test_the_page_has_every_part_of_a_preregistration(page: Path) -> None:
    """Design, hypotheses, tests, margins, exclusion rules, sample size with its simulation, and the commit."""
    text = page.read_text(encoding="utf-8")
    for heading in ("Design", "Hypotheses and tests", "Margins", "Exclusion rules", "Sample size"):
        assert f"\n## {heading}\n" in text
    assert "| participants | 3 |" in text
    assert "| a2 | is one zone chosen more than the other by any participant? | exact sign-flip test of net dom" in text
    assert "share of 20 simulated experiments" in text and "seed 1" in text
    assert ", commit `" in text
    assert "&" not in text


def test_the_command_on_the_page_repeats_its_power(page: Path) -> None:
    """All nine families agree; a shipped protocol is given by name, so that no local path is published."""
    text = page.read_text(encoding="utf-8")
    assert "from\n`demo` (SHA-256" in text
    command = next(line for line in text.splitlines() if line.endswith("repeats this simulation.")).split("`")[1]
    repeated = json.loads(run(*shlex.split(command)[1:], "--json").stdout)["power"]
    rows = [line.split(" | ") for line in text.partition("| family | power |")[2].split("\n\n")[0].splitlines()[2:]]
    assert len(rows) == 9
    assert [(name.strip("| "), float(power)) for name, power, *_ in rows] == [
        (row["family"], pytest.approx(row["power"], abs=1e-3)) for row in repeated
    ]


def test_an_analysis_as_preregistered_has_no_departures(analysis: Analysis) -> None:
    """The report states that there are none."""
    assert analysis.registration.departures == ()
    report = analysis.files["report.html"].read_text(encoding="utf-8")
    assert "Departures from the preregistration" in report
    assert "None from" in report


def test_every_departure_is_reported(analysis: Analysis, page: Path) -> None:
    """Number of participants or repetitions, family of tests, margin, protocol, and sessions before registration."""
    terms = read_preregistration(page)
    other = terms | {
        "participants": 12,
        "repetitions": 3,
        "equivalence margin": 0.1,
        "protocol (SHA-256)": "0",
        "date": "2999-01-01",
    }
    departures = replace(analysis, findings=analysis.findings[:6]).departures_from(other)
    message = " | ".join(departures)
    assert "participants: 12 preregistered, 3 analysed" in message
    assert "repetitions: 3 preregistered, 1 analysed" in message
    assert " preregistered, a1 (6) analysed" in message
    assert "equivalence margin: 0.1 preregistered, none analysed" in message
    assert "protocol (SHA-256): 0 preregistered" in message
    assert "3 of 3 sessions began before the day of the preregistration, 2999-01-01" in message
    assert len(departures) == 6


def test_a_page_created_meanwhile_is_not_overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulation takes minutes, in which a colleague may register the same protocol."""
    file = tmp_path / "demo.prereg.md"
    monkeypatch.setattr("modaltouch.planning.preregister", lambda *_, **__: str(file.write_text("theirs", "utf-8")))
    done = run("prereg", DEMO, "-n", 2, "--out", file)
    assert done.exit_code == 4
    assert "demo.prereg.md: exists already and is not overwritten; give another file" in done.stderr
    assert file.read_text("utf-8") == "theirs"


def test_the_page_beside_the_protocol_is_found(tmp_path: Path) -> None:
    """`prereg` writes it there by default, and does not overwrite an existing one."""
    assert run("new", tmp_path / "study", "--from", "demo").exit_code == 0
    protocol = tmp_path / "study" / "protocols" / "demo.yaml"
    assert run("prereg", protocol, "-n", 2, "--experiments", 4).exit_code == 0
    again = run("prereg", protocol, "-n", 2, "--experiments", 4)
    assert again.exit_code == 4
    assert "demo.prereg.md: exists already and is not overwritten" in again.stderr
    assert run("simulate", protocol, "-n", 1, "--results", tmp_path / "results").exit_code == 0
    done = run("analyse", tmp_path / "results")
    assert done.exit_code == 0, done.stderr
    assert "departs from the preregistration: participants: 2 preregistered, 1 analysed" in done.stderr


def test_an_unwritable_page_is_refused_before_the_simulation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file occupies the path of its folder."""

    def simulate(*given: object, **options: object) -> str:
        raise AssertionError("simulated")

    monkeypatch.setattr("modaltouch.planning.preregister", simulate)
    (tmp_path / "held").write_text("")
    done = run("prereg", "demo", "-n", 2, "--out", tmp_path / "held" / "demo.prereg.md")
    assert done.exit_code == 4
    assert "demo.prereg.md: cannot be written" in done.stderr


@pytest.mark.parametrize(
    ("protocol", "families"),
    [
        ("magnitude", {"exponent of magnitude": 1, "rating over levels": 1}),
        ("detection_with_confidence", {"d'": 4, "rating over levels": 1, "b": 1, "b mean": 1}),
    ],
)
def test_designs_beyond_two_fingers_are_simulated_in_sessions(
    tmp_path: Path, protocol: str, families: dict[str, int]
) -> None:
    """The page lists the tests that the analysis then makes, without departures."""
    file, results = tmp_path / "plan.md", tmp_path / "results"
    done = run("prereg", protocol, "-n", 2, "--experiments", 1, "--out", file)
    assert done.exit_code == 0, done.stderr
    text = file.read_text(encoding="utf-8")
    assert "| rating over levels | is it true that ratings or further answers change with the level? | " in text
    assert "share of 1 simulated experiment with" in text
    assert "--experiments 1 --observer" in text
    assert read_preregistration(file)["tests by family"] == families
    assert ("catch trials give the false alarms of d'" in text) is ("d'" in families)
    assert ("could change a mean difference or slope at worst" in text) is ("b mean" in families)
    assert "at random" not in text
    assert run("simulate", protocol, "-n", 2, "--results", results).exit_code == 0
    found = analyse(results, prereg=file)
    assert isinstance(found, Analysis)
    assert found.registration.departures == ()


@pytest.mark.parametrize(("protocol", "n"), [("demo", 300), ("magnitude", 2)])
def test_the_page_does_not_depend_on_the_number_of_processes(tmp_path: Path, protocol: str, n: int) -> None:
    """Answer counts in two batches of up to 250 experiments, and whole sessions: the same seed gives the same page."""
    pages = [tmp_path / f"{jobs}.md" for jobs in (1, 2)]
    for jobs, page in enumerate(pages, start=1):
        assert run("prereg", protocol, "-n", 2, "--experiments", n, "-j", jobs, "--out", page).exit_code == 0
    assert pages[0].read_text(encoding="utf-8") == pages[1].read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("protocol", "planned"),
    [
        ("protocol_staircase", "| trials a run | 50 |"),
        ("protocol_table", "| part 2 | one hand and two hands A-C at 150 mm/s, 2 times |"),
    ],
)
def test_adaptive_runs_and_uncrossed_designs_are_simulated_in_sessions(
    tmp_path: Path, protocol: str, planned: str
) -> None:
    """The page states what is estimated or tested, and how precisely; the analysis has no departures."""
    file, results, source = tmp_path / "plan.md", tmp_path / "results", ROOT / "docs" / "examples" / f"{protocol}.yaml"
    done = run("prereg", source, "-n", 2, "--experiments", 1, "--out", file)
    assert done.exit_code == 0, done.stderr
    text = file.read_text(encoding="utf-8")
    assert planned in text
    assert ("No hypothesis is tested" in text) is ("could change" not in text) is ("trials a run" in text)
    assert ("| mean threshold of | factor, median |" in text) is ("trials a run" in text)
    assert ("\n## Margins\n" in text) is ("trials a run" not in text)
    assert run("simulate", source, "-n", 2, "--results", results).exit_code == 0
    found = analyse(results, prereg=file)
    assert found.registration.departures == ()
    assert "None from <code>" in found.files["report.html"].read_text(encoding="utf-8")
    terms = read_preregistration(file) | {"participants": 12}
    assert found.departures_from(terms) == ("participants: 12 preregistered, 2 analysed",)


@pytest.mark.parametrize(
    ("sessions", "planned"),
    [
        ("2", ["| sessions per participant | 2 |", "| trials of a session | 12: every condition once; 1 more"]),
        (
            "[{name: pre}, {name: training, analysed: false, schedule: {repetitions: 2}}, {name: post}]",
            [
                "| 3: pre, training (not analysed), post |",
                "| trials of a session, training | 24; 1 more for practice |",
            ],
        ),
    ],
)
def test_every_session_of_a_participant_is_planned(edit, tmp_path: Path, sessions: str, planned: list[str]) -> None:
    """The protocol's sessions are listed; training that is not analysed also takes the participant's time."""
    file = tmp_path / "plan.md"
    source = edit("demo.yaml", ("schedule:\n", f"schedule:\n  sessions: {sessions}\n"))
    assert run("prereg", source, "-n", 2, "--experiments", 1, "--out", file).exit_code == 0
    text = file.read_text(encoding="utf-8")
    assert all(line in text for line in planned) and "| trials per participant |" not in text


def test_power_of_random_answers_is_reported_as_false_positives(edit, tmp_path: Path) -> None:
    """The observer cannot interpret answers that refer to neither a finger nor an interval."""
    file, keys = tmp_path / "plan.md", "keys: {same: [f1], different: [f2], first: [f3]}\n  question: What was it like?"
    source = edit("magnitude.yaml", ("scale: {kind: number}", keys))
    assert run("prereg", source, "-n", 2, "--experiments", 1, "--out", file).exit_code == 0
    assert "answer the first question at random.\nThe tests of its answers then show their rate of false claims" in (
        file.read_text(encoding="utf-8")
    )


@pytest.mark.parametrize(
    "change",
    [("", ""), ("schedule:\n", "schedule:\n  sessions: 2\n"),
     ("schedule:\n", "schedule:\n  sessions: [{name: training, analysed: false}, {name: test}]\n")],
    ids=["stimuli", "sessions", "training"],
)  # fmt: skip
def test_the_analysis_makes_the_planned_tests(edit, tmp_path: Path, change: tuple[str, str]) -> None:
    """Several stimuli are corrected together, and the repetitions of all sessions count, as in the analysis."""
    name = "demo" if change[0] else "two_fields"
    source = edit(f"{name}.yaml", change) if change[0] else ROOT / "protocols" / f"{name}.yaml"
    file, results = tmp_path / "plan.md", tmp_path / "results"
    assert run("prereg", source, "-n", 2, "--experiments", 1, "--out", file).exit_code == 0
    for participant, session in product(("p1", "p2"), (1, 2) if change[0] else (1,)):
        simulate_session(source, participant, results, session=session)
    found = analyse(results, prereg=file)
    assert found.registration.departures == ()
    scopes = "part 1: one hand, A and C: P(C) - P(A); " if name == "two_fields" else "one hand, A and C: P(C) - P(A); "
    assert scopes in file.read_text(encoding="utf-8")


def test_individual_levels_are_planned_with_an_expected_threshold(tmp_path: Path) -> None:
    """Without a threshold the plan is refused with a remedy; with fixed levels a threshold is refused."""
    file = tmp_path / "plan.md"
    asked = ("-n", 1, "--experiments", 1, "--out", file)
    done = run("prereg", "sensation_levels", *asked)
    assert done.exit_code == 2 and "give the threshold that you expect with --threshold" in done.stderr
    done = run("prereg", "sensation_levels", *asked, "--threshold", 20)
    assert done.exit_code == 0, done.stderr
    text = file.read_text(encoding="utf-8")
    assert "The levels are those of a threshold of 20 mm/s" in text and "--seed 1 --threshold 20 --out FILE`" in text
    assert read_preregistration(file)["levels [x threshold]"] == [1, 1.5, 2, 3]
    done = run("prereg", DEMO, "-n", 1, "--threshold", 20, "--out", tmp_path / "other.md")
    assert done.exit_code == 2 and "the levels do not depend on a threshold" in done.stderr


def test_a_file_that_is_not_a_preregistration_is_refused(tmp_path: Path) -> None:
    """The message gives the file and the remedy."""
    file = tmp_path / "notes.md"
    file.write_text("# Notes", encoding="utf-8")
    with pytest.raises(InputError, match=r"notes.md: given no block of JSON .*; write one with `modaltouch prereg"):
        read_preregistration(file)
    file.write_text("```json\n[]\n```\n", encoding="utf-8")
    with pytest.raises(InputError, match="notes.md: given no block of JSON with the terms"):
        read_preregistration(file)
    with pytest.raises(InputError, match="given a file that cannot be read"):
        read_preregistration(tmp_path / "absent.md")
