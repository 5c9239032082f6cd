"""Levels as multiples of the participant's threshold: from the session that measured it to the statistics."""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from modaltouch.analysis.crossed import Analysis
from modaltouch.analysis.pipeline import analyse, read_responses
from modaltouch.planning.design import designs_for
from modaltouch.planning.fitting import fit_answers
from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import Participant
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol import InputError
from modaltouch.record.audit import audit_session
from modaltouch.record.chain import GENESIS, encode_line, read_chain
from modaltouch.record.folders import SessionFolder
from modaltouch.record.session import Session, read_session
from modaltouch.session.console import Console, Request
from modaltouch.session.resumption import resume, wire_resume
from modaltouch.session.setup import begin
from modaltouch.session.wiring import wire_run
from modaltouch.window.interface import SessionStopped

pytestmark = pytest.mark.usefixtures("undrawn")

PROTOCOLS = Path(__file__).parents[2] / "protocols"
FAINT = Observer(Participant(detection_speed=0.015, lapse_rate=0.01), name="faint")
"""Feels only what moves fast, so that thresholds lie well within the levels."""

PEOPLE = ("p01", "p02", "p03")
MULTIPLES = [1.0, 1.5, 2.0, 3.0]


@pytest.fixture(scope="module")
def preflight() -> Preflight:
    """The shipped protocol."""
    return examine(PROTOCOLS / "sensation_levels.yaml").require()


@pytest.fixture(scope="module")
def finding(tmp_path_factory: pytest.TempPathFactory) -> Preflight:
    """The shipped protocol that measures thresholds, with runs of 16 trials."""
    folder = tmp_path_factory.mktemp("protocols") / "protocols"
    shutil.copytree(PROTOCOLS, folder)
    file = folder / "threshold.yaml"
    text = file.read_text(encoding="utf-8").replace("trials: 40", "trials: 16").replace("trials: 10", "trials: 4")
    file.write_text(text, encoding="utf-8")
    return examine(file).require()


