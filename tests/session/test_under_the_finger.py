"""Sessions of a protocol designed for fingers: presented, recorded, verified, resumed and analysed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from modaltouch.cli import app
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol import Findings, Trial
from modaltouch.record.audit import audit_session
from modaltouch.record.chain import GENESIS, encode_line, read_chain
from modaltouch.record.session import Session, read_session
from modaltouch.session.resumption import resume, wire_resume
from modaltouch.session.wiring import simulate_session

pytestmark = pytest.mark.usefixtures("undrawn")

PROTOCOLS = Path(__file__).parents[2] / "protocols"
LEVELS = [40, 60, 80, 100]
LIGHT = "fingers: {mass_g: 0.06, damping_N_s_per_m: 0.4, stiffness_N_per_mm: 0.4}\nspread: {mass: 0.3, damping: 0.3}\n"
HEAVY = "fingers: {mass_g: 0.3, damping_N_s_per_m: 2, stiffness_N_per_mm: 2}\n"
BY_HAND = """\
fingers:
  left:
    index: {mass_g: 0.08, damping_N_s_per_m: 0.5}
  right:
    index: {mass_g: 0.05, damping_N_s_per_m: 0.4}
    middle: {mass_g: 0.1, damping_N_s_per_m: 0.3}
"""


def protocol_for(folder: Path, fingers: str, *changes: tuple[str, str], name: str = "with_catch_trials") -> Path:
    """Return a copy of a shipped protocol designed for the fingers in a file, at attainable levels."""
    shutil.copytree(PROTOCOLS, folder)
    (folder / "mine.yaml").write_text(fingers, encoding="utf-8")
    file = folder / f"{name}.yaml"
    text = file.read_text(encoding="utf-8")
    designed = ("  focus: C  ", "  fingers: mine.yaml\n  focus: C  "), ("[80, 100, 150, 200]", str(LEVELS))
    for old, new in (*designed, *changes):
        assert text.count(old) == 1
        text = text.replace(old, new)
    file.write_text(text, encoding="utf-8")
    return file


def run(*words: object) -> Result:
    """Run the command line in this process."""
    return CliRunner().invoke(app, [str(word) for word in words])


def test_levels_are_equalised_in_a_band(tmp_path: Path) -> None:
    """Root mean square velocity at C in 20 to 1000 Hz, by a brick-wall filter, is equal over pairs."""
    band = ("  focus: C  ", "  equalise_band_Hz: [20, 1000]\n  focus: C  ")
    file = protocol_for(tmp_path / "protocols", HEAVY, (str(LEVELS), "[20]"), band)
    preflight, felt = examine(file).require(), []
    for part in preflight.designs.values():
        (level,) = part.inputs.levels.values()
        history = part.stimulus.velocity_history([0.0], level * 1e-3, whole_period=True)[0]
        spectrum, place = np.fft.rfft(history), np.fft.rfftfreq(history.size, 1 / part.stimulus.timing.sampling_rate)
        spectrum[(place < 20) | (place > 1000)] = 0
        felt.append((np.fft.irfft(spectrum, history.size) ** 2).mean() ** 0.5)
    assert felt == pytest.approx([felt[0]] * 3, rel=1e-4)
    share = preflight.placed["B-D"].inputs.share
    assert abs(share - 1) > 0.01
    (said,) = (each for each in preflight.as_dict()["warnings"] if "20 to 1000 Hz" in each)
    assert said.endswith(f"levels are multiplied by A-C 1, B-D {share:g}, C-E 1")
    session = simulate_session(preflight, "p01", tmp_path)
    assert audit_session(session).problems == ()
    for event in presented(session):
        played = 20 * (share if event["trial"]["condition"]["zone_left"] == "B" else 1)
        needed = preflight.designs[preflight.design_of(Trial.from_dict(event["trial"]).condition)].stimulus
        assert event["planned"]["velocity_mm_s"] == (0 if event.get("catch") else 20)
        assert tuple(event["commanded"]["amplitude_Vpp"]) == needed.burst.amplitude_for(played * 1e-3)


@pytest.mark.parametrize(
    ("band", "words"),
    [
        ("[1000, 20]", "given 1000 to 20 Hz; allowed: the lower end first; swap"),
        (
            "[22, 27]",
            "given 22 to 27 Hz, which contains no multiple of the repetition rate of 7 Hz; allowed: a band that",
        ),
        (
            "[2000000, 3000000]",
            "which contains no multiple of the repetition rate of 7 Hz; allowed: a band that contains a multiple of",
        ),
        (
            "[20, 1000]\n  priority: level",
            "given level, with the equalise_band_Hz (20.0, 1000.0); allowed: field",
        ),
    ],
)
def test_invalid_bands_are_refused(tmp_path: Path, band: str, words: str) -> None:
    """At their key."""
    own = ("  focus: C  ", f"  equalise_band_Hz: {band}\n  focus: C  ")
    (problem,) = examine(protocol_for(tmp_path / "protocols", HEAVY, own)).problems
    assert words in str(problem)


def presented(session: Session) -> list[dict[str, Any]]:
    """Return the answered main trials of a session."""
    return [event for event in session.trials if not event["trial"]["practice"]]


def answered(session: Session) -> list[tuple[bool, int, dict[str, Any], str]]:
    """Return conditions and answers, in order."""
    return [
        (event["trial"]["practice"], event["trial"]["index"], event["trial"]["condition"], event["response"]["answer"])
        for event in session.trials
    ]


@pytest.fixture(scope="module")
def protocol(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's experiment with catch trials, for light fingers."""
    return protocol_for(tmp_path_factory.mktemp("study") / "protocols", LIGHT)


