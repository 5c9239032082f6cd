"""`calibrate` through VISA, then a session with its file, judged by the twin's true state.

``MODALTOUCH_CALIBRATED_BEAMS`` sets the number of beams; ``make soak-calibration`` uses forty.
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modaltouch.__main__ import main
from modaltouch.analysis.provenance import take_facts
from modaltouch.lab.laboratory import Laboratory, open_laboratory
from modaltouch.preflight import examine
from modaltouch.record.chain import read_chain
from modaltouch.record.session import Session
from modaltouch.rig.scope import Recording

N_BEAMS = int(os.environ.get("MODALTOUCH_CALIBRATED_BEAMS", "1"))

MISMATCH = (
    ("natural_frequency_mismatch: 0.001", "natural_frequency_mismatch: 0.005"),
    ("damping_ratio_mismatch: 0.02", "damping_ratio_mismatch: 0.1"),
    ("  gain_mismatch: 0.02", "  gain_mismatch: 0.1"),
    ("amplifier: {bandwidth_kHz: 300, delay_us: 1}", "amplifier: {bandwidth_kHz: 100, delay_us: 5}"),
)


def command(*words: object) -> int:
    """Return the exit status of a command."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return int(ended.value.code or 0)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("seed", range(100, 100 + N_BEAMS))
def test_a_calibrated_session_plays_the_target_field(
    seed: int, edit: Callable, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """0.3 mm/s in velocity and w eta of every mode and 1 % of each level, by the twin's true state."""
    apparatus = edit("apparatus/beam_100x6x2.yaml", ("  seed: 1\n", f"  seed: {seed}\n"), *MISMATCH)
    folder = apparatus.parents[1]
    protocol, out = folder / "differentiated_stimulation.yaml", tmp_path / "calibration.yaml"
    assert command("calibrate", protocol, "--out", out, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["iterations"][0]["worst_displacement_error_mm_s"] > 2
    assert told["instruments"]["mode"] == "simulated"
    preflight = examine(protocol, out).require()
    stimulus = preflight.stimulus
    with open_laboratory(preflight.experiment.apparatus) as laboratory:
        assert laboratory.simulator is not None
        laboratory.load(stimulus.burst)
        shapes = laboratory.simulator.twin.beam.shapes(0.0)[:, 0]
        for level in stimulus.levels:
            assert laboratory.rig.fire(level).started
            state = laboratory.simulator.true_state(stimulus.timing.focusing_instant)
            wished = stimulus.target * level / stimulus.target_field.velocity
            assert np.abs(state.velocity - wished).max() <= 0.3e-3
            assert np.abs(state.displacement).max() <= 0.3e-3
            assert shapes @ np.append(state.velocity, state.unlisted_velocity) == pytest.approx(level, rel=0.01)
            laboratory.rig.stop()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration of the shipped demonstration on the simulated rig."""
    out = tmp_path_factory.mktemp("calibration") / "calibration.yaml"
    protocol = Path(__file__).parents[3] / "protocols" / "demo.yaml"
    assert command("calibrate", protocol, "--out", out, "--person", "tester") == 0
    return out


def test_the_record_has_the_calibration(made: Path, edit: Callable, tmp_path: Path) -> None:
    """`verify` recomputes the drive from the record alone."""
    protocol = edit("demo.yaml")
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
    (log,) = (tmp_path / "results").rglob("session.jsonl")
    start = read_chain(log).events[0]
    assert start["sources"]["calibration"]["text"] == made.read_text(encoding="utf-8")
    assert start["stimulus"]["content_hash"] != examine(protocol).stimulus.burst.content_hash
    copy.unlink()
    assert command("verify", log) == 0


def test_a_marked_calibration_is_stated_in_record_and_report(made: Path, edit: Callable, tmp_path: Path) -> None:
    """Refused without its option; with it, the log's first line and the report have the mark."""
    protocol, marked = edit("demo.yaml"), tmp_path / "marked.yaml"
    mark = "missed:\n- {limit: level_percent, level_mm_s: 200, reached: 2, allowed: 1}\ncauses: [a test]\n"
    unmarked = made.read_text(encoding="utf-8").replace("missed: []\n", "").replace("causes: []\n", "")
    marked.write_text(unmarked + mark, encoding="utf-8")
    words = ("simulate", protocol, "-n", 1, "--results", tmp_path / "results", "--calibration", marked)
    assert command(*words) == 2
    assert command(*words, "--with-marked-calibration") == 0
    (log,) = (tmp_path / "results").rglob("session.jsonl")
    said = "level_percent 2 at 200 mm/s (allowed 1): a test"
    assert read_chain(log).events[0]["calibration_mark"] == said
    assert take_facts(Session.find(log)).settings["calibration"] == f"misses its limits: {said}"


def test_another_generator_is_refused(
    made: Path, edit: Callable, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A different serial number: exit status 2 with the position in the file, before any record."""
    protocol, other = edit("demo.yaml"), tmp_path / "other.yaml"
    other.write_text(made.read_text(encoding="utf-8").replace(",SIMULATED,", ",C012345,"), encoding="utf-8")
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
    assert command(*words, "--calibration", other) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "instruments.generator: given TEKTRONIX,AFG3022B,C012345" in said
    assert not list((tmp_path / "results").rglob("session.jsonl"))


def test_an_existing_file_is_refused_before_anything_is_opened(made: Path, shipped: Path) -> None:
    """Exit status 4, with the file unchanged."""
    before = made.read_bytes()
    assert command("calibrate", shipped / "demo.yaml", "--out", made) == 4
    assert made.read_bytes() == before


def test_calibrate_needs_a_valid_protocol(edit: Callable, tmp_path: Path) -> None:
    """Otherwise exit status 2, and nothing is written."""
    path = edit("demo.yaml", ("focus: C", "focus: Q"))
    assert command("calibrate", path, "--out", tmp_path / "c.yaml") == 2
    assert not (tmp_path / "c.yaml").exists()


def test_a_signal_ends_calibrate_with_the_outputs_off(
    shipped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """SIGINT in the fourth record: exit status 130 before a fifth, no file, one JSON object."""
    records, outputs = [], []
    genuine = Laboratory.record

    def record(self: Laboratory, *asked: Any) -> Recording:
        records.append(asked)
        if len(records) == 4:
            os.kill(os.getpid(), signal.SIGINT)
        recording = genuine(self, *asked)
        assert self.simulator is not None
        outputs.append(self.simulator.outputs)
        return recording

    monkeypatch.setattr(Laboratory, "record", record)
    assert command("calibrate", shipped / "demo.yaml", "--out", tmp_path / "c.yaml", "--json") == 130
    assert len(records) == 4
    assert outputs[-1] == (False, False)
    assert "the outputs are off" in json.loads(capsys.readouterr().out)["error"]
    assert list(tmp_path.glob("*.yaml")) == []
