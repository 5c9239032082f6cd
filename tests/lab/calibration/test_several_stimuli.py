"""Calibration of a protocol with several stimuli: one file, each stimulus correct on the rig, used by sessions."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modaltouch.__main__ import main
from modaltouch.lab.calibration import calibrate_each, design_inputs_of
from modaltouch.lab.laboratory import MeasurementProgress, open_laboratory
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.calibration import examine_calibration
from modaltouch.protocol.source import Source

SHIPPED = Path(__file__).parents[3] / "protocols"
TWO_FIELDS = SHIPPED / "two_fields.yaml"


def command(*words: object) -> int:
    """Return the exit status of a command."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration of the shipped protocol with two stimuli, on the simulated rig."""
    out = tmp_path_factory.mktemp("several") / "calibration.yaml"
    assert command("calibrate", TWO_FIELDS, "--out", out) == 0
    return out


def changed(made: Path, folder: Path, *changes: tuple[str, str]) -> Path:
    """Write the calibration with changes and return its file."""
    text = made.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "changed.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_the_rig_is_identified_once(make_bench: Callable, mismatched: Apparatus) -> None:
    """Amplifier, clock and modes are measured before the first stimulus only; both end within 0.3 mm/s."""
    preflight = examine(TWO_FIELDS).require()
    bench, steps = make_bench(mismatched, 3), []

    def show(what: str, done: int, total: int) -> None:
        if done == 0:
            steps.append(what)

    said: list[str] = []
    bench.progress = MeasurementProgress(show=show, say=said.append)
    outcomes = calibrate_each(bench, mismatched, design_inputs_of(preflight))
    assert list(outcomes) == ["sharp", "blunt"]
    assert [words for words in said if words.startswith("stimulus")] == ["stimulus sharp", "stimulus blunt"]
    identified = ["amplifier and clock", "modes, by output 1", "modes, by output 2", "before"]
    assert steps[:4] == [f"sharp: {words}" for words in identified]
    after = [words for words in steps if words.startswith("blunt: ")]
    assert after[0] == "blunt: before"
    assert not any("amplifier" in words or "modes" in words for words in after)
    assert outcomes["sharp"].plant is outcomes["blunt"].plant
    for outcome in outcomes.values():
        assert outcome.turns[0].worst > 1e-3 > 0.3e-3 > outcome.best.worst
    assert not np.array_equal(outcomes["sharp"].target, outcomes["blunt"].target)


@pytest.mark.parametrize("name", ["sharp", "blunt"])
def test_a_session_plays_each_stimulus_within_the_limits(made: Path, name: str) -> None:
    """0.3 mm/s in velocity and w eta of every mode and 1 % of each level, by the twin's true state."""
    part = examine(TWO_FIELDS, made).require().parts[name]
    stimulus, uncalibrated = part.stimulus, examine(TWO_FIELDS).require().parts[name].stimulus
    with open_laboratory(part.experiment.apparatus) as laboratory:
        assert laboratory.simulator is not None
        shapes = laboratory.simulator.twin.beam.shapes(0.0)[:, 0]

        def worst(burst_of: Preflight, level: float) -> float:
            laboratory.load(burst_of.burst)
            assert laboratory.rig.fire(level).started
            state = laboratory.simulator.true_state(stimulus.timing.focusing_instant)
            laboratory.rig.stop()
            wished = stimulus.target * level / stimulus.target_field.velocity
            focus = float(shapes @ np.append(state.velocity, state.unlisted_velocity))
            off = max(float(np.abs(state.velocity - wished).max()), float(np.abs(state.displacement).max()))
            return max(off, 0.3e-3 * abs(focus / level - 1) / 0.01)

        assert worst(uncalibrated, stimulus.levels[-1]) > 0.6e-3
        assert all(worst(stimulus, level) <= 0.3e-3 for level in stimulus.levels)


