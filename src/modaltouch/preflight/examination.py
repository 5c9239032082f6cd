"""Check of a protocol without hardware: design of the stimuli and check against amplifier, generator and safety."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from modaltouch.preflight.checked import Preflight
from modaltouch.preflight.single_design import (
    DesignInputs,
    design,
    design_to_fit,
    errors_of_gains,
    find_design_inputs,
    speeds_when_lifted,
    zone_points,
)
from modaltouch.protocol import Findings, Problem, Schedule
from modaltouch.rig import instrument_of
from modaltouch.stimulus import Stimulus

if TYPE_CHECKING:
    from modaltouch.window import WindowOptions

_Key = tuple[str | int, ...]


def check_levels(inputs: DesignInputs, stimulus: Stimulus, findings: Findings) -> Iterator[Problem]:
    """Yield a problem for each level that the amplifier, the generator or the safety limit does not allow.

    Levels above the safety limit themselves are reported by the check of the protocol file.
    """
    if problem := _check_range(inputs, stimulus, findings):
        yield problem
        return
    for path, level in inputs.levels.items():
        amplified = list(_check_amplifier(inputs, stimulus, findings, path, level))
        yield from amplified or _check_generator(inputs, stimulus, findings, path, level)
    allowed = {path: level for path, level in inputs.levels.items() if level <= inputs.velocity_limit}
    # Speed rises with level: if one is slow enough, so are all lower ones.
    for path in sorted(allowed, key=allowed.__getitem__, reverse=True):
        too_fast = list(_check_safety(inputs, stimulus, findings, path, allowed[path]))
        yield from too_fast
        if not too_fast:
            break


def _check_amplifier(
    inputs: DesignInputs, stimulus: Stimulus, findings: Findings, path: _Key, level: float
) -> Iterator[Problem]:
    limit = inputs.apparatus.amplifier.limit_V
    needed = float(stimulus.peak_voltage.max()) * level * 1e-3 / stimulus.target_field.velocity
    if needed > limit * (1 + 1e-9):
        highest = _rounded(limit / needed * level)
        yield findings.problem(
            path,
            f"{level:g} mm/s, which needs {needed:.0f} V at the beam",
            f"at most {limit:g} V there ({highest} mm/s)",
            "lower the level, or choose a law, field or focus that needs less",
        )


def _check_generator(
    inputs: DesignInputs, stimulus: Stimulus, findings: Findings, path: _Key, level: float
) -> Iterator[Problem]:
    smallest, largest = instrument_of(inputs.apparatus).lowest_amplitude, inputs.highest_amplitude
    sounding, full = _sounding(stimulus, level)
    if not sounding:
        return
    strong, weak = max(full, key=full.__getitem__), min(sounding, key=sounding.__getitem__)
    if full[strong] > largest:
        yield findings.problem(
            path,
            f"{level:g} mm/s, which needs {full[strong]:.4g} V peak to peak of output {strong}",
            f"at most {largest:g} V into an open circuit ({_rounded(level * largest / full[strong])} mm/s)",
            "lower the level, or use an amplifier with a higher gain",
        )
    if sounding[weak] < smallest:
        given = f"{level:g} mm/s, which needs {sounding[weak]:.4g} V peak to peak of output {weak}"
        least = level * smallest / sounding[weak]
        allowed = f"at least {smallest:g} V, the generator's smallest amplitude (about {_rounded(least, up=True)} mm/s)"
        # A level given in m/s, such as 0.08 for 80 mm/s.
        meant = level * 1e3 if level < 1 and least <= level * 1e3 <= inputs.velocity_limit else None
        yield findings.problem(
            path,
            given,
            allowed,
            "raise the level" if meant is None else f"did you mean {meant:g} mm/s? Levels are in mm/s, not m/s",
        )


def _sounding(stimulus: Stimulus, level: float) -> tuple[dict[int, float], dict[int, float]]:
    """Return amplitude and full scale of every output that is not silent, by output number [V peak to peak]."""
    silent = stimulus.peak_drive(level * 1e-3) == 0
    amplitude, full = (
        {number: float(each) for number, each in enumerate(volts, 1) if not silent[number - 1]}
        for volts in (stimulus.burst.amplitude_for(level * 1e-3), stimulus.burst.full_scale_for(level * 1e-3))
    )
    return amplitude, full


def _check_range(inputs: DesignInputs, stimulus: Stimulus, findings: Findings) -> Problem | None:
    """Return a problem if no level can be played, since one output's smallest amplitude exceeds another limit."""
    level, limit = stimulus.target_field.velocity * 1e3, inputs.apparatus.amplifier.limit_V
    sounding, full = _sounding(stimulus, level)
    if not sounding:
        return None
    highest = level * min(limit / float(stimulus.peak_voltage.max()), inputs.highest_amplitude / max(full.values()))
    weak = min(sounding, key=sounding.__getitem__)
    least = level * instrument_of(inputs.apparatus).lowest_amplitude / sounding[weak]
    # Levels that round to zero result from an instant or duration given in seconds.
    if least <= highest and float(_rounded(highest)):
        return None
    length, base = inputs.apparatus.beam.length_mm, inputs.section.field.base_mm
    path: tuple[str, ...] = ("stimulus",)
    given = "a field that cannot be played at any level"
    if base > length:
        path = ("stimulus", "field", "base_mm")
        given = f"{base:g} mm on a beam of {length:g} mm, a field that cannot be played at any level"
    given += (
        f" (output {weak} needs at least {_rounded(least, up=True)} mm/s for the generator's smallest amplitude, and "
        f"amplifier and generator reach at most {_rounded(highest)} mm/s)"
    )
    return findings.problem(
        path,
        given,
        f"up to {length:g} mm" if base > length else "",
        "choose another field, focus, modes or focusing_instant_ms; no other level will do",
    )


