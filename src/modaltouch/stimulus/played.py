"""Codes as the generator plays them, and what they do to the beam at any worth of a code."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.stimulus.block_states import BlockStates
from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.timing import Timing
from modaltouch.stimulus.vibration import states_by_channel

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class QuantisedStimulus:
    """A record in the generator before a beam. What is linear in the level is computed once.

    Attributes
    ----------
    system : DiagonalSystem
        The beam behind its amplifier.
    timing : Timing
        Clock of the samples.
    codes : (n_channels, n_samples) array
        Signed codes, -8191 to 8191 [1].
    """

    system: DiagonalSystem
    timing: Timing
    codes: FloatArray

    @cached_property
    def highest(self) -> FloatArray:
        """Largest magnitude of each channel's codes, (n_channels,) array [1]."""
        return np.asarray(np.maximum(self.codes.max(axis=1), -self.codes.min(axis=1)))

    @cached_property
    def _states_per_volt(self) -> ComplexArray:
        """States at the focusing instant for codes worth a volt each, (n_channels, n_states) array."""
        return states_by_channel(self.system, self.codes, self.timing, self.timing.focusing_instant)

    @cached_property
    def _left_per_volt(self) -> ComplexArray:
        """States when the burst's end has arrived, for codes worth a volt each, (n_channels, n_states) array."""
        end = self.timing.duration + self.system.delay
        return states_by_channel(self.system, self.codes, self.timing, end)

    def states_at_focus(self, unit: FloatArray) -> ComplexArray:
        """Return the states at the focusing instant of the first burst, (n_states,) complex array.

        Parameters
        ----------
        unit : (n_channels,) array
            What a code is worth at the beam [V].
        """
        return np.asarray(unit @ self._states_per_volt)

    def states_steady(self, unit: FloatArray) -> ComplexArray:
        """Return the states at the focusing instant once the burst has been repeated for long, (n_states,) array.

        Parameters
        ----------
        unit : (n_channels,) array
            What a code is worth at the beam [V].
        """
        timing, exponent = self.timing, self.system.exponent
        end = timing.duration + self.system.delay
        left = unit @ self._left_per_volt
        period = 1 / timing.repetition_rate
        carried = np.exp(exponent * (period - end + timing.focusing_instant)) / -np.expm1(exponent * period)
        return np.asarray(self.states_at_focus(unit) + left * carried)

    @cached_property
    def _courses(self) -> dict[tuple[float, ...], tuple[BlockStates, dict[float, float]]]:
        """Courses already computed, and peaks by position, by the ratio of the channels."""
        return {}

    def _course(self, unit: FloatArray) -> tuple[BlockStates, dict[float, float], float]:
        """Return the course of the codes, known peaks by position, and what both are to be scaled by.

        Levels that keep the channels' ratio only scale: one course serves them all.
        """
        largest = float(unit.max()) or 1.0
        ratio = tuple(round(float(u), 12) for u in unit / largest)
        if ratio not in self._courses:
            # Codes for volts: what a code is worth goes into the gains, and no voltages are written out.
            gain = self.system.input_gain * (unit / largest)
            self._courses[ratio] = BlockStates.of(replace(self.system, input_gain=gain), self.codes, self.timing), {}
        return *self._courses[ratio], largest

    def passes(self, unit: FloatArray, shapes: FloatArray, limit: float) -> bool:
        """Return whether the speed at any of some points of the beam passes a limit, computing no more than needed.

        Parameters
        ----------
        unit : (n_channels,) array
            What a code is worth at the beam [V].
        shapes : (n_modes, n_positions) array
            Mode shapes at the points [1].
        limit : float
            Speed [m/s].
        """
        course, _, scale = self._course(unit)
        return bool((course.peak(shapes.T @ self.system.velocity, limit / scale) * scale > limit).any())

    def peaks(self, unit: FloatArray, positions: ArrayLike, shapes: FloatArray) -> FloatArray:
        """Return the highest speed at points of the beam until the next burst, (n_positions,) array [m/s].

        Parameters
        ----------
        unit : (n_channels,) array
            What a code is worth at the beam [V].
        positions : (n_positions,) array_like
            Where, by which peaks are known again [m].
        shapes : (n_modes, n_positions) array
            Mode shapes there [1].
        """
        place = np.atleast_1d(np.asarray(positions, dtype=float)).tolist()
        course, known, scale = self._course(unit)
        if not all(point in known for point in place):
            known.update(zip(place, course.peak(shapes.T @ self.system.velocity).tolist(), strict=True))
        return np.array([known[point] for point in place]) * scale
