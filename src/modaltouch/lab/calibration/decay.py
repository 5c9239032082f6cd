r"""The free decay after the drive has ended: common poles, and their complex amplitudes at every point.

.. math:: y_q(t) = \mathrm{Re} \sum_k R_{kq} e^{s_k t} + c_q + \text{noise}

over records q (positions, bursts), with the constant offset c of the vibrometer's output. For given poles the residues
R follow from linear least squares; the poles follow from a Gauss-Newton search on the residual with the residues
eliminated (variable projection: Golub & Pereyra 1973, with the Jacobian of Kaufman 1975). Unlisted modes appear as
lines in the residual; their poles are added until no line exceeds the noise, so that they do not bias the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modaltouch.lab.common import ComplexArray, FloatArray

_STANDS_OUT = 3.0
"""Power of a line above which it is a mode, relative to the highest power expected from noise alone [1]."""

_LEAST_APART = 0.75
"""Minimum distance of an unlisted pole from its neighbours, in decay rates; closer poles are a single line [1]."""


SLIP_NOISE = 5.0
"""Slip, in standard errors of a mode's velocity, up to which it may be noise: 2 for a fitted pole times 2.45 for 95 %
[1]."""


@dataclass(frozen=True, eq=False)
class Decay:
    """Fitted decays."""

    pole: ComplexArray  # (n_poles,): poles, listed modes first [1/s]
    residue: ComplexArray  # (n_poles, n_records): residues at time 0 [m/s]
    spread: FloatArray  # (n_poles,): standard error of the real or imaginary part of each residue [m/s]
    noise: float  # standard deviation of the residual [m/s]
    # (n_poles,): first-order deviation of the records' poles from the given ones; 0 where they were fitted [1/s]
    pole_error: ComplexArray


def fit_residues(time: FloatArray, records: FloatArray, pole: ComplexArray) -> Decay:
    """Fit decays with known poles.

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
    """Fit decays and their poles, which must be known to within about their own decay rate."""
    best = _Projection(time, records, pole)
    # Two or three steps usually suffice.
    for _ in range(12):
        step = best.newton_step()
        # A pole moves by at most half its decay rate per step, and so never becomes unstable.
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
        if float((np.abs(step) / -best.pole.real).max()) < 1e-3:
            break
    return best.decay()


def missed_swing(swing: ComplexArray, spread: FloatArray, pole: ComplexArray, error: ComplexArray) -> FloatArray:
    """Return the error of complex amplitudes due to pole errors that noise does not explain [m/s].

    It is half the slip, the mean over the decay.
    """
    slip = np.abs(swing * error / pole.real)
    return np.where(slip > SLIP_NOISE * spread, slip / 2, 0.0)


def find_poles(time: FloatArray, records: FloatArray, listed: ComplexArray, *, most: int = 16) -> Decay:
    """Fit the decays of the listed modes, and of further modes as long as one exceeds the noise.

    Parameters
    ----------
    time, records
        As for `fit_residues`.
    listed : (n_listed,) complex array
        Approximate poles [1/s].
    most : int
        Largest number of unlisted modes.
    """
    decay = fit_poles(time, records, listed)
    for _ in range(most):
        line = _next_line(time, records, decay)
        if line is None:
            break
        decay = fit_poles(time, records, np.append(decay.pole, line))
    return decay


def _next_line(time: FloatArray, records: FloatArray, decay: Decay) -> complex | None:
    """Return the pole of a further mode in the residual, or None."""
    rest = _about_mean(records - (decay.residue.T @ np.exp(np.outer(decay.pole, time))).real)
    n_records, n_samples = rest.shape
    step, found = float(time[1] - time[0]), list[tuple[float, complex]]()
    # The signal-to-noise ratio of a decaying line is highest with a window that decays at the same rate.
    for length in (n_samples, n_samples // 4, n_samples // 16):
        window = np.exp(-3.0 * np.arange(length) / length)
        power = (np.abs(np.fft.rfft(rest[:, :length] * window, axis=1)) ** 2).sum(axis=0)
        # Noise power is chi-square distributed with two degrees of freedom per record; the median gives its scale.
        scale = max(float(np.median(power)), 1e-300) / n_records
        highest = scale * (n_records + 2 * np.sqrt(n_records * np.log(power.size)) + 2 * np.log(power.size))
        # A damping ratio of 0.015 to begin with.
        line = (1j - 0.015) * 2 * np.pi * np.fft.rfftfreq(length, step)
        width = np.maximum(-decay.pole.real, -line.real[:, None])
        apart = (np.abs(decay.pole.imag - line.imag[:, None]) > _LEAST_APART * width).all(axis=1) & (line.imag > 0)
        best = int(np.where(apart, power, 0.0).argmax())
        found.append((float(power[best]) / highest, complex(line[best])))
    excess, pole = max(found, key=lambda each: each[0])
    return pole if excess >= _STANDS_OUT else None


def _about_mean(rows: FloatArray) -> FloatArray:
    """Subtract the mean of each row."""
    return np.asarray(rows - rows.mean(axis=1, keepdims=True))


class _Projection:
    """The projection of records on decays with given poles, and the residual."""

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
        """Return the fit."""
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
        """Return the Gauss-Newton step of every pole (Kaufman's Jacobian)."""
        n = self.pole.size
        # Derivatives of the decays by their poles, less their projection on the decays: t cos, -t sin.
        moved = _about_mean(self._swing * self._time)
        cross = (self._basis @ moved.T) / self._size[:, None]
        across = (moved @ moved.T - cross.T @ self._solve(cross)).reshape(2, n, 2, n)
        slope = (moved @ self._records.T - cross.T @ self._weights).reshape(2, n, -1)
        real, imag = (self._weights / self._size[:, None]).reshape(2, n, -1)
        # Re(R t e^{st}) = Rr t cos - Ri t sin; Re(i R t e^{st}) = -(Rr t sin + Ri t cos).
        turned = np.array([[real, imag], [-imag, real]])
        downhill = np.einsum("ikq,aikq->ak", slope, turned).ravel()
        normal = np.einsum("ikjl,aikq,bjlq->akbl", across, turned, turned, optimize=True).reshape(2 * n, 2 * n)
        size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal / np.outer(size, size) + 1e-9 * np.eye(2 * n)
        step = np.linalg.solve(scaled, downhill / size) / size
        return np.asarray(step[:n] + 1j * step[n:])
