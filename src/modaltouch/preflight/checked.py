"""Result of the check of a protocol: its faults, or its stimuli and the predicted response of the beam."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

from modaltouch.preflight.design_inputs import DesignInputs
from modaltouch.preflight.figures import (
    DESIGN_FIGURES,
    contrasts,
    design_figures_of,
    field_figures,
    finger_places,
    occasion_figures,
    stimulus_figures,
)
from modaltouch.protocol import Experiment, Findings, InputError, Problem, Trial
from modaltouch.stimulus import Burst, Law, Stimulus


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
        self.require()
        if self.findings.fingers is not None:
            raise InputError(
                [
                    self.findings.problem(
                        ("stimulus", "fingers"),
                        "fingers, but this measures the untouched beam",
                        "none",
                        "make a copy of the protocol without them",
                    )
                ]
            )
        return self

    def of_one_stimulus(self) -> Self:
        """Return self if there are no problems and the protocol has a single stimulus, else raise InputError."""
        self.require()
        if self.variants and self.findings.protocol is not None:
            raise InputError(
                [
                    self.findings.protocol.problem(
                        ("stimuli",),
                        f"{len(self.variants)} stimuli",
                        "one stimulus",
                        "make a separate protocol for each",
                    )
                ]
            )
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
        return {" ".join(named.values()): each for named, each in self._named_designs()}

    def _named_designs(self) -> Iterator[tuple[dict[str, str], Preflight]]:
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
            return [{**named, **row} for named, each in self._named_designs() for row in each.stimuli]
        inputs, stimulus = self.sound
        return [stimulus_figures(inputs, stimulus, level) for level in inputs.levels.values()]

    @property
    def fields(self) -> list[dict[str, Any]]:
        """Target and predicted field of each design at its highest level."""
        return [{**named, **field_figures(*each.sound)} for named, each in self._named_designs()]

    def comparison(self) -> list[dict[str, Any]]:
        """Return the predicted figures of each level under the other drive law, on the same rig."""
        if self.variants:
            return [{"stimulus": name, **each} for name, part in self.parts.items() for each in part.comparison()]
        if self.placed:
            return []  # the other law applies to the untouched beam
        inputs, stimulus = self.sound
        other: Law = "paper" if stimulus.law == "exact" else "exact"
        compared = stimulus.under_law(other)
        return [stimulus_figures(inputs, compared, level) for level in inputs.levels.values()]

    def touched(self, fingers: str | None = None) -> list[dict[str, dict[str, Any]]]:
        """Return the figures of each level of each stimulus under fingers, by placement (see `preflight.exploration`).

        The fingers are those of the protocol, or of a file, or shipped ones. Raises InputError with all faults.
        """
        from modaltouch.preflight.exploration import touched_figures

        findings = self.require().findings if fingers is None else self.findings.under(fingers)
        return [
            row
            for part in self.parts.values()
            for row in touched_figures(findings, {name: each.sound for name, each in part.by_placement.items()})
        ]

    def untouched_warning(self) -> str | None:
        """Return a warning on the effect of typical fingers; None for a stimulus designed for fingers."""
        from modaltouch.preflight.exploration import untouched_warning

        return None if self.findings.fingers is not None else untouched_warning(self.findings, *self.sound)

    def drive_arrays(self) -> dict[str, Any]:
        """Return the drive voltage at the beam at the highest level: ``time_s`` and ``voltage_V``."""
        from modaltouch.preflight.exploration import drive_arrays

        return drive_arrays({name: part.sound for name, part in self.designs.items()})

    def explore(self, **asked: Any) -> dict[str, Any]:
        """Return the requested explorations of a single stimulus; arguments as for `exploration.explore`."""
        from modaltouch.preflight.exploration import explore

        placed = {name: part.sound for name, part in self.of_one_stimulus().placed.items()}
        pairs = map("-".join, self.experiment.protocol.conditions.contacts)
        return explore(self.sound, placed, tuple(pairs), **asked)

    def as_dict(self, *, compare: bool = False, fingers: str | None = None) -> dict[str, Any]:
        """Return all results as plain values, as printed by ``modaltouch check --json``.

        `compare` includes the other drive law; `fingers` are as for `touched`, or ``none``.
        """
        reading = self.findings.protocol
        values: dict[str, Any] = {
            "protocol": reading.sound("protocol") if reading else None,
            "title": reading.sound("title") if reading else None,
            "file": str(reading.source.path) if reading else None,
            "apparatus": self.findings.apparatus.sound("apparatus") if self.findings.apparatus else None,
            "calibration": self._calibration(),
            **dict.fromkeys(DESIGN_FIGURES),
            "problems": [problem.as_dict() for problem in self.problems],
            "warnings": [],
            "defaults": self.findings.defaults(),
            "stimuli": self._levels(fingers),
            **{name: [] for name in ("contrasts", "unknown_gains", "assumed_gains", "offered_gains")},
        }
        if self.others:
            values["occasions"] = [occasion_figures(each.findings) for each in (self, *self.others)]
        if reading is not None and reading.value is not None:
            values |= design_figures_of(reading.value)
        if self.problems:
            return values
        from modaltouch.preflight import advice

        protocol, apparatus = self.experiment.protocol, self.sound[0].apparatus
        values |= {
            "warnings": [
                *([f"the calibration misses its limits: {self.calibration_mark}"] if self.calibration_mark else []),
                *self._stimulus_warnings(),
                *advice.placement_warnings({name: part.sound[0] for name, part in self.designs.items()}),
                *advice.contact_warnings(self.findings if fingers in (None, "none") else self.findings.under(fingers)),
                *advice.design_warnings(protocol),
                *advice.answer_warnings(protocol),
                *advice.interval_warnings(protocol),
                *advice.generator_warnings(self.experiment.apparatus),
                *advice.sound_warnings(protocol, self.experiment.apparatus),
                *advice.default_warnings(values["defaults"]),
            ],
            "contrasts": self._contrasts(),
            "unknown_gains": [{"mode": label, "set": name} for label, name in apparatus.unknown_gains()],
            "assumed_gains": [{"mode": label, "set": name} for label, name in apparatus.assumed_gains()],
            "offered_gains": [
                {"mode": label, "set": name, "gain_mm_s2_per_V": gain}
                for label, name, gain in apparatus.offered_gains()
            ],
        }
        if compare:
            from modaltouch.preflight.exploration import continuous_figures

            values |= {"comparison": self.comparison(), "continuous_fallback": continuous_figures(*self.sound)}
        return values

    def _levels(self, fingers: str | None) -> list[dict[str, Any]]:
        """Return the figures of each level; with fingers, those of the first placement and under each placement."""
        if self.problems:
            return []
        rows = [
            {**({"stimulus": name} if self.variants else {}), **row}
            for name, part in self.parts.items()
            for row in next(iter(part.placed.values()), part).stimuli
        ]
        if fingers == "none" or (fingers is None and self.findings.fingers is None):
            return rows
        return [{**row, "touched": each} for row, each in zip(rows, self.touched(fingers), strict=True)]

    def _stimulus_warnings(self) -> list[str]:
        from modaltouch.preflight.advice import field_warnings, stimulus_warnings

        warnings: list[tuple[str, list[str]]] = []
        for name, part in self.parts.items():
            inputs, stimulus = part.sound
            own = [*field_warnings(inputs, stimulus, part.stimuli), *stimulus_warnings(inputs, stimulus, part.stimuli)]
            warnings.append((name, own))
        shared = [each for each in warnings[0][1] if all(each in own for _, own in warnings)]
        return [*shared, *(f"stimulus {name}: {each}" for name, own in warnings for each in own if each not in shared)]

    def _contrasts(self) -> list[dict[str, Any]]:
        protocol = self.experiment.protocol
        return [
            {**named, **row}
            for named, each in self._named_designs()
            for row in contrasts(protocol, each.stimuli[-1]["zone_peak_mm_s"], named.get("placement", "").split(" ")[0])
        ]

    @property
    def calibration_mark(self) -> str:
        """Limits that the calibration misses, and why; empty if it meets them or there is no calibration."""
        reading = self.findings.calibration
        return "" if reading is None or reading.value is None else reading.value.mark

    def _calibration(self) -> dict[str, Any] | None:
        """Return the calibration used and its remaining errors; None without a calibration."""
        reading = self.findings.calibration
        if reading is None or (value := reading.value) is None:
            return None
        return {
            "file": str(reading.source.path),
            "sha256": reading.source.sha256,
            "made": value.made,
            "generator": value.instruments.generator,
            "reference_mm_s": max(each.reference_mm_s for each in value.by_stimulus.values()),
            "worst_modal_error_mm_s": max(each.worst_error_mm_s for each in value.by_stimulus.values()),
            "mark": value.mark,
        }
