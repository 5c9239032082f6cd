"""Result of the check of a protocol: its faults, or its stimuli and the predicted response of the beam."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

from modaltouch.preflight.single_design import DesignInputs, field_figures, finger_places, stimulus_figures
from modaltouch.protocol import Experiment, Findings, InputError, Problem, Trial
from modaltouch.stimulus import Burst, Stimulus


@dataclass(frozen=True, eq=False)
class Preflight:
    """An examined protocol.

    Attributes
    ----------
    findings : Findings
        The files and their contents.
    problems : tuple of Problem
        All faults of the files and the physics; empty if a session may run.
    inputs : DesignInputs or None
        Inputs of the design; None if the files lack any of them.
    designed : Stimulus or None
        The stimulus, common to all levels; the first of several; None if there is none.
    variants : dict of str to Preflight
        Preflight of each stimulus on its own, by name; empty if the protocol has only one.
    placed : dict of str to Preflight
        Preflight of the design for each finger placement; empty for the untouched beam.
    attainable : float
        Highest level that can be played with a design for measured fingers [mm/s].
    others : tuple of Preflight
        Preflights for the other groups of participants and kinds of session.
    """

    findings: Findings
    problems: tuple[Problem, ...]
    inputs: DesignInputs | None
    designed: Stimulus | None
    variants: dict[str, Preflight] = field(default_factory=dict)
    placed: dict[str, Preflight] = field(default_factory=dict)
    attainable: float = math.inf
    others: tuple[Preflight, ...] = ()

    def at(self, group: str, session_kind: str) -> Preflight:
        """Return the preflight for a group of participants and a kind of session; self if there are none."""
        return next((each for each in self.others if each.findings.occasion == (group, session_kind)), self)

    def require(self) -> Self:
        """Return self if a session may run, else raise InputError with all problems."""
        if self.problems:
            raise InputError(self.problems)
        return self

    @property
    def experiment(self) -> Experiment:
        """The experiment described by the files; raises InputError if they have any fault."""
        return self.require().findings.experiment()

    @property
    def stimulus(self) -> Stimulus:
        """The stimulus, common to all levels; raises InputError if anything is wrong with the protocol."""
        return self.sound[1]

    def of_untouched_beam(self) -> Self:
        """Return self if there are no problems and the stimuli are for the untouched beam, else raise InputError."""
        given, remedy = "fingers, but this measures the untouched beam", "make a copy of the protocol without them"
        return self._refused(self.findings.fingers is not None, ("stimulus", "fingers"), given, "none", remedy)

    def of_one_stimulus(self) -> Self:
        """Return self if there are no problems and the protocol has a single stimulus, else raise InputError."""
        given, remedy = f"{len(self.variants)} stimuli", "make a separate protocol for each"
        return self._refused(bool(self.variants), ("stimuli",), given, "one stimulus", remedy)

    def _refused(self, holds: bool, path: tuple[str, ...], given: str, allowed: str, remedy: str) -> Self:
        self.require()
        if holds:
            raise InputError([self.findings.problem(path, given, allowed, remedy)])
        return self

    def with_levels(self, levels_mm_s: tuple[float, ...]) -> Self:
        """Return the preflight for a participant whose calibrated levels are known [mm/s].

        The stimulus is unchanged, designed at the highest level allowed for any participant: all participants get the
        same codes, at individual amplitudes.
        """
        reading = self.findings.protocol
        if reading is None or reading.value is None or self.inputs is None:
            raise InputError(self.problems)
        findings = replace(self.findings, protocol=replace(reading, value=reading.value.with_levels(levels_mm_s)))
        return replace(
            self,
            findings=findings,
            inputs=replace(self.inputs, levels={key: v * self.inputs.share for key, v in findings.levels.items()}),
            variants={name: part.with_levels(levels_mm_s) for name, part in self.variants.items()},
            placed={name: part.with_levels(levels_mm_s) for name, part in self.placed.items()},
        )

    @property
    def parts(self) -> dict[str, Preflight]:
        """Preflight of each stimulus by name; self under an empty name if there is only one."""
        return self.variants or {"": self}

    @property
    def by_placement(self) -> dict[str, Preflight]:
        """Preflight of the design for each finger placement; self under an empty name for the untouched beam."""
        return self.placed or {"": self}

    @cached_property
    def designs(self) -> dict[str, Preflight]:
        """Preflight of each design, by stimulus and, for fingers, placement; the name is empty for a single one."""
        return {" ".join(named.values()): each for named, each in self.named_designs()}

    def named_designs(self) -> Iterator[tuple[dict[str, str], Preflight]]:
        """Yield the preflight of each design, with the names of its stimulus and placement if there are several."""
        for name, part in self.parts.items():
            for place, each in part.by_placement.items():
                yield {key: own for key, own in (("stimulus", name), ("placement", place)) if own}, each

    def design_of(self, condition: Any) -> str:
        """Return the name of the design for a condition; for a catch trial, the first design of its placement."""
        names = tuple(self.parts)
        stimulus = condition.stimulus if condition.stimulus in names else names[0]
        return " ".join(filter(None, (stimulus, self.findings.placement(condition))))

    @property
    def bursts(self) -> tuple[Burst, ...]:
        """The burst of each design, in the protocol's order."""
        return tuple(part.stimulus.burst for part in self.designs.values())

    @property
    def content_hashes(self) -> dict[str, str]:
        """Hash of the burst of each design, by name."""
        return {name: part.stimulus.burst.content_hash for name, part in self.designs.items()}

    @property
    def sound(self) -> tuple[DesignInputs, Stimulus]:
        """The design inputs and the stimulus, the first of several; raises InputError if anything is wrong."""
        if self.problems or self.inputs is None or self.designed is None:
            raise InputError(self.problems)
        return self.inputs, self.designed

    def speeds(self, trial: Trial) -> tuple[float, ...]:
        """Return the predicted peak speed under each finger in a trial, from left to right [m/s]."""
        condition = trial.condition
        if condition.is_catch:
            return (0.0,) * len(condition.zones)
        peaks = self.zone_peaks(self.design_of(condition), self.played(condition, condition.velocity_mm_s))
        return tuple(peaks[zone] for zone in condition.zones)

    def played(self, condition: Any, level: float) -> float:
        """Return the level played for a nominal level: equalised and limited to the attainable level [mm/s]."""
        part = self.designs[self.design_of(condition)]
        return min(level * part.sound[0].share, part.attainable)

    def zone_peaks(self, name: str, level: float) -> dict[str, float]:
        """Return the predicted peak speed at each zone's centre, or at the finger on it [m/s]; the level is in mm/s."""
        if (name, level) not in self._peaks:
            inputs, stimulus = self.designs[name].sound
            peaks = stimulus.peak_velocity(finger_places(inputs), level * 1e-3)
            self._peaks[name, level] = dict(zip(inputs.apparatus.ordered_zones, peaks.tolist(), strict=True))
        return self._peaks[name, level]

    @cached_property
    def _peaks(self) -> dict[tuple[str, float], dict[str, float]]:
        """Cache of `zone_peaks`, which is called for every trial."""
        return {}

    @cached_property
    def stimuli(self) -> list[dict[str, Any]]:
        """Predicted figures of each level, in the protocol's order; empty if there are problems."""
        if self.problems:
            return []
        if self.variants or self.placed:
            return [{**named, **row} for named, each in self.named_designs() for row in each.stimuli]
        inputs, stimulus = self.sound
        return [stimulus_figures(inputs, stimulus, level) for level in inputs.levels.values()]

    @property
    def fields(self) -> list[dict[str, Any]]:
        """Target and predicted field of each design at its highest level."""
        return [{**named, **field_figures(*each.sound)} for named, each in self.named_designs()]

    def untouched_warning(self) -> str | None:
        """Return a warning on the effect of typical fingers; None for a stimulus designed for fingers."""
        from modaltouch.preflight.exploration import untouched_warning

        return None if self.findings.fingers is not None else untouched_warning(self.findings, *self.sound)

    def drive_arrays(self) -> dict[str, Any]:
        """Return the drive voltage at the beam at the highest level: ``time_s`` and ``voltage_V``."""
        from modaltouch.preflight.exploration import drive_arrays

        return drive_arrays({name: part.sound for name, part in self.designs.items()})

    def explore(
        self, *, sensitivity: bool = False, contrast: bool = False, tolerance: float | None = None
    ) -> dict[str, Any]:
        """Return the requested explorations of a single stimulus, by name."""
        from modaltouch.preflight.exploration import contrast_figures, sample_figures, sensitivity_figures

        placed = {name: part.sound for name, part in self.of_one_stimulus().placed.items()}
        asked: dict[str, Any] = {}
        if sensitivity:
            first = {"placement": next(iter(placed))} if placed else {}
            asked["sensitivity"] = {**first, **sensitivity_figures(*self.sound)}
        if contrast:
            pairs = map("-".join, self.experiment.protocol.conditions.contacts)
            asked["contrast"] = [*contrast_figures(placed or dict.fromkeys(pairs, self.sound))]
        if tolerance is not None:
            asked["samples"] = sample_figures(*self.sound, tolerance)
        return asked

    def as_dict(self, *, compare: bool = False, fingers: str | None = None) -> dict[str, Any]:
        """Return all results as plain values, as printed by ``modaltouch check --json``.

        `compare` includes the other drive law; `fingers` are those of a file, or shipped ones, or ``none``.
        """
        from modaltouch.preflight.results import check_results

        return check_results(self, compare=compare, fingers=fingers)

    @property
    def calibration_mark(self) -> str:
        """Limits that the calibration misses, and why; empty if it meets them or there is no calibration."""
        reading = self.findings.calibration
        return "" if reading is None or reading.value is None else reading.value.mark