def _check_safety(
    inputs: DesignInputs, stimulus: Stimulus, findings: Findings, path: _Key, level: float
) -> Iterator[Problem]:
    limit, zones, points = inputs.velocity_limit, inputs.apparatus.ordered_zones, zone_points(inputs)
    error = errors_of_gains(inputs, stimulus, level)
    # For a level at the limit, rounding of the codes may exceed it at the focus.
    most = limit * (1 + 1e-3)
    speeds = {"": stimulus.peak_velocity(points.ravel(), level * 1e-3)}
    speeds |= speeds_when_lifted(inputs, stimulus, level, most * 1e-3 - float(error.max()))
    worst = max(speeds, key=lambda each: float((speeds[each] + error).max()))
    highest = speeds[worst] + error
    speed = float(highest.max()) * 1e3
    if speed > most * (1 + 1e-12):  # speeds that need not be known exactly are returned as exactly the most
        fastest = int(highest.argmax()) // points.shape[1]
        if error.any():
            worst += f", up to {error.max() * 1e3:.3g} mm/s of it by the intervals of the gains"
        yield findings.problem(
            path,
            f"{level:g} mm/s, which moves zone {list(zones)[fastest]} at {speed:.0f} mm/s{worst}",
            f"at most {limit:g} mm/s anywhere in a zone ({_rounded(level * limit / speed)} mm/s)",
            "lower the level; the limit is set in the section safety of the apparatus",
        )


def _rounded(value: float, *, up: bool = False) -> str:
    """Format a level, rounded down to stay below an upper limit or up to stay above a lower one [mm/s]."""
    way, fine = (math.ceil, 10) if up else (math.floor, 1000)
    return f"{way(value):d}" if value >= 10 else f"{way(value * fine) / fine:g}"


def examine(
    path: Path | str, calibration: Path | None = None, *, uncalibrated: bool = False, marked: bool = False
) -> Preflight:
    """Check a protocol without hardware: files, limits and predictions.

    Parameters
    ----------
    path : path
        Protocol file, or name of a shipped protocol such as ``demo``.
    calibration : Path, optional
        Calibration file to use instead of the one named in the protocol.
    uncalibrated : bool
        Whether to ignore a calibration that the protocol names or requires, for calibrating or planning.
    marked : bool
        Whether to accept a calibration marked as missing its limits.

    Returns
    -------
    Preflight
        All faults are in its `problems`; none is raised.
    """
    return examine_findings(Findings.read(path, calibration, uncalibrated=uncalibrated, marked=marked))


def check_legibility(preflight: Preflight, window: WindowOptions | None = None) -> Preflight:
    """Return the preflight with illegible texts added to its problems; full screen if no window is given."""
    from modaltouch.window import WindowOptions

    options = window or WindowOptions(fullscreen=True)
    found = options.check_texts(preflight.findings, letters_only=bool(preflight.problems))
    return replace(preflight, problems=tuple(sorted((*preflight.problems, *found))))