@pytest.fixture(scope="module")
def preflight(protocol: Path) -> Preflight:
    """The same, examined."""
    return examine(protocol).require()


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory, preflight: Preflight) -> list[Session]:
    """Simulated sessions of two participants."""
    results = tmp_path_factory.mktemp("results")
    return [simulate_session(preflight, name, results) for name in ("p01", "p02")]


@pytest.fixture
def copied(sessions: list[Session], tmp_path: Path) -> Path:
    """The log of the first in a tree that a test may change."""
    results = sessions[0].path.parents[5]
    return Path(shutil.copytree(results, tmp_path / "results")) / sessions[0].path.relative_to(results)


def test_every_session_is_complete_and_verified(sessions: list[Session]) -> None:
    """24 trials, 6 catch trials and 3 of practice."""
    for session in sessions:
        assert session.complete
        assert len(presented(session)) == 30
        assert audit_session(Session.find(session.path)).problems == ()
        assert run("verify", session.path.parent).exit_code == 0
    assert answered(sessions[0]) != answered(sessions[1])


def test_the_planned_speeds_are_those_under_the_fingers(sessions: list[Session], preflight: Preflight) -> None:
    """Peak speeds at the touched zones, under the fingers on that pair; 0 in a catch trial."""
    touched = {row["velocity_mm_s"]: row["touched"] for row in preflight.as_dict()["stimuli"]}
    assert list(touched) == LEVELS
    for event in presented(sessions[0]):
        condition, planned = event["trial"]["condition"], event["planned"]
        left, right, level = condition["zone_left"], condition["zone_right"], condition["velocity_mm_s"]
        peaks = dict.fromkeys("ABCDE", 0.0) if level == 0 else touched[level][f"{left}-{right}"]["zone_peak_mm_s"]
        speeds = planned["speed_left_mm_s"], planned["speed_right_mm_s"]
        assert speeds == pytest.approx((peaks[left], peaks[right]), abs=1e-3)


