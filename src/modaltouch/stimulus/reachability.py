r"""Least-energy voltages that take the modes from rest to a given state: weights, Gramian, solution.

The weighted energy :math:`\sum v^2/D` subject to :math:`R v = x_F` is least for :math:`v = D R^T W^{-1} x_F` with the
reachability Gramian :math:`W = R D R^T`. The rows of R and the weight D are sums of exponentials, so that every entry
of W is a sum of geometric series; R itself, with one column per sample, is never formed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modaltouch.stimulus.quantities import ComplexArray, DesignError, FloatArray
from modaltouch.stimulus.synthesis import synthesise


@dataclass(frozen=True)
class Taper:
    """Window of weight 1 with raised-cosine ends; the first and the last sample have weight 0.

    Attributes
    ----------
    n_samples : int
        Number of samples.
    rise, fall : int
        Number of samples from 0 to 1 at the start, and from 1 to 0 at the end, at least 1 each.
    """

    n_samples: int
    rise: int
    fall: int

    @classmethod
    def fitting(cls, n_samples: int, rise: float, fall: float) -> Taper:
        """Return the taper with these ends [samples], both shortened if they would exceed half of the samples."""
        shrink = min(1.0, 0.5 * n_samples / max(rise + fall, 1.0))
        return cls(n_samples, max(1, int(rise * shrink)), max(1, int(fall * shrink)))

    def apply(self, voltage: FloatArray) -> None:
        """Multiply voltages, (n_channels, n_samples) array, by the weight, in place."""
        voltage[:, : self.rise] *= raised_cosine(self.rise)
        voltage[:, self.n_samples - self.fall :] *= raised_cosine(self.fall)[::-1]

    def write(self, amplitude: ComplexArray, exponent: ComplexArray, hold: float, voltage: FloatArray) -> None:
        """Write tapered sums of exponentials.

        Parameters
        ----------
        amplitude : (n_channels, n_states) complex array
            Amplitudes at the last sample, before the taper [V].
        exponent : (n_states,) complex array
            Exponents, real parts at most 0 [1/s].
        hold : float
            Length of a sample [s].
        voltage : (n_channels, n_samples) array
            Receives the voltages [V]; each row contiguous.
        """
        synthesise(amplitude, exponent, hold, voltage)
        self.apply(voltage)

    def transform(self, rate: ComplexArray) -> ComplexArray:
        """Return the sum over samples of weight * exp(rate * samples before the last), elementwise."""
        flat_for = self.n_samples - self.rise - self.fall
        step = np.expm1(rate)
        over_fall, over_flat, over_rise = (np.expm1(rate * n) for n in (self.fall, flat_for, self.rise))
        at_fall = 0.5 * _geometric(step, over_fall, self.fall) - 0.25 * _turned(rate, over_fall, self.fall, 0)
        flat = _geometric(step, over_flat, flat_for)
        at_rise = 0.5 * _geometric(step, over_rise, self.rise) + 0.25 * _turned(rate, over_rise, self.rise, 1)
        return np.asarray(at_fall + (1 + over_fall) * (flat + (1 + over_flat) * at_rise))


def raised_cosine(n: int) -> FloatArray:
    """Return a raised cosine rising from 0, (n,) array [1]; it would reach 1 at sample n."""
    return np.asarray(np.sin(np.arange(n) * (np.pi / (2 * n))) ** 2)


def _geometric(step: ComplexArray, over_all: ComplexArray, n: int) -> ComplexArray:
    """Return the sum of exp(rate * m) for m from 0 to n - 1, from expm1(rate) and expm1(rate * n)."""
    still = step == 0
    return np.where(still, n, over_all / np.where(still, 1, step))


def _turned(rate: ComplexArray, over_all: ComplexArray, n: int, shift: int) -> ComplexArray:
    """Return the sum of exp(rate * m) * 2 cos(pi (m + shift) / n) for m from 0 to n - 1, with expm1(rate * n).

    Over n samples the cosine advances by half a period, so that exp(n (rate +- i pi / n)) = -exp(rate n).
    """
    angle = 1j * np.pi / n
    ahead, behind = np.expm1(rate + angle), np.expm1(rate - angle)
    turn = np.exp(angle * shift)
    whole = -2.0 - over_all
    return np.asarray(
        np.where(ahead == 0, n, whole / np.where(ahead == 0, 1, ahead)) * turn
        + np.where(behind == 0, n, whole / np.where(behind == 0, 1, behind)) * np.conjugate(turn)
    )


@dataclass(frozen=True, eq=False)
class ReachabilityGramian:
    """Factored reachability matrix R of tapered samples, with its Gramian."""

    # (n_conditions, n_channels, n_states) complex: condition j of a volt on channel c, m samples before the last, is
    # the real part of ``sum(row[j, c] * exp(exponent * hold * m))``
    row: ComplexArray
    exponent: ComplexArray  # (n_states,) complex: exponents of the states [1/s]
    hold: float  # length of a sample [s]
    taper: Taper  # weight of the samples

    def gramian(self) -> FloatArray:
        """Return W = R D R^T, (n_conditions, n_conditions) array."""
        rate = self.exponent * self.hold
        together, against = self.taper.transform(np.stack([rate[:, None] + rate, rate[:, None] + rate.conj()]))
        rows = self.row.transpose(1, 0, 2)
        gram = rows @ together @ rows.transpose(0, 2, 1) + rows @ against @ rows.conj().transpose(0, 2, 1)
        return np.asarray(0.5 * gram.real.sum(axis=0))

    def write(self, weight: FloatArray, voltage: FloatArray) -> None:
        """Write the voltages D R^T weight, one weight per condition, into contiguous rows."""
        self.taper.write(np.tensordot(weight, self.row, axes=1), self.exponent, self.hold, voltage)


@dataclass(frozen=True, eq=False)
class GramianSolver:
    """Solver of W x = b, with W scaled to unit diagonal."""

    scale: FloatArray  # (n,): inverse square roots of the diagonal
    eigenvalue: FloatArray  # (n,): eigenvalues of the scaled Gramian, increasing
    eigenvector: FloatArray  # (n, n): eigenvectors of the scaled Gramian, in columns

    @classmethod
    def of(cls, gramian: FloatArray, label: Sequence[int]) -> GramianSolver:
        """Return the solver of a Gramian; messages name the modes `label` of the conditions, repeated cyclically.

        Raises ValueError if a condition does not respond to any voltage in double precision.
        """
        diagonal = np.diag(gramian)
        lost = np.flatnonzero(~((diagonal > 0) & np.isfinite(gramian).all(axis=1)))
        if lost.size:
            raise DesignError(
                f"mode {label[lost[0] % len(label)]} has {diagonal[lost[0]]:.3g} on the diagonal of the Gramian, which "
                f"must be above 0: its motion under the drive is lost in rounding; leave the mode out, or check its "
                f"frequency, damping and gain",
                "modal_gain",
                label[lost[0] % len(label)],
            )
        scale = 1 / np.sqrt(diagonal)
        eigenvalue, eigenvector = np.linalg.eigh(gramian * scale[:, None] * scale)
        return cls(scale, eigenvalue, eigenvector)

    @property
    def condition_number(self) -> float:
        """Ratio of the largest to the smallest eigenvalue of the scaled Gramian [1]; infinite if singular."""
        smallest = float(self.eigenvalue[0])
        return float(self.eigenvalue[-1]) / smallest if smallest > 0 else float("inf")

    def solve(self, value: FloatArray) -> FloatArray:
        """Return the solution for a right-hand side, without eigenvectors lost to rounding."""
        lost = self.eigenvalue <= self.eigenvalue.size * np.finfo(float).eps * self.eigenvalue[-1]
        inverse = np.where(lost, 0.0, 1 / np.where(lost, 1.0, self.eigenvalue))
        return np.asarray(self.scale * (self.eigenvector @ (inverse * (self.eigenvector.T @ (self.scale * value)))))
