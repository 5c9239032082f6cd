"""Several stimuli in one protocol: checked, drawn, presented, verified and analysed."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from typer.testing import CliRunner

from modaltouch.analysis.pipeline import analyse, read_responses
from modaltouch.analysis.runs import ThresholdAnalysis, over_participants
from modaltouch.cli import app
from modaltouch.planning.design import designs_for
from modaltouch.planning.experiments import Study
from modaltouch.planning.observer import Observer
from modaltouch.planning.power import plan
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol import InputError
from modaltouch.protocol.levels import Levels
from modaltouch.protocol.schedule import Schedule
from modaltouch.record.audit import audit_session
from modaltouch.record.session import Session, read_session
from modaltouch.session.setup import begin
from modaltouch.session.wiring import wire_run

SHIPPED = Path(__file__).parents[2] / "protocols" / "two_fields.yaml"


@pytest.fixture(scope="module")
def preflight() -> Preflight:
    """The shipped protocol with two stimuli."""
    return examine(SHIPPED).require()


def write(folder: Path, *changes: tuple[str, str], name: str = "two_fields.yaml") -> Path:
    """Write a shipped protocol with changes and return its file."""
    text = SHIPPED.with_name(name).read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    text = _with_absolute_paths(text)
    file = folder / "protocol.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_each_stimulus_is_the_same_as_alone(preflight: Preflight, tmp_path: Path) -> None:
    """The burst of `sharp` has the same codes as in a protocol with that stimulus only."""
    alone = examine(_sharp_alone(tmp_path)).require()
    assert preflight.content_hashes["sharp"] == alone.stimulus.burst.content_hash
    assert preflight.content_hashes["sharp"] != preflight.content_hashes["blunt"]
    assert [(each["stimulus"], each["velocity_mm_s"]) for each in preflight.stimuli] == [
        ("sharp", 80), ("sharp", 150), ("blunt", 80), ("blunt", 150),
    ]  # fmt: skip


def _sharp_alone(folder: Path) -> Path:
    lines = SHIPPED.read_text(encoding="utf-8").split("\n")
    kept = [line for line in lines if not line.startswith(("stimuli:", "  sharp:", "  blunt:"))]
    text = "\n".join(kept).replace("  focus: C\n", "  focus: C\n  field: {shape: triangle, base_mm: 56}\n")
    file = folder / "alone.yaml"
    file.write_text(_with_absolute_paths(text), encoding="utf-8")
    return file


def _with_absolute_paths(text: str) -> str:
    """Replace the paths of apparatus and texts by absolute ones."""
    home = SHIPPED.parent
    return text.replace(": apparatus/", f": {home}/apparatus/").replace(": texts/", f": {home}/texts/")


@pytest.mark.parametrize("order", ["shuffled", "by_pair", "by_velocity", "latin_square"])
def test_every_condition_meets_every_stimulus_equally_often(tmp_path: Path, order: str) -> None:
    """It holds for every order by the definition of the design; catch trials have no stimulus."""
    limit = "" if order != "shuffled" else "\n  max_same_pair_running: 2"
    file = write(tmp_path, ("repetitions: 2\n  max_same_pair_running: 2", f"repetitions: 2\n  order: {order}{limit}"))
    protocol = examine(file).require().experiment.protocol
    drawn = Schedule.draw(protocol, "p03", 5)
    assert len(drawn.trials) == protocol.n_trials == 32
    counted = Counter(trial.condition for trial in drawn.trials)
    assert set(counted.values()) == {2}
    assert Counter(condition.stimulus for condition in counted) == {"sharp": 8, "blunt": 8}
    assert [trial.condition.stimulus for trial in drawn.trials[:8]] != ["sharp"] * 8


@pytest.mark.parametrize(
    ("changes", "place", "words"),
    [
        ([("blunt: {field", "blunt: {focus: Q, field")], "stimuli.blunt.focus", "'Q', which is not a zone"),
        ([("blunt: {field: {shape: raised_cosine, base_mm: 100}}", "blunt: {duration_ms: 200}")],
         "stimuli.blunt.duration_ms", "200 ms at 7 bursts per second"),
        ([("blunt: {field: {shape: raised_cosine, base_mm: 100}}", "blunt: {repetition_rate_Hz: 30}")],
         "stimuli.blunt.repetition_rate_Hz", "50 ms at 30 bursts per second"),
        ([("blunt: {field: {shape: raised_cosine, base_mm: 100}}", "blunt: {selected_modes: [2]}")],
         "stimuli.blunt.selected_modes", "(stimulus blunt)"),
        ([("[80, 150]", "[80, 200]")], "conditions.peak_velocities_mm_s[1]", "(stimulus blunt)"),
        ([("  blunt:", "  third: {field: {shape: triangle, base_mm: 60}}\n  blunt:")], "stimuli", "at most 4"),
    ],
)  # fmt: skip
def test_faults_are_reported_at_the_stimulus(
    tmp_path: Path, changes: list[tuple[str, str]], place: str, words: str
) -> None:
    """The fault gives value and allowed values, at the stimulus' own key if it has one."""
    problems = [str(problem) for problem in examine(write(tmp_path, *changes)).problems]
    assert any(f" {place}: " in problem and words in problem for problem in problems), problems


