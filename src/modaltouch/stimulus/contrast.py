r"""The drive with the highest contrast between the focus and another zone, and an upper bound of that contrast.

The highest speed s of the other zone over the whole burst is minimised while the focus reaches its level at the
focusing instant: a linear programme in the drive, :math:`\min s` subject to :math:`v_{focus}(t_F) = level`,
:math:`|v_{zone}(t)| \le s` and :math:`|u(t)| \le limit`. The drives are drawn from one family: oscillations at the
frequency of each mode, windowed by raised cosines that lengthen away from the focusing instant. The programme is solved
by a barrier and Newton's method (Boyd and Vandenberghe 2004, sec. 11.3); its duality gap bounds the contrast of every
drive of the family.
"""

from __future__ import annotations

import numpy as np

from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantities import FloatArray
from modaltouch.stimulus.vibration import history

HOLD = 2e-6
"""Approximate length of a sample [s]: six per cycle of the highest mode of the paper's Table I."""

_NEAR, _SPARSE = 1.5e-3, 10
"""Time around the focusing instant within which every sample is bounded [s], and the stride elsewhere [samples]."""

_GROWTH, _FORGOTTEN = 3.0, 6.0
"""Ratio of successive lags of the raised cosines; time constants after which a mode has decayed [1]."""

_GAP = 0.15
"""Duality gap at convergence, relative to the highest speed of the zone [1]."""

_KEPT = 0.95
"""Fraction of the amplifier's limit allowed at the bounded samples; those in between may exceed it slightly [1]."""

_NEWTON_STEPS = 30


def contrast_drive(
    model: ModalModel, amplifier: Amplifier, timing: Timing, places: FloatArray, level: float
) -> tuple[FloatArray, float]:
    """Return the drive that takes the focus to its level with the least peak speed at other points.

    Parameters
    ----------
    model, amplifier, timing
        The beam, its amplifier, and the clock, with samples about `HOLD` long.
    places : (n_places,) array
        Positions of the focus, then of the other points, origin at mid-beam [m].
    level : float
        Velocity of the focus [m/s].

    Returns
    -------
    voltage : (n_channels, n_samples) array
        Voltages at the beam [V].
    bound : float
        Upper bound, over all drives of the family, of the level over the highest speed of the other points [1].
    """
    focused = timing.focusing_instant - amplifier.delay
    time = np.asarray((np.arange(timing.n_samples) + 0.5) * timing.hold - focused, dtype=float)
    waves = _family(model, time)
    bounded = np.flatnonzero((np.abs(time) < _NEAR) | (np.arange(time.size) % _SPARSE == 0))
    speeds = _speeds(DiagonalSystem.of(model, amplifier), model.shapes(places), timing, waves)
    # Voltages are scaled by the limit, speeds by the level: the least-energy solution and the directions normal to it.
    limit = _KEPT * amplifier.limit
    speeds *= limit / level
    focus = speeds[0, :, int((time < 0).sum())]
    first, rest = focus / (focus @ focus), np.linalg.qr(focus[:, None], mode="complete")[0][:, 1:]
    speed = speeds[1:, :, bounded].transpose(0, 2, 1).reshape(-1, focus.size)
    volts = np.kron(np.eye(model.n_channels), waves[:, bounded].T)
    rows, slack = np.concatenate([speed, volts]), np.repeat([1.0, 0.0], [len(speed), len(volts)])
    weight, least = least_peak(rows @ first, rows @ rest, slack)
    return (first + rest @ weight).reshape(model.n_channels, -1) * limit @ waves, 1 / least


def _family(model: ModalModel, time: FloatArray) -> FloatArray:
    """Return orthogonal waves, (n_waves, n_samples) array, at times from the focusing instant [s]."""
    rows: list[FloatArray] = []
    for s in model.exponent:
        last = min(-_FORGOTTEN / s.real, float(np.abs(time).max()))
        nearest = max(60e-6, np.pi / s.imag)
        lags = [*nearest * _GROWTH ** np.arange(max(1, np.ceil(np.log(last / nearest) / np.log(_GROWTH)))), last]
        knots = np.array([*(-lag for lag in reversed(lags)), 0.0, *lags])
        for left, middle, right in zip(knots, knots[1:], knots[2:], strict=False):
            rise = np.clip(np.minimum((time - left) / (middle - left), (right - time) / (right - middle)), 0, 1)
            swing = np.sin(np.pi / 2 * rise) ** 2 * np.exp(1j * s.imag * time)
            rows += [swing.real, swing.imag]
    waves = np.array(rows)
    size, direction = np.linalg.eigh(waves @ waves.T / time.size)
    kept = size > 1e-8 * size[-1]
    return np.asarray((direction[:, kept] / np.sqrt(size[kept])).T @ waves)


def _speeds(system: DiagonalSystem, shapes: FloatArray, timing: Timing, waves: FloatArray) -> FloatArray:
    """Return velocities of points per volt of each wave on each channel, (n_points, n_channels n_waves, n_samples)."""
    n, n_channels = waves.shape[1], system.input_gain.shape[1]
    spectrum = np.fft.rfft(waves, 2 * n)
    speeds = np.empty((shapes.shape[1], n_channels, len(waves), n))
    for channel in range(n_channels):
        pulse = np.zeros((n_channels, n))
        pulse[channel, 0] = 1.0
        response = history(system, shapes.T @ system.velocity, pulse, timing)
        for speed, answer in zip(speeds[:, channel], np.fft.rfft(response, 2 * n), strict=True):
            speed[:] = np.fft.irfft(answer * spectrum, 2 * n)[:, :n]
    return speeds.reshape(len(speeds), -1, n)


def least_peak(offset: FloatArray, rows: FloatArray, slack: FloatArray) -> tuple[FloatArray, float]:
    """Minimise s subject to |offset + rows @ weights| <= s where `slack` is 1, else <= 1; return weights and bound."""
    n, n_sides = rows.shape[1], 2 * len(rows)
    point = np.append(np.zeros(n), 1.2 * np.abs(offset[slack > 0]).max())
    sharpness = n_sides / point[n] / 2
    while True:
        for _ in range(_NEWTON_STEPS):
            value, most = offset + rows @ point[:n], 1 - slack + slack * point[n]
            above, below = 1 / (most - value), 1 / (most + value)
            gradient = np.append(rows.T @ (above - below), sharpness - slack @ (above + below))
            curvature, cross = above**2 + below**2, -(slack * (above**2 - below**2)) @ rows
            hessian = np.block([[(rows * curvature[:, None]).T @ rows, cross[:, None]], [cross, slack @ curvature]])
            scale = 1 / np.sqrt(np.diag(hessian))
            step = -scale * np.linalg.solve(hessian * scale[:, None] * scale + 1e-13 * np.eye(n + 1), scale * gradient)
            move, room = rows @ step[:n], slack * step[n]
            towards = np.concatenate([(move - room) * above, (-move - room) * below])
            length, gain = min(1.0, 0.95 / max(float(towards.max()), 0.95)), -float(gradient @ step)
            # Backtracking line search.
            while sharpness * length * step[n] - np.log1p(-length * towards).sum() > -0.1 * length * gain:
                length /= 2
            point = point + length * step
            if gain < 1:
                break
        if n_sides / sharpness < _GAP * point[n]:
            return point[:n], float(point[n] - n_sides / sharpness)
        sharpness *= 20
