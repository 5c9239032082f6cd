r"""Least-squares fit of many responses with common poles: linear in the residues, iterative in poles and delay.

A velocity response with a delay :math:`\tau` and a known low-pass L is

.. math:: H_r(\omega) = L e^{-i\omega\tau} \Big[\sum_k \frac{i\omega R_{kr}}
          {\omega_k^2 - \omega^2 + 2 i \xi_k \omega_k \omega} + c_r + d_r \omega\Big]

with real residues R, which are gain times shape, and a complex linear background c + d w. For given poles and delay the
model A x is linear in x, the residues and backgrounds, and the residual of the responses y is r = P y with a projector
P; it is minimised over poles and delay (variable projection). Its derivative is exactly -P (dA/dp) x (Golub and Pereyra
1973), and the Gauss-Newton Hessian follows from that (Kaufman 1975).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.common import ComplexArray, FloatArray, low_pass

N_REST = 4
"""Real columns of the complex linear background."""


@dataclass(frozen=True)
class Bins:
    """Groups of neighbouring bins over which responses and model are averaged, wider where the responses are smooth."""

    frequency: FloatArray  # (n_bins,): frequency of every bin [Hz]
    start: NDArray[np.intp]  # (n_groups,): first bin of each group

    @classmethod
    def near(cls, frequency: FloatArray, natural_frequency: FloatArray, damping_ratio: FloatArray) -> Bins:
        """Return groups no wider than an eighth of their distance from the nearest pole in the complex plane."""
        distance = np.hypot(frequency[:, None] - natural_frequency, damping_ratio * natural_frequency).min(axis=1)
        spacing = frequency[1] - frequency[0]
        start, n = [], frequency.size
        index = 0
        while index < n:
            start.append(index)
            index += max(1, int(distance[index] / 8 / spacing))
        return cls(frequency, np.array(start, dtype=np.intp))

    def between(self, lowest: float, highest: float) -> tuple[Bins, NDArray[np.bool_]]:
        """Return the groups centred within a band [Hz], and for each of all groups whether it is."""
        inside = (self.centre >= lowest) & (self.centre <= highest)
        stop = np.append(self.start[1:], self.frequency.size)[inside].max(initial=0)
        return Bins(self.frequency[:stop], self.start[inside]), inside

    @cached_property
    def size(self) -> FloatArray:
        """Number of bins in each group, (n_groups,) array."""
        return np.diff(np.append(self.start, self.frequency.size)).astype(float)

    @cached_property
    def centre(self) -> FloatArray:
        """Mean frequency of each group, (n_groups,) array [Hz]."""
        return self.mean(self.frequency).real

    @cached_property
    def nodes(self) -> FloatArray:
        r"""Frequencies at which a model is evaluated instead of at all bins, three per group, (n_nodes,) array [Hz].

        They are the nodes of the Gauss rule for a sum over n bins, exact for polynomials of degree 5, from the moments
        :math:`\mu_2 = (n^2 - 1)/12` and :math:`\mu_4 = \mu_2 (3 n^2 - 7)/20` of the bins. The mean is accurate to 1e-8
        for a group as wide as an eighth of its distance from a pole. One node suffices if all groups are single bins.
        """
        if (self.size == 1).all():
            return self.frequency
        apart = np.sqrt(np.maximum(3 * self.size**2 - 7, 0) / 20) * (self.frequency[1] - self.frequency[0])
        return np.asarray(self.centre[:, None] + apart[:, None] * [-1.0, 0.0, 1.0]).ravel()

    @cached_property
    def node_weight(self) -> FloatArray:
        """Weight of each node in the mean over its group, (n_groups, 1 or 3) array [1]."""
        if (self.size == 1).all():
            return self.size[:, None]
        outer = (self.size**2 - 1) / 12 / np.maximum((3 * self.size**2 - 7) / 10, 0.1)
        return np.stack([outer, 1 - 2 * outer, outer], axis=1)

    def mean_of_nodes(self, values: ComplexArray) -> ComplexArray:
        """Return the mean over each group from values at the nodes, along the last axis."""
        parts = values.reshape(*values.shape[:-1], *self.node_weight.shape)
        return np.asarray(np.einsum("...gn,gn->...g", parts, self.node_weight))

    def mean(self, values: FloatArray | ComplexArray) -> ComplexArray:
        """Return the mean over each group, along the last axis."""
        return np.asarray(np.add.reduceat(values, self.start, axis=-1) / self.size, dtype=complex)


@dataclass(frozen=True, eq=False)
class Poles:
    """Natural frequencies, damping ratios and the common delay."""

    # natural_frequency, damping_ratio, (n_modes,): in order of frequency [Hz, 1]
    natural_frequency: FloatArray
    damping_ratio: FloatArray
    delay: float  # delay common to all responses [s]

    def sorted(self) -> Poles:
        """Return the poles in order of frequency."""
        order = np.argsort(self.natural_frequency)
        return Poles(self.natural_frequency[order], self.damping_ratio[order], self.delay)

    def near(self, frequency: float, damping_ratio: float) -> int:
        """Return the number of poles within two half-power bandwidths of a frequency."""
        return int((np.abs(self.natural_frequency / frequency - 1) <= 4 * damping_ratio).sum())


@dataclass(frozen=True, eq=False)
class LeastSquaresProblem:
    """Responses to fit."""

    bins: Bins  # groups of bins at which they are fitted
    # (n_groups, n_responses): responses divided by their standard deviation, times the square root of the number of
    # bins in the group
    response: ComplexArray
    # (n_groups,): the same factor for the model's columns; each set's own noise level is absorbed by its residues
    weight: FloatArray
    bandwidth: float | None  # corner of the known low-pass [Hz]
    # frequency that turns the delay into a phase equal at all frequencies [Hz]; None for a true delay
    phase_at: float | None = None

    @cached_property
    def stacked(self) -> FloatArray:
        """Real above imaginary parts, (2 n_groups, n_responses) array."""
        return np.concatenate([self.response.real, self.response.imag])

    @cached_property
    def omega(self) -> FloatArray:
        """Angular frequency of every node, (n_nodes,) array [rad/s]."""
        return 2 * np.pi * self.bins.nodes

    @property
    def highest(self) -> float:
        """Angular frequency of the last bin [rad/s]."""
        return 2 * np.pi * float(self.bins.frequency[-1])

    @cached_property
    def turning(self) -> FloatArray:
        """Phase per unit of delay, (n_nodes,) array [rad/s]."""
        return self.omega if self.phase_at is None else np.full(self.omega.size, 2 * np.pi * self.phase_at)

    @cached_property
    def low_pass(self) -> ComplexArray:
        """The known low-pass, (n_nodes,) array [1]."""
        return low_pass(self.bins.nodes, self.bandwidth)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A fit at given poles and delay."""

    problem: LeastSquaresProblem  # the responses
    poles: Poles  # poles and delay
    # (n_modes + 4, n_responses): residues of the modes, then coefficients of the background, in the scale of the
    # problem's responses
    residue: FloatArray
    rest: FloatArray  # (2 n_groups, n_responses): residual, in standard deviations
    # (2 n_groups, 2 n_modes): derivatives of the modes' columns with respect to natural frequency in units of its
    # damping, then to the logarithm of the damping ratio, minus their projection on all columns
    slope: FloatArray
    # (2 n_groups, n_modes + 4): derivatives of all columns with respect to the delay, minus their projection
    turned: FloatArray
    # basis, factor, (2 n_groups, n_modes + 4) and (n_modes + 4, n_modes + 4): orthonormal and upper triangular factor
    # of the columns
    basis: FloatArray
    factor: FloatArray
    # (n_modes + 4, 2 n_modes): coefficients of the derivatives' projection on the columns, hence the change of the
    # residues with the poles
    lost: FloatArray
    lost_turned: FloatArray  # (n_modes + 4, n_modes + 4): the same for the delay

    @property
    def n_modes(self) -> int:
        """Number of poles."""
        return int(self.poles.natural_frequency.size)

    @property
    def left(self) -> ComplexArray:
        """Residual as complex numbers, (n_groups, n_responses) array."""
        n = len(self.rest) // 2
        return np.asarray(self.rest[:n] + 1j * self.rest[n:])

    @cached_property
    def cost(self) -> float:
        """Half the sum of squares of the residual."""
        return 0.5 * float((self.rest**2).sum())

    @cached_property
    def _own(self) -> FloatArray:
        """Residue of the mode to which each pole parameter belongs, (2 n_modes, n_responses) array."""
        return np.concatenate([self.residue[: self.n_modes]] * 2)

    @cached_property
    def gradient(self) -> FloatArray:
        """Gradient of the cost, (2 n_modes + 1,) array."""
        own = -np.einsum("pr,pr->p", self.slope.T @ self.rest, self._own)
        return np.append(own, -float(np.sum((self.turned.T @ self.rest) * self.residue)))

    @cached_property
    def curvature(self) -> FloatArray:
        """Gauss-Newton Hessian of the cost, (2 n_modes + 1, 2 n_modes + 1) array."""
        n = 2 * self.n_modes
        result = np.empty((n + 1, n + 1))
        result[:n, :n] = (self.slope.T @ self.slope) * (self._own @ self._own.T)
        mixed = self.residue @ self.residue.T
        result[:n, n] = np.einsum("pc,cp->p", self.slope.T @ self.turned, self.residue @ self._own.T)
        result[n, :n] = result[:n, n]
        result[n, n] = float(np.sum((self.turned.T @ self.turned) * mixed))
        return result

    @cached_property
    def scores(self) -> FloatArray:
        """Contribution of each group of bins to the gradient, over all responses, (n_groups, 2 n_modes + 1) array.

        Errors common to all points, such as those of the measured drive, add up here.
        """
        own = self.slope * (self.rest @ self._own.T)
        delay = (self.turned * (self.rest @ self.residue.T)).sum(axis=1)
        both = np.concatenate([own, delay[:, None]], axis=1)
        n = both.shape[0] // 2
        return np.asarray(both[:n] + both[n:])

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters for responses of unit variance.

        The parameters are natural frequency in units of its damping, log damping ratio, and delay times `highest`.
        """
        return np.asarray(np.linalg.pinv(self.curvature, hermitian=True))

    @property
    def variance(self) -> float:
        """Sum of squares of the residual divided by the degrees of freedom."""
        return 2 * self.cost / max(self.rest.size - self.residue.size - 2 * self.n_modes - 1, 1)

    @cached_property
    def deviation(self) -> FloatArray:
        """Standard deviation of the parameters, in the units of the covariance, (2 n_modes + 1,) array.

        The larger of the values for scatter independent between responses and scatter common to all responses of a bin.
        """
        moved = self.scores @ self.covariance
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance) * self.variance, (moved**2).sum(axis=0))))


def evaluate(problem: LeastSquaresProblem, poles: Poles) -> Evaluation:
    """Return the best fit of the responses for given poles and delay."""
    n_modes = poles.natural_frequency.size
    grouped = _columns(problem, poles) * problem.weight
    real = np.concatenate([grouped.real, grouped.imag], axis=1).T
    n_columns = n_modes + N_REST
    basis, factor = np.linalg.qr(real[:, :n_columns])
    moved = real[:, n_columns:]
    taken = basis.T @ moved
    left = moved - basis @ taken
    solved = basis.T @ problem.stacked
    inverse = np.linalg.inv(factor)
    lost = inverse @ taken
    return Evaluation(
        problem=problem,
        poles=poles,
        residue=inverse @ solved,
        rest=problem.stacked - basis @ solved,
        slope=left[:, : 2 * n_modes],
        turned=left[:, 2 * n_modes :],
        basis=basis,
        factor=factor,
        lost=lost[:, : 2 * n_modes],
        lost_turned=lost[:, 2 * n_modes :],
    )


def fitted(fit: Evaluation) -> ComplexArray:
    """Return the fitted responses at every bin, in the problem's scale, (n_responses, n_bins) array."""
    frequency = fit.problem.bins.frequency
    columns = _columns(replace(fit.problem, bins=Bins(frequency, np.arange(frequency.size))), fit.poles)
    return np.asarray(fit.residue.T @ columns[: fit.n_modes + N_REST])


