"""The loop: identify, aim, measure, correct the targets, until nothing is left that the noise does not explain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modaltouch.apparatus import Apparatus
from modaltouch.calibration.bursts import commanded_voltage, identifying_burst, probe_voltage, timing_voltage
from modaltouch.calibration.decay import find_poles, fit_residues
from modaltouch.calibration.lag import fit_drive
from modaltouch.calibration.plant import ModalState, Plant, identify_plant
from modaltouch.calibration.taking import Bench, Taking, measuring_points
from modaltouch.document import InputError
from modaltouch.preflight.examine import Preflight, design_to_fit
from modaltouch.preflight.ground import Ground
from modaltouch.rig.interface import RigError
from modaltouch.stimulus.burst import Burst
from modaltouch.stimulus.correction import Correction
from modaltouch.stimulus.design import Stimulus

FloatArray = NDArray[np.float64]

MOST_ITERATIONS = 4
"""Turns of the loop at most; two settle it."""

CERTAIN = 3.0
"""Standard errors below which a deviation may be noise, and is not corrected [1]."""

LEAST_CHANGE = 2e-4
"""Correction, as a part of the reference level, that is not worth another turn [1]."""

DIGITS = 6
"""Decimals of a target in mm/s that the file keeps: a thousandth of what noise leaves."""

LEAST_TRIM = 2e-3
"""Deviation of a level below which its amplitude is left as it is [1]."""


@dataclass(frozen=True)
class Turn:
    """What one turn of the loop measured at the reference level.

    Attributes
    ----------
    number : int
        0 is the stimulus as the apparatus file gives it.
    state : ModalState
        Of the modes at the focusing instant.
    errors : (float, float)
        Largest of velocity, and of w eta [m/s].
    peak_voltage : float
        Highest voltage at the beam [V].
    """

    number: int
    state: ModalState
    errors: tuple[float, float]
    peak_voltage: float

    @property
    def worst(self) -> float:
        """The larger of both errors [m/s]."""
        return max(self.errors)


@dataclass(frozen=True)
class Level:
    """A level as measured at the centre of the focus zone.

    Attributes
    ----------
    velocity : float
        The level [m/s].
    factor : float
        Of its amplitude [1].
    amplitude : tuple of float
        Of each output [V peak to peak, open circuit].
    at_focus : float
        Velocity at the focusing instant [m/s].
    spread : float
        Its standard error [m/s].
    highest : float
        Highest speed over the burst [m/s].
    """

    velocity: float
    factor: float
    amplitude: tuple[float, ...]
    at_focus: float
    spread: float
    highest: float


@dataclass(frozen=True, eq=False)
class Outcome:
    """A finished calibration.

    Attributes
    ----------
    plant : Plant
        The identified rig.
    refined : Apparatus
        The apparatus with modes and amplifier as identified, in the units and digits of its file.
    target : (n_modes,) array
        Modal velocities wished at the reference level [m/s].
    correction : Correction
        Targets to aim at, and factors of the levels.
    points : (n_points,) array
        Where the beam was measured [m].
    turns : tuple of Turn
        All turns, the first before any correction.
    best : Turn
        The one whose targets are kept.
    levels : tuple of Level
        As verified.
    """

    plant: Plant
    refined: Apparatus
    target: FloatArray
    correction: Correction
    points: FloatArray
    turns: tuple[Turn, ...]
    best: Turn
    levels: tuple[Level, ...]


def _quiet(*_: object) -> None:
    """Say nothing, stop at no moment."""


@dataclass(frozen=True)
class Progress:
    """Whom to tell what the loop does.

    Attributes
    ----------
    check : callable
        Called before each record; raises where a signal has come.
    step : callable
        Called with what begins, in words, and how many records it takes.
    advance : callable
        Called after each record.
    turn : callable
        Called with each `Turn` as soon as it is measured.
    """

    check: Callable[[], None] = _quiet
    step: Callable[[str, int], None] = _quiet
    advance: Callable[[], None] = _quiet
    turn: Callable[[Turn], None] = _quiet


def calibrate(bench: Bench, apparatus: Apparatus, ground: Ground, progress: Progress | None = None) -> Outcome:
    """Return the targets and amplitudes that make a stimulus true on the rig at a bench.

    Parameters
    ----------
    bench : Bench
        Generator and scope.
    apparatus : Apparatus
        As its file gives it.
    ground : Ground
        The stimulus, without any calibration.
    progress : Progress, optional
        Whom to tell.

    Raises
    ------
    RigError
        If the rig fails, or the stimulus needs more than its amplifier gives.
    ValueError
        If the stimulus cannot be designed for the identified rig.
    """
    return _Loop(bench, apparatus, ground, progress or Progress()).run()


class _Loop:
    """One calibration, from the listed apparatus to verified levels."""

    def __init__(self, bench: Bench, apparatus: Apparatus, ground: Ground, progress: Progress) -> None:
        self._bench, self._apparatus, self._ground, self._progress = bench, apparatus, ground, progress
        self._listed = design_to_fit(ground, release="free")
        self._timing, self._target = self._listed.timing, self._listed.target
        self._reference = self._listed.wish.velocity
        model = self._listed.model
        self._points = measuring_points(model)
        self._shapes = model.shapes(self._points)
        self._taking = Taking(
            bench=bench,
            model=model,
            timing=self._timing,
            highest_velocity=apparatus.acquisition.range_mm_s * 1e-3,
            check=progress.check,
            advance=progress.advance,
        )

    def run(self) -> Outcome:
        """Identify, correct, verify."""
        plant = self._identify()
        refined = refined_apparatus(self._apparatus, plant)
        turns = [self._measure(0, self._listed, plant)]
        aim = np.stack([self._target, np.zeros_like(self._target)])
        best, kept = self._measure_aimed(1, plant, refined, aim), aim
        turns.append(best)
        for number in range(2, MOST_ITERATIONS + 1):
            change = significant(turns[-1].state, self._target)
            if np.abs(change).max() < LEAST_CHANGE * self._reference:
                break
            aim = aim - change
            if self._excess(refined, aim):
                break
            turns.append(self._measure_aimed(number, plant, refined, aim))
            if turns[-1].worst >= best.worst:
                break
            best, kept = turns[-1], aim
        correction = self._correction(kept)
        levels = self._levels(plant, refined, correction)
        trims = tuple((level.velocity, level.factor) for level in levels)
        return Outcome(
            plant=plant,
            refined=refined,
            target=self._target,
            correction=replace(correction, trims=trims),
            points=self._points,
            turns=tuple(turns),
            best=best,
            levels=levels,
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

        self._progress.step("amplifier and clock", 2)
        burst = burst_of(timing_voltage(listed.model, timing))
        commanded = commanded_voltage(burst, to_beam)
        drive = fit_drive(self._taking.drive(burst, float(np.abs(commanded).max())), commanded, timing)
        rows, voltages, time = [], [], np.zeros(0)
        for channel in range(n_channels):
            self._progress.step(f"modes, by output {channel + 1}", self._points.size)
            burst = burst_of(probe_voltage(listed.model, timing, channel))
            voltages.append(commanded_voltage(burst, to_beam))
            time, decay = self._taking.decays(burst, burst.velocity, self._points)
            rows.append(decay)
        since = time / (1 + drive.clock) - timing.focusing_instant
        decays = find_poles(since, np.concatenate(rows), listed.model.exponent)
        return identify_plant(listed.model, listed.amplifier, drive, decays, self._shapes, voltages, timing)

    def _aimed(self, refined: Apparatus, correction: Correction) -> Stimulus:
        return design_to_fit(aimed_ground(self._ground, refined, correction), release="free")

    def _correction(self, aim: FloatArray) -> Correction:
        """Return targets with the digits that the file keeps."""
        velocity, displacement = (np.round(each * 1e3, DIGITS) * 1e-3 for each in aim)
        return Correction(velocity, displacement, self._reference)

    def _excess(self, refined: Apparatus, aim: FloatArray) -> float:
        """Return the voltage that targets need, where the amplifier does not give it; else 0 [V]."""
        highest = float(self._aimed(refined, self._correction(aim)).peak_voltage.max())
        return highest if highest > refined.amplifier.limit_V else 0.0

    def _measure_aimed(self, number: int, plant: Plant, refined: Apparatus, aim: FloatArray) -> Turn:
        needed = self._excess(refined, aim)
        if needed:
            raise RigError(
                f"{self._reference * 1e3:g} mm/s needs {needed:.0f} V at the beam on this rig: allowed are "
                f"{refined.amplifier.limit_V:g} V; the outputs are off; lower the highest level of the protocol"
            )
        return self._measure(number, self._aimed(refined, self._correction(aim)), plant)

    def _measure(self, number: int, stimulus: Stimulus, plant: Plant) -> Turn:
        """Play a stimulus at the reference level and return what the modes do at the focusing instant."""
        self._progress.step("before" if number == 0 else f"iteration {number}", self._points.size)
        time, decay = self._taking.decays(stimulus.burst, self._reference, self._points)
        fitted = fit_residues(plant.decay_time(time, self._timing), decay, plant.pole)
        state = plant.state(fitted, self._shapes)
        turn = Turn(number, state, state.error(self._target), float(stimulus.peak_voltage.max()))
        self._progress.turn(turn)
        return turn

    def _levels(self, plant: Plant, refined: Apparatus, correction: Correction) -> tuple[Level, ...]:
        """Measure every level at the focus, with amplitudes in proportion and then, where that is off, as measured."""
        stimulus = self._aimed(refined, correction)
        self._bench.load(stimulus.burst)
        self._progress.step("levels", 2 * len(stimulus.levels))
        first = [self._level(plant, stimulus, level, 1.0) for level in stimulus.levels]
        factors = [_trim(level) for level in first]
        if all(factor == 1.0 for factor in factors):
            return tuple(first)
        trims = tuple((level.velocity, factor) for level, factor in zip(first, factors, strict=True))
        trimmed = self._aimed(refined, replace(correction, trims=trims))
        self._bench.load(trimmed.burst)
        self._progress.step("levels again", 2 * len(stimulus.levels))
        return tuple(self._level(plant, trimmed, level, factor) for level, factor in trims)

    def _level(self, plant: Plant, stimulus: Stimulus, level: float, factor: float) -> Level:
        time, decay, highest = self._taking.at_level(level, stimulus.wish.centre)
        fitted = fit_residues(plant.decay_time(time, self._timing), decay, plant.pole)
        sight = plant.sight.response(plant.pole)
        return Level(
            velocity=level,
            factor=factor,
            amplitude=stimulus.amplitude_for(level),
            at_focus=float((fitted.residue[:, 0] / sight).real.sum()),
            spread=float(np.sqrt(np.sum((fitted.spread / np.abs(sight)) ** 2))),
            highest=highest,
        )


def ground_of(preflight: Preflight) -> Ground:
    """Return what the stimulus of a checked protocol is designed from.

    Raises
    ------
    InputError
        If anything is wrong with the files, or the stimulus has no targets that could be corrected.
    """
    preflight.require()
    ground, reading = preflight.ground, preflight.findings.protocol
    if ground is None or reading is None:
        raise InputError(preflight.problems)
    if ground.section.law != "exact":
        given = f"{ground.section.law}, a law without targets that could be corrected"
        raise InputError([reading.problem(("stimulus", "law"), given, "exact", "calibrate the exact law")])
    return ground


def significant(state: ModalState, target: FloatArray) -> FloatArray:
    """Return how far the states are from their targets, less what may be noise, (2, n_modes) array [m/s].

    A deviation of a few standard errors is corrected in part, a smaller one not at all, so that the loop does not
    chase the noise of its own measurements.

    Parameters
    ----------
    state : ModalState
        As measured.
    target : (n_modes,) array
        Modal velocities wished [m/s].
    """
    error = np.stack([state.velocity - target, state.displacement])
    doubt = CERTAIN * state.spread / np.maximum(np.abs(error), 1e-30)
    return np.asarray(error * np.maximum(1 - doubt**2, 0.0))


def aimed_ground(ground: Ground, refined: Apparatus, correction: Correction) -> Ground:
    """Return what a stimulus is designed from on an identified rig."""
    used = ground.apparatus.model_copy(update={"modes": refined.modes, "amplifier": refined.amplifier})
    return replace(ground, apparatus=used, correction=correction)


def refined_apparatus(apparatus: Apparatus, plant: Plant) -> Apparatus:
    """Return an apparatus with modes and amplifier as identified, with the digits that the calibration file keeps."""
    channel = {name: actuators.channel - 1 for name, actuators in apparatus.actuator_sets.items()}
    modes = []
    for row, mode in enumerate(apparatus.modes):
        gains = {name: _digits(plant.model.modal_gain[row, place] * 1e3) for name, place in channel.items()}
        update = {
            "natural_frequency_Hz": _digits(plant.model.natural_frequency[row]),
            "damping_ratio": _digits(plant.model.damping_ratio[row]),
            "gain_mm_s2_per_V": gains,
            "assumed": (),
        }
        modes.append(mode.model_copy(update=update))
    bandwidth = plant.amplifier.bandwidth
    amplifier = apparatus.amplifier.model_copy(
        update={
            "gain_V_per_V": _digits(plant.amplifier.gain),
            "bandwidth_kHz": None if bandwidth is None else _digits(bandwidth * 1e-3),
            "delay_us": _digits(plant.amplifier.delay * 1e6),
        }
    )
    return apparatus.model_copy(update={"modes": tuple(modes), "amplifier": amplifier})


def _digits(value: float) -> float:
    return float(f"{value:.9g}")


def _trim(level: Level) -> float:
    """Return the factor of a level's amplitude: 1 where the noise may explain the deviation."""
    factor = level.velocity / level.at_focus if level.at_focus > 0 else float("inf")
    if not 0.5 < factor < 2:
        raise RigError(
            f"the level of {level.velocity * 1e3:g} mm/s reaches {level.at_focus * 1e3:.1f} mm/s at the focus: the rig "
            "does not follow its amplitude; the outputs are off; see whether the amplifier saturates"
        )
    within = abs(level.at_focus - level.velocity) < max(LEAST_TRIM * level.velocity, 3 * level.spread)
    return 1.0 if within else round(factor, 6)
