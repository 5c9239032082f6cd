"""The command ``modaltouch calibrate``: identify, design, measure, and correct the targets until only noise is left.

No record reveals the trigger latency, the time from the generator's first sample to the scope's. With the shipped
stimulus each 0.05 us of error in `acquisition.trigger_latency_us` leaves an error of 0.08 mm/s in a displacement.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.lab.calibration.acquisition import (
    HEADROOM,
    SWEEP,
    DecayRecorder,
    identifying_burst,
    measuring_points,
    probe_voltage,
    timing_voltage,
)
from modaltouch.lab.calibration.decay import find_poles, fit_residues, missed_swing
from modaltouch.lab.calibration.file import (
    DIGITS,
    CalibrationResult,
    Iteration,
    Level,
    calibration_of,
    corrected_inputs,
    refined_apparatus,
    significant,
    write_calibration,
)
from modaltouch.lab.calibration.plant import (
    DriveDelay,
    ModalState,
    Plant,
    fit_drive,
    identify_plant,
    peak_shortfall,
    predicted_drive,
)
from modaltouch.lab.calibration.plausibility import (
    CLEARLY_LACKING,
    MOST_LACKING,
    common_factor,
    mark_of,
    refuse_changing_beam,
    refuse_common_factor,
    refuse_disproportion,
    refuse_implausible_drive,
    refuse_implausible_plant,
    refuse_odd_point,
    refuse_tones,
    refuse_wrong_drive,
)
from modaltouch.lab.common import COMMON_FACTORS, NORMAL_95, FloatArray
from modaltouch.lab.laboratory import SILENT_PROGRESS, SIMULATED, Laboratory, MeasurementProgress, open_laboratory
from modaltouch.lab.recorded_files import RecordedFiles
from modaltouch.preflight import DesignInputs, Preflight, design_to_fit, examine
from modaltouch.protocol import Apparatus, InputError, Problem, Protocol
from modaltouch.record import prepare_file
from modaltouch.rig import RigError
from modaltouch.stimulus import Burst, Correction, Stimulus


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
    at_stimulus, parts = preflight.findings.at_stimulus, preflight.parts.items()
    if problems := [each for name, part in parts for each in at_stimulus(name, list(_uncorrectable(part)))]:
        raise InputError(problems)
    return {name: part.sound[0] for name, part in parts}


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
    (inputs, _), problem = preflight.sound, preflight.findings.problem
    if inputs.section.law != "exact":
        yield problem(
            ("stimulus", "law"),
            f"{inputs.section.law}, a law whose targets cannot be corrected",
            "exact",
            "calibrate the exact law",
        )
    if inputs.section.field.file is not None:
        yield problem(
            ("stimulus", "field", "file"),
            "a file, which a calibration cannot contain",
            "points",
            "write its points into the protocol under `points`",
        )


MOST_ITERATIONS = 4
"""Largest number of iterations; two usually suffice."""

LEAST_CHANGE = 2e-4
"""Correction, relative to the reference level, below which the loop ends [1]."""


def calibrate_each(
    bench: Laboratory,
    apparatus: Apparatus,
    inputs_of: Mapping[str, DesignInputs],
    between: Sequence[float] = (),
) -> dict[str, CalibrationResult]:
    """Determine the targets and amplitudes that make each of several stimuli accurate on a rig, by name.

    The rig is identified once, with the sample clock of the first stimulus: amplifier, modes and vibrometer are the
    same for all.

    Parameters
    ----------
    bench, apparatus : Laboratory and Apparatus
        Generator and scope, and the apparatus as in its file.
    inputs_of : mapping of str to DesignInputs
        The uncalibrated stimuli by name; a protocol's single stimulus has an empty name.
    between : sequence of float
        Levels to verify in addition to the protocol's own [mm/s].

    Raises
    ------
    RigError
        If the rig fails, or a stimulus needs more voltage than the amplifier's limit.
    ValueError
        If a stimulus cannot be designed for the identified rig.
    """
    found: dict[str, CalibrationResult] = {}
    plant: Plant | None = None
    for name, inputs in inputs_of.items():
        if name:
            bench.progress.say(f"stimulus {name}")
        found[name] = CalibrationLoop(bench, apparatus, inputs, between, name).run(plant)
        plant = found[name].plant
    return found


class CalibrationLoop:
    """The calibration of one stimulus on a rig, from the listed apparatus to verified levels."""

    def __init__(
        self,
        bench: Laboratory,
        apparatus: Apparatus,
        inputs: DesignInputs,
        between: Sequence[float] = (),
        name: str = "",
    ) -> None:
        self._name = name
        self._asked = sorted({level * 1e-3 for level in (*inputs.levels.values(), *between)})
        self._bench, self._apparatus, self._inputs = bench, apparatus, inputs
        self._listed = design_to_fit(inputs, release="free")
        self._timing, self._target = self._listed.timing, self._listed.target
        self._reference = self._listed.target_field.velocity
        model = self._listed.model
        self._points = measuring_points(model)
        self._shapes = model.shapes(self._points)
        self._recorder = DecayRecorder(
            bench=bench,
            model=model,
            timing=self._timing,
            highest_velocity=apparatus.acquisition.range_mm_s * 1e-3,
            latency=apparatus.acquisition.trigger_latency_us * 1e-6,
            name=name,
        )

    def run(self, known: Plant | None = None) -> CalibrationResult:
        """Identify the rig unless it is known, correct the targets, and verify the levels."""
        plant = known or self._identify()
        self._recorder.wait_for(plant.drive)
        refined = refined_apparatus(self._apparatus, plant)
        # The stimulus designed from the apparatus file assumes the amplifier gain given there.
        self._refuse_beyond_limit(float(self._listed.peak_voltage.max()) * max(plant.drive.gain))
        turns = [self._measure(0, self._listed, plant)]
        self._drives("drive before", self._listed.burst, plant.drive, self._asked[-1])
        corrected_target = listed_target = np.stack([self._target, np.zeros_like(self._target)])
        stimulus = self._corrected(refined, self._correction(corrected_target))
        low, high = COMMON_FACTORS
        as_listed = low <= common_factor(plant.model, self._listed.model) <= high
        if float(stimulus.peak_voltage.max()) > self._apparatus.amplifier.limit_V or not as_listed:
            self._recorder.begin("at half the level", self._points.size)
            refuse_disproportion(turns[0].state, self._turn(0, self._listed, plant, self._reference / 2).state)
        refuse_common_factor(plant.model, self._listed.model, COMMON_FACTORS)
        self._refuse_beyond_limit(float(stimulus.peak_voltage.max()))
        best, kept = self._measure(1, stimulus, plant), corrected_target
        turns.append(best)
        for number in range(2, MOST_ITERATIONS + 1):
            change = significant(turns[-1].state, self._target)
            if np.abs(change).max() < LEAST_CHANGE * self._reference:
                break
            corrected_target = corrected_target - change
            stimulus = self._corrected(refined, self._correction(corrected_target))
            if float(stimulus.peak_voltage.max()) > refined.amplifier.limit_V:
                break
            turns.append(self._measure(number, stimulus, plant))
            if turns[-1].worst >= best.worst:
                break
            best, kept = turns[-1], corrected_target
        if not self._name and turns[0].worst < best.worst:
            # No correction helped: keep the rig of the apparatus file, unless several stimuli share the identified one.
            best, kept, refined = turns[0], listed_target, self._apparatus
        correction = self._correction(kept)
        levels = self._levels(plant, refined, correction, best.state)
        correction = replace(correction, corrections=tuple((level.velocity, level.factor) for level in levels))
        stimulus = self._corrected(refined, correction)
        drives = self._drives("drive", stimulus.burst, plant.drive, self._asked[-1])
        halfway_level = min(self._asked, key=lambda level: abs(level - self._reference / 2))
        self._recorder.begin(f"at {halfway_level * 1e3:g} mm/s", self._points.size)
        halfway = self._turn(len(turns), stimulus, plant, halfway_level, HEADROOM * halfway_level)
        return CalibrationResult(
            inputs=self._inputs,
            plant=plant,
            refined=refined,
            target=self._target,
            correction=correction,
            points=self._points,
            turns=tuple(turns),
            best=best,
            levels=levels,
            halfway=halfway,
            halfway_level=halfway_level,
            drive_peak=np.abs(drives[0]).max(axis=1),
            drive_shortfall=peak_shortfall(*drives),
        )

    def _refuse_beyond_limit(self, needed: float) -> None:
        limit = self._apparatus.amplifier.limit_V
        if needed > limit:
            raise RigError(
                f"{self._reference * 1e3:g} mm/s needs {needed:.0f} V at the beam on this rig: allowed at most "
                f"{limit:g} V; the outputs are off; lower the highest level of the protocol"
            )

    def _identify(self) -> Plant:
        """Identify amplifier and clock from the drive, modes and vibrometer from the decays after a probe per output.

        Delay and lag are identified first, since an unknown delay of a few microseconds makes the loop diverge.
        """
        listed, timing, knobs = self._listed, self._timing, self._apparatus.acquisition
        highest = min(self._apparatus.safety.velocity_limit_mm_s, knobs.range_mm_s) * 1e-3
        self._recorder.begin("amplifier and clock", 2)
        burst = identifying_burst(timing_voltage(listed.model, timing), listed, highest)
        commanded = burst.commanded(listed.to_beam)
        drive = fit_drive(self._recorder.drive(burst, float(np.abs(commanded).max())), commanded, timing)
        refuse_implausible_drive(drive)
        self._recorder.wait_for(drive)
        rows, bursts, time = [], list[Burst](), np.zeros(0)
        for channel in range(listed.model.n_channels):
            self._recorder.begin(f"modes, by output {channel + 1}", self._points.size)
            burst = identifying_burst(probe_voltage(listed.model, timing, channel), listed, highest)
            bursts.append(burst)
            time, decay = self._recorder.decays(burst, burst.velocity, self._points)
            rows.append(decay)
        since = time / (1 + drive.clock) - timing.focusing_instant
        decays = find_poles(since, np.concatenate(rows), listed.model.exponent)
        refuse_tones(decays, listed.model.n_modes, float(np.ptp(since)))
        refuse_changing_beam([fit_residues(since, each, decays.pole) for each in rows], self._shapes)
        corner = knobs.vibrometer_bandwidth_kHz
        plant = identify_plant(
            listed.model,
            listed.amplifier,
            drive,
            decays,
            self._shapes,
            [burst.commanded(listed.to_beam) for burst in bursts],
            timing,
            None if corner is None else corner * 1e3,
        )
        try:
            refuse_implausible_plant(plant, listed.model, self._recorder.margin)
        except RigError:
            # An amplifier that saturates changes the gains, too.
            for number, burst in enumerate(bursts, start=1):
                self._bench.load(burst)
                self._drives(f"drive of output {number}", burst, drive, burst.velocity, most_lacking=CLEARLY_LACKING)
            raise
        refuse_odd_point(decays, self._shapes, self._points)
        return replace(
            plant,
            latency_doubt=knobs.trigger_latency_uncertainty_us * 1e-6,
            sensitivity_doubt=knobs.sensitivity_uncertainty_percent * 1e-2,
        )

    def _corrected(self, refined: Apparatus, correction: Correction) -> Stimulus:
        return design_to_fit(corrected_inputs(self._inputs, refined, correction), release="free")

    def _correction(self, corrected_target: FloatArray) -> Correction:
        """Return targets rounded to the digits of the file."""
        velocity, displacement = (np.round(each * 1e3, DIGITS) * 1e-3 for each in corrected_target)
        return Correction(velocity, displacement, self._reference)

    def _measure(self, number: int, stimulus: Stimulus, plant: Plant) -> Iteration:
        """Play a stimulus at the reference level and return the modal state at the focusing instant."""
        self._recorder.begin("before" if number == 0 else f"iteration {number}", self._points.size)
        turn = self._turn(number, stimulus, plant, self._reference)
        self._bench.progress.say(str(turn))
        return turn

    def _turn(
        self, number: int, stimulus: Stimulus, plant: Plant, level: float, highest: float | None = None
    ) -> Iteration:
        time, decay = self._recorder.decays(stimulus.burst, level, self._points, highest)
        fitted = fit_residues(plant.decay_time(time, self._timing), decay, plant.pole)
        refuse_changing_beam([replace(fitted, pole_error=np.zeros_like(plant.pole)), fitted], self._shapes)
        state = plant.state(fitted, self._shapes)
        scale = level / self._reference
        return Iteration(
            number=number,
            state=state,
            errors=state.error(self._target * scale),
            peak_voltage=float(stimulus.peak_voltage.max()) * scale,
            n_taken=self._recorder.n_taken,
        )

    def _drives(
        self, name: str, burst: Burst, drive: DriveDelay, level: float, most_lacking: float = MOST_LACKING
    ) -> tuple[FloatArray, FloatArray]:
        """Return predicted and measured drive of the loaded burst about its peak at a level [V]; refuse a wrong one."""
        commanded = burst.commanded(self._listed.to_beam, level)
        highest = np.abs(commanded).max(axis=0)
        self._recorder.begin(name, 1)
        about = float(highest.argmax()) * self._timing.hold
        taken = self._recorder.drive_from(about - SWEEP / 2, level, float(highest.max()))
        predicted, measured = predicted_drive(drive, commanded, taken.time, self._timing), taken.drive.mean(axis=0)
        refuse_wrong_drive(predicted, measured, 1 / taken.sampling_rate, most_lacking)
        return predicted, measured

    def _levels(
        self, plant: Plant, refined: Apparatus, correction: Correction, reached: ModalState
    ) -> tuple[Level, ...]:
        """Measure every level at the focus; if any deviates, correct the amplitudes and measure all levels again."""
        stimulus = self._corrected(refined, correction)
        self._bench.load(stimulus.burst)
        self._recorder.begin("levels", 2 * len(self._asked))
        first = [self._level(plant, stimulus, reached, level, 1.0) for level in self._asked]
        factors = [level.trim for level in first]
        if all(factor == 1.0 for factor in factors):
            return tuple(first)
        corrections = tuple((level.velocity, factor) for level, factor in zip(first, factors, strict=True))
        corrected = self._corrected(refined, replace(correction, corrections=corrections))
        self._bench.load(corrected.burst)
        self._recorder.begin("levels again", 2 * len(self._asked))
        return tuple(self._level(plant, corrected, reached, level, factor) for level, factor in corrections)

    def _level(self, plant: Plant, stimulus: Stimulus, reached: ModalState, level: float, factor: float) -> Level:
        time, decay, highest = self._recorder.at_level(level, stimulus.target_field.centre)
        fitted = fit_residues(plant.decay_time(time, self._timing), decay, plant.pole)
        vibrometer = plant.vibrometer.response(plant.pole)
        swing = (fitted.residue[:, 0] / vibrometer).real
        shape = plant.model.shapes([stimulus.target_field.centre])[:, 0]
        expected = float(shape @ reached.velocity) * factor * level / self._reference
        noise = float(np.sqrt(np.sum((fitted.spread / np.abs(vibrometer)) ** 2)))
        missed = missed_swing(fitted.residue[:, 0], fitted.spread, fitted.pole, fitted.pole_error)
        return Level(
            velocity=level,
            factor=factor,
            amplitude=stimulus.burst.amplitude_for(level),
            at_focus=float(swing.sum()),
            excess=float(swing[: plant.model.n_modes].sum()) / expected - 1,
            spread=float(np.hypot(noise, np.linalg.norm(missed) / NORMAL_95)),
            sensitivity_doubt=plant.sensitivity_doubt,
            highest=highest,
        )