def test_the_record_has_the_calibration_and_is_verified(made: Path, edit: Callable, tmp_path: Path) -> None:
    """`verify` recomputes the drives of both stimuli from the record."""
    protocol = edit("two_fields.yaml", ("repetitions: 2", "repetitions: 1"))
    copy = tmp_path / "calibration.yaml"
    copy.write_bytes(made.read_bytes())
    words = (
        "run",
        protocol,
        "-p",
        "p01",
        "--rig",
        "simulated",
        "--answers",
        "simulated",
        "--results",
        tmp_path / "results",
        "--yes",
    )
    assert command(*words, "--calibration", copy) == 0
    copy.unlink()
    (log,) = (tmp_path / "results").rglob("session.jsonl")
    assert command("verify", log) == 0
    start = json.loads(log.read_text(encoding="utf-8").splitlines()[0])
    hashes = start["stimulus"]["content_hashes"]
    before = examine(protocol).require().content_hashes
    assert set(hashes) == set(before)
    assert all(hashes[name] != before[name] for name in hashes)


def test_the_check_shows_the_largest_error(made: Path) -> None:
    """After calibration, over both stimuli, as in the file."""
    held = examine_calibration(Source.load(made)).value
    assert held is not None
    errors = [abs(e) for own in held.by_stimulus.values() for mode in own.modes for e in mode.error_after_mm_s]
    told = examine(TWO_FIELDS, made).require().as_dict()["calibration"]
    assert told["worst_modal_error_mm_s"] == max(errors) < 0.3
    assert told["reference_mm_s"] == 150


@pytest.mark.parametrize(
    ("protocol", "changes", "place", "words"),
    [
        ("two_fields", [("  blunt:", "  round:")], "stimuli", "stimuli sharp, round; allowed: one of sharp, blunt"),
        ("demo", [], "stimuli", "of the stimuli sharp, blunt; allowed: one of a single stimulus"),
        ("two_fields", [("base_mm: 100", "base_mm: 90")], "stimuli.blunt.stimulus.field", "(stimulus blunt)"),
        ("two_fields", [("label: 13", "label: 15")], "stimuli.sharp.modes", "1, 3, 5, 7, 9, 11, 15"),
        ("two_fields", [("positions_mm: [", "positions_mm: [a, ")], "positions_mm[0]", "'a'; allowed: a number [mm]"),
    ],
)  # fmt: skip
def test_a_calibration_that_does_not_fit_is_refused(
    made: Path, tmp_path: Path, protocol: str, changes: list[tuple[str, str]], place: str, words: str
) -> None:
    """With file, line and key; a common fault once, an individual one with its stimulus."""
    file = changed(made, tmp_path, *changes)
    problems = [str(each) for each in examine(SHIPPED / f"{protocol}.yaml", file).problems]
    assert any(str(file) in each and f" {place}: " in each and words in each for each in problems), problems


def test_a_calibration_of_one_stimulus_is_refused_for_several() -> None:
    """The message has the stimuli and the remedy."""
    file = Path(__file__).with_name("of_one_stimulus.yaml")
    (problem,) = (each for each in examine(TWO_FIELDS, file).problems if each.path == "stimuli")
    assert "a calibration of one stimulus; allowed: one of sharp, blunt" in str(problem)
    assert "calibrate again" in str(problem)


def test_the_papers_law_is_refused_at_its_stimulus(
    edit: Callable, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With exit status 2, before anything is opened."""
    protocol = edit("two_fields.yaml", ("blunt: {field", "blunt: {law: paper, field"))
    assert command("calibrate", protocol, "--out", tmp_path / "c.yaml") == 2
    assert "stimuli.blunt.law: given paper, a law whose targets cannot be corrected" in " ".join(
        capsys.readouterr().err.split()
    )
    assert not (tmp_path / "c.yaml").exists()


def test_a_faulty_calibration_hides_no_fault_of_the_protocol(made: Path, edit: Callable, tmp_path: Path) -> None:
    """An invalid value in the file and a level beyond the apparatus are reported together."""
    protocol = edit("two_fields.yaml", ("[80, 150]", "[80, 900]"))
    file = changed(made, tmp_path, ("positions_mm: [", "positions_mm: [a, "))
    paths = {problem.path for problem in examine(protocol, file).problems}
    assert paths == {"positions_mm[0]", "conditions.peak_velocities_mm_s[1]"}
