"""Calibrations that fit a protocol, and refusals with positions."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from modaltouch.preflight import examine, examine_findings
from modaltouch.protocol import Findings, Protocol, Sources
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.calibration import check_age, examine_calibration
from modaltouch.protocol.reading import read
from modaltouch.protocol.source import Source

IDENTITY = "TEKTRONIX,AFG3022B,C012345,SCPI:99.0 FV:3.2.2"


def text_for(apparatus: Path, *, made: str = "") -> str:
    """Return a calibration of the demonstration, with targets as listed."""
    listed = Apparatus.read(apparatus)
    made = made or datetime.now(UTC).isoformat(timespec="seconds")
    modes = "\n".join(
        f"- {{label: {mode.label}, natural_frequency_Hz: {mode.natural_frequency_Hz}, damping_ratio: "
        f"{mode.damping_ratio}, gain_mm_s2_per_V: {{centre: {mode.gain_mm_s2_per_V.get('centre', 1.0)}, side: "
        f"{mode.gain_mm_s2_per_V.get('side', 1.0)}}}, wished_mm_s: 1, target_mm_s: {20 if mode.label < 8 else 0}, "
        "target_displacement_mm_s: 0.5, error_before_mm_s: [1, 2], error_after_mm_s: [0.1, -0.2], "
        "uncertainty_mm_s: 0.05}"
        for mode in listed.modes
    )
    levels = "amplitude_Vpp: [6, 1], at_focus_mm_s: 80, uncertainty_mm_s: 1, highest_mm_s: 80"
    return f"""\
calibration: 1
made: '{made}'
made_by: modaltouch 0.1.0
protocol: demo
apparatus: {{name: beam_100x6x2, sha256: {listed.measured_hash}}}
instruments: {{generator: '{IDENTITY}', scope: a scope, mode: real}}
stimulus:
  focus: C
  field: {{shape: triangle, base_mm: 56}}
  repetition_rate_Hz: 7
