"""What the codes of a stimulus do to the beam with fingers on it, whatever beam they were designed for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.blocks import BlockKernel
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem
from modaltouch.stimulus.fingers import Finger
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantised import QuantisedStimulus
from modaltouch.stimulus.quantities import ComplexArray, FloatArray
from modaltouch.stimulus.timing import Timing


@dataclass(frozen=True, eq=False)
class TouchedBeam:
    """A beam under fingers while a burst is played.

    Attributes
    ----------
    model : ModalModel
        The beam with its fingers; without any, the untouched beam.
    amplifier : Amplifier
        Its pole and delay count.
    timing : Timing
        Clock of the samples.
    codes : (n_channels, n_samples) array
        Codes counted from mid-scale [1].
    """

    model: ModalModel
    amplifier: Amplifier
    timing: Timing
    codes: FloatArray

    @cached_property
    def _played(self) -> QuantisedStimulus:
        return QuantisedStimulus(DiagonalSystem.of(self.model, self.amplifier), self.timing, self.codes)

    def velocity_at_focus(self, positions: ArrayLike, unit: FloatArray) -> FloatArray:
        """Velocity at points of the beam at the focusing instant, (n_positions,) array [m/s].

        Parameters
        ----------
        positions : (n_positions,) array_like
            Where, origin at mid-beam [m].
        unit : (n_channels,) array
            What a code is worth at the beam [V].
        """
        velocity, _ = self._played.system.read(self._played.states_at_focus(unit))
        return np.asarray(velocity @ self.model.shapes(positions))

    def peak_velocity(self, positions: ArrayLike, unit: FloatArray) -> FloatArray:
        """Highest speed at points of the beam until the next burst, (n_positions,) array [m/s]; as above."""
        return self._played.peaks(unit, positions, self.model.shapes(positions))

    def velocity_at(self, positions: ArrayLike, instants: ArrayLike, unit: FloatArray) -> FloatArray:
        """Velocity at points, each at its own instant from the start of the burst [s], (n_positions,) array [m/s]."""
        shapes, codes, system = self.model.shapes(positions), self.codes * unit[:, None], self._played.system
        states = [system.state_at(codes, self.timing, instant) for instant in np.asarray(instants).tolist()]
        return np.array([shape @ system.read(state)[0] for shape, state in zip(shapes.T, states, strict=True)])

    def peak_instants(self, positions: ArrayLike, unit: FloatArray) -> FloatArray:
        """Instants of a burst at which points are fastest, (n_positions,) array [s]; as for `peak_velocity`."""
        system = self._played.system
        speed = np.abs(self._course(self.model.shapes(positions).T @ system.velocity, self.codes * unit[:, None]))
        return np.asarray(speed.argmax(axis=1) * self.timing.hold + system.delay)

    def peak_below(self, frequency: float, position: float, unit: FloatArray) -> float:
        """Highest speed of what swings and decays slower than a frequency [Hz] at a point of the beam [m], [m/s]."""
        system = self._played.system
        slow = np.abs(system.exponent) < 2 * np.pi * frequency
        return self._played.peak_of(unit, (self.model.shapes([position]).T @ system.velocity) * slow)

    def peak_when_lifted(
        self, left: TouchedBeam, positions: ArrayLike, unit: FloatArray, floor: float = 0.0
    ) -> FloatArray:
        """Highest speed at points where fingers are taken away at the worst instant, (n_positions,) array [m/s].

        Parameters
        ----------
        left : TouchedBeam
            The same burst on the beam under the fingers that stay.
        positions, unit
            As for `peak_velocity`.
        floor : float
            Speed below which nobody needs to know; lower peaks are returned as it [m/s].
        """
        from modaltouch.stimulus.lifted import FINE, LiftedBeam

        times = max(1, round(self.timing.hold / FINE))
        systems = self._played.system, left._played.system, DiagonalSystem.of(left.model)
        voltage = np.repeat(self.codes * unit[:, None], times, axis=1)
        lifted = LiftedBeam(*systems, voltage, self.timing.hold / times)
        known = np.stack([each.peak_velocity(positions, unit) for each in (self, left)])
        return lifted.peaks(left.model.shapes(positions), known, floor)

    def highest_contrast(self, focus: float, points: FloatArray, level: float) -> tuple[TouchedBeam, float]:
        """The beam under a drive that moves other points least, and a bound (see `stimulus.contrast`).

        Parameters
        ----------
        focus, points : float and (n_points,) array
            What reaches the level at the focusing instant, and the others, origin at mid-beam [m].
        level : float
            Velocity of the focus [m/s].

        Returns
        -------
        played : TouchedBeam
            Its codes are volts: a code is worth 1 V at the beam.
        bound : float
            Level over the highest speed of the points that no drive of the family passes [1].
        """
        from modaltouch.stimulus.contrast import HOLD, contrast_drive

        timing = replace(self.timing, n_samples=2 * round(self.timing.duration / HOLD / 2))
        drive, bound = contrast_drive(self.model, self.amplifier, timing, np.append(focus, points), level)
        return replace(self, timing=timing, codes=drive), bound

    def pull(self, unit: FloatArray) -> FloatArray:
        """Largest force by which each finger would have to stick to the beam to follow it, (n_fingers,) array [N].

        The impedance holds as long as the contact can pull, which skin cannot: where this passes the force with which
        the finger presses, skin and beam part, and no linear figure holds.
        """
        if not self.model.fingers:
            return np.zeros(0)
        rows = [_force(self.model, finger, self._played.system) for finger in self.model.fingers]
        at_once, voltage = np.stack([direct for _, direct in rows]), self.codes * unit[:, None]
        # The force of an inertia follows the acceleration, in which a step of voltage shows at once.
        force = self._course(np.stack([row for row, _ in rows]), voltage) + at_once @ voltage
        return np.asarray(np.abs(force).max(axis=1))

    def _course(self, output: ComplexArray, voltage: FloatArray) -> FloatArray:
        """What is read off the states at the start of each sample, (n_outputs, n_samples) array."""
        course = np.empty((len(output), voltage.shape[1]))
        kernel = BlockKernel.of(self._played.system, output, self.timing.hold)
        kernel.write(lambda start, stop: voltage[:, start:stop], course)
        return course


def _force(model: ModalModel, finger: Finger, system: DiagonalSystem) -> tuple[ComplexArray, FloatArray]:
    """What reads the force of a finger off the states, and what a volt adds to it at once, two (n_...,) arrays."""
    mean = finger.mean_shape(model.shapes, model.length)
    velocity = mean @ system.velocity
    # Each state decays by its own exponent s, and the impedance at s turns its velocity into force.
    row = velocity * finger.impedance(system.exponent)
    return row, finger.mass * (velocity @ system.input_gain).real