def test_check_shows_how_stimuli_of_one_field_differ(tmp_path: Path) -> None:
    """Their speeds are equal, their rates and bursts are not: 2 s at 7 and at 3.5 Hz."""
    own = ("blunt: {field: {shape: raised_cosine, base_mm: 100}}", "blunt: {repetition_rate_Hz: 3.5}")
    file = write(tmp_path, own, ("presentation_s: 1.0", "presentation_s: 2.0"))
    done = CliRunner().invoke(app, ["check", str(file)], env={"COLUMNS": "200"})
    assert "14 bursts at 7 Hz" in done.output
    assert "7 bursts at 3.5 Hz" in done.output


def test_cells_of_one_and_two_fingers_can_be_listed_together(tmp_path: Path) -> None:
    """Each cell gives its finger condition, for any stimulus; typical fingers touch only the zones of the cell."""
    cells = (
        "cells:\n    - {pair: [A, C], peak_velocities_mm_s: [80], finger_conditions: [one_hand]}\n"
        "    - {pair: [C], peak_velocities_mm_s: [80], finger_conditions: [tip]}"
    )
    text = SHIPPED.read_text(encoding="utf-8")
    section = text[text.index("conditions:") : text.index("\n\n", text.index("conditions:"))]
    keys = text[text.index("  keys:") :].split("\n\n")[0]
    own = f"conditions:\n  finger_conditions: [one_hand, tip]\n  fingers: {{tip: [left index]}}\n  {cells}"
    file = write(
        tmp_path, (section, own), ("  max_same_pair_running: 2\n", ""), (keys, "  keys: {felt: [y], not_felt: [n]}")
    )
    found = examine(file)
    assert found.problems == ()
    assert found.untouched_warning() is not None


def test_a_session_switches_stimuli_without_an_upload(preflight: Preflight, tmp_path: Path) -> None:
    """Four records are uploaded before the first trial and none after it; verify redraws and recomputes everything."""
    session = begin(wire_run(preflight, "p01", answers="simulated", results=tmp_path))
    exchanges = [
        (event["n"], each["what"]) for event in session.events if event["event"] == "rig" for each in event["exchanges"]
    ]
    first = next(event["n"] for event in session.events if event["event"] == "fired")
    assert sum(what == "record_sent" for n, what in exchanges if n < first) == 4
    assert not any(what == "record_sent" for n, what in exchanges if n > first)
    rows = [(t["trial"]["condition"]["stimulus"], t["planned"]["speed_left_mm_s"]) for t in session.trials]
    assert len({name for name, _ in rows}) == 2
    assert all(event["confirmed"]["confirmed"] for event in session.trials)
    verdict = audit_session(Session.find(session.path.parent))
    assert verdict.problems == ()
    assert any(line.startswith("drives of 2 stimuli recomputed") for line in verdict.lines)
    table = next(session.path.parent.glob("*_beh.tsv")).read_text(encoding="utf-8").splitlines()
    assert "stimulus" in table[0].split("\t")
    both = read_responses(tmp_path)
    assert (len(both.frame), both.stimuli) == (32, ("sharp", "blunt"))
    chosen = read_responses(tmp_path, stimulus="blunt")
    assert (len(chosen.frame), chosen.focus, set(chosen.frame["stimulus"])) == (16, "C", {"blunt"})
    with pytest.raises(InputError, match="'round'.*sharp, blunt|'round'.*blunt, sharp"):
        read_responses(tmp_path, stimulus="round")


def test_the_speeds_under_the_fingers_depend_on_the_stimulus(preflight: Preflight) -> None:
    """The faster finger moves over 1.5 times as fast as the slower in a sharp field, under 1.2 times in a blunt one."""
    drawn = Schedule.draw(preflight.experiment.protocol, "p01", 1)
    ratio = {}
    for trial in drawn.trials:
        slower, faster = sorted(preflight.speeds(trial))
        ratio[trial.condition.stimulus] = faster / slower
    assert ratio["sharp"] > 1.5 > 1.2 > ratio["blunt"]


