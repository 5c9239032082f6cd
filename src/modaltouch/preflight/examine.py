"""The whole check of a protocol, without any hardware."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from modaltouch.document import Problem
from modaltouch.preflight.checked import Preflight
from modaltouch.preflight.faults import locate
from modaltouch.preflight.ground import Ground, design, find_ground
from modaltouch.preflight.limits import check_levels, fits_generator
from modaltouch.preflight.several import at_stimulus, check_memories, each_stimulus
from modaltouch.preflight.sound import check_masking_level
from modaltouch.protocol import Findings, examine_files
from modaltouch.schedule import draw_schedule
from modaltouch.stimulus.design import Stimulus
from modaltouch.stimulus.drive import Release


def examine(path: Path | str, calibration: Path | None = None, *, uncalibrated: bool = False) -> Preflight:
    """Return the whole check of a protocol: files, limits, predictions; no hardware is touched.

    Parameters
    ----------
    path : path
        The protocol file.
    calibration : Path, optional
        Calibration file to use instead of the one that the protocol names.
    uncalibrated : bool
        Whether no calibration is read, although the protocol names or requires one: to make one, or to plan.

    Returns
    -------
    Preflight
        With every fault in its `problems`; nothing is raised for a faulty file.
    """
    return examine_findings(examine_files(Path(path), calibration, uncalibrated=uncalibrated))


def examine_findings(findings: Findings) -> Preflight:
    """Return the whole check of files that have been read.

    Parameters
    ----------
    findings : Findings
        The files and what is wrong with them.
    """
    reading = findings.protocol
    if reading is not None and reading.value is not None and reading.value.stimuli and not findings.problems:
        return _examine_several(findings)
    problems = list(findings.problems)
    ground, stimulus = find_ground(findings), None
    if ground is not None and findings.protocol is not None:
        try:
            with np.errstate(all="ignore"):
                stimulus = design_to_fit(ground)
                problems += check_levels(ground, stimulus, findings.protocol)
        except (ValueError, ArithmeticError) as error:
            problems.append(locate(error, findings))
    if findings.protocol is not None and findings.protocol.value is not None:
        problems += [*_check_schedule(findings), *check_masking_level(findings)]
    return Preflight(findings, tuple(sorted(set(problems))), ground, stimulus)


def _examine_several(findings: Findings) -> Preflight:
    """Return the check of a protocol with several stimuli: of each alone, and of all together."""
    variants = {name: examine_findings(alone) for name, alone in each_stimulus(findings)}
    problems = {problem for name, part in variants.items() for problem in at_stimulus(findings, name, part.problems)}
    first = next(iter(variants.values()))
    together = Preflight(findings, (), first.ground, first.designed, variants)
    if not problems:
        problems.update(check_memories(findings, together.bursts))
    problems.update([*_check_schedule(findings), *check_masking_level(findings)])
    return replace(together, problems=tuple(sorted(problems)))


def design_to_fit(ground: Ground, *, release: Release | None = None) -> Stimulus:
    """Return the stimulus, without the 5 % of full scale for the amplitude grid where they do not fit.

    Parameters
    ----------
    ground : Ground
        What it is designed from.
    release : str, optional
        What follows the focusing instant; the protocol's own if not given.

    Raises
    ------
    ValueError
        If the engine refuses it.
    """
    stimulus = design(ground, release=release)
    within = float(stimulus.peak_voltage.max()) <= ground.apparatus.amplifier.limit_V
    if within and not fits_generator(ground, stimulus):
        return design(ground, release=release, on_grid=False)
    return stimulus


def _check_schedule(findings: Findings) -> list[Problem]:
    """Return why no order can be drawn, if none can."""
    reading = findings.protocol
    if reading is None or reading.value is None or findings.problems:
        return []
    try:
        draw_schedule(reading.value, "p01", 0)
    except ValueError as error:
        path = ("schedule", "max_same_pair_running")
        return [reading.problem(path, f"a limit that cannot be kept, {error}", "")]
    return []
