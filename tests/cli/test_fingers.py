"""The finger probe at the command line: what it prints, and what it requests from the lab."""

import json

import pytest
from typer.testing import CliRunner

from modaltouch.cli import app
from modaltouch.rig import RigError

FOUND = {
    "placements": [
        {
            "placement": "right index on A, right middle on C",
            "misfit": 1.13,
            "asked_mm_s": 100,
            "level_mm_s": 99.83,
            "interval_mm_s": [99.51, 100.16],
            "attainable_mm_s": 114.2,
        }
    ],
    "fingers": {"right": {"index": {"mass_g": 0.0812, "damping_N_s_per_m": 0.502, "offset_mm": -1.254}}},
    "sensitivity_uncertainty_percent": 1.0,
    "file": "mine.yaml",
}


@pytest.fixture
def asked(monkeypatch):
    """The options that the command passes to the lab."""
    given = []
    monkeypatch.setattr("modaltouch.lab.probe_fingers", lambda *_, **options: given.append(options) or FOUND)
    return given


def test_the_probe_prints_its_results(asked):
    """Each finger, the level with its interval, the attainable level and the file are printed."""
    result = CliRunner().invoke(app, ["fingers", "probe", "demo", "--pair", "A-C"], env={"COLUMNS": "160"})
    assert result.exit_code == 0
    row = next(row for row in result.stdout.splitlines() if "0.0812" in row)
    assert [cell.strip() for cell in row.split("│")[1:-1]] == ["right index", "0.0812", "0.502", "0", "-1.25"]
    assert "99.8 (99.5 to 100.2)" in result.stdout
    assert "the vibrometer's sensitivity, known to 1 %, an error all levels share" in result.stdout
    assert "Written: mine.yaml" in result.stdout


def test_options_reach_the_lab_in_si_units(asked):
    """The command line takes millimetres and millimetres per second."""
    words = ["fingers", "probe", "demo", "--laser-mm", "-46", "--speed-mm-s", "5", "--hand", "left", "--json"]
    result = CliRunner().invoke(app, words)
    assert json.loads(result.stdout) == FOUND
    (options,) = asked
    assert [options[name] for name in ("laser", "speed", "hand", "pair")] == [-0.046, 0.005, "left", ""]


def test_a_refused_probe_is_a_failure_of_the_rig(monkeypatch):
    """Exit status 3 with the message only: nothing is wrong with what was given."""

    def refuse(*_, **options):
        raise RigError("the records of the probe differ; the outputs are off")

    monkeypatch.setattr("modaltouch.lab.probe_fingers", refuse)
    result = CliRunner().invoke(app, ["fingers", "probe", "demo"])
    assert result.exit_code == 3
    assert result.stderr.strip() == "the records of the probe differ; the outputs are off"