def complex_residue(fit: Evaluation) -> ComplexArray:
    r"""Return complex residues for the same poles and delay, (n_modes, n_responses) array.

    A complex conjugate pair of poles with the residues :math:`R \mp i S` over :math:`2 i \omega_d` contributes
    :math:`R + S (i\omega + \xi_k\omega_k) / \omega_d` times the mode's column: S is in quadrature at its resonance.
    """
    n, problem = fit.n_modes, fit.problem
    own, ratio = fit.poles.natural_frequency[:, None], fit.poles.damping_ratio[:, None]
    columns = _columns(problem, fit.poles)[: n + N_REST] * problem.weight
    quadrature = columns[:n] * (1j * problem.bins.centre + ratio * own) / (own * np.sqrt(1 - ratio**2))
    both = np.concatenate([columns, quadrature])
    solved = np.linalg.lstsq(np.concatenate([both.real, both.imag], axis=1).T, problem.stacked, rcond=None)[0]
    return np.asarray(solved[:n] + 1j * solved[-n:])


def _columns(problem: LeastSquaresProblem, poles: Poles) -> ComplexArray:
    """Return the model's columns and their derivatives, averaged over the groups of bins.

    Returns
    -------
    (4 n_modes + 2 N_REST, n_groups) complex array
        Columns of the modes and of the background; derivatives of the modes' columns with respect to natural frequency,
        then to damping ratio; derivatives of all columns with respect to the delay times `highest`.
    """
    omega = problem.omega
    turn = problem.low_pass * np.exp(-1j * problem.turning * poles.delay)
    own, ratio = 2 * np.pi * poles.natural_frequency[:, None], poles.damping_ratio[:, None]
    dynamic = 1 / (own**2 - omega**2 + 2j * ratio * own * omega)
    modes = 1j * omega * turn * dynamic * (own * ratio)
    relative = omega / problem.highest
    columns = np.concatenate([modes, [turn, 1j * turn, relative * turn, 1j * relative * turn]])
    moved = modes * dynamic * (-own * ratio)
    mean = problem.bins.mean_of_nodes
    steeper = mean(moved * omega)
    by_frequency = 2 * own * mean(moved) + 2j * ratio * steeper
    by_delay = mean(columns * (-1j * problem.turning / problem.highest))
    return np.concatenate([mean(columns), by_frequency, 2j * steeper, by_delay])
