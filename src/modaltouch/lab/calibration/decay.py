r"""The free decay after the drive has ended: common poles, and how strongly each swings at every point.

.. math:: y_q(t) = \mathrm{Re} \sum_k R_{kq} e^{s_k t} + c_q + \text{noise}

over records q (positions, bursts), with the constant c that a vibrometer's output has at rest. For given poles the
residues R follow by linear least squares; the poles by Gauss-Newton on what is left over, the residues eliminated
(variable projection: Golub & Pereyra 1973 with the Jacobian of Kaufman 1975). Modes that nobody listed show as lines in
the rest; their poles are added until none stands out of the noise, so that they do not bias the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modaltouch.lab.arrays import ComplexArray, FloatArray

_STEPS = 12
"""Most Gauss-Newton steps: two or three settle it."""

_SETTLED = 1e-3
"""Step below which the poles have settled, in units of each pole's own decay rate [1]."""

_STANDS_OUT = 3.0
"""Power of a line over what noise alone would show at its highest, above which it is a mode [1]."""

_FIRST_DAMPING = 0.015
"""Damping ratio with which the fit of an unlisted mode begins [1]."""

_LEAST_APART = 0.75
"""How many decay rates an unlisted pole must lie from its neighbours: nearer, both are one line [1]."""


SLIP_NOISE = 5.0
"""Standard errors of a mode's velocity up to which its slip may be noise: 2 for a fitted pole, 2.45 for 95 % [1]."""


@dataclass(frozen=True, eq=False)
class Decay:
    """Decays as they were fitted.

    Attributes
    ----------
    pole : (n_poles,) complex array
        Listed modes first [1/s].
    residue : (n_poles, n_records) complex array
        At time 0 of the clock that was given [m/s].
    spread : (n_poles,) array
        Standard error of each residue, real or imaginary part [m/s].
    noise : float
        Standard deviation of what is left over [m/s].
    pole_error : (n_poles,) complex array
        How far the poles of the records lie from those given, to first order; 0 where they were fitted [1/s].
    """

    pole: ComplexArray
    residue: ComplexArray
    spread: FloatArray
    noise: float
    pole_error: ComplexArray


def fit_residues(time: FloatArray, records: FloatArray, pole: ComplexArray) -> Decay:
    """Return the decays for known poles.

    Parameters
    ----------
    time : (n_samples,) array
        Instants, evenly spaced [s].
    records : (n_records, n_samples) array
        Velocities [m/s].
    pole : (n_poles,) complex array
        Poles [1/s].
    """
    projection = _Projection(time, records, pole)
    return replace(projection.decay(), pole_error=projection.newton_step())


def fit_poles(time: FloatArray, records: FloatArray, pole: ComplexArray) -> Decay:
    """Return the decays for poles that are known roughly: to about their own decay rate."""
    best = _Projection(time, records, pole)
    for _ in range(_STEPS):
        step = best.newton_step()
        # A pole moves by at most half its decay rate at once, and never into growth.
        size = np.abs(step) / -best.pole.real
        step = step * np.minimum(1.0, 0.5 / np.maximum(size, 1e-12))
        for _ in range(5):
            tried = _Projection(time, records, best.pole + step)
            if tried.left <= best.left:
                break
            step = step / 4
        else:
            break
        best = tried
        if float((np.abs(step) / -best.pole.real).max()) < _SETTLED:
            break
    return best.decay()


def missed_swing(swing: ComplexArray, spread: FloatArray, pole: ComplexArray, error: ComplexArray) -> FloatArray:
    """Return what errors of the poles take from complex amplitudes, where noise does not explain them [m/s].

    Averaged over the decay, a residue misses half of what its pole does.
    """
    slip = np.abs(swing * error / pole.real)
    return np.where(slip > SLIP_NOISE * spread, slip / 2, 0.0)


def find_poles(time: FloatArray, records: FloatArray, listed: ComplexArray, *, most: int = 16) -> Decay:
    """Return the decays of the listed modes, and of others as long as any stands out of the noise.

    Parameters
    ----------
    time, records
        As for `fit_residues`.
    listed : (n_listed,) complex array
        Poles known roughly [1/s].
    most : int
        Unlisted modes looked for at most.
    """
    decay = fit_poles(time, records, listed)
    for _ in range(most):
        line = _next_line(time, records, decay)
        if line is None:
            break
        decay = fit_poles(time, records, np.append(decay.pole, line))
    return decay


