"""The loop: identify, aim, measure, correct the targets, until nothing is left that the noise does not explain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from modaltouch.lab.arrays import FloatArray
from modaltouch.lab.calibration.acquisition import (
    DecayRecorder,
    commanded_voltage,
    identifying_burst,
    measuring_points,
    probe_voltage,
    timing_voltage,
)
from modaltouch.lab.calibration.decay import find_poles, fit_residues
from modaltouch.lab.calibration.file import (
    DIGITS,
    CalibrationResult,
    Iteration,
    Level,
    corrected_inputs,
    refined_apparatus,
    significant,
)
from modaltouch.lab.calibration.plant import DriveDelay, Plant, fit_drive, identify_plant
from modaltouch.lab.laboratory import Laboratory, MeasurementProgress
from modaltouch.preflight import DesignInputs, design_to_fit
from modaltouch.protocol import Apparatus
from modaltouch.rig import RigError
from modaltouch.stimulus import Burst, Correction, ModalModel, Stimulus

GAINS = (0.67, 1.5)
"""Measured over commanded drive that is believed [1]: beyond, a probe or a switch is not as the file says."""

NOTHING = 0.02
"""Measured over commanded drive below which there is none [1]."""

LARGEST_REST = 0.3
"""Part of the measured drive that delay, lag and gain may leave unexplained [1]: noise alone leaves a twentieth."""

LEAST_CERTAINTY = 8.0
"""Standard errors by which a mode's swing must stand out of the noise [1]."""

FURTHEST = 0.05
"""How far a natural frequency may lie from the listed one [1]: further, it may be another mode's."""

LARGEST_PHASE = 0.2
"""Phase that the vibrometer's delay and lag may leave unexplained [rad]."""


def refuse_doubtful_drive(drive: DriveDelay) -> None:
    """Refuse a measured drive that is not the commanded one behind an amplifier."""
    believed = drive.rest <= LARGEST_REST
    for number, gain in enumerate(drive.gain, start=1):
        if (believed or abs(gain) < NOTHING) and not GAINS[0] <= gain <= GAINS[1]:
            raise RigError(
                f"the drive measured at the beam is {gain:.2f} times what output {number} commands: allowed "
                f"{GAINS[0]:g} to {GAINS[1]:g}; the outputs are off; see whether the amplifier is on and its gain as "
                "in the apparatus file, the probe at its output, and `acquisition.probe_attenuation` right"
            )
    if not believed:
        raise RigError(
            f"of the drive measured at the beam, {drive.rest:.0%} is not the commanded one behind a delay and a lag: "
            f"allowed at most {LARGEST_REST:.0%}; the outputs are off; see whether the probes are at the amplifier's "
            "outputs and it does not saturate"
        )


def refuse_doubtful_plant(plant: Plant, listed: ModalModel, margin: float) -> None:
    """Refuse modes that are not seen, or are not those of the table."""
    found = plant.model
    for row, label in enumerate(listed.label):
        if not plant.certainty[row] >= LEAST_CERTAINTY:
            raise RigError(
                f"mode {label} at {listed.natural_frequency[row]:.0f} Hz is not seen: it stands out of the noise by "
                f"{plant.certainty[row]:.1f} standard errors, needed are {LEAST_CERTAINTY:g}; the outputs are off; see "
                "whether the vibrometer is focused on the beam and its signal reaches the scope"
            )
        moved = found.natural_frequency[row] / listed.natural_frequency[row] - 1
        if abs(moved) > FURTHEST:
            raise RigError(
                f"mode {label} was found at {found.natural_frequency[row]:.0f} Hz, {moved:+.1%} from the listed "
                f"{listed.natural_frequency[row]:.0f} Hz: allowed {FURTHEST:.0%}; the outputs are off; identify the "
                "beam anew with `modaltouch identify`"
            )
    _refuse_phases(plant, margin)
    known = listed.modal_gain != 0
    ratio = np.where(known, found.modal_gain / np.where(known, listed.modal_gain, 1.0), 1.0)
    if (ratio[known] < 0).all():
        raise RigError(
            "every mode moves against the sign of its listed gain: the vibrometer's signal or the drive is inverted; "
            "the outputs are off; turn the signal round"
        )
    for row, channel in np.argwhere((ratio < 0.4) | (ratio > 2.5)).tolist():
        raise RigError(
            f"the gain of mode {listed.label[row]} by output {channel + 1} was found as "
            f"{found.modal_gain[row, channel] * 1e3:.4g} mm/s^2 per V, listed is "
            f"{listed.modal_gain[row, channel] * 1e3:.4g}: allowed 0.4 to 2.5 times that; the outputs are off; see "
            "whether the sets are wired as listed, or identify the beam anew with `modaltouch identify`"
        )


