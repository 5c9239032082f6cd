r"""Fingertips on the beam: what each adds to the modal equations, and the coupled equations made uncoupled again.

A finger with the impedance :math:`Z(s) = m s + c + k/s + \sum_j k_j \tau_j / (1 + s \tau_j)` along its contact
couples the modes; a second mass behind a spring adds :math:`k_2 (m_2 s + c_2) / (m_2 s^2 + c_2 s + k_2)`. With
:math:`W = \langle\varphi\varphi^T\rangle` over the contact and the moving mass :math:`m_b` of the beam,

.. math:: \left(I + \frac{m}{m_b} W\right)\ddot\eta + \left(2\xi\omega + \frac{c}{m_b} W\right)\dot\eta
   + \left(\omega^2 + \frac{k}{m_b} W\right)\eta = G v.

The complex eigenvectors of the state :math:`(\omega\eta, \dot\eta)` uncouple it, and everything that holds for free
modes holds for it. Where two eigenvalues meet (critical damping) the eigenvectors are lost: the fingers are then taken
by a few parts in 1e9 off their values, and what that misses is measured on the equations as they are (`RealSystem`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.quantities import ComplexArray, FloatArray, require_finite, require_positive

_NODES = 12
"""Points for each tenth of the beam under a contact: exact for products of shapes that change sign six times there."""

_WORST_CONDITION = 1e5
"""Condition number of the eigenvectors above which they are not trusted [1]."""

_OFF = (0.0, 1e-9, 1e-8, 1e-7)
"""Relative deviations of the fingers that are tried until their eigenvectors can be trusted [1]."""

_ALIKE = 1e-9
"""Distance, over the largest, of eigenvalues whose vectors cannot be told apart [1]."""

_THIN = 1e-12
"""Share of the largest below which a direction of a contact, or a coupling, is rounding [1]."""


@dataclass(frozen=True)
class Finger:
    """A fingertip on the beam: a mass, a damper and springs between the beam and a point at rest.

    Attributes
    ----------
    position : float
        Centre of the contact, origin at mid-beam [m].
    mass : float
        Mass that moves with the beam [kg].
    damping : float
        Of the damper [N s/m].
    stiffness : float
        Of the spring [N/m].
    width : float
        Of the contact along the beam, over which all of it is spread evenly [m].
    maxwell : tuple of (float, float)
        Springs behind dampers: stiffness [N/m] and relaxation time [s] of each.
    second_mass : (float, float, float), optional
        Mass [kg] behind a spring [N/m], which a damper [N s/m] holds to a point at rest.
    """

    position: float
    mass: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0
    width: float = 0.01
    maxwell: tuple[tuple[float, float], ...] = ()
    second_mass: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Refuse what is no fingertip."""
        require_finite("the place of a finger", self.position, "m", "give a point of the beam")
        require_positive("the width of a contact", self.width, "m", "a fingertip has 10 mm")
        for name, unit in (("mass", "kg"), ("damping", "N s/m"), ("stiffness", "N/m")):
            require_finite(f"the {name} of a finger", getattr(self, name), unit, "measure it, or take the typical one")
            if getattr(self, name) < 0:
                raise ValueError(f"the {name} of a finger is {getattr(self, name)} {unit}; it must be 0 or above")
        for stiffness, time in self.maxwell:
            require_positive("the stiffness of a Maxwell term", stiffness, "N/m", "leave it out")
            require_positive("the relaxation time of a Maxwell term", time, "s", "leave it out")
        if self.second_mass is not None:
            require_positive("the second mass of a finger", self.second_mass[0], "kg", "leave it out")
            require_positive("the stiffness before a second mass", self.second_mass[1], "N/m", "leave it out")

    @property
    def weighs(self) -> bool:
        """Whether it adds anything to the beam."""
        return bool(self.mass or self.damping or self.stiffness or self.maxwell or self.second_mass)

    def impedance(self, s: ComplexArray) -> ComplexArray:
        """Force per velocity at complex frequencies other than 0 [1/s], array of their shape [N s/m]."""
        total = self.mass * s + self.damping + self.stiffness / s
        for stiffness, time in self.maxwell:
            decaying = 1 + s * time
            # A state that decays by this term alone moves nothing.
            alone = np.abs(decaying) < _THIN
            total = total + np.where(alone, 0, stiffness * time / np.where(alone, 1, decaying))
        if self.second_mass is not None:
            mass, stiffness, damping = self.second_mass
            held = mass * s + damping
            total = total + stiffness * held / (s * held + stiffness)
        return np.asarray(total)

    def scaled(self, factor: float) -> Finger:
        """The finger with this many times the damping, and as many times squared the stiffness."""
        return replace(self, damping=self.damping * factor, stiffness=self.stiffness * factor**2)

    def contact(self, shapes: Callable[[FloatArray], FloatArray], length: float) -> FloatArray:
        """Mean of shape times shape over the contact, cut at the beam's ends, (n_modes, n_modes) array [1].

        Parameters
        ----------
        shapes : callable
            Returns the mode shapes at positions [m], (n_modes, n_points or a multiple of them) array.
        length : float
            Length of the beam [m].
        """
        values, weights = self._over_contact(shapes, length)
        return np.asarray((values * weights) @ values.T)

    def mean_shape(self, shapes: Callable[[FloatArray], FloatArray], length: float) -> FloatArray:
        """Mean of each mode shape over the contact, (n_modes,) array [1]; arguments as for `contact`."""
        values, weights = self._over_contact(shapes, length)
        return np.asarray(values @ weights)

    def _over_contact(self, shapes: Callable[[FloatArray], FloatArray], length: float) -> tuple[FloatArray, FloatArray]:
        left, right = max(self.position - self.width / 2, -length / 2), min(self.position + self.width / 2, length / 2)
        tenths = max(1, math.ceil(10 * (right - left) / length * (1 - 1e-9)))
        nodes, weights = _gauss(_NODES * tenths)
        values = shapes((left + right) / 2 + (right - left) / 2 * nodes)
        repeats = values.shape[1] // nodes.size
        return values, np.tile(weights, repeats) / (2 * repeats)


