"""Codes played on another beam: speeds over time, forces in the contacts, fingers that are lifted, contrast."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.quantised import QuantisedStimulus
from modaltouch.stimulus.quantities import FloatArray
from modaltouch.stimulus.vibration import TURN, history, search_instants


class TouchedStimulus(QuantisedStimulus):
    """The codes of a burst played on the beam with any fingers, or on a beam with other modes."""

    def modal_peaks(self, unit: FloatArray) -> FloatArray:
        """Return upper bounds of the modal velocities until the next burst, (n_modes,) array [m/s]."""
        response, _, scale = self._response(unit)
        # At most half a sample from its peak, a damped oscillation has fallen by less.
        return np.asarray(response.peak(self.system.velocity) * scale * (1 + TURN**2 / 3))

    def velocity_at(self, positions: ArrayLike, instants: ArrayLike, unit: FloatArray) -> FloatArray:
        """Return the velocity at points, each at a separate instant of the burst [s], (n_positions,) array [m/s]."""
        shapes, codes, system = self.model.shapes(positions), self.codes * unit[:, None], self.system
        states = [system.state_at(codes, self.timing, instant) for instant in np.asarray(instants).tolist()]
        return np.array([shape @ system.read(state)[0] for shape, state in zip(shapes.T, states, strict=True)])

    def peak_instants(self, positions: ArrayLike, unit: FloatArray) -> FloatArray:
        """Return the instant of the burst at which each point is fastest, (n_positions,) array [s]."""
        output, voltage = self.model.shapes(positions).T @ self.system.velocity, self.codes * unit[:, None]
        late = search_instants(self.system, self.timing)
        courses = [history(self.system, output, voltage, self.timing, each) for each in late.tolist()]
        speed = np.abs(np.stack(courses, axis=2)).reshape(len(output), -1)
        # Speed is stationary at the top of the parabola through the fastest instant and its neighbours.
        fastest = speed.argmax(axis=1).clip(1, speed.shape[1] - 2)
        before, most, after = (speed[np.arange(len(speed)), fastest + by] for by in (-1, 0, 1))
        curve = before - 2 * most + after
        between = np.divide(before - after, 2 * curve, out=np.zeros_like(curve), where=curve < 0)
        step = self.timing.hold / late.size
        return np.asarray((fastest + between.clip(-0.5, 0.5)) * step + self.system.delay)

    def peak_below(self, frequency: float, position: float, unit: FloatArray) -> float:
        """Return the highest speed [m/s] at a point [m] due to states with |exponent| below a frequency [Hz]."""
        response, _, scale = self._response(unit)
        slow = np.abs(self.system.exponent) < 2 * np.pi * frequency
        return float(response.peak((self.model.shapes([position]).T @ self.system.velocity) * slow)[0]) * scale

    def peak_when_lifted(
        self, left: QuantisedStimulus, positions: ArrayLike, unit: FloatArray, floor: float = 0.0
    ) -> FloatArray:
        """Return the highest speed at points if fingers are lifted at the worst instant, (n_positions,) array [m/s].

        `left` is the same burst on the beam with the remaining fingers. Peaks below `floor` are not resolved [m/s].
        """
        from modaltouch.stimulus.lifted import FINE, peaks_when_lifted

        times = max(1, round(self.timing.hold / FINE))
        systems = self.system, left.system, DiagonalSystem.of(left.model)
        voltage = np.repeat(self.codes * unit[:, None], times, axis=1)
        known = np.stack([each.peak_velocity(positions, unit) for each in (self, left)])
        shapes = left.model.shapes(positions)
        return peaks_when_lifted(systems, voltage, self.timing.hold / times, shapes, known, floor)

    def highest_contrast(self, focus: float, points: FloatArray, level: float) -> tuple[QuantisedStimulus, float]:
        """Return the beam under the drive of highest contrast, its codes in volts, and `contrast_drive`'s bound [1].

        At the focusing instant `focus` reaches the level [m/s]; `points` are to be slow, (n_points,) array [m].
        """
        from modaltouch.stimulus.other_drives import HOLD, contrast_drive

        timing = replace(self.timing, n_samples=2 * round(self.timing.duration / HOLD / 2))
        drive, bound = contrast_drive(self.model, self.amplifier, timing, np.append(focus, points), level)
        return replace(self, timing=timing, codes=drive), bound

    def pull(self, unit: FloatArray) -> FloatArray:
        """Return the largest tension in the contact of each finger, (n_fingers,) array [N].

        The impedance assumes a bonded contact. Skin cannot pull: if this tension exceeds the contact force of the
        finger, skin and beam separate, and the linear model does not hold.
        """
        response, known, scale = self._response(unit)
        fingers, system = self.model.fingers, response.system
        if not all(finger in known for finger in fingers):
            means = np.stack([finger.mean_shape(self.model.shapes, self.model.length) for finger in fingers])
            velocity = means @ system.velocity
            # Each state decays with its exponent s, and the impedance at s converts its velocity to force.
            force = velocity * np.stack([finger.impedance(system.exponent) for finger in fingers])
            # The inertial force follows the acceleration, on which a voltage acts immediately, however late its step.
            at_once = np.zeros((len(fingers), response.push.shape[1]))
            at_once[:, : unit.size] = (velocity @ system.input_gain).real * [[finger.mass] for finger in fingers]
            known.update(zip(fingers, response.peak(force, at_once=at_once).tolist(), strict=True))
        return np.array([known[finger] for finger in fingers]) * scale
