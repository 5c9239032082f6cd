"""Groups, kinds of session and a table of cells: run, killed, resumed, verified, analysed and listed."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from outside import call

from modaltouch.analysis import analyse
from modaltouch.cli.check import show
from modaltouch.planning import Observer, designs_for, fit_answers
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol import InputError
from modaltouch.record import RecordInputError, Session, audit_session, read_session
from modaltouch.session import begin, resume, simulate_session, survey_results, wire_resume, wire_run

GROUPS = """groups:
  near: {conditions: {table: near.csv}}
  far: {conditions: {cells: [{pair: [C, E], peak_velocities_mm_s: [150], weight: 2}]}}

schedule:
  sessions:
    - {name: training, analysed: false, conditions: {finger_conditions: [one_hand]},
       schedule: {max_same_pair_running: null}}
    - {name: test, min_gap_days: 1, schedule: {order: as_listed, max_same_pair_running: null}}
"""
NEAR = "zone_left,zone_right,peak_velocity_mm_s,weight\nA,C,80,2\nB,D,120,1\n"
CROSSED = "  zone_pairs: [[A, C], [B, D], [C, E]]\n  peak_velocities_mm_s: [80, 200]\n"
"""Lines of the demonstration that the groups have otherwise."""


@pytest.fixture(scope="module")
def preflight(tmp_path_factory: pytest.TempPathFactory) -> Preflight:
    """Two groups with different cells, and a training session before the test."""
    folder = tmp_path_factory.mktemp("protocols") / "protocols"
    shutil.copytree(Path(__file__).parents[2] / "protocols", folder)
    text = (folder / "demo.yaml").read_text("utf-8").replace(CROSSED, "").replace("schedule:\n", GROUPS)
    (folder / "demo.yaml").write_text(text, "utf-8")
    (folder / "near.csv").write_text(NEAR, "utf-8")
    return examine(folder / "demo.yaml").require()


def sit(preflight: Preflight, results: Path, participant: str, **more: Any) -> Session:
    """Return a participant's next recorded session."""
    more = {"session": None} | more
    return begin(wire_run(preflight, participant, answers="simulated", results=results, **more))