def _refuse_phases(plant: Plant, margin: float) -> None:
    """Refuse a vibrometer that is no delay and low-pass, or so late that the records begin before its signal."""
    vibrometer = plant.vibrometer
    if vibrometer.rest > LARGEST_PHASE:
        raise RigError(
            f"the modes' phases differ by {vibrometer.rest:.2f} rad from those of a delay and a low-pass: allowed "
            f"{LARGEST_PHASE:g} rad; the outputs are off; see which filters the vibrometer has switched on"
        )
    if vibrometer.delay + 10 * vibrometer.lag > margin:
        raise RigError(
            f"the vibrometer is {vibrometer.delay * 1e6:.0f} us late, with a low-pass of {vibrometer.lag * 1e6:.1f} "
            f"us: allowed together with ten times the latter {margin * 1e6:.0f} us; the outputs are off; switch on a "
            "faster filter"
        )


MOST_ITERATIONS = 4
"""Turns of the loop at most; two settle it."""

LEAST_CHANGE = 2e-4
"""Correction, as a part of the reference level, that is not worth another turn [1]."""

LEAST_TRIM = 5e-3
"""Deviation of a level below which its amplitude is left as it is [1]."""


def calibrate_each(
    bench: Laboratory,
    apparatus: Apparatus,
    inputs_of: Mapping[str, DesignInputs],
    progress: MeasurementProgress | None = None,
    between: Sequence[float] = (),
) -> dict[str, CalibrationResult]:
    """Return the targets and amplitudes that make each of several stimuli true on the rig at a bench, by name.

    The rig is identified once, with the clock of the first: amplifier, modes and vibrometer are those of all.

    Parameters
    ----------
    bench : Laboratory
        Generator and scope.
    apparatus : Apparatus
        As its file gives it.
    inputs_of : mapping of str to DesignInputs
        The stimuli, without any calibration; one, without a name, of a protocol that has one alone.
    progress : MeasurementProgress, optional
        Whom to tell.
    between : sequence of float
        Levels to verify besides the protocol's own [mm/s].

    Raises
    ------
    RigError, ValueError
        As `calibrate` does.
    """
    heard = progress or MeasurementProgress()
    found: dict[str, CalibrationResult] = {}
    plant: Plant | None = None
    for name, inputs in inputs_of.items():
        if name:
            heard.say(f"stimulus {name}")
        found[name] = calibrate(bench, apparatus, inputs, heard, plant, between, name)
        plant = found[name].plant
    return found


def calibrate(
    bench: Laboratory,
    apparatus: Apparatus,
    inputs: DesignInputs,
    progress: MeasurementProgress | None = None,
    plant: Plant | None = None,
    between: Sequence[float] = (),
    name: str = "",
) -> CalibrationResult:
    """Return the targets and amplitudes that make a stimulus true on the rig at a bench.

    Parameters
    ----------
    bench, apparatus
        As for `calibrate_each`.
    inputs : DesignInputs
        The stimulus, without any calibration.
    progress : MeasurementProgress, optional
        Whom to tell.
    plant : Plant, optional
        The rig, where it has been identified already.
    between : sequence of float
        Levels to verify besides the protocol's own [mm/s].
    name : str
        Of the stimulus, where there are several.

    Raises
    ------
    RigError
        If the rig fails, or the stimulus needs more than its amplifier gives.
    ValueError
        If the stimulus cannot be designed for the identified rig.
    """
    return _Loop(bench, apparatus, inputs, progress or MeasurementProgress(), between, name).run(plant)