def test_each_pair_is_presented_with_its_own_drive(sessions: list[Session], preflight: Preflight) -> None:
    """The confirmed amplitudes are those of the design for that pair's fingers."""
    seen = {}
    for event in presented(sessions[0]):
        condition = event["trial"]["condition"]
        if condition["velocity_mm_s"]:
            pair = f"{condition['zone_left']}-{condition['zone_right']}"
            burst = preflight.designs[pair].stimulus.burst
            sent = tuple(event["confirmed"]["confirmed_amplitude"])
            assert sent == tuple(burst.amplitude_for(condition["velocity_mm_s"] * 1e-3))
            seen[pair, condition["velocity_mm_s"]] = sent
    assert len(seen) == 12
    assert seen["A-C", 100.0] == seen["C-E", 100.0] != seen["B-D", 100.0]


def test_catch_trials_are_silent(sessions: list[Session]) -> None:
    """Six per session, answered "none" by an observer who does not guess."""
    for session in sessions:
        silent = [event for event in presented(session) if event["trial"]["condition"]["velocity_mm_s"] == 0]
        assert [event["response"]["answer"] for event in silent] == ["none"] * 6
        assert all(event["catch"] for event in silent)


def test_the_record_has_every_design_and_the_fingers(sessions: list[Session], preflight: Preflight) -> None:
    """Codes, fields and speeds by placement, and the text of the file."""
    start = sessions[0].start
    assert start["stimulus"]["content_hashes"] == preflight.content_hashes
    assert list(preflight.content_hashes) == ["A-C", "B-D", "C-E"]
    assert [(row["placement"], row["velocity_mm_s"]) for row in start["stimulus"]["stimuli"]] == [
        (pair, level) for pair in preflight.content_hashes for level in LEVELS
    ]
    assert start["sources"]["fingers"]["text"] == LIGHT


def test_a_later_change_of_the_file_does_not_matter(protocol: Path, sessions: list[Session], copied: Path) -> None:
    """The record has the text with which the session began."""
    own = protocol.with_name("mine.yaml")
    own.write_text(HEAVY, encoding="utf-8")
    try:
        assert audit_session(Session.find(copied)).problems == ()
        assert run("verify", copied.parent).exit_code == 0
    finally:
        own.write_text(LIGHT, encoding="utf-8")


def test_fingers_changed_in_the_record_are_detected(copied: Path) -> None:
    """Other fingers have another drive, even with all checksums recomputed."""
    check, lines = GENESIS, []
    for event in read_chain(copied).events:
        if event["event"] == "start":
            fingers = event["sources"]["fingers"]
            fingers["text"] = fingers["text"].replace("mass_g: 0.06", "mass_g: 0.07")
        line, check = encode_line(event, check)
        lines.append(line)
    copied.write_bytes(b"".join(lines))
    assert any("the recomputed drive" in problem for problem in audit_session(Session.find(copied)).problems)


@pytest.mark.parametrize("n_lines", [12, 41])
def test_an_interrupted_session_continues_with_its_fingers(
    protocol: Path, sessions: list[Session], copied: Path, n_lines: int
) -> None:
    """Resumed after the file was changed: the same trials, answers and speeds."""
    copied.write_bytes(b"".join(copied.read_bytes().splitlines(keepends=True)[:n_lines]))
    for view in copied.parent.glob("*_beh.*"):
        view.unlink()  # made after every answer: one of the whole session would tell that lines are gone
    own = protocol.with_name("mine.yaml")
    own.write_text(HEAVY, encoding="utf-8")
    try:
        done = resume(wire_resume(copied))
    finally:
        own.write_text(LIGHT, encoding="utf-8")
    assert done.complete
    assert answered(done) == answered(sessions[0])
    assert [event["planned"] for event in done.trials] == [event["planned"] for event in sessions[0].trials]
    assert audit_session(Session.find(done.path)).problems == ()