def test_check_shows_the_levels_of_each_group(
    preflight: Preflight, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One table for both kinds of session of a group, since they are equal."""
    monkeypatch.setenv("COLUMNS", "120")
    show(preflight, fingers="none")
    titles = [line.strip() for line in capsys.readouterr().out.splitlines() if line.startswith("Largest speed")]
    told = "Largest speed at the centre of each zone, mm/s"
    assert titles == [f"{told} (near training, near test)", f"{told} (far training, far test)"]


@pytest.fixture(scope="module")
def results(preflight: Preflight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four participants with both sessions, the last of which was killed and resumed."""
    place = tmp_path_factory.mktemp("results")
    for participant in ("p01", "p02", "p03", "p04"):
        sit(preflight, place, participant)
        last = sit(preflight, place, participant, any_gap=True)
    lines = last.path.read_bytes().splitlines(keepends=True)
    last.path.write_bytes(b"".join(lines[:-12]))
    for view in last.path.parent.glob("sub-*"):
        view.unlink()
    assert not read_session(last.path).complete
    assert resume(wire_resume(last.path)).complete
    return place


def test_every_record_is_recomputed_from_its_group_and_kind(results: Path) -> None:
    """Order, cells, drive and answers, from the recorded text and table."""
    logs = sorted(results.rglob("session.jsonl"))
    sessions = [read_session(log) for log in logs]
    assert [session.occasion for session in sessions] == [
        ("near", "training"), ("near", "test"), ("far", "training"), ("far", "test"),
    ] * 2  # fmt: skip
    assert [problem for session in sessions for problem in audit_session(session).problems] == []
    near = [trial[2:5] for trial in sessions[1].start["schedule"]["order"]]
    assert near == [["A", "C", 80.0], ["A", "C", 80.0], ["B", "D", 120.0]] * 2
    assert sessions[0].start["schedule"]["n_trials"] == 3
    assert sessions[2].start["schedule"]["group_by"] == "number of the participant"
    assert sessions[3].start["schedule"]["group_by"] == "the participant's earlier sessions"


@pytest.mark.parametrize(("key", "other"), [("group", "far"), ("session_kind", "training")])
def test_a_record_with_another_group_or_kind_is_invalid(results: Path, key: str, other: str) -> None:
    """Its order would be a different one."""
    session = read_session(next(results.rglob("sub-p01/ses-2/beh/session.jsonl")))
    start = {**session.start, "schedule": {**session.start["schedule"], key: other}}
    changed = replace(session, events=(start, *session.events[1:]))
    assert audit_session(changed).problems


def test_participants_are_listed_with_their_group(results: Path) -> None:
    """In BIDS participants.tsv, with a description."""
    dataset = results / "simulated" / "demo"
    rows = [line.split("\t") for line in (dataset / "participants.tsv").read_text("utf-8").splitlines()]
    assert rows == [
        ["participant_id", "group"], ["sub-p01", "near"], ["sub-p02", "far"], ["sub-p03", "near"], ["sub-p04", "far"],
    ]  # fmt: skip
    assert list(json.loads((dataset / "participants.json").read_text("utf-8"))["group"]["Levels"]) == ["near", "far"]


@pytest.mark.usefixtures("undrawn")
def test_the_analysis_excludes_training_and_separates_groups(results: Path, tmp_path: Path) -> None:
    """Two participants per group, each cell with its number of trials, nothing missing."""
    analysis = analyse(results, tmp_path / "analysis")
    counts = analysis.counts.set_index(["group", "finger_condition", "pair"])["asked"].to_dict()
    assert counts == {
        (group, fingers, pair): n
        for fingers in ("one_hand", "two_hands")
        for group, pair, n in (("near", "A-C", 4), ("near", "B-D", 2), ("far", "C-E", 4))
    }
    values = analysis.as_dict()
    assert (values["n_participants"], values["n_responses"], values["missing"]) == (4, 20, [])
    assert {each["reason"] for each in values["left_out"]} == {
        "of the kind training, which is not analysed (schedule.sessions)"
    }
    report = (tmp_path / "analysis" / "report.html").read_text("utf-8")
    assert "near one hand and two hands A-C at 80 mm/s" in report
    # In words, as in the report of a crossed design: no bare names, no minus for "against".
    assert ">one hand against two hands, A and C<" in report
    tests = report[report.index('<section id="tests">') : report.index('<section id="limits">')]
    assert not re.search("<t[dh][^>]*>[^<]*(one_hand|two_hands|hands? - )", tests)
    assert "zone ~ group + finger_condition + pair + level" in (tmp_path / "analysis" / "models.R").read_text("utf-8")


def test_the_study_shows_groups_and_kinds_and_who_is_next(results: Path) -> None:
    """P05 would be in the first group; all others are complete."""
    study = survey_results(results)[0]
    assert [(row["group"], row["session_kind"]) for row in study["sessions"][:3]] == [
        ("near", "training"), ("near", "test"), ("far", "training"),
    ]  # fmt: skip
    orders = [(row["group"], row["session_kind"], *row["finger_conditions"], row["filled"]) for row in study["orders"]]
    assert orders == [
        (group, *order)
        for group in ("near", "far")
        for order in (
            ("training", "one_hand", 2),
            ("test", "one_hand", "two_hands", 1),
            ("test", "two_hands", "one_hand", 1),
        )
    ]
    assert [(each["participant"], each["group"], each["session_kind"]) for each in study["next"]] == [
        ("p05", "near", "training")
    ]
    assert study["sessions_each"] == 2


def test_sessions_excluded_for_one_reason_share_a_line(results: Path) -> None:
    """A line for each training session would hide the damaged ones."""
    said = " ".join(call(f"study {results}").stdout.split())
    assert said.count("excluded") == 1
    assert "4 sessions: excluded, of the kind training, which is not analysed (schedule.sessions)" in said


def test_analyse_reports_a_common_reason_of_exclusion_once(results: Path, tmp_path: Path) -> None:
    """With the first session and the number of the others; the report lists all."""
    complained = call(f"analyse {results} --out {tmp_path / 'out'}").stderr
    assert complained.count("left out: ") == 1 and " and 3 more: of the kind training" in complained


def test_a_session_sooner_than_its_kind_allows_is_refused(preflight: Preflight, results: Path, tmp_path: Path) -> None:
    """With --any-gap it begins, and the record says so."""
    sit(preflight, tmp_path, "p01")
    due = (datetime.now(UTC) + timedelta(days=1)).strftime("%Y-%m-%d")
    with pytest.raises(RecordInputError, match=f"kind 'test' has min_gap_days: 1 .* from {due} .* --any-gap"):
        sit(preflight, tmp_path, "p01")
    assert survey_results(tmp_path)[0]["next"][0]["from"].startswith(due)
    begun = read_session(next(results.rglob("sub-p01/ses-2/beh/session.jsonl")))
    assert begun.start["any_gap"] is True
    assert "0.00 days after the previous session, where 'test' has min_gap_days: 1, waived by --any-gap" in "".join(
        audit_session(begun).lines
    )
    silent = replace(begun, events=({**begun.start, "any_gap": False}, *begun.events[1:]))
    assert (
        "begun 0.00 days after the previous session, where 'test' has min_gap_days: 1"
        in audit_session(silent).problems[0]
    )
    with pytest.raises(
        RecordInputError, match="given session 2, of the kind 'test', but .* p03 has had 0; allowed: session 1"
    ):
        sit(preflight, tmp_path, "p03", session=2)


def test_a_gap_is_counted_from_the_session_and_not_from_its_repair(
    preflight: Preflight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed at its end two days ago and repaired today, the training does not delay the test."""

    class TwoDaysAgo(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Any:
            return datetime.now(tz) - timedelta(days=2)

    with monkeypatch.context() as earlier:
        earlier.setattr("modaltouch.record.log.datetime", TwoDaysAgo)
        training = sit(preflight, tmp_path, "p01")
    training.path.write_bytes(training.path.read_bytes()[:-20])
    mended = resume(wire_resume(training.path))
    assert (mended.complete, mended.events[-1]["event"]) == (True, "stop")
    assert datetime.fromisoformat(survey_results(tmp_path)[0]["next"][0]["from"]) < datetime.now(UTC)
    test = sit(preflight, tmp_path, "p01")
    assert "begun 2.00 days after the previous session" in audit_session(test).lines
    assert not [note for note in survey_results(tmp_path)[0]["notes"] if "p01 session 2" in note]


def test_a_restarted_session_keeps_the_gap_of_the_one_it_replaces(preflight: Preflight, tmp_path: Path) -> None:
    """The replaced session does not count as an earlier one; resuming needs no gap."""
    sit(preflight, tmp_path, "p01")
    cut = sit(preflight, tmp_path, "p01", any_gap=True)
    cut.path.write_bytes(b"".join(cut.path.read_bytes().splitlines(keepends=True)[:-12]))
    for view in cut.path.parent.glob("sub-*"):
        view.unlink()
    due = survey_results(tmp_path)[0]["next"][0]
    assert (due["do"], due["session"], "from" in due) == ("resume", 2, False)
    anew = resume(wire_resume(cut.path, restart=True))
    assert (anew.complete, anew.start["begins_anew"]["session"]) == (True, 2)
    assert audit_session(anew).problems == ()
    notes = survey_results(tmp_path)[0]["notes"]
    assert not [note for note in notes if "p01 session 3" in note]


def test_a_given_group_is_kept(preflight: Preflight, tmp_path: Path) -> None:
    """Whatever the participant's number; another group and an unknown one are refused."""
    first = sit(preflight, tmp_path, "p01", group="far")
    second = sit(preflight, tmp_path, "p01", any_gap=True)
    assert [each.start["schedule"]["group_by"] for each in (first, second)] == [
        "given", "the participant's earlier sessions",
    ]  # fmt: skip
    assert [problem for each in (first, second) for problem in audit_session(each).problems] == []
    with pytest.raises(RecordInputError, match="p01 belongs to group far"):
        sit(preflight, tmp_path, "p01", any_gap=True, session=3, group="near")
    with pytest.raises(RecordInputError, match="given --group middle; allowed: near, far"):
        sit(preflight, tmp_path, "p02", group="middle")


def test_power_refuses_a_design_of_listed_cells(preflight: Preflight) -> None:
    """An observer's design has every pair at every level."""
    with pytest.raises(InputError, match="given cells that are not every pair at every level equally often"):
        designs_for(preflight, Observer.read("paper"))


def test_power_and_fit_plan_the_only_kind_of_session_that_is_analysed(tmp_path: Path) -> None:
    """Two tests of four levels after a training of one: the cells of the tests, twice."""
    kinds = "{name: training, analysed: false, conditions: {peak_velocities_mm_s: [90]}}, {name: test, times: 2}"
    shutil.copytree(Path(__file__).parents[2] / "protocols", tmp_path / "protocols")
    file = tmp_path / "protocols" / "demo.yaml"
    file.write_text(file.read_text("utf-8").replace("schedule:\n", f"schedule:\n  sessions: [{kinds}]\n"), "utf-8")
    preflight = examine(file).require()
    design = designs_for(preflight, Observer.read("paper"))[""]
    tests = preflight.at("", "test").experiment.protocol
    assert preflight.experiment.protocol.conditions.peak_velocities_mm_s == (90,)
    assert design.levels == tests.conditions.peak_velocities_mm_s != (90,)
    assert design.n_repetitions == 2 * tests.schedule.repetitions
    for session in (1, 2, 3):
        simulate_session(preflight, "p01", tmp_path / "results", observer=Observer(), session=session)
    assert fit_answers(preflight, tmp_path / "results", Observer()).n_answers == 2 * len(design.cells)


def test_simulate_gives_every_participant_all_kinds_of_session(preflight: Preflight, tmp_path: Path) -> None:
    """Training alone could not be analysed."""
    file = preflight.findings.protocol.source.path
    done = call(f"simulate {file} -n 2 --results {tmp_path} --json")
    folders = [Path(each).parts[-3:-1] for each in json.loads(done.stdout)["sessions"]]
    assert folders == [(who, session) for who in ("sub-sim01", "sub-sim02") for session in ("ses-1", "ses-2")]


@pytest.fixture(scope="module")
def balanced(preflight: Preflight, tmp_path_factory: pytest.TempPathFactory) -> Preflight:
    """The same with groups assigned from the records."""
    file = preflight.experiment.sources.protocol.path
    text = (
        Path(file).read_text("utf-8").replace("schedule:\n  sessions", "schedule:\n  balance: least_filled\n  sessions")
    )
    other = Path(file).with_name("balanced.yaml")
    other.write_text(text, "utf-8")
    return examine(other).require()


def test_simultaneous_sessions_get_different_groups(balanced: Preflight, tmp_path: Path) -> None:
    """Both were wired before either was recorded: the second is refused, and gets the other group."""
    first, second = (wire_run(balanced, name, answers="simulated", results=tmp_path) for name in ("p01", "p02"))
    assert begin(first).occasion[0] == "near"
    with pytest.raises(RecordInputError, match="the group near for participant p02, .*now far is due: begin again"):
        begin(second)
    assert not second.place.log.exists()
    assert sit(balanced, tmp_path, "p02").occasion[0] == "far"


def test_a_dropout_is_replaced_in_its_group(balanced: Preflight, tmp_path: Path) -> None:
    """P01 of near is complete, p02 of far incomplete, so p03 is in far."""
    first, second = (sit(balanced, tmp_path, name) for name in ("p01", "p02"))
    assert (first.occasion[0], second.occasion[0]) == ("near", "far")
    second.path.write_bytes(b"".join(second.path.read_bytes().splitlines(keepends=True)[:-12]))
    assert sit(balanced, tmp_path, "p03").occasion[0] == "far"


def test_an_empty_log_causes_no_gap(preflight: Preflight, tmp_path: Path) -> None:
    """A kill while the file was created: the next session, given by its number, begins."""
    setup = wire_run(preflight, "p01", answers="simulated", results=tmp_path)
    setup.place.log.parent.mkdir(parents=True)
    setup.place.log.touch()
    assert wire_run(preflight, "p01", session=2, answers="simulated", results=tmp_path).place.session == 2