focus_centre_mm: 0
reference_mm_s: 200
amplifier: {{gain_V_per_V: 25.1, bandwidth_kHz: 300, delay_us: 1}}
measuring_chain: {{vibrometer_delay_us: 4, vibrometer_lag_us: 0.6, clock_offset_ppm: 5}}
positions_mm: [-10, 10]
iterations:
- {{iteration: 0, worst_velocity_error_mm_s: 1, worst_displacement_error_mm_s: 2, peak_voltage_V: 180}}
modes:
{modes}
levels:
- {{velocity_mm_s: 80, amplitude_factor: 1, {levels}}}
- {{velocity_mm_s: 200, amplitude_factor: 1.01, {levels}}}
"""


@pytest.fixture
def calibrate(tmp_path: Path, edit: Callable) -> Callable[..., tuple[Path, Path]]:
    """Return a function that writes a changed protocol and a calibration of the unchanged one."""

    def make(*changes: tuple[str, str], made: str = "") -> tuple[Path, Path]:
        protocol = edit("demo.yaml", *changes)
        path = protocol.parent / "calibration.yaml"
        path.write_text(text_for(protocol.parent / "apparatus" / "beam_100x6x2.yaml", made=made), encoding="utf-8")
        return protocol, path

    return make


def problems(protocol: Path, calibration: Path | None) -> str:
    """Return all problems, one per line."""
    return "\n".join(map(str, examine(protocol, calibration).problems))


def test_the_stimulus_uses_the_calibration(calibrate: Callable) -> None:
    """Corrected targets, measured amplifier, level corrections."""
    protocol, calibration = calibrate()
    stimulus = examine(protocol, calibration).require().stimulus
    velocity, displacement = stimulus.corrected_target
    assert velocity[:4] == pytest.approx([0.02] * 4)
    assert displacement == pytest.approx([0.5e-3] * 9)
    assert stimulus.amplifier.delay == pytest.approx(1e-6)
    assert stimulus.amplifier.bandwidth == pytest.approx(300e3)
    assert stimulus.worst_modal_error(0.2) < 1e-6
    untrimmed = stimulus.burst.amplitude[0]
    assert stimulus.burst.amplitude_for(0.2)[0] == pytest.approx(1.01 * untrimmed, rel=1e-3)
    assert stimulus.burst.amplitude_for(0.08)[0] == pytest.approx(0.4 * untrimmed, rel=1e-3)


def test_a_protocol_may_name_its_calibration(calibrate: Callable) -> None:
    """`calibration.file` is relative to the protocol; --calibration takes precedence."""
    named = ("title: Demonstration", "title: Demonstration\ncalibration: {file: calibration.yaml, required: true}")
    protocol, _ = calibrate(named)
    preflight = examine(protocol).require()
    assert preflight.as_dict()["calibration"]["worst_modal_error_mm_s"] == 0.2
    assert preflight.experiment.sources.as_dict()["calibration"]["path"].endswith("calibration.yaml")
    assert examine(protocol, uncalibrated=True).require().as_dict()["calibration"] is None


def test_a_missing_calibration_file_is_reported_at_its_key(calibrate: Callable) -> None:
    """With line and column of the name."""
    protocol, path = calibrate(("title: Demonstration", "title: Demonstration\ncalibration: {file: calibration.yaml}"))
    path.unlink()
    said = problems(protocol, None)
    assert "demo.yaml:5:21: calibration.file: given 'calibration.yaml', a file that does not exist" in said
    assert "allowed: a YAML file that exists and can be read, as a path relative to this file" in said


def test_a_required_calibration_must_be_given(calibrate: Callable) -> None:
    """The problem is at the key that requires it."""
    protocol, path = calibrate(("title: Demonstration", "title: Demonstration\ncalibration: {required: true}"))
    assert "calibration.required: given true, but no calibration is given" in problems(protocol, None)
    assert problems(protocol, path) == ""


def test_a_calibration_of_another_apparatus_is_refused(calibrate: Callable) -> None:
    """A changed gain is refused; a changed comment, zone width or safety limit is not."""
    protocol, path = calibrate()
    apparatus = protocol.parent / "apparatus" / "beam_100x6x2.yaml"
    text = apparatus.read_text(encoding="utf-8")
    apparatus.write_text(text.replace("velocity_limit_mm_s: 500  #", "velocity_limit_mm_s: 450  # lower:"), "utf-8")
    assert problems(protocol, path) == ""
    apparatus.write_text(text.replace("{centre: 654}", "{centre: 655}"), encoding="utf-8")
    assert "calibration.yaml:5:41: apparatus.sha256: given a calibration of another apparatus" in problems(
        protocol, path
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("base_mm: 56", "base_mm: 50", "stimulus.field: given triangle 56, from a calibration of another stimulus"),
        ("selected_modes: 6", "selected_modes: 5", "stimulus: given 6, from a calibration of another stimulus"),
        ("focus: C", "focus: B", "stimulus.focus: given C, from a calibration of another stimulus"),
        ("law: exact", "law: paper", "given exact, from a calibration of another stimulus; allowed: paper"),
        ("[80, 200]", "[80, 150]", "given 150 mm/s, a level that was not calibrated; allowed: 80, 200"),
    ],
)
def test_a_calibration_of_another_stimulus_is_refused(calibrate: Callable, old: str, new: str, said: str) -> None:
    """The message has the key that differs, with both values."""
    assert said.replace("stimulus: ", "stimulus.selected_modes: ") in problems(*calibrate((old, new)))


def test_the_release_may_differ_from_the_calibration(calibrate: Callable) -> None:
    """The field at the focusing instant is the same."""
    assert problems(*calibrate(("release: braked", "release: free"))) == ""


def test_age_is_unlimited_by_default(calibrate: Callable) -> None:
    """A calibration eight days old is accepted."""
    made = (datetime.now(UTC) - timedelta(days=8)).isoformat(timespec="seconds")
    assert problems(*calibrate(made=made)) == ""


@pytest.mark.parametrize(("days", "refused"), [(7, True), (10, False)])
def test_a_calibration_older_than_the_limit_is_refused(calibrate: Callable, days: int, *, refused: bool) -> None:
    """The message has its age."""
    made = (datetime.now(UTC) - timedelta(days=8)).isoformat(timespec="seconds")
    limit = ("title: Demonstration", f"title: Demonstration\ncalibration: {{max_age_days: {days}}}")
    said = problems(*calibrate(limit, made=made))
    assert ("calibration.max_age_days: given 7 days, but the calibration" in said) is refused
    assert ("is 8.0 days old" in said) is refused


@pytest.mark.parametrize(
    ("made", "said"),
    [
        ("yesterday", "'yesterday', which is not a valid instant"),
        ("2026-05-04T10:30:00", "which is not a valid instant"),
        ("2999-01-01T00:00:00+00:00", "which lies in the future"),
    ],
)
def test_invalid_instants_are_refused(calibrate: Callable, made: str, said: str) -> None:
    """No date, a date without offset from UTC, and a date in the future."""
    assert said in problems(*calibrate(made=made))


def test_age_is_counted_from_the_instant_and_not_from_the_file(shipped: Path) -> None:
    """Half an hour before and after the limit."""
    text = text_for(shipped / "apparatus" / "beam_100x6x2.yaml", made="2026-05-04T12:00:00+02:00")
    calibration = examine_calibration(Source(Path("c.yaml"), text))
    protocol = read(
        Source(
            Path("p.yaml"),
            Source.load(shipped / "demo.yaml").text + "\ncalibration: {max_age_days: 1}\n",
        ),
        Protocol,
    )
    limit = datetime(2026, 5, 5, 10, 0, tzinfo=UTC)
    assert not list(check_age(calibration, protocol, limit - timedelta(minutes=30)))
    assert len(list(check_age(calibration, protocol, limit + timedelta(minutes=30)))) == 1


def test_another_serial_number_is_refused(shipped: Path) -> None:
    """Maker, model and serial number must match; the firmware need not."""
    calibration = examine_calibration(Source(Path("c.yaml"), text_for(shipped / "apparatus" / "beam_100x6x2.yaml")))
    findings = Findings(None, None, None, (), calibration)
    assert findings.generator_problem(IDENTITY + "9\n") is None
    found = findings.generator_problem(IDENTITY.replace("C012345", "C099999"))
    assert str(found).startswith("c.yaml:6:26: instruments.generator: given TEKTRONIX,AFG3022B,C012345")


def test_an_inconsistent_file_is_refused(calibrate: Callable) -> None:
    """An unknown actuator set, a missing mode and a faulty apparatus give problems, not exceptions."""
    protocol, path = calibrate()
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("side: ", "rim: ", 1), encoding="utf-8")
    assert "modes[0].gain_mm_s2_per_V: given gains by centre, rim; allowed: one by each of centre, side" in problems(
        protocol, path
    )
    lines = [line for line in text.splitlines() if "label: 9," not in line]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert "given modes 1, 3, 5, 7, 11" in problems(protocol, path)
    apparatus = protocol.parent / "apparatus" / "beam_100x6x2.yaml"
    apparatus.write_text(apparatus.read_text(encoding="utf-8").replace("width_mm: 6", "width_mm: -6"), "utf-8")
    assert "width_mm" in problems(protocol, path)


def test_faults_of_the_file_have_their_position(calibrate: Callable) -> None:
    """An invalid number and a missing key are reported together."""
    protocol, path = calibrate()
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("focus_centre_mm: 0\n", "").replace("reference_mm_s: 200", "reference_mm_s: fast"))
    said = problems(protocol, path)
    assert "focus_centre_mm" in said
    assert "calibration.yaml:11:17: reference_mm_s" in said


def test_a_record_is_restored_whatever_the_age_of_its_calibration(calibrate: Callable) -> None:
    """`resume` and `verify` get the same codes, although a new session would be refused."""
    made = (datetime.now(UTC) - timedelta(days=400)).isoformat(timespec="seconds")
    limit = ("title: Demonstration", "title: Demonstration\ncalibration: {required: true, max_age_days: 500}")
    protocol, path = calibrate(limit, made=made)
    begun = examine(protocol, path).require()
    recorded = json.loads(json.dumps(begun.experiment.sources.as_dict()))
    recorded["protocol"]["text"] = recorded["protocol"]["text"].replace("500}", "5}")
    restored = examine_findings(Findings.restored(Sources.from_dict(recorded))).require()
    assert restored.stimulus.burst.content_hash == begun.stimulus.burst.content_hash
    plain = examine(protocol, uncalibrated=True).stimulus.burst.content_hash
    assert restored.stimulus.burst.content_hash != plain


MARK = """\
missed:
- {limit: drive_percent, level_mm_s: 200, reached: 13.6, allowed: 1}
causes: [the amplifier saturates]
"""


def test_a_marked_calibration_needs_its_option(edit: Callable, tmp_path: Path) -> None:
    """Refused with limit and cause at its line; with the option, check and record have the mark."""
    protocol = edit("demo.yaml")
    file = tmp_path / "marked.yaml"
    file.write_text(text_for(protocol.parent / "apparatus" / "beam_100x6x2.yaml") + MARK, encoding="utf-8")
    (problem,) = examine(protocol, file).problems
    line = file.read_text(encoding="utf-8").splitlines().index("missed:") + 2
    assert str(problem).startswith(f"{file}:{line}:")
    assert "drive_percent 13.6 at 200 mm/s (allowed 1): the amplifier saturates" in problem.given
    assert "--with-marked-calibration" in problem.remedy
    preflight = examine(protocol, file, marked=True).require()
    told = preflight.as_dict()
    assert told["calibration"]["mark"] == preflight.calibration_mark
    assert told["warnings"][0].startswith("the calibration misses its limits: drive_percent 13.6 at 200 mm/s")
    restored = examine_findings(Findings.restored(preflight.experiment.sources)).require()
    assert restored.calibration_mark == preflight.calibration_mark