class _Loop:
    """One calibration, from the listed apparatus to verified levels."""

    def __init__(
        self,
        bench: Laboratory,
        apparatus: Apparatus,
        inputs: DesignInputs,
        progress: MeasurementProgress,
        between: Sequence[float],
        name: str,
    ) -> None:
        self._asked = sorted({level * 1e-3 for level in (*inputs.levels.values(), *between)})
        self._bench, self._apparatus, self._inputs, self._progress = bench, apparatus, inputs, progress
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
            progress=progress,
            name=name,
        )

    def run(self, known: Plant | None) -> CalibrationResult:
        """Identify what is not known, correct, verify."""
        plant = known or self._identify()
        self._recorder.wait_for(plant.drive)
        refined = refined_apparatus(self._apparatus, plant)
        # What is listed commands volts of the listed amplifier.
        self._refuse_beyond_limit(float(self._listed.peak_voltage.max()) * max(plant.drive.gain))
        turns = [self._measure(0, self._listed, plant)]
        corrected_target = np.stack([self._target, np.zeros_like(self._target)])
        stimulus = self._corrected(refined, self._correction(corrected_target))
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
        correction = self._correction(kept)
        levels = self._levels(plant, refined, correction)
        corrections = tuple((level.velocity, level.factor) for level in levels)
        return CalibrationResult(
            inputs=self._inputs,
            plant=plant,
            refined=refined,
            target=self._target,
            correction=replace(correction, corrections=corrections),
            points=self._points,
            turns=tuple(turns),
            best=best,
            levels=levels,
        )

    def _refuse_beyond_limit(self, needed: float) -> None:
        limit = self._apparatus.amplifier.limit_V
        if needed > limit:
            raise RigError(
                f"{self._reference * 1e3:g} mm/s needs {needed:.0f} V at the beam on this rig: allowed are {limit:g} "
                "V; the outputs are off; lower the highest level of the protocol"
            )

    def _identify(self) -> Plant:
        """Identify amplifier and clock by the drive, modes and vibrometer by the decays after a probe of each output.

        Delay and lag come first: a delay of a few microseconds that the loop does not know makes it diverge.
        """
        listed, timing = self._listed, self._timing
        n_channels, to_beam = listed.model.n_channels, listed.amplifier.gain * listed.load_factor

        def burst_of(voltage: FloatArray) -> Burst:
            limits = (self._apparatus.safety.velocity_limit_mm_s, self._apparatus.acquisition.range_mm_s)
            return identifying_burst(
                voltage,
                listed.model,
                timing,
                listed.amplifier,
                load_factor=listed.load_factor,
                velocity_limit=min(limits) * 1e-3,
            )

        self._recorder.begin("amplifier and clock", 2)
        burst = burst_of(timing_voltage(listed.model, timing))
        commanded = commanded_voltage(burst, to_beam)
        drive = fit_drive(self._recorder.drive(burst, float(np.abs(commanded).max())), commanded, timing)
        refuse_doubtful_drive(drive)
        self._recorder.wait_for(drive)
        rows, voltages, time = [], [], np.zeros(0)
        for channel in range(n_channels):
            self._recorder.begin(f"modes, by output {channel + 1}", self._points.size)
            burst = burst_of(probe_voltage(listed.model, timing, channel))
            voltages.append(commanded_voltage(burst, to_beam))
            time, decay = self._recorder.decays(burst, burst.velocity, self._points)
            rows.append(decay)
        since = time / (1 + drive.clock) - timing.focusing_instant
        decays = find_poles(since, np.concatenate(rows), listed.model.exponent)
        plant = identify_plant(listed.model, listed.amplifier, drive, decays, self._shapes, voltages, timing)
        refuse_doubtful_plant(plant, listed.model, self._recorder.margin)
        return plant

    def _corrected(self, refined: Apparatus, correction: Correction) -> Stimulus:
        return design_to_fit(corrected_inputs(self._inputs, refined, correction), release="free")

    def _correction(self, corrected_target: FloatArray) -> Correction:
        """Return targets with the digits that the file keeps."""
        velocity, displacement = (np.round(each * 1e3, DIGITS) * 1e-3 for each in corrected_target)
        return Correction(velocity, displacement, self._reference)

    def _measure(self, number: int, stimulus: Stimulus, plant: Plant) -> Iteration:
        """Play a stimulus at the reference level and return what the modes do at the focusing instant."""
        self._recorder.begin("before" if number == 0 else f"iteration {number}", self._points.size)
        time, decay = self._recorder.decays(stimulus.burst, self._reference, self._points)
        fitted = fit_residues(plant.decay_time(time, self._timing), decay, plant.pole)
        state = plant.state(fitted, self._shapes)
        turn = Iteration(number, state, state.error(self._target), float(stimulus.peak_voltage.max()))
        self._progress.say(str(turn))
        return turn

    def _levels(self, plant: Plant, refined: Apparatus, correction: Correction) -> tuple[Level, ...]:
        """Measure every level at the focus, with amplitudes in proportion and then, where that is off, as measured."""
        stimulus = self._corrected(refined, correction)
        self._bench.load(stimulus.burst)
        self._recorder.begin("levels", 2 * len(self._asked))
        first = [self._level(plant, stimulus, level, 1.0) for level in self._asked]
        factors = [_trim(level) for level in first]
        if all(factor == 1.0 for factor in factors):
            return tuple(first)
        corrections = tuple((level.velocity, factor) for level, factor in zip(first, factors, strict=True))
        corrected = self._corrected(refined, replace(correction, corrections=corrections))
        self._bench.load(corrected.burst)
        self._recorder.begin("levels again", 2 * len(self._asked))
        return tuple(self._level(plant, corrected, level, factor) for level, factor in corrections)

    def _level(self, plant: Plant, stimulus: Stimulus, level: float, factor: float) -> Level:
        time, decay, highest = self._recorder.at_level(level, stimulus.target_field.centre)
        fitted = fit_residues(plant.decay_time(time, self._timing), decay, plant.pole)
        vibrometer = plant.vibrometer.response(plant.pole)
        return Level(
            velocity=level,
            factor=factor,
            amplitude=stimulus.amplitude_for(level),
            at_focus=float((fitted.residue[:, 0] / vibrometer).real.sum()),
            spread=float(np.sqrt(np.sum((fitted.spread / np.abs(vibrometer)) ** 2))),
            highest=highest,
        )


def _trim(level: Level) -> float:
    """Return the factor of a level's amplitude: 1 where the noise may explain the deviation."""
    if abs(level.at_focus - level.velocity) < max(LEAST_TRIM * level.velocity, 3 * level.spread):
        return 1.0
    factor = level.velocity / level.at_focus if level.at_focus > 0 else float("inf")
    if not 0.5 < factor < 2:
        raise RigError(
            f"the level of {level.velocity * 1e3:g} mm/s reaches {level.at_focus * 1e3:.1f} mm/s at the focus: the rig "
            "does not follow its amplitude; the outputs are off; see whether the amplifier saturates"
        )
    return round(factor, 6)