def test_each_stimulus_has_a_separate_plan(preflight: Preflight, tmp_path: Path) -> None:
    """As in the analysis, the plan for `sharp` equals exactly that of a protocol with that stimulus only."""
    designs = designs_for(preflight, Observer())
    assert list(designs) == ["sharp", "blunt"]
    alone = designs_for(examine(_sharp_alone(tmp_path)).require(), Observer())[""]
    both = (Study(design, Observer(), ("a2", "d"), null=False, seed=4) for design in (designs["sharp"], alone))
    first, second = (plan(study, [(8, 2)], 30).as_dict() for study in both)
    assert first.pop("stimulus") == "sharp"
    assert first == second
    assert (designs["blunt"].speeds[0, 0] > 1.2 * designs["sharp"].speeds[0, 0])[:, 0].all()


SHARP_AND_SLOW = (
    "conditions:\n",
    "stimuli:\n  sharp: {field: {shape: triangle, base_mm: 56}}\n  slow: {repetition_rate_Hz: 5}\n\nconditions:\n",
)
"""Two stimuli for the shipped adaptive protocol."""


def test_each_stimulus_has_its_own_adaptive_runs(tmp_path: Path) -> None:
    """Each has forty trials, and answers to one stimulus change no level of the other."""
    file = write(tmp_path, SHARP_AND_SLOW, name="threshold.yaml")
    protocol = examine(file).require().experiment.protocol
    trials = [trial for trial in Schedule.draw(protocol, "p01", 1).trials if not trial.condition.is_catch]
    assert Counter((t.condition.zones, t.condition.stimulus) for t in trials) == {
        (pair, name): 40 for pair in (("A", "C"), ("C", "E")) for name in ("sharp", "slow")
    }
    levels, first = Levels(protocol), trials[0]
    event = {"trial": first.as_dict(), "confirmed": {"confirmed": True}, "response": {"answer": "none"}}
    of_pair = [trial for trial in trials[1:] if trial.condition.zones == first.condition.zones]
    same = next(trial for trial in of_pair if trial.condition.stimulus == first.condition.stimulus)
    other = next(trial for trial in of_pair if trial.condition.stimulus != first.condition.stimulus)
    assert levels.settle(same, [event]).condition.velocity_mm_s > 60
    assert levels.settle(other, [event]).condition.velocity_mm_s == 60


def test_a_threshold_is_fitted_for_each_stimulus(tmp_path: Path) -> None:
    """Runs, tables and report of an adaptive session with two stimuli; catch trials count for the runs of both."""
    short = (SHARP_AND_SLOW, ("trials: 40", "trials: 8"), ("catch_trials: 10", "catch_trials: 4"))
    preflight = examine(write(tmp_path, *short, name="threshold.yaml")).require()
    log = begin(wire_run(preflight, "p01", answers="simulated", results=tmp_path)).path
    assert audit_session(Session.find(log)).problems == ()
    analysis = analyse(tmp_path, tmp_path / "out")
    assert isinstance(analysis, ThresholdAnalysis)
    assert [(run.kind, len(run.levels)) for run in analysis.runs] == [
        (f"one hand {pair} {name}", 8) for pair in ("A-C", "C-E") for name in ("sharp", "slow")
    ]
    catches = [run.fitted.n_catch for run in analysis.runs]
    assert catches[0] == catches[1]
    assert catches[2] == catches[3]
    assert catches[0] + catches[2] == 4
    assert {row["stimulus"] for row in over_participants(analysis.runs)} == {"sharp", "slow"}
    report = analysis.files["report.html"].read_text(encoding="utf-8")
    assert "one hand A-C slow" in report
    with pytest.raises(InputError, match="'sharp' with adaptive sessions; allowed: all stimuli together"):
        analyse(tmp_path, tmp_path / "other", stimulus="sharp")


def test_the_check_describes_each_stimulus() -> None:
    """Modes and spot width of both are shown, in the protocol's order."""
    shown = CliRunner().invoke(app, ["check", str(SHIPPED)]).output
    sharp, blunt = shown.index("sharp: focus C, law exact"), shown.index("blunt: focus C, law exact")
    assert sharp < blunt


def test_the_record_of_one_stimulus_has_no_stimulus_name(tmp_path: Path) -> None:
    """Protocols without a section stimuli are recorded as before it existed."""
    preflight = examine(SHIPPED.with_name("demo.yaml")).require()
    session = read_session(begin(wire_run(preflight, "p01", answers="simulated", results=tmp_path)).path)
    assert all("stimulus" not in event["trial"]["condition"] for event in session.trials)
    assert "content_hashes" not in session.start["stimulus"]
