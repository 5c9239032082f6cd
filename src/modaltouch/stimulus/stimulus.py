"""Stimulus: from a target field to voltages, codes, and the response of the beam at every level."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.burst import Burst, Correction, Timing
from modaltouch.stimulus.drive import (
    Design,
    Drive,
    Law,
    Priority,
    Release,
    Rounding,
    Steering,
    check_drivable,
    exact_drive,
)
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantised import QuantisedStimulus, settle
from modaltouch.stimulus.quantities import FloatArray
from modaltouch.stimulus.target_field import Projection, TargetField
from modaltouch.stimulus.vibration import history

if TYPE_CHECKING:
    from modaltouch.stimulus.fingers import Finger
    from modaltouch.stimulus.touched import TouchedStimulus


@dataclass(frozen=True, eq=False)
class Stimulus:
    """Voltages for a target field, their codes, and the response of the beam at every level.

    All results are computed on first use.

    Attributes
    ----------
    model : ModalModel
        The identified beam.
    target_field : TargetField
        The target field; its velocity is the reference level, the highest of all levels.
    timing : Timing
        Samples, clock and focusing instant.
    amplifier : Amplifier
        The amplifier between generator and beam.
    law : str
        ``exact`` (every modelled mode meets its target) or ``paper`` (equations 6 and 7).
    release : str
        ``braked`` (at rest at the end of the burst) or ``free`` (zero volts after the focusing instant).
    levels : tuple of float
        Levels whose amplitudes should lie close to the generator's grid [m/s].
    load_factor : float
        Amplifier input voltage over the generator's open-circuit voltage: 1 into high impedance, 0.5 into 50 ohm [1].
    rounding : str
        ``settled`` (single codes are changed so that rounding causes almost no error at the focusing instant; not for
        the law of the paper, whose error is far larger) or ``plain``.
    correction : Correction, optional
        Calibrated corrections of the amplitudes and of the targets of the exact law.
    design : str
        Design of the exact law: ``least_energy``; ``norm_4`` or ``norm_8``, with lower peak voltage but more energy; or
        ``least_peak``, which switches between the extremes and excites unmodelled modes.
    priority : str
        ``field`` (the whole field, at any voltage) or ``level`` (the exact level at the focus, and the field as close
        as the amplifier's limit allows).
    """

    model: ModalModel
    target_field: TargetField
    timing: Timing
    amplifier: Amplifier
    law: Law
    release: Release
    levels: tuple[float, ...]
    load_factor: float
    rounding: Rounding = "settled"
    correction: Correction | None = None
    design: Design = "least_energy"
    priority: Priority = "field"

    @cached_property
    def projection(self) -> Projection:
        """The target field projected on the modelled modes."""
        return Projection(self.model, self.target_field)

    @property
    def selected(self) -> tuple[int, ...]:
        """Labels of the excited modes, increasing."""
        return self.projection.selected

    @property
    def target(self) -> FloatArray:
        """Modal velocities at the focusing instant at the reference level, (n_modes,) array [m/s]."""
        return self.projection.target

    @cached_property
    def system(self) -> DiagonalSystem:
        """The modal equations behind the amplifier."""
        return DiagonalSystem.of(self.model, self.amplifier)

    @cached_property
    def corrected_target(self) -> tuple[FloatArray, FloatArray]:
        """Targets of the law at the reference level, with any calibrated correction.

        Modal velocities, and displacements times angular frequency, two (n_modes,) arrays [m/s].
        """
        if self._correction is None:
            return self.target, np.zeros_like(self.target)
        return self._correction.at(self.target_field.velocity)

    @property
    def _correction(self) -> Correction | None:
        return self.correction if self.law == "exact" else None

    @cached_property
    def _steering(self) -> Steering:
        return Steering(self.model, self.system, self.timing, self.release, *self.corrected_target)

    @cached_property
    def drive(self) -> Drive:
        """Voltages before rounding, and how accurately they meet the targets."""
        if (self.law, self.priority, self.design) == ("exact", "field", "least_energy"):
            return exact_drive(self._steering)
        from modaltouch.stimulus.other_drives import least_norm, least_peak, level_first_drive, paper_drive

        if self.law == "paper":
            return paper_drive(self._steering)
        if self.priority == "level":
            focus = self.model.shapes([self.target_field.centre])[:, 0]
            return level_first_drive(self._steering, focus, self.amplifier.limit)
        if self.design == "least_peak":
            return least_peak(self._steering)
        return least_norm(self._steering, {"norm_4": 4.0, "norm_8": 8.0}[self.design])

    @property
    def voltage(self) -> FloatArray:
        """Voltages at the beam before rounding, at the reference level, (n_channels, n_samples) array [V]."""
        return self.drive.voltage

    @cached_property
    def peak_voltage(self) -> FloatArray:
        """Highest voltage at the beam at the reference level, either sign, (n_channels,) array [V]."""
        return np.asarray(np.maximum(self.voltage.max(axis=1), -self.voltage.min(axis=1)))

    @cached_property
    def burst(self) -> Burst:
        """The codes, shared by all levels, and the amplitude of each channel at the reference level."""
        return Burst(
            codes=self.timing.converter.unsigned(self._played.codes),
            duration=self.timing.duration,
            repetition_rate=self.timing.repetition_rate,
            velocity=self.target_field.velocity,
            amplitude=self._full_scale,
            converter=self.timing.converter,
            corrections=() if self._correction is None else self._correction.corrections,
        )

    @property
    def to_beam(self) -> float:
        """Voltage at the beam per open-circuit voltage of the generator [V/V]."""
        return self.amplifier.gain * self.load_factor

    @cached_property
    def _full_scale(self) -> tuple[float, ...]:
        """Amplitude of each channel's full scale at the reference level [V peak to peak, open circuit]."""
        shares = tuple(v / self.target_field.velocity for v in self.levels)
        return tuple(self.timing.converter.full_scale(2 * float(v) / self.to_beam, shares) for v in self.peak_voltage)

    @cached_property
    def _played(self) -> QuantisedStimulus:
        """The codes and the resulting motion."""
        converter = self.timing.converter
        volts_per_code = np.asarray(self._full_scale) * (self.to_beam / 2 / converter.mid_code)
        codes = converter.round_to_codes(self.voltage, volts_per_code)
        if self.law == "exact" and self.rounding == "settled":
            states = volts_per_code @ self.system.states_by_channel(codes, self.timing, self.timing.focusing_instant)
            error = self._reached - np.concatenate(self.system.read(states))
            codes = settle(codes, volts_per_code, self.system, self.timing, error, float(np.abs(self.target).max()))
        played = QuantisedStimulus(self.model, self.amplifier, self.timing, codes)
        vars(played)["system"] = self.system  # slow to compute with fingers
        return played

    @property
    def _reached(self) -> FloatArray:
        """Modal velocities, then w eta, reached by the voltages before rounding, (2 n_modes,) array [m/s]."""
        if self.priority == "field":
            return np.concatenate(self.corrected_target)
        timing = self.timing
        return np.concatenate(self.system.read(self.system.state_at(self.voltage, timing, timing.focusing_instant)))

    def peak_drive(self, velocity: float) -> FloatArray:
        """Return the peak voltage of each channel played at a level [m/s], (n_channels,) array [V]."""
        return self._played.highest * self.volts_per_code(velocity)

    def touched(self, fingers: tuple[Finger, ...]) -> TouchedStimulus:
        """Return the codes played on the beam with fingers; `volts_per_code` gives the voltage of a code."""
        from modaltouch.stimulus.touched import TouchedStimulus

        return TouchedStimulus(self.model.touched(fingers), self.amplifier, self.timing, self._played.codes)

    def volts_per_code(self, velocity: float) -> FloatArray:
        """Return the voltage of one code at the beam at a level [m/s], amplitudes rounded, (n_channels,) array [V]."""
        # Without calibrated amplitude factors, which only correct the output of the real generator at this level.
        burst = self.burst
        amplitude = burst.converter.amplitudes_at(burst.amplitude, velocity, burst.velocity, burst.shares)
        return np.asarray(amplitude) / burst.shares * (self.to_beam / 2 / self.timing.converter.mid_code)

    def voltage_played(self, velocity: float) -> FloatArray:
        """Return the voltages at the beam when the codes are played at a level [m/s], (n_channels, n_samples) [V]."""
        return self._played.codes * self.volts_per_code(velocity)[:, None]

    def achieved(self, velocity: float, *, steady: bool = False) -> tuple[FloatArray, FloatArray]:
        """Return the modal state reached by the rounded codes at the focusing instant.

        Parameters
        ----------
        velocity : float
            Level [m/s].
        steady : bool
            Whether in the steady state of the repeated burst rather than in the first burst.

        Returns
        -------
        velocity : (n_modes,) array
            Modal velocities [m/s].
        displacement : (n_modes,) array
            Modal displacements times angular frequency [m/s].
        """
        unit = self.volts_per_code(velocity)
        return self.system.read(self._played.states_steady(unit) if steady else self._played.states_at_focus(unit))

    def worst_modal_error(self, velocity: float, *, steady: bool = False) -> float:
        """Return the largest of ``|velocity - target|`` and ``|w eta - target|`` over the modes [m/s].

        Parameters
        ----------
        velocity, steady
            As in `achieved`.
        """
        corrected_target = np.concatenate(self.corrected_target) * (velocity / self.target_field.velocity)
        return float(np.abs(np.concatenate(self.achieved(velocity, steady=steady)) - corrected_target).max())

    def velocity_at_focus(self, positions: ArrayLike, velocity: float) -> FloatArray:
        """Return the velocity at points [m] at the focusing instant for a level [m/s], (n_positions,) array [m/s]."""
        return self._played.velocity_at_focus(positions, self.volts_per_code(velocity))

    def velocity_history(self, positions: ArrayLike, velocity: float, *, whole_period: bool = False) -> FloatArray:
        """Return the velocity at points of the beam during the first burst as played, (n_positions, n_samples) array.

        Parameters
        ----------
        positions, velocity
            As in `velocity_at_focus`.
        whole_period : bool
            Whether to continue to the end of the period, with silence after the burst.

        Returns
        -------
        (n_positions, n_samples) array
            Velocity at the instants ``n * hold + delay`` at which each sample begins at the beam [m/s].
        """
        voltage = self.voltage_played(velocity)
        if whole_period:
            n_silent = int(self.timing.sampling_rate / self.timing.repetition_rate) - voltage.shape[1]
            voltage = np.pad(voltage, ((0, 0), (0, max(0, n_silent))))
        return history(self.system, self.model.shapes(positions).T @ self.system.velocity, voltage, self.timing)

    def peak_velocity(self, positions: ArrayLike, velocity: float) -> FloatArray:
        """Return the highest speed at points of the beam until the next burst, (n_positions,) array [m/s].

        Parameters
        ----------
        positions, velocity
            As in `velocity_at_focus`.
        """
        return self._played.peak_velocity(positions, self.volts_per_code(velocity))


def design_stimulus(
    model: ModalModel,
    target_field: TargetField,
    timing: Timing,
    amplifier: Amplifier,
    *,
    law: Law = "exact",
    release: Release = "braked",
    levels: tuple[float, ...] | None = None,
    load_factor: float = 1.0,
    rounding: Rounding = "settled",
    design: Design = "least_energy",
    priority: Priority = "field",
    correction: Correction | None = None,
) -> Stimulus:
    """Return the stimulus that produces a target field at the focusing instant.

    Parameters
    ----------
    model, target_field, timing, amplifier, law, release, load_factor, rounding, design, priority, correction
        As in `Stimulus`.
    levels : tuple of float, optional
        Every level that will be played [m/s]; the velocity of the target field if not given.

    Raises
    ------
    ValueError
        If modes and clock cannot produce the field; the message states the bound and a remedy.
    """
    played = (target_field.velocity,) if levels is None else tuple(levels)
    if amplifier.delay >= timing.focusing_instant:
        raise ValueError(
            f"the delay of the amplifier is {amplifier.delay:g} s, past the focusing instant of "
            f"{timing.focusing_instant:g} s; it must be shorter: focus later, or check the delay"
        )
    given = model, target_field, timing, amplifier, law, release, played, load_factor, rounding, correction
    stimulus = Stimulus(*given, design=design, priority=priority)
    check_drivable(model, stimulus.target, timing)
    return stimulus