@pytest.fixture(scope="module")
def results(preflight: Preflight, finding: Preflight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three participants, each with a threshold session and one at levels derived from it."""
    folder = tmp_path_factory.mktemp("results")
    for participant in PEOPLE:
        for each in (finding, preflight):
            begin(wire_run(each, participant, answers="simulated", results=folder, observer=FAINT))
    return folder


def session_of(results: Path, participant: str) -> Session:
    """Return a participant's session at individual levels."""
    return read_session(SessionFolder(results, "simulated", "sensation_levels", participant).log)


def test_everyone_gets_multiples_of_their_own_threshold(results: Path, tmp_path: Path) -> None:
    """Reference: the geometric mean of the thresholds that the analysis of the first session reports."""
    found = analyse(results / "simulated" / "threshold", tmp_path / "out").as_dict()["thresholds"]
    seen = set()
    for participant in PEOPLE:
        own = [row["threshold_mm_s"] for row in found if row["participant"] == participant]
        assert len(own) == 2
        session = session_of(results, participant)
        facts = session.start["sensation_levels"]
        assert facts["threshold_mm_s"] == pytest.approx(math.prod(own) ** 0.5, rel=1e-3)
        assert [run["threshold_mm_s"] for run in facts["runs"]] == own
        assert facts["levels_mm_s"] == pytest.approx([m * facts["threshold_mm_s"] for m in MULTIPLES], rel=1e-3)
        velocities = {event["trial"]["condition"]["velocity_mm_s"] for event in session.trials}
        assert velocities == {0.0, *facts["levels_mm_s"]}
        seen.add(facts["threshold_mm_s"])
    assert len(seen) == 3, "the simulated participants differ"


def test_the_instrument_plays_the_levels_and_all_get_the_same_codes(results: Path) -> None:
    """Amplitudes are in proportion to the multiples; everyone has the burst of the bounds."""
    sessions = [session_of(results, participant) for participant in PEOPLE]
    assert len({session.start["stimulus"]["content_hash"] for session in sessions}) == 1
    for session in sessions:
        amplitudes = {}
        for event in session.trials:
            if event["trial"]["condition"]["velocity_mm_s"] != 0:
                assert event["confirmed"]["confirmed"]
                level = event["trial"]["condition"]["velocity_mm_s"]
                amplitudes[session.multiples[level]] = event["commanded"]["amplitude_Vpp"][0]
        ratios = {multiple: value / amplitudes[1.0] for multiple, value in sorted(amplitudes.items())}
        assert list(ratios.values()) == pytest.approx(MULTIPLES, rel=2e-3)


def test_the_table_has_the_multiple_of_every_answer(results: Path) -> None:
    """BIDS view: velocity and multiple of the threshold; no multiple in a catch trial."""
    session = session_of(results, "p02")
    table = next(session.path.parent.glob("*_beh.tsv"))
    frame = pd.read_csv(table, sep="\t")
    threshold = session.start["sensation_levels"]["threshold_mm_s"]
    driven = frame[frame["catch"] == 0]
    assert (driven["velocity_mm_s"] / driven["multiple_of_threshold"]).to_numpy() == pytest.approx(threshold, rel=1e-3)
    assert frame.loc[frame["catch"] == 1, "multiple_of_threshold"].isna().all()
    side = json.loads(table.with_suffix(".json").read_text(encoding="utf-8"))
    assert side["multiple_of_threshold"]["Units"] == "1"


def test_the_analysis_counts_by_multiple(results: Path, tmp_path: Path) -> None:
    """Participants at different velocities share their cells; every level has its unit."""
    found = analyse(results / "simulated" / "sensation_levels", tmp_path / "out")
    assert isinstance(found, Analysis)
    assert found.answers.levels == tuple(MULTIPLES)
    assert found.answers.counts.sum() == 3 * 40
    counts = pd.read_csv(tmp_path / "out" / "counts.csv")
    assert "velocity_mm_s" not in counts
    assert sorted(counts["multiple_of_threshold"].unique()) == MULTIPLES
    trends = found.tests.loc[found.tests["question"] == "b", "quantity"].dropna()
    assert set(trends) == {"change of P(C) with the level", "change of P(C) per one threshold"}
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    words = re.sub(r"<[^>]+>", " ", report)
    assert "1.5 x threshold" in words
    assert "own threshold [mm/s]" in words
    for participant in PEOPLE:
        assert f"{session_of(results, participant).start['sensation_levels']['threshold_mm_s']:g}" in words
    assert not re.search(r"\b(1|1\.5|2|3) mm/s", words), "a multiple is no velocity"


def test_more_is_felt_at_higher_multiples(results: Path) -> None:
    """At the threshold about half of the answers name C, at three times nearly all."""
    frame = read_responses(results / "simulated" / "sensation_levels").frame
    right = ((frame["zone_left"] == "C") & (frame["response"] == "left")) | (
        (frame["zone_right"] == "C") & (frame["response"] == "right")
    )
    share = right.groupby(frame["multiple_of_threshold"]).mean()
    assert share[1.0] < share[3.0]
    assert share[3.0] > 0.8


def test_an_interrupted_session_continues_at_the_same_levels(preflight: Preflight, tmp_path: Path) -> None:
    """From its record alone, without asking for the threshold again."""
    setup = wire_run(preflight, "p07", answers="simulated", results=tmp_path, observer=FAINT, threshold_mm_s=12.34)
    with pytest.raises(SessionStopped):
        begin(_stopped_after(setup, 9))
    log = setup.place.log
    order = [event["trial"] for event in read_session(log).trials]
    resumed = resume(wire_resume(log.parent))
    assert resumed.complete
    assert [event["trial"] for event in resumed.trials][: len(order)] == order
    assert set(resumed.multiples.values()) == set(MULTIPLES)
    assert list(resumed.multiples) == [12.34, 18.51, 24.68, 37.02]
    verdict = audit_session(Session.find(log.parent))
    assert verdict.problems == ()
    assert "levels follow from the threshold of 12.34 mm/s, as it was given" in verdict.lines


def test_a_restarted_session_keeps_the_levels(preflight: Preflight, tmp_path: Path) -> None:
    """The new record has the order and the levels of the interrupted session."""
    setup = wire_run(preflight, "p08", answers="simulated", results=tmp_path, observer=FAINT, threshold_mm_s=12.34)
    with pytest.raises(SessionStopped):
        begin(_stopped_after(setup, 5))
    anew = resume(wire_resume(setup.place.log.parent, restart=True))
    assert anew.complete
    assert list(anew.multiples) == [12.34, 18.51, 24.68, 37.02]
    assert audit_session(Session.find(anew.path.parent)).problems == ()


def _stopped_after(setup, n_trials: int):
    """Return a setup whose session is stopped after some answers."""

    class Experimenter(Console):
        def __init__(self) -> None:
            self.n_answered = 0

        def show(self, facts: dict[str, Any]) -> None:
            self.n_answered = facts["n_answered"]

        def requests(self) -> list[Request]:
            return [Request("stop")] * (self.n_answered >= n_trials)

    return replace(setup, console=Experimenter())


@pytest.mark.parametrize(
    ("forge", "words"),
    [
        (lambda start: start["sensation_levels"].update(threshold_mm_s=9.0), "do not follow from the threshold"),
        (lambda start: start["sensation_levels"].update(last_check="0" * 64), "has changed since the threshold"),
    ],
)
def test_a_forged_threshold_is_detected(results: Path, tmp_path: Path, forge, words: str) -> None:
    """Changed in the record, with all checksums recomputed."""
    copy = tmp_path / "results"
    shutil.copytree(results, copy)
    log = SessionFolder(copy, "simulated", "sensation_levels", "p01").log
    events = [dict(event) for event in read_chain(log).events]
    forge(events[0])
    lines, check = [], GENESIS
    for event in events:
        line, check = encode_line(event, check)
        lines.append(line)
    log.write_bytes(b"".join(lines))
    assert any(words in problem for problem in audit_session(Session.find(log.parent)).problems)


@pytest.mark.parametrize(
    ("participant", "given", "words"),
    [
        ("p99", None, "participant p99 has no complete session of it in"),
        ("p01", 90.0, "90 mm/s, which gives 270 mm/s; allowed: 2 to 200 mm/s, so thresholds of 2 to 66.67 mm/s"),
        ("p01", 1.5, "1 times the threshold of participant p01, 1.5 mm/s, which gives 1.5 mm/s"),
    ],
)
def test_unknown_and_unplayable_thresholds_are_refused(
    preflight: Preflight, results: Path, participant: str, given: float | None, words: str
) -> None:
    """With the position in the protocol and the remedy, before anything is recorded."""
    with pytest.raises(InputError, match=re.escape(words)) as told:
        wire_run(preflight, participant, answers="simulated", results=results, session=5, threshold_mm_s=given)
    assert re.search(r"sensation_levels\.yaml:\d+:\d+: conditions\.sensation_levels\.", str(told.value))


def test_a_session_without_a_threshold_is_refused(preflight: Preflight, finding: Preflight, tmp_path: Path) -> None:
    """A guessing participant has none: with the reason from the run, and the remedy."""
    guessing = Observer(Participant(lapse_rate=1.0), name="guessing")
    begin(wire_run(finding, "p01", answers="simulated", results=tmp_path, observer=guessing))
    said = r"2 of 2 runs of participant p01 give no threshold \(one_hand A-C: .*give the threshold with --thr"
    with pytest.raises(InputError, match=said):
        wire_run(preflight, "p01", answers="simulated", results=tmp_path)


def test_the_latest_complete_session_counts(
    preflight: Preflight, finding: Preflight, results: Path, tmp_path: Path
) -> None:
    """A second session replaces the first; an interrupted third does not."""
    for session, observer in ((1, FAINT), (2, Observer(Participant(detection_speed=0.03, lapse_rate=0.01)))):
        begin(wire_run(finding, "p01", session=session, answers="simulated", results=tmp_path, observer=observer))
    with pytest.raises(SessionStopped):
        begin(_stopped_after(wire_run(finding, "p01", session=3, answers="simulated", results=tmp_path), 9))
    facts = wire_run(preflight, "p01", answers="simulated", results=tmp_path).facts["sensation_levels"]
    assert facts["session"] == "simulated/threshold/sub-p01/ses-2/beh/session.jsonl"
    assert facts["threshold_mm_s"] > 1.2 * session_of(results, "p01").start["sensation_levels"]["threshold_mm_s"]


@pytest.mark.parametrize("spoil", [lambda data: data.replace(b"answer", b"answar", 1), lambda data: data[:-40]])
def test_a_damaged_session_is_not_skipped_for_an_older_one(
    preflight: Preflight, results: Path, tmp_path: Path, spoil
) -> None:
    """The older threshold may differ: refused, with `modaltouch doctor` as the remedy."""
    shutil.copytree(results / "simulated" / "threshold" / "sub-p01", tmp_path / "simulated" / "threshold" / "sub-p01")
    first = tmp_path / "simulated" / "threshold" / "sub-p01" / "ses-1"
    shutil.copytree(first, first.with_name("ses-2"))
    log = first.with_name("ses-2") / "beh" / "session.jsonl"
    log.write_bytes(spoil(log.read_bytes()))
    with pytest.raises(InputError, match=r"latest session of participant p01 is damaged \(.*ses-2.*modaltouch doctor"):
        wire_run(preflight, "p01", answers="simulated", results=tmp_path)


def test_thresholds_need_an_adaptive_protocol(edit, tmp_path: Path) -> None:
    """A protocol with fixed levels is refused even if it has sessions."""
    results = tmp_path / "results"
    begin(wire_run(examine(PROTOCOLS / "demo.yaml").require(), "p01", answers="simulated", results=results))
    preflight = examine(edit("sensation_levels.yaml", ("from: threshold ", "from: demo "))).require()
    with pytest.raises(InputError, match=r"'demo', whose session .* is not adaptive; allowed: an adaptive protocol"):
        wire_run(preflight, "p01", answers="simulated", results=results)


def test_a_threshold_is_refused_for_fixed_levels(tmp_path: Path) -> None:
    """It would be ignored."""
    demo = examine(PROTOCOLS / "demo.yaml").require()
    with pytest.raises(InputError, match=r"a threshold of 20 mm/s, but the levels do not depend on a threshold.*leave"):
        wire_run(demo, "p01", answers="simulated", results=tmp_path, threshold_mm_s=20.0)


def test_fixed_and_calibrated_levels_are_not_mixed(results: Path, tmp_path: Path, edit) -> None:
    """Under one protocol name a level would have two meanings."""
    shutil.copytree(results, tmp_path / "results")
    fixed = edit(
        "sensation_levels.yaml",
        ("    thresholds_from: threshold        # name of the protocol that measures the thresholds\n", ""),
        ("  sensation_levels:\n", ""),
        ("    multiples: [1, 1.5, 2, 3]\n", ""),
        ("[2, 200]      # lowest and highest level for any participant", "[20, 30, 40, 60]"),
    )
    begin(wire_run(examine(fixed).require(), "p04", answers="simulated", results=tmp_path / "results"))
    with pytest.raises(InputError, match=r"several kinds of levels \(.*(fixed|calibrated), .*(fixed|calibrated)\)"):
        read_responses(tmp_path / "results" / "simulated" / "sensation_levels")


def test_power_and_fit_refuse_individual_levels(preflight: Preflight, results: Path) -> None:
    """With a reason, since they work with velocities."""
    with pytest.raises(InputError, match="levels calibrated by participant, which depend on thresholds not yet known"):
        designs_for(preflight, FAINT)
    with pytest.raises(InputError, match="levels calibrated by participant, so each felt different velocities"):
        fit_answers(preflight, results / "simulated" / "sensation_levels", FAINT)
