"""The command ``modaltouch calibrate``: stimuli and levels that can be calibrated, and the calibration file."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

from modaltouch.lab.calibration.file import calibration_of, write_calibration
from modaltouch.lab.calibration.loop import calibrate_each
from modaltouch.lab.calibration.plausibility import mark_of
from modaltouch.lab.laboratory import SILENT_PROGRESS, SIMULATED, MeasurementProgress, open_laboratory
from modaltouch.lab.recorded_files import RecordedFiles
from modaltouch.preflight import DesignInputs, Preflight, examine
from modaltouch.protocol import InputError, Problem, Protocol
from modaltouch.record import prepare_file
from modaltouch.rig import RigError


def calibrate(
    protocol: Path,
    out: Path,
    *,
    rig: str = SIMULATED,
    person: str = "",
    accept: bool = False,
    record: Path | None = None,
    progress: MeasurementProgress = SILENT_PROGRESS,
) -> dict[str, Any]:
    """Calibrate every stimulus of a protocol on a rig, write the file, and return its values with its path.

    Parameters
    ----------
    protocol : Path
        A YAML file, or the name of a shipped protocol.
    out : Path
        The calibration file; never overwritten.
    rig : str
        ``simulated``, or the generator's VISA address.
    person, accept
        Name of the operator for the file; whether a calibration that misses its limits is written, with a mark.
    record : Path, optional
        Folder into which another scope saves its records as files; a PicoScope is used if not given.
    progress : MeasurementProgress, optional
        Reports progress and lets the user interrupt.

    Raises
    ------
    InputError
        If the protocol has faults, or the targets of a stimulus cannot be corrected.
    RecordError
        If the file cannot be written, or exists already.
    RigError
        If the rig fails or is not that of the apparatus file, or an error exceeds ``calibration.limits``.
    """
    preflight = examine(protocol, uncalibrated=True).of_untouched_beam()
    experiment, inputs_of = preflight.experiment, design_inputs_of(preflight)
    prepare_file(out)
    with progress.interruptible() as heard:
        scope = RecordedFiles(record, experiment.apparatus, heard) if record else None
        with open_laboratory(experiment.apparatus, rig, heard, scope=scope) as laboratory:
            outcomes = calibrate_each(laboratory, experiment.apparatus, inputs_of, levels_between(experiment.protocol))
            calibration = calibration_of(
                outcomes,
                protocol=experiment.protocol.protocol,
                apparatus=experiment.apparatus,
                generator=laboratory.rig.identity,
                scope=laboratory.scope.identity,
                mode=laboratory.mode,
                person=person,
                made=datetime.now().astimezone(),
                marks={name: mark_of(outcome, experiment.protocol) for name, outcome in outcomes.items()},
            )
    if calibration.mark and not accept:
        raise RigError(
            f"the calibration misses its limits: {calibration.mark}; the outputs are off and nothing is written; "
            "--accept writes it with a mark, and --with-marked-calibration lets a session use it"
        )
    return write_calibration(calibration, out)


N_BETWEEN = 3
"""Number of levels verified between the bounds of a protocol that may play any level."""


def design_inputs_of(preflight: Preflight) -> dict[str, DesignInputs]:
    """Return the design inputs of each stimulus of a checked protocol, by name; a single stimulus has an empty name."""
    preflight.require()
    faults = {name: list(_uncorrectable(part)) for name, part in preflight.parts.items()}
    problems = [each for name, own in faults.items() for each in preflight.findings.at_stimulus(name, own)]
    if problems:
        raise InputError(problems)
    return {name: part.sound[0] for name, part in preflight.parts.items()}


def levels_between(protocol: Protocol) -> tuple[float, ...]:
    """Return the levels to verify between a protocol's bounds, at equal ratios [mm/s].

    Adaptive runs, and sensation levels relative to a participant's threshold, may use any level between the bounds.
    Other protocols need none, since all levels that they play are measured.
    """
    if protocol.adaptive is None and protocol.conditions.sensation_levels is None:
        return ()
    low, *_, high = sorted(protocol.conditions.peak_velocities_mm_s)
    ratio = (high / low) ** (1 / (N_BETWEEN + 1))
    return tuple(float(f"{low * ratio**step:.4g}") for step in range(1, N_BETWEEN + 1))


def _uncorrectable(preflight: Preflight) -> Iterator[Problem]:
    """Yield the reasons why the targets of a protocol's single stimulus cannot be corrected."""
    (inputs, _), reading = preflight.sound, preflight.findings.protocol
    if reading is None:
        return
    if inputs.section.law != "exact":
        given = f"{inputs.section.law}, a law whose targets cannot be corrected"
        yield reading.problem(("stimulus", "law"), given, "exact", "calibrate the exact law")
    if inputs.section.field.file is not None:
        given, remedy = (
            "a file, which a calibration cannot contain",
            "write the points into the protocol, under `points`",
        )
        yield reading.problem(("stimulus", "field", "file"), given, "points", remedy)