def _next_line(time: FloatArray, records: FloatArray, decay: Decay) -> complex | None:
    """Return where the rest shows a mode that is not fitted yet."""
    rest = _about_mean(records - (decay.residue.T @ np.exp(np.outer(decay.pole, time))).real)
    n_records, n_samples = rest.shape
    # A decaying line is short: a window that falls with it shows it best.
    step = float(time[1] - time[0])
    best: tuple[float, complex] | None = None
    for length in (n_samples, n_samples // 4, n_samples // 16):
        if length < 64:
            continue
        window = np.exp(-3.0 * np.arange(length) / length)
        power = (np.abs(np.fft.rfft(rest[:, :length] * window, axis=1)) ** 2).sum(axis=0)
        frequency = np.fft.rfftfreq(length, step)
        # Without a line the power is a chi-square of two degrees a record; the median tells its scale.
        scale = float(np.median(power)) / n_records
        if scale == 0:
            continue
        highest = scale * (n_records + 2 * np.sqrt(n_records * np.log(power.size)) + 2 * np.log(power.size))
        for place in np.argsort(-power)[:20]:
            excess = float(power[place]) / highest
            if excess < _STANDS_OUT or (best is not None and excess <= best[0]):
                break
            omega = 2 * np.pi * float(frequency[place])
            if omega == 0:
                continue
            line = complex(-_FIRST_DAMPING * omega, omega)
            apart = np.abs(decay.pole.imag - omega) / np.maximum(-decay.pole.real, -line.real)
            if (apart > _LEAST_APART).all():
                best = (excess, line)
                break
    return None if best is None else best[1]


def _about_mean(rows: FloatArray) -> FloatArray:
    """Return rows without their constants."""
    return np.asarray(rows - rows.mean(axis=1, keepdims=True))


class _Projection:
    """The part of the records that decays at given poles, and what is left over."""

    def __init__(self, time: FloatArray, records: FloatArray, pole: ComplexArray) -> None:
        self.pole = np.asarray(np.where(pole.real < 0, pole, -np.abs(pole.real) * 1e-3 - 1e-3 + 1j * pole.imag))
        swing = np.exp(np.outer(self.pole, time))
        n = self.pole.size
        self._swing = np.concatenate([swing.real, -swing.imag])
        basis, records = _about_mean(self._swing), _about_mean(records)
        self._size = np.sqrt(np.einsum("ij,ij->i", basis, basis))
        self._gram = basis @ basis.T / np.outer(self._size, self._size)
        seen = basis @ records.T / self._size[:, None]
        self._factor = np.linalg.cholesky(self._gram + 1e-12 * np.eye(2 * n))
        self._weights = self._solve(seen)
        self.left = float(np.einsum("ij,ij->", records, records) - np.einsum("ij,ij->", seen, self._weights))
        self._time, self._basis, self._records = time, basis, records

    def _solve(self, value: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.solve(self._factor.T, np.linalg.solve(self._factor, value)))

    def decay(self) -> Decay:
        """Return what was fitted."""
        n = self.pole.size
        freedom = max(1, (self._time.size - 2 * n - 1) * self._records.shape[0])
        noise = np.sqrt(max(self.left, 0.0) / freedom)
        weight = self._weights / self._size[:, None]
        variance = np.diag(self._solve(np.eye(2 * n))) / self._size**2
        return Decay(
            pole=self.pole,
            residue=weight[:n] + 1j * weight[n:],
            spread=noise * np.sqrt(0.5 * (variance[:n] + variance[n:])),
            noise=float(noise),
            pole_error=np.zeros_like(self.pole),
        )

    def newton_step(self) -> ComplexArray:
        """Return the change of every pole that lessens most what is left over (Kaufman's Jacobian)."""
        n = self.pole.size
        # What moving a pole changes, less what the residues make of it: columns t cos, t (-sin), t sin, t cos.
        turned = np.concatenate([-self._swing[n:], self._swing[:n]])
        moved = _about_mean(np.concatenate([self._swing, turned]) * self._time)
        cross = (self._basis @ moved.T) / self._size[:, None]
        across = moved @ moved.T - cross.T @ self._solve(cross)
        slope = moved @ self._records.T - cross.T @ self._weights
        real, imag = self._weights[:n] / self._size[:n, None], self._weights[n:] / self._size[n:, None]
        # Re(R t e^{st}) = Rr t cos - Ri t sin; Re(i R t e^{st}) = -(Rr t sin + Ri t cos).
        normal = np.zeros((2 * n, 2 * n))
        downhill = np.zeros(2 * n)
        parts = ((0, real, 0), (0, imag, 1), (1, -real, 2), (1, -imag, 3))
        for row, first, one in parts:
            rows = slice(row * n, (row + 1) * n)
            downhill[rows] += np.einsum("kq,kq->k", first, slope[one * n : (one + 1) * n])
            for column, second, other in parts:
                columns = slice(column * n, (column + 1) * n)
                shared = across[one * n : (one + 1) * n, other * n : (other + 1) * n]
                normal[rows, columns] += shared * (first @ second.T)
        size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal / np.outer(size, size) + 1e-9 * np.eye(2 * n)
        step = np.linalg.solve(scaled, downhill / size) / size
        return np.asarray(step[:n] + 1j * step[n:])