def examine_findings(findings: Findings) -> Preflight:
    """Check the contents of files already read."""
    if findings.others:
        first, *others = (examine_findings(replace(each, others=())) for each in (findings, *findings.others))
        problems = set(first.problems).union(*(each.problems for each in others))
        return replace(first, problems=tuple(sorted(problems)), others=tuple(others))
    reading = findings.protocol
    if reading is not None and reading.value is not None and reading.value.stimuli and findings.apparatus is not None:
        from modaltouch.preflight.designs import examine_several

        shared = findings.problems or (*Schedule.check(findings), *_check_masking_level(findings))
        return examine_several(findings, examine_findings, {*shared})
    inputs = find_design_inputs(findings)
    if findings.fingers is not None and inputs is not None and not findings.problems:
        from modaltouch.preflight.designs import examine_placements

        return examine_placements(findings, inputs, _examine_one)
    return _examine_one(findings, inputs)


def _examine_one(findings: Findings, inputs: DesignInputs | None) -> Preflight:
    problems, stimulus = list(findings.problems), None
    if inputs is not None and findings.protocol is not None:
        unplayable = list(_check_generator_itself(inputs, findings))
        problems += unplayable
        try:
            with np.errstate(all="ignore"):
                stimulus = None if unplayable else design_to_fit(inputs)
                found = [] if stimulus is None else [*check_levels(inputs, stimulus, findings)]
                if found and stimulus and stimulus.peak_voltage.max() > inputs.apparatus.amplifier.limit_V:
                    # Lower levels may fit without the full scale reserved for the amplitude grid.
                    found = [*check_levels(inputs, design(inputs, on_grid=False), findings)]
                problems += found
        except (ValueError, ArithmeticError) as error:
            problems.append(_located(error, findings))
    if not findings.problems:
        problems += [*Schedule.check(findings), *_check_masking_level(findings)]
    return Preflight(findings, tuple(sorted(set(problems))), inputs, stimulus)


_KEYS = {
    "points": "field",
    "n_decomposed": "decomposed_modes",
    "selection": "selected_modes",
    "focusing_instant": "focusing_instant_ms",
}
"""Keys of the section stimulus with another name than the parameter of the design."""


def _located(error: Exception, findings: Findings) -> Problem:
    """Return an error of the design as a problem of the key that gives the parameter at fault."""
    given, _, remedy = " ".join(str(error).split()).rpartition(": ")
    told = f"a stimulus that cannot be made, {given or remedy}", "", remedy if given else ""
    parameter, mode = getattr(error, "parameter", ""), getattr(error, "mode", 0)
    if findings.apparatus is not None and mode:
        index = [each.label for _, each in findings.apparatus.items("modes")].index(mode)
        return findings.apparatus.problem(("modes", index, "gain_mm_s2_per_V"), *told)
    if findings.apparatus is not None and parameter == "basis":
        return findings.apparatus.problem(("beam", "measured_shapes"), *told)
    return findings.problem(("stimulus", *filter(None, [_KEYS.get(parameter, parameter)])), *told)


def _check_generator_itself(inputs: DesignInputs, findings: Findings) -> Iterator[Problem]:
    """Yield problems at any level: too many samples for the generator's record or clock, or a missing timer."""
    section, instrument = inputs.section, instrument_of(inputs.apparatus)
    converter, path = instrument.converter, ("stimulus", "n_samples")
    if section.n_samples > converter.max_points:
        yield findings.problem(
            path,
            f"{section.n_samples}",
            f"at most {converter.max_points}, the points of a record of the {instrument.models[0]}",
            "use fewer",
        )
    rate = section.n_samples / section.duration_ms * 1e3
    if rate > converter.clock_rate * (1 + 1e-12):
        given = f"{section.n_samples} samples in {section.duration_ms:g} ms, which is {rate:.4g} Hz"
        most, clock = int(section.duration_ms * 1e-3 * converter.clock_rate), converter.clock_rate * 1e-6
        yield findings.problem(path, given, f"at most {most} samples, at the generator's {clock:g} MHz", "use fewer")
    if inputs.apparatus.generator.repeats == "timer" and instrument.commands.timer is None and findings.apparatus:
        yield findings.apparatus.problem(
            ("generator", "repetition"),
            f"timer, which the channels of a {instrument.models[0]} do not share",
            "single",
            "write single",
        )


def _check_masking_level(findings: Findings) -> Iterator[Problem]:
    """Yield a problem if the peaks of the masking noise exceed full scale."""
    experiment = findings.experiment()
    if experiment.protocol.masking is not None:
        from modaltouch.window import MaskingNoise

        yield from MaskingNoise(experiment.protocol.masking, experiment.apparatus).check_level(findings)
