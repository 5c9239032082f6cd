"""``modaltouch identify`` as a user runs it: exit status, messages, one JSON object, nothing half written."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from modaltouch.cli import app
from modaltouch.lab.laboratory import Laboratory
from modaltouch.rig import Recording
from modaltouch.system.operating_system import Interrupted, Interruption

APPARATUS = str(Path(__file__).parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml")
RUN = CliRunner()

pytestmark = pytest.mark.usefixtures("undrawn")


def responses_file(folder: Path) -> Path:
    """Write one velocity response of two modes."""
    frequency = np.arange(1, 1200) * 0.5
    omega = 2 * np.pi * frequency
    values = np.zeros(frequency.size, dtype=complex)
    for own, ratio in ((120.0, 0.01), (330.0, 0.01)):
        pole = 2 * np.pi * own
        values += 1j * omega / (pole**2 - omega**2 + 2j * ratio * pole * omega)
    rng = np.random.default_rng(0)
    values += 1e-5 * (rng.standard_normal(values.size) + 1j * rng.standard_normal(values.size))
    path = folder / "point.npz"
    np.savez(path, frequency=frequency, response=values[None, None], sets=["hammer"], quantity="velocity")
    return path


def test_a_file_of_responses_gives_a_table_and_figures(tmp_path: Path) -> None:
    """Standard output has one JSON object; there is no apparatus file, since a hammer has no voltage."""
    out = tmp_path / "out"
    done = RUN.invoke(app, ["identify", str(responses_file(tmp_path)), "--out", str(out), "--json"])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert [mode["natural_frequency_Hz"]["value"] for mode in result["modes"]] == pytest.approx([120, 330], rel=1e-3)
    assert result["apparatus_file"] is None
    assert {path.name for path in out.iterdir()} >= {"table_1.csv", "identification.json", "stability.png"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--points", "15"], "15 points are too few to distinguish modes 14 and 16"),
        (["--set", "left"], "'left' is not an actuator set"),
        (["--modes", "some"], "--modes is 'some': give `listed`, `all`, or labels"),
        (["--drive-V", "400"], "an excitation of 400 V was requested: allowed above 0 and up to 250 V"),
        (["--highest-kHz", "500"], "an excitation up to 500 kHz was requested"),
        (["nothing.csv"], "nothing.csv: there is no such file"),
    ],
)
def test_bad_input_exits_with_2_and_writes_nothing(tmp_path: Path, arguments: list[str], words: str) -> None:
    """The message is on standard error, or in one JSON object with --json; the folder is not created."""
    command = ["identify", *arguments, "--apparatus", APPARATUS, "--out", str(tmp_path / "out")]
    said = RUN.invoke(app, command)
    assert said.exit_code == 2
    assert words in " ".join(said.stderr.split())
    told = RUN.invoke(app, [*command, "--json"])
    assert told.exit_code == 2
    assert words in json.loads(told.stdout)["error"]
    assert not (tmp_path / "out").exists()


def test_a_folder_without_a_scan_of_a_set_is_refused(tmp_path: Path) -> None:
    """The message gives the actuator set without a scan."""
    said = RUN.invoke(app, ["identify", str(tmp_path), "--apparatus", APPARATUS, "--out", str(tmp_path / "out")])
    assert said.exit_code == 2
    assert "there is no scan of the actuator set centre (scan_centre is missing)" in " ".join(said.stderr.split())


def test_a_folder_of_another_command_is_not_overwritten(tmp_path: Path) -> None:
    """The folder holds a plan: exit status 4 before anything is measured."""
    manifest = tmp_path / "manifest.json"
    manifest.write_text(json.dumps({"generated_by": "modaltouch power", "files": {}}))
    said = RUN.invoke(app, ["identify", str(responses_file(tmp_path)), "--out", str(tmp_path)])
    assert said.exit_code == 4
    assert "contains output of `modaltouch power`" in said.stderr


def test_a_scan_without_a_terminal_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a terminal nobody can aim the vibrometer of a real rig: exit status 2, not 41 records of one point."""

    @contextmanager
    def open_laboratory(*parts: Any, **options: object) -> Iterator[None]:
        parts[2].aim(0.0125, 0.0)
        yield

    monkeypatch.setattr("modaltouch.lab.identification.command.open_laboratory", open_laboratory)
    said = RUN.invoke(app, ["identify", "--apparatus", APPARATUS, "--out", str(tmp_path / "out")])
    assert said.exit_code == 2
    assert "+12.50 mm from mid-beam" in said.stderr
    assert "someone must aim the vibrometer" in " ".join(said.stderr.split())


@pytest.mark.parametrize(
    ("command", "kept"),
    [
        (("identify", "--apparatus", APPARATUS, "--out", "kept"), "2 of 41 points are kept in kept/scan_centre"),
        (("validate", "demo", "--scan", "kept"), "2 of 41 points are kept in kept/exact_field"),
        (("compare", "demo"), "nothing measured is kept"),
    ],
    ids=["identify", "validate", "compare"],
)
def test_an_interrupted_scan_reports_the_points_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...], kept: str
) -> None:
    """Exit status 130; the message gives the number of points on disk, their folder and how to continue."""
    passed = iter(range(2))

    def check(self: Interruption) -> None:
        if next(passed, None) is None:
            raise Interrupted("SIGINT")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Interruption, "check", check)
    said = RUN.invoke(app, list(command))
    assert said.exit_code == 130
    assert f"ended by SIGINT: the outputs are off; {kept}" in " ".join(said.stderr.split())
    assert ("; run the same command again to continue" in said.stderr) is ("kept" in command)
    assert len(list(tmp_path.rglob("position_*.npz"))) == 2 * ("kept" in command)


def test_ctrl_c_while_aiming_reports_the_points_kept(tmp_path: Path, monkeypatch) -> None:
    """The prompt ends immediately by its own exception, and the points on disk are still reported."""
    monkeypatch.chdir(tmp_path)
    recorded = Laboratory.record

    def record(self: Laboratory, position: float, *parts: Any) -> Recording:
        if position > -0.048:
            raise KeyboardInterrupt
        return recorded(self, position, *parts)

    monkeypatch.setattr(Laboratory, "record", record)
    said = RUN.invoke(app, ["validate", "demo", "--scan", "kept"])
    assert said.exit_code == 130
    assert "interrupted: the outputs are off; 1 of 41 points are kept in kept/exact_field; run" in said.stderr
