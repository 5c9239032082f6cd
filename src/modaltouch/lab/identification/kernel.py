r"""Least squares of many responses on common poles: residues are solved for, poles and delay searched.

A velocity response behind a delay :math:`\tau` and a known low-pass L is

.. math:: H_r(\omega) = L e^{-i\omega\tau} \Big[\sum_k \frac{i\omega R_{kr}}
          {\omega_k^2 - \omega^2 + 2 i \xi_k \omega_k \omega} + c_r + d_r \omega\Big]

with real residues R, which are gain times shape, and a complex linear rest c + d w. For given poles and delay the rest
is linear; what is left of the responses then, r = P y with the projector P, is minimised over poles and delay (variable
projection). Its slope is exactly -P (dA/dp) x (Golub and Pereyra 1973); Gauss and Newton's second derivative follows
from it (Kaufman 1975).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.arrays import ComplexArray, FloatArray

N_REST = 4
"""Columns of the complex linear rest."""


@dataclass(frozen=True)
class Bins:
    """Neighbouring bins joined where the responses are smooth, and the model averaged over the same ones.

    Attributes
    ----------
    frequency : (n_bins,) array
        Of every bin [Hz].
    start : (n_groups,) array
        First bin of each group.
    """

    frequency: FloatArray
    start: NDArray[np.intp]

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

    @cached_property
    def size(self) -> FloatArray:
        """Bins of each group, (n_groups,) array."""
        return np.diff(np.append(self.start, self.frequency.size)).astype(float)

    @cached_property
    def centre(self) -> FloatArray:
        """Mean frequency of each group, (n_groups,) array [Hz]."""
        return self.mean(self.frequency).real

    @cached_property
    def nodes(self) -> FloatArray:
        r"""Where a model is computed instead of at every bin: three to each group, (n_nodes,) array [Hz].

        They are those of Gauss's rule for a sum over n bins: with the moments :math:`\mu_2 = (n^2 - 1)/12` and
        :math:`\mu_4 = \mu_2 (3 n^2 - 7)/20` of their places it is exact for polynomials of degree 5. Of a group as wide
        as an eighth of its distance from a pole it gives the mean to 1e-8.
        Where every group is a bin, one is enough.
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
        """Return the mean over each group of what is known at the nodes, along the last axis."""
        parts = values.reshape(*values.shape[:-1], *self.node_weight.shape)
        return np.asarray(np.einsum("...gn,gn->...g", parts, self.node_weight))

    def mean(self, values: FloatArray | ComplexArray) -> ComplexArray:
        """Return the mean over each group, along the last axis."""
        return np.asarray(np.add.reduceat(values, self.start, axis=-1) / self.size, dtype=complex)


