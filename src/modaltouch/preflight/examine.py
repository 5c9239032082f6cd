"""The whole check of a protocol, without any hardware."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from modaltouch.apparatus import offered_gains
from modaltouch.document import InputError, Problem
from modaltouch.preflight.advice import answer_warnings, default_warnings, field_warnings, taken_defaults
from modaltouch.preflight.faults import locate
from modaltouch.preflight.figures import (
    contrasts,
    estimated_duration,
    stimulus_figures,
    warnings,
    zone_centres,
)
from modaltouch.preflight.ground import Ground, design, find_ground
from modaltouch.preflight.limits import check_levels, fits_generator
from modaltouch.preflight.several import at_stimulus, check_calibrations, check_memories, each_stimulus
from modaltouch.preflight.sound import check_masking_level, sound_warnings
from modaltouch.protocol import Experiment, Findings, Protocol, examine_files
from modaltouch.schedule import draw_schedule
from modaltouch.stimulus.burst import Burst
from modaltouch.stimulus.design import Stimulus
from modaltouch.stimulus.drive import Law, Release
from modaltouch.trial import Trial


@dataclass(frozen=True, eq=False)
class Preflight:
    """A protocol, examined.

    Attributes
    ----------
    findings : Findings
        The files and what they hold.
    problems : tuple of Problem
        Every fault, of the files and of the physics; empty when the session may run.
    ground : Ground or None
        What the stimulus was designed from; None where the files do not say it.
    designed : Stimulus or None
        The stimulus of all levels; None where there is none. Of several, the first.
    variants : dict of str to Preflight
        Of several stimuli, the protocol with each of them alone; empty where it has one.
    """

    findings: Findings
    problems: tuple[Problem, ...]
    ground: Ground | None
    designed: Stimulus | None
    variants: dict[str, Preflight] = field(default_factory=dict)

    def require(self) -> Self:
        """Return the preflight itself if a session may run.

        Raises
        ------
        InputError
            With every problem.
        """
        if self.problems:
            raise InputError(self.problems)
        return self

    @property
    def experiment(self) -> Experiment:
        """The files' contents.

        Raises
        ------
        InputError
            If anything is wrong with them.
        """
        if self.problems:
            raise InputError(self.problems)
        return self.findings.experiment()

    @property
    def stimulus(self) -> Stimulus:
        """The stimulus of all levels.

        Raises
        ------
        InputError
            If anything is wrong with the protocol.
        """
        return self._sound[1]

    def of_one_stimulus(self) -> Self:
        """Return the preflight itself if the protocol has a single stimulus.

        Raises
        ------
        InputError
            If it has several, or with every problem.
        """
        self.require()
        if self.variants and self.findings.protocol is not None:
            given, remedy = f"{len(self.variants)} stimuli", "make a protocol of each of them for this"
            raise InputError([self.findings.protocol.problem(("stimuli",), given, "one stimulus", remedy)])
        return self

    @property
    def parts(self) -> dict[str, Preflight]:
        """The protocol with each of its stimuli alone, by name; itself, without a name, where it has one."""
        return self.variants or {"": self}

    @property
    def bursts(self) -> tuple[Burst, ...]:
        """The burst of each stimulus, in the protocol's order."""
        return tuple(part.stimulus.burst for part in self.parts.values())

    @property
    def content_hashes(self) -> dict[str, str]:
        """Hash of the burst of each stimulus, by name."""
        return {name: part.stimulus.burst.content_hash for name, part in self.parts.items()}

    @property
    def _sound(self) -> tuple[Ground, Stimulus]:
        if self.problems or self.ground is None or self.designed is None:
            raise InputError(self.problems)
        return self.ground, self.designed

    def speeds(self, trial: Trial) -> tuple[float, float]:
        """Return the predicted peak speeds at the centres of the zones under the left and right finger [m/s].

        Parameters
        ----------
        trial : Trial
            What is presented.
        """
        if trial.condition.is_catch:
            return 0.0, 0.0
        ground, stimulus = self.parts[trial.condition.stimulus]._sound
        peaks = stimulus.peak_velocity(zone_centres(ground), trial.condition.velocity_mm_s * 1e-3)
        by_zone = dict(zip(ground.zones, peaks.tolist(), strict=True))
        return by_zone[trial.condition.zone_left], by_zone[trial.condition.zone_right]

    @cached_property
    def stimuli(self) -> list[dict[str, Any]]:
        """What each level does to the beam, in the protocol's order; empty where anything is wrong."""
        if self.problems:
            return []
        if self.variants:
            return [{"stimulus": name, **each} for name, part in self.parts.items() for each in part.stimuli]
        ground, stimulus = self._sound
        return [stimulus_figures(ground, stimulus, level) for level in ground.levels.values()]

    def comparison(self) -> list[dict[str, Any]]:
        """Return what the other drive law would do on the same rig, level by level."""
        if self.problems:
            return []
        if self.variants:
            return [{"stimulus": name, **each} for name, part in self.parts.items() for each in part.comparison()]
        ground, stimulus = self._sound
        other: Law = "paper" if stimulus.law == "exact" else "exact"
        compared = stimulus.under_law(other)
        return [stimulus_figures(ground, compared, level) for level in ground.levels.values()]

    def continuous_fallback(self) -> dict[str, Any] | None:
        """Return what a generator without burst mode would miss at the highest level; None where anything is wrong."""
        if self.problems:
            return None
        from modaltouch.preflight.fallback import continuous_figures

        ground, stimulus = self._sound
        return continuous_figures(stimulus, max(ground.levels.values()) * 1e-3)

    def as_dict(self, *, compare: bool = False) -> dict[str, Any]:
        """Return everything as plain values, as ``modaltouch check --json`` prints it.

        Parameters
        ----------
        compare : bool
            Whether the other drive law is shown too.
        """
        reading = self.findings.protocol
        values: dict[str, Any] = {
            "protocol": reading.sound("protocol") if reading else None,
            "title": reading.sound("title") if reading else None,
            "file": str(reading.source.path) if reading else None,
            "apparatus": self._apparatus_name(),
            "calibration": self._calibration(),
            "n_trials": None,
            "n_catch_trials": None,
            "n_practice_trials": None,
            "estimated_duration_min": None,
            "problems": [problem.as_dict() for problem in self.problems],
            "warnings": [],
            "defaults": taken_defaults(reading) if reading else [],
            "stimuli": self.stimuli,
            "contrasts": [],
            "unknown_gains": [],
            "assumed_gains": [],
            "offered_gains": [],
        }
        if reading is not None and reading.value is not None:
            values |= _design_figures(reading.value)
        if self.problems:
            return values
        ground, _ = self._sound
        protocol, apparatus = self.experiment.protocol, ground.apparatus
        values |= {
            "warnings": [
                *self._stimulus_warnings(),
                *answer_warnings(protocol),
                *sound_warnings(protocol, self.experiment.apparatus),
                *default_warnings(values["defaults"]),
            ],
            "contrasts": self._contrasts(),
            "unknown_gains": [{"mode": label, "set": name} for label, name in apparatus.unknown_gains()],
            "assumed_gains": [{"mode": label, "set": name} for label, name in apparatus.assumed_gains()],
            "offered_gains": [
                {"mode": label, "set": name, "gain_mm_s2_per_V": gain} for label, name, gain in offered_gains(apparatus)
            ],
        }
        if compare:
            values |= {"comparison": self.comparison(), "continuous_fallback": self.continuous_fallback()}
        return values

    def _stimulus_warnings(self) -> list[str]:
        said: list[tuple[str, list[str]]] = []
        for name, part in self.parts.items():
            ground, stimulus = part._sound
            own = [*field_warnings(ground, stimulus, part.stimuli), *warnings(ground, stimulus, part.stimuli)]
            said.append((name, own))
        shared = [each for each in said[0][1] if all(each in own for _, own in said)]
        return [*shared, *(f"stimulus {name}: {each}" for name, own in said for each in own if each not in shared)]

    def _contrasts(self) -> list[dict[str, Any]]:
        protocol = self.experiment.protocol
        return [
            {**({"stimulus": name} if name else {}), **row}
            for name, part in self.parts.items()
            for row in contrasts(protocol, part.stimuli[-1]["zone_peak_mm_s"])
        ]

    def _calibration(self) -> dict[str, Any] | None:
        """Return which calibration is used and how far from the wish it left the beam; None without one."""
        reading = self.findings.calibration
        if reading is None or reading.value is None:
            return None
        value = reading.value
        return {
            "file": str(reading.source.path),
            "sha256": reading.source.sha256,
            "made": value.made,
            "generator": value.instruments.generator,
            "reference_mm_s": value.reference_mm_s,
            "worst_modal_error_mm_s": max(abs(each) for mode in value.modes for each in mode.error_after_mm_s),
        }

    def _apparatus_name(self) -> str | None:
        reading = self.findings.apparatus
        name: str | None = reading.sound("apparatus") if reading else None
        return name


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
    refused = tuple(check_calibrations(findings))
    if refused:
        return Preflight(findings, refused, None, None)
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


def _design_figures(protocol: Protocol) -> dict[str, Any]:
    return {
        "n_trials": protocol.n_trials,
        "n_catch_trials": protocol.schedule.catch_trials * len(protocol.conditions.finger_conditions),
        "n_practice_trials": protocol.schedule.practice_trials,
        "estimated_duration_min": estimated_duration(protocol),
    }