@lru_cache(maxsize=16)
def _gauss(n: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights of the Gauss-Legendre rule, two (n,) arrays."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return nodes, weights


Uncoupled = tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]
"""Exponents, input gains, and what reads velocities and displacements, as the attributes of `DiagonalSystem`."""

Load = tuple[FloatArray, Finger]
"""A contact over the beam's moving mass, (n_modes, n_modes) array [1/kg], and the finger on it."""


@dataclass(frozen=True, eq=False)
class CoupledModes:
    """Modes coupled by fingers, as real first-order equations x' = matrix @ x + force @ voltage.

    Attributes
    ----------
    matrix : (n_states, n_states) array
        Of the state: displacements times angular frequency, velocities [m/s], Maxwell terms and second masses [1/s].
    force : (n_states, n_channels) array
        What a volt does to each state [m/s^2 per V].
    n_modes : int
        Number of modes.
    """

    matrix: FloatArray
    force: FloatArray
    n_modes: int

    @classmethod
    def of(cls, omega: FloatArray, damping_ratio: FloatArray, gain: FloatArray, loads: Sequence[Load]) -> CoupledModes:
        """Equations of modes under fingers.

        Parameters
        ----------
        omega, damping_ratio : (n_modes,) array
            Angular frequencies [rad/s] and damping ratios [1] of the free modes.
        gain : (n_modes, n_channels) array
            Modal accelerations per volt [m/s^2 per V].
        loads : sequence of Load
            The fingers.
        """
        n = omega.size
        mass, damping, stiffness = np.eye(n), np.diag(2 * damping_ratio * omega), np.diag(omega)
        branches, inner = [np.zeros((n, 0))], list[FloatArray]()
        for contact, finger in loads:
            mass = mass + finger.mass * contact
            damping = damping + finger.damping * contact
            stiffness = stiffness + finger.stiffness * contact / omega
            if finger.maxwell or finger.second_mass:
                # Along each direction in which the contact moves, every term has a state of its own, or two.
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

    def uncoupled(self) -> tuple[Uncoupled, float]:
        """Uncoupled equations, and the condition number of the eigenvectors [1].

        Of each conjugate pair one is kept, counted twice; a mode that does not swing has no pair.
        """
        n = self.n_modes
        exponent, vectors = eigenvectors(self.matrix)
        pushed = np.linalg.solve(vectors, self.force.astype(complex)).astype(np.complex128)
        kept = exponent.imag >= 0
        weighted = vectors[:, kept] * np.where(exponent[kept].imag > 0, 2.0, 1.0)
        return (exponent[kept], pushed[kept], weighted[n : 2 * n], weighted[:n]), float(np.linalg.cond(vectors))


def eigenvectors(matrix: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Eigenvalues and vectors after one Newton step in extended precision, where it is a small one.

    An eigenvalue is found to 1e-16 of the largest: of a mode 400 times slower, that turns 1e-12 within a burst.
    """
    exponent, vectors = (np.asarray(each).astype(np.complex128) for each in np.linalg.eig(matrix))
    long, inverse = vectors.astype(np.clongdouble), np.linalg.inv(vectors).astype(np.clongdouble)
    across, unit = inverse @ (matrix.astype(np.longdouble) @ long), inverse @ long
    found = np.diag(across) / np.diag(unit)
    gap = found[None, :] - found[:, None]
    apart = np.abs(gap) > _ALIKE * np.abs(found).max()
    turn = np.where(apart, (across - unit * found) / np.where(apart, gap, 1), 0)
    if np.abs(turn).max() > _ALIKE:
        return exponent, vectors  # of vectors all but parallel, the step would be no improvement
    real = exponent.imag == 0
    found, long = np.where(real, found.real, found), long + long @ turn
    return found.astype(complex), np.where(real, long.real, long).astype(complex)


def uncouple(
    omega: FloatArray, damping_ratio: FloatArray, gain: FloatArray, loads: Sequence[Load]
) -> tuple[Uncoupled, bool]:
    """Uncoupled equations of modes under fingers, and whether they are those of the very fingers.

    Arguments as for `CoupledModes.of`. Where the eigenvectors cannot be trusted, they are those of fingers a few parts
    in 1e9 off.
    """
    tried: list[tuple[float, Uncoupled, bool]] = []
    for off in _OFF:
        moved = [(contact, finger.scaled(1 + off * (2 + place))) for place, (contact, finger) in enumerate(loads)]
        uncoupled, condition = CoupledModes.of(omega, damping_ratio, gain, moved).uncoupled()
        tried.append((condition, uncoupled, off == 0))
        if condition <= _WORST_CONDITION:
            break
    _, best, exact = min(tried, key=lambda each: each[0])
    return best, exact


def coupled_with(driven: NDArray[np.bool_], loads: Sequence[Load]) -> NDArray[np.bool_]:
    """Whether each mode moves where some are driven: those, and what the fingers couple to them, (n_modes,) array."""
    size = sum((np.abs(contact) for contact, _ in loads), np.zeros((driven.size, driven.size)))
    linked = size > _THIN * size.max(initial=0.0)
    moves = driven.copy()
    for _ in range(driven.size):
        moves = moves | linked[:, moves].any(axis=1)
    return moves
