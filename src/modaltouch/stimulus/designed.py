"""A designed stimulus: it knows its codes, and what they do to the beam."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.stimulus.bounds import require_positive
from modaltouch.stimulus.burst import MID_CODE, Burst, amplitudes_at
from modaltouch.stimulus.correction import Correction, Trims, trimmed
from modaltouch.stimulus.drive import Drive, Law
from modaltouch.stimulus.played import QuantisedStimulus
from modaltouch.stimulus.quantisation import full_scale, round_to_codes, unsigned_codes
from modaltouch.stimulus.rounding import settle
from modaltouch.stimulus.vibration import states_by_channel
from modaltouch.stimulus.voltages import LAWLESS, Voltages

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Rounding = Literal["settled", "plain"]
Design = Literal["least_energy", "norm_4", "norm_8", "least_peak"]

_FEW = 1024
"""Points up to which mode shapes are kept for the next question."""


@dataclass(frozen=True, eq=False)
class Stimulus(Voltages):
    """A designed stimulus: voltages, their codes, and the beam's answer at every level.

    Attributes
    ----------
    model, wish, timing, amplifier, law, release
        As for `Voltages`.
    levels : tuple of float
        Levels whose amplitudes shall lie on the generator's grid [m/s].
    load_factor : float
        Share of the generator's open-circuit voltage that reaches the amplifier's input: 1 into high impedance,
        0.5 into 50 ohm [1].
    rounding : str
        ``settled`` (single codes changed so that rounding costs next to nothing at the focus; the paper's law,
        which misses by far more, is left alone) or ``plain``.
    correction : Correction, optional
        What a calibration makes of the targets of the exact law and of the amplitudes.
    design : str
        Of the exact law: ``least_energy``; ``norm_4`` or ``norm_8``, of less peak voltage for more energy; or
        ``least_peak``, which jumps from end to end and shakes what is not modelled.
    """

    levels: tuple[float, ...]
    load_factor: float
    rounding: Rounding = "settled"
    correction: Correction | None = None
    design: Design = "least_energy"

    @cached_property
    def drive(self) -> Drive:
        """Voltages before rounding, and how well they were solved for."""
        if self.law == "paper" or self.design == "least_energy":
            return super().drive
        from modaltouch.stimulus.alternative_designs import alternative_drive

        return alternative_drive(self, self.design)

    @cached_property
    def aim(self) -> tuple[FloatArray, FloatArray]:
        """What the exact law steers the model to at the reference level, corrected by a calibration.

        A real beam that differs from the model then meets the target. Modal velocities, and displacements times
        angular frequency, two (n_modes,) arrays [m/s].
        """
        if self.correction is None or self.law != "exact":
            return self.target, np.zeros_like(self.target)
        return self.correction.at(self.wish.velocity)

    @property
    def trims(self) -> Trims:
        """Levels with the factors of their amplitudes, as a calibration measured them."""
        return self.correction.trims if self.correction is not None and self.law == "exact" else ()

    @cached_property
    def burst(self) -> Burst:
        """The codes, common to all levels, and each channel's amplitude at the reference level."""
        return Burst(
            codes=unsigned_codes(self._played.codes),
            duration=self.timing.duration,
            repetition_rate=self.timing.repetition_rate,
            velocity=self.wish.velocity,
            amplitude=self._amplitude,
            trims=self.trims,
        )

    @property
    def _to_beam(self) -> float:
        """Volts at the beam for a volt of the open generator [1]."""
        return self.amplifier.gain * self.load_factor

    @cached_property
    def _amplitude(self) -> tuple[float, ...]:
        """Amplitude of each channel at the reference level [V peak to peak, open circuit]."""
        shares = tuple(v / self.wish.velocity for v in self.levels)
        return tuple(full_scale(2 * float(v) / self._to_beam, shares) for v in self.peak_voltage)

    @cached_property
    def _played(self) -> QuantisedStimulus:
        """The codes, and what they do to the beam."""
        volts_per_code = np.asarray(self._amplitude) * (self._to_beam / 2 / MID_CODE)
        codes = round_to_codes(self.voltage, volts_per_code)
        if self.law == "exact" and self.rounding == "settled":
            states = volts_per_code @ states_by_channel(self.system, codes, self.timing, self.timing.focusing_instant)
            reached, displacement = self._read(states)
            error = np.concatenate([self.aim[0] - reached, self.aim[1] - displacement])
            codes = settle(codes, volts_per_code, self.system, self.timing, error, float(np.abs(self.target).max()))
        return QuantisedStimulus(self.system, self.timing, codes)

    def peak_drive(self, velocity: float) -> FloatArray:
        """Return the highest magnitude of each channel's voltage as played at a level, (n_channels,) array [V].

        Parameters
        ----------
        velocity : float
            Level [m/s].
        """
        return self._played.highest * self.volts_per_code(velocity)

    def under_law(self, law: Law) -> Stimulus:
        """Return the same stimulus under another drive law; what does not depend on the law is not computed again.

        Parameters
        ----------
        law : str
            ``exact`` or ``paper``.
        """
        other = replace(self, law=law, design=self.design if law == "exact" else "least_energy")
        vars(other).update({name: getattr(self, name) for name in (*LAWLESS, "_shapes")})
        return other

    def volts_per_code(self, velocity: float) -> FloatArray:
        """Return what a code is worth at the beam at a level as the generator plays, (n_channels,) array [V].

        Parameters
        ----------
        velocity : float
            Level [m/s].
        """
        require_positive("the velocity level", velocity, "m/s", "the paper has 0.08 to 0.2 m/s")
        # A level is trimmed so that the generator, as measured, really gives what proportion asks of it.
        proportional = amplitudes_at(self._amplitude, velocity, self.wish.velocity)
        return np.asarray(proportional) * (self._to_beam / 2 / MID_CODE)

    def amplitude_for(self, velocity: float) -> tuple[float, ...]:
        """Return the amplitude of each channel at a level, as that of `burst` [V peak to peak, open circuit].

        Parameters
        ----------
        velocity : float
            Level [m/s].
        """
        require_positive("the velocity level", velocity, "m/s", "the paper has 0.08 to 0.2 m/s")
        return amplitudes_at(self._amplitude, trimmed(velocity, self.trims), self.wish.velocity)

    def voltage_played(self, velocity: float) -> FloatArray:
        """Return the voltages at the beam of the codes as played at a level, (n_channels, n_samples) array [V].

        Parameters
        ----------
        velocity : float
            Level [m/s].
        """
        return self._played.codes * self.volts_per_code(velocity)[:, None]

    def states_at_focus(self, velocity: float) -> ComplexArray:
        """Return the states of `system` at the focusing instant of the first burst, (n_states,) complex array.

        Parameters
        ----------
        velocity : float
            Level [m/s].
        """
        return self._played.states_at_focus(self.volts_per_code(velocity))

    def achieved(self, velocity: float) -> tuple[FloatArray, FloatArray]:
        """Return what the rounded codes do to the modes at the focusing instant of the first burst.

        Parameters
        ----------
        velocity : float
            Level [m/s].

        Returns
        -------
        velocity : (n_modes,) array
            Modal velocities [m/s].
        displacement : (n_modes,) array
            Modal displacements times angular frequency [m/s].
        """
        if velocity not in self._achieved:
            self._achieved[velocity] = self._read(self.states_at_focus(velocity))
        return self._achieved[velocity]

    @cached_property
    def _achieved(self) -> dict[float, tuple[FloatArray, FloatArray]]:
        """What was achieved at levels already asked for."""
        return {}

    def _read(self, states: ComplexArray) -> tuple[FloatArray, FloatArray]:
        return (self.system.velocity @ states).real, (self.system.displacement @ states).real

    def achieved_steady(self, velocity: float) -> tuple[FloatArray, FloatArray]:
        """Return what the codes do at the focusing instant once the burst has been repeated for long.

        Parameters
        ----------
        velocity : float
            Level [m/s].

        Returns
        -------
        velocity, displacement : (n_modes,) arrays
            As `achieved` [m/s].
        """
        return self._read(self._played.states_steady(self.volts_per_code(velocity)))

    def worst_modal_error(self, velocity: float, *, steady: bool = False) -> float:
        """Return the largest of |velocity - aim| and |w eta - aim| over the modes [m/s].

        Parameters
        ----------
        velocity : float
            Level [m/s].
        steady : bool
            Of the burst repeated for long, as `achieved_steady`; of the first one, as `achieved`, if not.
        """
        reached, displacement = self.achieved_steady(velocity) if steady else self.achieved(velocity)
        share = velocity / self.wish.velocity
        miss = np.concatenate([reached - self.aim[0] * share, displacement - self.aim[1] * share])
        return float(np.abs(miss).max())

    def velocity_at_focus(self, positions: ArrayLike, velocity: float) -> FloatArray:
        """Return the velocity at points of the beam at the focusing instant, (n_positions,) array [m/s].

        Parameters
        ----------
        positions : (n_positions,) array_like
            Where, origin at mid-beam [m].
        velocity : float
            Level [m/s].
        """
        reached, _ = self.achieved(velocity)
        if np.size(positions) > _FEW:
            return self.model.field(reached, positions)
        return np.asarray(reached @ self._shapes_at(positions))

    def _shapes_at(self, positions: ArrayLike) -> FloatArray:
        """Return the mode shapes at points asked for before, or again at others, (n_modes, n_positions) array."""
        place = tuple(np.atleast_1d(np.asarray(positions, dtype=float)).tolist())
        if place not in self._shapes:
            self._shapes[place] = self.model.shapes(place)
        return self._shapes[place]

    @cached_property
    def _shapes(self) -> dict[tuple[float, ...], FloatArray]:
        """Mode shapes already computed, by the positions."""
        return {}

    def passes(self, positions: ArrayLike, velocity: float, limit: float) -> bool:
        """Return whether the speed at any of some points of the beam passes a limit.

        No more is computed than it takes to know: far below the limit, the envelope is enough.

        Parameters
        ----------
        positions, velocity
            As for `velocity_at_focus`.
        limit : float
            Speed [m/s].
        """
        return self._played.passes(self.volts_per_code(velocity), self._shapes_at(positions), limit)

    def peak_velocity(self, positions: ArrayLike, velocity: float) -> FloatArray:
        """Return the highest speed at points of the beam until the next burst, (n_positions,) array [m/s].

        Parameters
        ----------
        positions, velocity
            As for `velocity_at_focus`.
        """
        return self._played.peaks(self.volts_per_code(velocity), positions, self._shapes_at(positions))
