r"""Fingertips on the beam: their terms in the modal equations, and the decoupling of the coupled equations.

A finger with the impedance :math:`Z(s) = m s + c + k/s + \sum_j k_j \tau_j / (1 + s \tau_j)` along its contact
couples the modes; a second mass behind a spring adds :math:`k_2 (m_2 s + c_2) / (m_2 s^2 + c_2 s + k_2)`. With the mean
:math:`W = \langle\varphi\varphi^T\rangle` over the contact and the moving mass :math:`m_b` of the beam,

.. math:: \left(I + \frac{m}{m_b} W\right)\ddot\eta + \left(2\xi\omega + \frac{c}{m_b} W\right)\dot\eta
   + \left(\omega^2 + \frac{k}{m_b} W\right)\eta = G v.

The complex eigenvectors of the state :math:`(\omega\eta, \dot\eta)` uncouple these equations, which can then be treated
like those of free modes. If two eigenvalues coincide (critical damping), the eigenvectors are ill-conditioned: the
fingers are then perturbed by a few parts in 1e9, and the resulting error is computed with the real equations
(`CoupledModes.reached`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.quantities import ComplexArray, FloatArray
from modaltouch.stimulus.shapes import gauss_legendre

_NODES = 12
"""Quadrature points of a contact per tenth of the beam: exact for products of shapes with six sign changes there."""

_WORST_CONDITION = 1e5
"""Largest acceptable condition number of the eigenvectors [1]."""

_OFF = (0.0, 1e-9, 1e-8, 1e-7)
"""Relative perturbations of the fingers, tried until the condition number is acceptable [1]."""

_ALIKE = 1e-9
"""Distance of eigenvalues, relative to the largest, below which their eigenvectors cannot be separated [1]."""

_THIN = 1e-12
"""Magnitude, relative to the largest, below which an eigenvalue of a contact or a coupling is rounding error [1]."""

_BLOCK = 256
"""Samples per matrix product."""

_TERMS = 5
"""Number of powers of the clock delay of a step; the remainder is below 1e-12 at 90 kHz with a 250 MHz clock."""


@dataclass(frozen=True)
class Finger:
    """A fingertip on the beam: a mass on the beam, a damper and springs between the beam and a point at rest.

    Attributes
    ----------
    position : float
        Centre of the contact, origin at mid-beam [m].
    mass : float
        Mass that moves with the beam [kg].
    damping : float
        Damping constant of the damper [N s/m].
    stiffness : float
        Stiffness of the spring [N/m].
    width : float
        Width of the contact along the beam, over which the load is distributed evenly [m].
    maxwell : tuple of (float, float)
        Maxwell terms, springs in series with dampers: stiffness [N/m] and relaxation time [s] of each.
    second_mass : (float, float, float), optional
        Second mass [kg], stiffness of the spring to it [N/m], and damping between it and a point at rest [N s/m].
    """

    position: float
    mass: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0
    width: float = 0.01
    maxwell: tuple[tuple[float, float], ...] = ()
    second_mass: tuple[float, float, float] | None = None

    @property
    def loads_beam(self) -> bool:
        """Whether the finger loads the beam at all."""
        return bool(self.mass or self.damping or self.stiffness or self.maxwell or self.second_mass)

    def impedance(self, s: ComplexArray) -> ComplexArray:
        """Return the impedance (force per velocity) at complex frequencies s != 0 [1/s], same shape [N s/m]."""
        total = self.mass * s + self.damping + self.stiffness / s
        for stiffness, time in self.maxwell:
            decaying = 1 + s * time
            # At the pole of the term, s = -1/time, only the term moves and the beam is at rest.
            alone = np.abs(decaying) < _THIN
            total = total + np.where(alone, 0, stiffness * time / np.where(alone, 1, decaying))
        if self.second_mass is not None:
            mass, stiffness, damping = self.second_mass
            held = mass * s + damping
            total = total + stiffness * held / (s * held + stiffness)
        return np.asarray(total)

    def scaled(self, factor: float) -> Finger:
        """Return the finger with its damping times `factor`, and its stiffness times the square of `factor`."""
        return replace(self, damping=self.damping * factor, stiffness=self.stiffness * factor**2)

    def contact(self, shapes: Callable[[FloatArray], FloatArray], length: float) -> FloatArray:
        """Return the mean of the products of mode shapes over the contact, (n_modes, n_modes) array [1].

        A part of the contact beyond the end of the beam is ignored.

        Parameters
        ----------
        shapes : callable
            Returns the mode shapes at positions [m], (n_modes, n_points or a multiple of n_points) array.
        length : float
            Length of the beam [m].
        """
        values, weights = self._over_contact(shapes, length)
        return np.asarray((values * weights) @ values.T)

    def mean_shape(self, shapes: Callable[[FloatArray], FloatArray], length: float) -> FloatArray:
        """Return the mean of each mode shape over the contact, (n_modes,) array [1]; arguments as in `contact`."""
        values, weights = self._over_contact(shapes, length)
        return np.asarray(values @ weights)

    def _over_contact(self, shapes: Callable[[FloatArray], FloatArray], length: float) -> tuple[FloatArray, FloatArray]:
        left, right = max(self.position - self.width / 2, -length / 2), min(self.position + self.width / 2, length / 2)
        tenths = max(1, math.ceil(10 * (right - left) / length * (1 - 1e-9)))
        nodes, weights = gauss_legendre(_NODES * tenths)
        values = shapes((left + right) / 2 + (right - left) / 2 * nodes)
        repeats = values.shape[1] // nodes.size
        return values, np.tile(weights, repeats) / (2 * repeats)


Uncoupled = tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]
"""Exponents, input gains, and output matrices of velocities and displacements, as in `DiagonalSystem`."""

Load = tuple[FloatArray, Finger]
"""A contact over the beam's moving mass, (n_modes, n_modes) array [1/kg], and the finger on it."""


