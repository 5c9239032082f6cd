r"""Codes played on another beam: speeds over time, forces in the contacts, fingers that are lifted, contrast.

From the instant at which fingers are lifted, the beam moves without them, from its current state. Its motion is the
response as if the fingers had never been there, plus the free decay of the difference between the two states,
:math:`y(t) = y_{left}(t) + \mathrm{Re} \sum_j c_j \delta_j(\tau) e^{s_j (t - \tau)}`. The moduli of its terms bound
the decay, which rules out most pairs of blocks of instants. Maxwell terms and second masses of the remaining fingers
are assumed to be in the state that they have without the lifted fingers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.quantised import QuantisedStimulus
from modaltouch.stimulus.quantities import ComplexArray, FloatArray
from modaltouch.stimulus.vibration import SHORT, TURN, BlockKernel, history, search_instants

FINE = 0.4e-6
"""Approximate time between the instants at which speeds are computed [s]; lifting is tried at every sixteenth."""

_BLOCK = 16 * SHORT
"""Number of instants in a block, each of which has one upper bound."""

_BETWEEN = 1.1
"""Factor on the bounds that covers lifting between the instants tried: for fingers up to 0.3 g and 30 N s/m, moduli
rise by 8 % between them within a block, by 0.5 % over a burst [1]."""


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
        times = max(1, round(self.timing.hold / FINE))
        voltage, hold = np.repeat(self.codes * unit[:, None], times, axis=1), self.timing.hold / times
        shapes, beam = left.model.shapes(positions), DiagonalSystem.of(left.model)
        known = np.stack([each.peak_velocity(positions, unit) for each in (self, left)])
        peak: FloatArray = np.maximum(known.max(axis=0), floor)
        output, difference = shapes.T @ beam.velocity, _difference((self.system, left.system), beam, voltage, hold)
        if (known[1] + _BETWEEN * np.abs(output) @ np.abs(difference).max(axis=1) <= peak).all():
            return peak
        speed = np.empty((len(output), voltage.shape[1]))
        kernel = BlockKernel.of(left.system, shapes.T @ left.system.velocity, hold)
        kernel.write(lambda start, stop: voltage[:, start:stop], speed)
        return _raised(speed, output, difference, peak, beam.exponent * hold)

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


def _difference(
    both: tuple[DiagonalSystem, DiagonalSystem], beam: DiagonalSystem, voltage: FloatArray, hold: float
) -> ComplexArray:
    """Return the difference of the motions of two systems, as states of a beam, at every `SHORT`-th instant.

    The voltages, (n_channels, n_instants) array [V], are held between instants [s]. The systems include the amplifier,
    the beam does not; the result is a (n_states, n_instants / SHORT) array.
    """
    blocks, motion = BlockKernel.blocks(voltage), []
    for system in both:
        rest = np.zeros(system.exponent.size, dtype=complex)
        begin, _ = BlockKernel.of(system, np.empty((0, rest.size), dtype=complex), hold).states(blocks, rest)
        motion.append((np.concatenate([system.velocity, system.displacement]) @ begin).real)
    read = np.concatenate([beam.velocity, beam.displacement])
    parts = np.linalg.pinv(np.concatenate([read.real, -read.imag], axis=1)) @ (motion[0] - motion[1])
    real, imaginary = np.split(parts, 2)
    return np.asarray(real + 1j * imaginary)


def _raised(
    speed: FloatArray, output: ComplexArray, difference: ComplexArray, peak: FloatArray, rate: ComplexArray
) -> FloatArray:
    """Return the peaks, raised where the response without the fingers plus the decaying difference exceeds them.

    The `rate` is the exponents times the time between instants [1].
    """
    highest = BlockKernel.blocks(np.abs(speed), _BLOCK).max(axis=2)
    size = _BETWEEN * BlockKernel.blocks(np.abs(difference), _BLOCK // SHORT).max(axis=2)
    n_blocks = highest.shape[1]
    swing = np.exp(np.outer(np.arange(_BLOCK), rate)) * output[:, None]
    swing_parts = np.concatenate([swing.real, -swing.imag], axis=2)
    for block in range(n_blocks):
        later = np.maximum(np.arange(n_blocks - block) - 1, 0) * _BLOCK
        faded = np.exp(np.outer(rate.real, later)) * size[:, block, None]
        near = highest[:, block:] + np.abs(output) @ faded > peak[:, None]
        away = difference[:, block * _BLOCK // SHORT : (block + 1) * _BLOCK // SHORT]
        since = SHORT * np.arange(away.shape[1])
        for ahead in np.flatnonzero(near.any(axis=0)).tolist():
            begun = np.exp(np.outer(rate, ahead * _BLOCK - since)) * away
            begun_parts = np.concatenate([begun.real, begun.imag])
            for point in np.flatnonzero(near[:, ahead]).tolist():
                some = speed[point, (block + ahead) * _BLOCK :][:_BLOCK, None]
                found = np.abs(some + swing_parts[point, : some.size] @ begun_parts)
                if not ahead:  # no decay before the fingers are lifted
                    found[np.arange(some.size)[:, None] < since] = 0.0
                peak[point] = max(peak[point], found.max())
    return peak