def test_sessions_are_analysed_with_the_recorded_speeds(sessions: list[Session], tmp_path: Path) -> None:
    """Catch trials are counted separately."""
    results = sessions[0].path.parents[5]
    done = run("analyse", results, "--out", tmp_path / "analysis")
    assert done.exit_code == 0, done.output
    tests = json.loads((tmp_path / "analysis" / "tests.json").read_text(encoding="utf-8"))
    catches = [row for row in tests if row["question"] == "catch"]
    assert [row["estimate"] for row in catches[:2]] == [0, 0]


def test_simulated_fingers_follow_from_the_seed(sessions: list[Session], preflight: Preflight, tmp_path: Path) -> None:
    """The same seed and participant give the same answers."""
    assert answered(simulate_session(preflight, "p01", tmp_path)) == answered(sessions[0])


def test_simulated_participants_have_individual_fingers(preflight: Preflight, shipped: Path) -> None:
    """With the spread of the file: in mass and damping, not in stiffness; none without fingers in the design."""
    findings = preflight.findings
    drawn = [findings.with_true_fingers(np.random.default_rng(seed)).twin.fingers for seed in (1, 2, 1)]
    first, second, again = (
        (0, 0, 0) if f is None else (f.mass_g, f.damping_N_s_per_m, f.stiffness_N_per_mm) for f in drawn
    )
    assert first == again
    assert first[0] != second[0]
    assert first[1] != second[1]
    assert first[2] == second[2] == 0.4
    untouched = Findings.read(shipped / "demo.yaml")
    assert untouched.with_true_fingers(np.random.default_rng(1)).twin.fingers is None


def test_the_twins_spreads_override_those_of_the_file(tmp_path: Path) -> None:
    """Between placements the file's spread applies, between trials the apparatus's."""
    file = protocol_for(
        tmp_path / "protocols", f"{LIGHT}placement_spread: {{mass: 0.2}}\ntrial_spread: {{mass: 0.1}}\n"
    )
    beam = file.parent / "apparatus" / "beam_100x6x2.yaml"
    beam.write_text(beam.read_text("utf-8") + "  finger_trial_spread: {mass: 0.5}\n", "utf-8")
    twin = Findings.read(file).with_true_fingers(np.random.default_rng(1)).twin
    assert (twin.finger_spread.mass, twin.finger_trial_spread.mass) == (0.2, 0.5)


def test_fingers_by_hand_have_a_design_per_placement(tmp_path: Path) -> None:
    """One and two hands have different fingers; eight waveforms alternate in four memories."""
    pairs = "[[A, C], [B, D], [C, E]]", "[[A, C], [B, D]]"
    protocol = protocol_for(tmp_path / "protocols", BY_HAND, pairs, name="differentiated_stimulation")
    changed = protocol.read_text(encoding="utf-8").replace("  max_same_pair_running: 2\n", "")
    protocol.write_text(changed, encoding="utf-8")
    preflight = examine(protocol).require()
    assert list(preflight.designs) == ["A-C", "B-D", "A-C left index, right index", "B-D left index, right index"]
    assert len({codes.tobytes() for burst in preflight.bursts for codes in burst.codes}) == 8
    session = simulate_session(preflight, "p01", tmp_path / "results")
    assert audit_session(Session.find(session.path)).problems == ()
    read = read_session(session.path)
    speeds: dict[str, dict[float, tuple[float, float]]] = {"one_hand": {}, "two_hands": {}}
    for event in presented(read):
        condition, planned = event["trial"]["condition"], event["planned"]
        pair = planned["speed_left_mm_s"], planned["speed_right_mm_s"]
        if condition["zone_left"] != "A":
            continue
        speeds[condition["finger_condition"]][condition["velocity_mm_s"]] = pair
    for name, place in (("one_hand", "A-C"), ("two_hands", "A-C left index, right index")):
        for level, found in speeds[name].items():
            peaks = preflight.zone_peaks(place, level)
            assert found == pytest.approx((peaks["A"] * 1e3, peaks["C"] * 1e3), abs=1e-3)
    assert speeds["one_hand"] != speeds["two_hands"]
