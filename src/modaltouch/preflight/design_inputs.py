"""Inputs of the design of a stimulus, taken from the valid parts of the files, and the design itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modaltouch.protocol import Apparatus, Findings, StimulusSection
from modaltouch.rig import instrument_of
from modaltouch.stimulus import Correction, Law, Release, Stimulus, TargetField, Timing, design_stimulus

if TYPE_CHECKING:
    from modaltouch.stimulus import Finger

_NEEDED = ("stimulus", "beam", "actuator_sets", "modes", "amplifier", "generator")

_FALLBACK_LEVEL = 100.0
"""Level of the design if the protocol has no valid one [mm/s]; results scale linearly with it."""


@dataclass(frozen=True)
class DesignInputs:
    """Inputs of the design of a stimulus.

    Attributes
    ----------
    section : StimulusSection
        The protocol's stimulus section.
    apparatus : Apparatus
        The apparatus, corrected by the calibration if there is one; only sections that a stimulus needs are present.
    centre_mm : float
        Centre of the focus zone [mm].
    levels : dict of tuple to float
        Valid levels by their keys in the protocol, the peak velocities and that of a standard [mm/s].
    velocity_limit : float
        Safety limit [mm/s]; infinite if it is not valid.
    correction : Correction or None
        Correction of the targets from a calibration.
    points : tuple of (float, float)
        Positions [mm] and relative velocities of a sampled field.
    fingers : tuple of Finger
        Fingertips on the beam; empty for the untouched beam.
    share : float
        Ratio of `levels` to the nominal levels, if placements are equalised in a band [1].
    at_samples : bool
        As in `Timing`.
    """

    section: StimulusSection
    apparatus: Apparatus
    centre_mm: float
    levels: dict[tuple[str | int, ...], float]
    velocity_limit: float
    correction: Correction | None = None
    points: tuple[tuple[float, float], ...] = ()
    fingers: tuple[Finger, ...] = ()
    share: float = 1.0
    at_samples: bool = False

    @property
    def reference(self) -> float:
        """Highest level within the safety limit, at which the codes span the generator's range [mm/s]."""
        return max(
            [level for level in self.levels.values() if level <= self.velocity_limit],
            default=min(self.levels.values(), default=_FALLBACK_LEVEL),
        )

    @property
    def loads(self) -> list[Finger]:
        """Fingers as they load the modes; equal ones share a design."""
        return [load for _, load in self.apparatus.modal_model().touched(self.fingers).loads]

    @property
    def highest_amplitude(self) -> float:
        """Generator's highest amplitude whose full scale is within the amplifier's limit [Vpp]."""
        return 2 * instrument_of(self.apparatus).highest_level(self.apparatus)


def find_design_inputs(findings: Findings) -> DesignInputs | None:
    """Return the inputs of the design; None if the files lack any of them."""
    protocol, apparatus = findings.protocol, findings.apparatus
    if protocol is None or apparatus is None:
        return None
    # Faults of single keys are handled below; faults between keys invalidate the section.
    between = set(findings.problems) - set(protocol.problems) - set(apparatus.problems)
    if any(problem.path.split(".")[0].split("[")[0] in _NEEDED for problem in between):
        return None
    section = protocol.sound("stimulus")
    parts = {name: apparatus.sound(name) for name in _NEEDED if name != "stimulus"}
    if section is None or any(part is None for part in parts.values()):
        return None
    zones = dict(apparatus.items("zones"))
    if any(zone not in zones for zone in (section.focus, *section.further_foci)):
        return None
    points = section.field.points or ()
    if section.field.shape == "sampled" and findings.field is not None:
        points = findings.points()
    if points is None:
        return None
    limit = apparatus.sound("safety", "velocity_limit_mm_s")
    used = Apparatus.model_construct(apparatus="", zones=zones, **parts)
    reading = findings.calibration
    calibration = None if reading is None or reading.value is None else reading.value.alone("")
    correction = None
    if reading is not None and calibration is not None:
        # Use a calibration only if it has no fault.
        if apparatus.value is None or any(problem.file == str(reading.source.path) for problem in findings.problems):
            return None
        used = calibration.applied(used)
        correction = Correction(
            velocity=np.array([mode.target_mm_s for mode in calibration.modes]) * 1e-3,
            displacement=np.array([mode.target_displacement_mm_s for mode in calibration.modes]) * 1e-3,
            reference=calibration.reference_mm_s * 1e-3,
            corrections=tuple((level.velocity_mm_s * 1e-3, level.amplitude_factor) for level in calibration.levels),
        )
    elif reading is not None and reading.value is not None:
        return None  # a calibration of other stimuli
    return DesignInputs(
        section=section,
        apparatus=used,
        centre_mm=zones[section.focus].centre_mm,
        levels=findings.levels,
        velocity_limit=float("inf") if limit is None else limit,
        correction=correction,
        points=points,
        at_samples=findings.at_samples,
    )


def design(
    inputs: DesignInputs, *, law: Law | None = None, release: Release | None = None, on_grid: bool = True
) -> Stimulus:
    """Design the stimulus of a protocol.

    Parameters
    ----------
    inputs : DesignInputs
        Inputs of the design.
    law : str, optional
        Drive law; the protocol's if not given.
    release : str, optional
        Drive after the focusing instant; the protocol's if not given.
    on_grid : bool
        Whether to put all levels on the generator's amplitude grid, for which full scale may exceed the peak by 5 %;
        otherwise full scale equals the peak.

    Raises
    ------
    ValueError
        If the design fails.
    """
    section, reference = inputs.section, inputs.reference
    levels = tuple(sorted({level for level in inputs.levels.values() if level <= reference})) or (reference,)
    target_field = TargetField(
        shape=section.field.shape,
        base=section.field.base_mm * 1e-3,
        centre=inputs.centre_mm * 1e-3,
        velocity=reference * 1e-3,
        n_decomposed=section.decomposed_modes,
        selection=section.selected_modes,
        further_centres=tuple(inputs.apparatus.zones[name].centre_mm * 1e-3 for name in section.further_foci),
        points=tuple((position * 1e-3, velocity) for position, velocity in inputs.points),
    )
    timing = Timing(
        instrument_of(inputs.apparatus).converter,
        n_samples=section.n_samples,
        duration=section.duration_ms * 1e-3,
        focusing_instant=section.focusing_instant_ms * 1e-3,
        repetition_rate=section.repetition_rate_Hz,
        at_samples=inputs.at_samples,
    )
    return design_stimulus(
        inputs.apparatus.modal_model().touched(inputs.fingers),
        target_field,
        timing,
        inputs.apparatus.amplifier_values(),
        law=law or section.law,
        release=release or section.release,
        levels=tuple(level * 1e-3 for level in levels) if on_grid else None,
        load_factor=inputs.apparatus.generator.load_factor,
        design=section.design if (law or section.law) == "exact" else "least_energy",
        priority=section.priority if (law or section.law) == "exact" else "field",
        correction=inputs.correction,
    )


def design_to_fit(inputs: DesignInputs, *, release: Release | None = None) -> Stimulus:
    """Return the stimulus, without the 5 % of full scale reserved for the amplitude grid if that does not fit.

    Parameters and errors are those of `design`.
    """
    stimulus = design(inputs, release=release)
    within = float(stimulus.peak_voltage.max()) <= inputs.apparatus.amplifier.limit_V
    if within and max(stimulus.burst.full_scale_for(stimulus.target_field.velocity)) > inputs.highest_amplitude:
        return design(inputs, release=release, on_grid=False)
    return stimulus