@dataclass(frozen=True, eq=False)
class LeastSquaresProblem:
    """Responses to be fitted.

    Attributes
    ----------
    bins : Bins
        Where.
    response : (n_groups, n_responses) complex array
        Responses over their standard deviation, times the square root of the bins of the group.
    weight : (n_groups,) array
        What the columns are multiplied by likewise; a response's own scale is in its residues.
    bandwidth : float or None
        Corner of the known low-pass [Hz].
    phase_at : float or None
        Where the delay stands for a phase that is the same at all frequencies [Hz]; None for a true delay.
    """

    bins: Bins
    response: ComplexArray
    weight: FloatArray
    bandwidth: float | None
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
        """What a delay is multiplied by for its phase, (n_nodes,) array [rad/s]."""
        return self.omega if self.phase_at is None else np.full(self.omega.size, 2 * np.pi * self.phase_at)

    @cached_property
    def low_pass(self) -> ComplexArray:
        """The known low-pass, (n_nodes,) array [1]."""
        if self.bandwidth is None:
            return np.ones(self.omega.size, dtype=complex)
        return np.asarray(1 / (1 + 1j * self.bins.nodes / self.bandwidth))


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A fit at given poles and delay.

    Attributes
    ----------
    natural_frequency, damping_ratio : (n_modes,) array
        The poles [Hz, 1].
    delay : float
        Of the responses [s].
    residue : (n_modes + 4, n_responses) array
        Of the modes, then of the rest, in the scale of the problem's responses.
    rest : (2 n_groups, n_responses) array
        What is left, in standard deviations.
    slope : (2 n_groups, 2 n_modes + 1) array
        Change of the modes' columns by natural frequency over its damping, by the logarithm of the damping ratio, less
        what the columns can take; the last is unused.
    turned : (2 n_groups, n_modes + 4) array
        Change of all columns by the delay, likewise.
    basis, factor : (2 n_groups, n_modes + 4) and (n_modes + 4, n_modes + 4) array
        The columns' orthonormal and upper triangular factors.
    lost : (n_modes + 4, 2 n_modes) array
        What the columns take of the slopes: how residues follow the poles.
    lost_turned : (n_modes + 4, n_modes + 4) array
        The same of the delay.
    """

    natural_frequency: FloatArray
    damping_ratio: FloatArray
    delay: float
    residue: FloatArray
    rest: FloatArray
    slope: FloatArray
    turned: FloatArray
    basis: FloatArray
    factor: FloatArray
    lost: FloatArray
    lost_turned: FloatArray

    @property
    def n_modes(self) -> int:
        """Number of poles."""
        return int(self.natural_frequency.size)

    @cached_property
    def cost(self) -> float:
        """Half the sum of squares."""
        return 0.5 * float((self.rest**2).sum())

    @cached_property
    def _own(self) -> FloatArray:
        """Residue of the mode that each pole parameter moves, (2 n_modes, n_responses) array."""
        return np.concatenate([self.residue[: self.n_modes]] * 2)

    @cached_property
    def gradient(self) -> FloatArray:
        """Of the cost by the parameters, (2 n_modes + 1,) array."""
        own = -np.einsum("pr,pr->p", self.slope.T @ self.rest, self._own)
        return np.append(own, -float(np.sum((self.turned.T @ self.rest) * self.residue)))

    @cached_property
    def curvature(self) -> FloatArray:
        """Of the cost by the parameters, (2 n_modes + 1, 2 n_modes + 1) array."""
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
        """What each group of bins adds to the slope of the cost, over all responses, (n_groups, 2 n_modes + 1) array.

        An error that is the same at all points, as one of the measured drive, adds up here.
        """
        own = self.slope * (self.rest @ self._own.T)
        delay = (self.turned * (self.rest @ self.residue.T)).sum(axis=1)
        both = np.concatenate([own, delay[:, None]], axis=1)
        n = both.shape[0] // 2
        return np.asarray(both[:n] + both[n:])

    @cached_property
    def covariance(self) -> FloatArray:
        """Of the parameters (frequency over damping, log damping, delay times scale) for responses of unit variance."""
        return np.asarray(np.linalg.pinv(self.curvature, hermitian=True))

    @property
    def variance(self) -> float:
        """Mean square of what is left, by the degrees of freedom."""
        return 2 * self.cost / max(self.rest.size - self.residue.size - 2 * self.n_modes - 1, 1)

    @cached_property
    def deviation(self) -> FloatArray:
        """Of the parameters, in the units of the covariance, (2 n_modes + 1,) array.

        Of scatter that is independent from response to response, or common to all of a bin: the wider of both.
        """
        moved = self.scores @ self.covariance
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance) * self.variance, (moved**2).sum(axis=0))))


def evaluate(
    problem: LeastSquaresProblem, natural_frequency: FloatArray, damping_ratio: FloatArray, delay: float, scale: float
) -> Evaluation:
    """Return the best fit of the responses for given poles and delay.

    Parameters
    ----------
    problem : LeastSquaresProblem
        The responses.
    natural_frequency, damping_ratio : (n_modes,) array
        The poles [Hz, 1].
    delay : float
        Of the responses [s].
    scale : float
        Unit of the delay among the parameters [s].
    """
    n_modes = natural_frequency.size
    grouped = _columns(problem, natural_frequency, damping_ratio, delay, scale) * problem.weight
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
        natural_frequency=natural_frequency,
        damping_ratio=damping_ratio,
        delay=delay,
        residue=inverse @ solved,
        rest=problem.stacked - basis @ solved,
        slope=left[:, : 2 * n_modes],
        turned=left[:, 2 * n_modes :],
        basis=basis,
        factor=factor,
        lost=lost[:, : 2 * n_modes],
        lost_turned=lost[:, 2 * n_modes :],
    )


def fitted(problem: LeastSquaresProblem, fit: Evaluation) -> ComplexArray:
    """Return what a fit makes of the responses at every bin, in the problem's scale, (n_responses, n_bins) array."""
    frequency = problem.bins.frequency
    every = replace(problem, bins=Bins(frequency, np.arange(frequency.size)))
    columns = _columns(every, fit.natural_frequency, fit.damping_ratio, fit.delay, 1.0)
    return np.asarray(fit.residue.T @ columns[: fit.n_modes + N_REST])


def complex_residue(problem: LeastSquaresProblem, fit: Evaluation) -> ComplexArray:
    r"""Return residues that may be complex, of the same poles and delay, (n_modes, n_responses) array.

    A complex conjugate pair of poles with the residues :math:`R \mp i S` over :math:`2 i \omega_d` adds
    :math:`R + S (i\omega + \xi_k\omega_k) / \omega_d` times the mode's column: S stands in quadrature at its resonance.
    """
    n, own, ratio = fit.n_modes, fit.natural_frequency[:, None], fit.damping_ratio[:, None]
    columns = _columns(problem, fit.natural_frequency, fit.damping_ratio, fit.delay, 1.0)[: n + N_REST] * problem.weight
    quadrature = columns[:n] * (1j * problem.bins.centre + ratio * own) / (own * np.sqrt(1 - ratio**2))
    both = np.concatenate([columns, quadrature])
    solved = np.linalg.lstsq(np.concatenate([both.real, both.imag], axis=1).T, problem.stacked, rcond=None)[0]
    return np.asarray(solved[:n] + 1j * solved[-n:])


def _columns(
    problem: LeastSquaresProblem, natural_frequency: FloatArray, damping_ratio: FloatArray, delay: float, scale: float
) -> ComplexArray:
    """Return what the responses are made of, and how it changes, averaged over the groups of bins.

    Returns
    -------
    (4 n_modes + 2 N_REST, n_groups) complex array
        Columns of the modes and of the rest; changes of the modes' columns by natural frequency, then by damping ratio;
        changes of all columns by the delay.
    """
    omega = problem.omega
    turn = problem.low_pass * np.exp(-1j * problem.turning * delay)
    own, ratio = 2 * np.pi * natural_frequency[:, None], damping_ratio[:, None]
    dynamic = 1 / (own**2 - omega**2 + 2j * ratio * own * omega)
    modes = 1j * omega * turn * dynamic * (own * ratio)
    relative = omega / problem.highest
    columns = np.concatenate([modes, [turn, 1j * turn, relative * turn, 1j * relative * turn]])
    moved = modes * dynamic * (-own * ratio)
    mean = problem.bins.mean_of_nodes
    steeper = mean(moved * omega)
    by_frequency = 2 * own * mean(moved) + 2j * ratio * steeper
    by_delay = mean(columns * (-1j * problem.turning * scale))
    return np.concatenate([mean(columns), by_frequency, 2j * steeper, by_delay])
