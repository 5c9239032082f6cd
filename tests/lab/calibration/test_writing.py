"""A calibration file gives the same stimulus when read back, and is never overwritten."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from modaltouch.lab.calibration import CalibrationLoop
from modaltouch.lab.calibration.file import (
    CalibrationResult,
    calibration_of,
    corrected_inputs,
    write_calibration,
)
from modaltouch.preflight import Preflight, examine
from modaltouch.preflight.single_design import design_to_fit
from modaltouch.protocol.calibration import Calibration, examine_calibration
from modaltouch.protocol.source import Source
from modaltouch.record.chain import RecordError


@pytest.fixture(scope="module")
def outcome(preflight: Preflight, make_bench: Callable) -> CalibrationResult:
    """A calibration of the shipped twin, with one level corrected."""
    apparatus = preflight.experiment.apparatus
    bench = make_bench(apparatus, 1, lambda amplitude: 1.02 if amplitude < 7 else 1.0)
    return CalibrationLoop(bench, apparatus, preflight.inputs).run()


@pytest.fixture(scope="module")
def calibration(preflight: Preflight, outcome: CalibrationResult) -> Calibration:
    """The contents of its file."""
    return calibration_of(
        {"": outcome},
        protocol="differentiated_stimulation",
        apparatus=preflight.experiment.apparatus,
        generator="TEKTRONIX,AFG3022B,C012345,SCPI:99.0 FV:3.2.2\n",
        scope="PicoScope 3404D, 0001",
        mode="real",
        person="Zoé",
        made=datetime(2026, 5, 4, 10, 30, tzinfo=UTC),
    )


def test_a_calibration_is_read_back_unchanged(calibration: Calibration, tmp_path: Path) -> None:
    """Every value, through YAML and the reader with line numbers."""
    write_calibration(calibration, tmp_path / "c.yaml")
    reading = examine_calibration(Source.load(tmp_path / "c.yaml"))
    assert reading.problems == ()
    assert reading.value == calibration
    assert calibration.person == "Zoé"
    assert calibration.made == "2026-05-04T10:30:00+00:00"


def test_the_session_plays_what_the_loop_verified(
    preflight: Preflight, outcome: CalibrationResult, calibration: Calibration, tmp_path: Path
) -> None:
    """Codes and amplitudes designed from the file are those of the measured stimulus."""
    path = tmp_path / "calibration.yaml"
    write_calibration(calibration, path)
    read = examine(preflight.findings.protocol.source.path, path).require().stimulus
    verified = design_to_fit(corrected_inputs(preflight.inputs, outcome.refined, outcome.correction))
    assert read.burst.content_hash == verified.burst.content_hash
    for level, kept in zip(read.levels, calibration.levels, strict=True):
        assert read.burst.amplitude_for(level) == kept.amplitude_Vpp
    assert calibration.levels[0].amplitude_factor == pytest.approx(1 / 1.02, rel=5e-3)


def test_a_file_of_the_former_format_is_readable() -> None:
    """For one stimulus, without faults, with its keys in the former places."""
    text = Path(__file__).with_name("of_one_stimulus.yaml").read_text(encoding="utf-8")
    reading = examine_calibration(Source(Path("c.yaml"), text))
    assert reading.problems == ()
    assert reading.value is not None
    assert list(reading.value.by_stimulus) == [""]
    only = reading.value.alone("")
    assert only == reading.value
    assert only.modes[0].target_mm_s == reading.sound("modes", 0, "target_mm_s")
    assert reading.value.alone("sharp") is None


def test_an_existing_file_is_not_overwritten(calibration: Calibration, tmp_path: Path) -> None:
    """A second calibration into the same file is refused, and the first is unchanged."""
    path = tmp_path / "folder" / "calibration.yaml"
    write_calibration(calibration, path)
    before = path.read_bytes()
    with pytest.raises(RecordError, match="exists already and is not overwritten; give another file with --out"):
        write_calibration(calibration, path)
    assert path.read_bytes() == before
    assert [each.name for each in path.parent.iterdir()] == ["calibration.yaml"]


def test_an_impossible_folder_is_refused(calibration: Calibration, tmp_path: Path) -> None:
    """A file has the name of the folder."""
    (tmp_path / "taken").write_text("")
    with pytest.raises(RecordError, match="c.yaml: cannot be written"):
        write_calibration(calibration, tmp_path / "taken" / "c.yaml")