@dataclass(frozen=True, eq=False)
class CoupledModes:
    """Modes coupled by fingers, as real first-order equations x' = matrix @ x + force @ voltage.

    Attributes
    ----------
    matrix : (n_states, n_states) array
        System matrix; the state holds displacements times angular frequency, velocities [m/s], then Maxwell terms and
        second masses [1/s].
    force : (n_states, n_channels) array
        Rate of each state per volt [m/s^2 per V].
    n_modes : int
        Number of modes.
    delay : float
        Delay from the generator's output to the beam [s].
    """

    matrix: FloatArray
    force: FloatArray
    n_modes: int
    delay: float = 0.0
    # Decays and effects already computed, by time.
    _known: dict[float, tuple[FloatArray, FloatArray]] = field(default_factory=dict, init=False)

    @classmethod
    def of(cls, omega: FloatArray, damping_ratio: FloatArray, gain: FloatArray, loads: Sequence[Load]) -> CoupledModes:
        """Return the equations of modes with fingers on the beam; parameters as in `DiagonalSystem.of_modes`."""
        n = omega.size
        mass, damping, stiffness = np.eye(n), np.diag(2 * damping_ratio * omega), np.diag(omega)
        branches, inner = [np.zeros((n, 0))], list[FloatArray]()
        for contact, finger in loads:
            mass = mass + finger.mass * contact
            damping = damping + finger.damping * contact
            stiffness = stiffness + finger.stiffness * contact / omega
            if finger.maxwell or finger.second_mass:
                # For each eigenvector of the contact, a Maxwell term has one state and a second mass two.
                size, direction = np.linalg.eigh(contact)
                kept = size > _THIN * size[-1]
                along = direction[:, kept] * np.sqrt(size[kept])
                for spring, time in finger.maxwell:
                    branches.append(along * np.sqrt(spring))
                    inner += [np.array([[-1 / time]])] * along.shape[1]
                if finger.second_mass:
                    second, spring, damper = finger.second_mass
                    swing = np.sqrt(spring / second)
                    branches.append(np.repeat(along * np.sqrt(spring), 2, axis=1) * np.tile([1.0, 0.0], along.shape[1]))
                    inner += [np.array([[0.0, -swing], [swing, -damper / second]])] * along.shape[1]
        branch = np.concatenate(branches, axis=1)
        lower = np.linalg.solve(mass, np.concatenate([-stiffness, -damping, -branch, gain], axis=1))
        n_states = 2 * n + branch.shape[1]
        matrix = np.zeros((n_states, n_states))
        matrix[:n, n : 2 * n] = np.diag(omega)
        matrix[n : 2 * n] = lower[:, :n_states]
        matrix[2 * n :, n : 2 * n] = branch.T
        for row, own in zip(np.cumsum([2 * n, *map(len, inner)]), inner, strict=False):
            matrix[row : row + len(own), row : row + len(own)] = own
        force = np.zeros((n_states, gain.shape[1]))
        force[n : 2 * n] = lower[:, n_states:]
        return cls(matrix, force, n)

    def behind(self, bandwidth: float | None, delay: float) -> CoupledModes:
        """Return the equations behind an amplifier with a bandwidth [Hz] and a delay [s], whose states come last."""
        if bandwidth is None:
            return replace(self, delay=delay)
        pole, (n, n_channels) = 2 * np.pi * bandwidth, self.force.shape
        matrix = np.block([[self.matrix, self.force], [np.zeros((n_channels, n)), -pole * np.eye(n_channels)]])
        force = np.concatenate([np.zeros((n, n_channels)), pole * np.eye(n_channels)])
        return CoupledModes(matrix, force, self.n_modes, delay)

    def uncoupled(self) -> tuple[Uncoupled, float]:
        """Return the uncoupled equations, and the condition number of the eigenvectors [1].

        One state of each conjugate pair is kept and counted twice; an overdamped mode has no pair.
        """
        n = self.n_modes
        exponent, vectors = eigenvectors(self.matrix)
        pushed = np.linalg.solve(vectors, self.force.astype(complex)).astype(np.complex128)
        kept = exponent.imag >= 0
        weighted = vectors[:, kept] * np.where(exponent[kept].imag > 0, 2.0, 1.0)
        return (exponent[kept], pushed[kept], weighted[n : 2 * n], weighted[:n]), float(np.linalg.cond(vectors))

    def reached(self, voltage: FloatArray, timing: Timing, instant: float) -> FloatArray:
        """Return modal velocities, then displacements times angular frequency, from rest, (2 n_modes,) array [m/s].

        Parameters
        ----------
        voltage : (n_channels, n_samples) array
            Held samples at the beam from the start of the burst [V].
        timing : Timing
            Clock of the samples.
        instant : float
            Time from the start of the burst [s].
        """
        n_whole, remainder = timing.samples_until(instant - self.delay)
        n_whole = min(n_whole, voltage.shape[1])
        over, held = self._held(timing.hold)
        state = np.zeros(len(self.matrix))
        for effect, samples in self._inputs(voltage[:, :n_whole], timing, over, held):
            state = state + _summed(samples, over, effect)
        if remainder:
            rest, begun = self._held(remainder)
            state = rest @ state
            if n_whole < min(voltage.shape[1], timing.n_samples):
                wait = 0.0 if timing.clock_error is None else min(float(timing.clock_error[n_whole]), remainder)
                late = self._held(remainder - wait)[1]
                state = state + late @ voltage[:, n_whole]
                if wait and n_whole:
                    state = state + (begun - late) @ voltage[:, n_whole - 1]
        n = self.n_modes
        return np.concatenate([state[n : 2 * n], state[:n]])

    def _held(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return the decay matrix over a time [s] and the contribution of 1 V held for that time to the states."""
        if time not in self._known:
            from scipy.linalg import expm

            n, n_channels = self.force.shape
            whole = np.zeros((n + n_channels, n + n_channels))
            whole[:n, :n], whole[:n, n:] = self.matrix * time, self.force * time
            grown = expm(whole)
            self._known[time] = grown[:n, :n], grown[:n, n:]
        return self._known[time]

    def _inputs(
        self, voltage: FloatArray, timing: Timing, over: FloatArray, held: FloatArray
    ) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield effects and inputs: the voltages, then the steps times powers of their clock delay."""
        yield held, voltage
        effect = over @ self.force
        for term, steps in zip(range(1, _TERMS + 1), timing.late_steps(voltage, 0, voltage.shape[1]), strict=False):
            effect = -effect / term if term == 1 else -(self.matrix @ effect) / term
            yield effect, steps


def _summed(samples: FloatArray, over: FloatArray, effect: FloatArray) -> FloatArray:
    """Return the sum of ``over**(samples after it) @ effect @ sample``, (n_states,) array."""
    rows, power = effect[None], over
    while len(rows) < _BLOCK:
        rows, power = np.concatenate([rows, power @ rows]), power @ power
    filled = np.pad(samples, ((0, 0), (-samples.shape[1] % _BLOCK, 0)))
    # Transpose the small array rather than the long one, and copy no channel.
    turned = np.ascontiguousarray(rows[::-1].transpose(2, 0, 1))
    state = np.zeros(len(over))
    for push in (filled.reshape(len(samples), -1, _BLOCK) @ turned).sum(axis=0):
        state = power @ state + push
    return state


def eigenvectors(matrix: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return eigenvalues and eigenvectors, refined by one Newton step in extended precision if that step is small.

    LAPACK computes each eigenvalue to 1e-16 of the largest: a phase error of 1e-12 over a burst, even for slow modes.
    """
    exponent, vectors = (np.asarray(each).astype(np.complex128) for each in np.linalg.eig(matrix))
    long, inverse = vectors.astype(np.clongdouble), np.linalg.inv(vectors).astype(np.clongdouble)
    across, unit = inverse @ (matrix.astype(np.longdouble) @ long), inverse @ long
    found = np.diag(across) / np.diag(unit)
    gap = found[None, :] - found[:, None]
    apart = np.abs(gap) > _ALIKE * np.abs(found).max()
    turn = np.where(apart, (across - unit * found) / np.where(apart, gap, 1), 0)
    if np.abs(turn).max() > _ALIKE:
        return exponent, vectors  # for nearly parallel vectors the step would not improve them
    real = exponent.imag == 0
    found, long = np.where(real, found.real, found), long + long @ turn
    return found.astype(complex), np.where(real, long.real, long).astype(complex)


def uncouple(
    omega: FloatArray, damping_ratio: FloatArray, gain: FloatArray, loads: Sequence[Load]
) -> tuple[Uncoupled, CoupledModes | None]:
    """Return the uncoupled equations of modes with fingers on the beam; arguments as in `CoupledModes.of`.

    If the eigenvectors are ill-conditioned, they are those of fingers perturbed by a few parts in 1e9, and the coupled
    equations are returned as well.
    """
    tried: list[tuple[float, Uncoupled, CoupledModes]] = []
    for off in _OFF:
        moved = [(contact, finger.scaled(1 + off * (2 + place))) for place, (contact, finger) in enumerate(loads)]
        modes = CoupledModes.of(omega, damping_ratio, gain, moved)
        uncoupled, condition = modes.uncoupled()
        tried.append((condition, uncoupled, modes))
        if condition <= _WORST_CONDITION:
            break
    _, best, modes = min(tried, key=lambda each: each[0])
    return best, None if modes is tried[0][2] else tried[0][2]


def coupled_with(driven: NDArray[np.bool_], loads: Sequence[Load]) -> NDArray[np.bool_]:
    """Return a mask of the modes that move: the driven ones and those coupled to them by fingers, (n_modes,) array."""
    size = sum((np.abs(contact) for contact, _ in loads), np.zeros((driven.size, driven.size)))
    linked = size > _THIN * size.max(initial=0.0)
    moves = driven.copy()
    for _ in range(driven.size):
        moves = moves | linked[:, moves].any(axis=1)
    return moves
