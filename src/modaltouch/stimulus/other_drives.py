r"""Drives other than the least-energy exact law: of lower peak voltage, the level first, the paper's, highest contrast.

The least p-norm subject to :math:`R v = x_F` is :math:`v = D\,\mathrm{sign}(g)|g|^{1/(p-1)}` with :math:`g =
R^T\lambda`; the dual problem in the few multipliers is smooth and convex and is solved by Newton's method. The least
peak is a linear programme. In both cases a least-energy correction removes the remaining residual.
"""

from __future__ import annotations

import numpy as np

from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.drive import Drive, Steering, check_drivable, exact_drive, polished
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantities import FloatArray
from modaltouch.stimulus.reachability import ReachabilityGramian
from modaltouch.stimulus.synthesis import decay, synthesise
from modaltouch.stimulus.vibration import history

_HELD_STEPS = 1024
"""Largest number of steps of the linear programme; more would take minutes without any gain."""

_CONVERGED = 1e-12
_FLOOR = 1e-9
"""Lower bound of |g|, relative to the largest, in the curvature, which for p > 2 is infinite at g = 0 [1]."""


def least_norm(steering: Steering, p: float) -> Drive:
    """Return the voltages of least weighted p-norm, p from 2 (the exact law) to about 8; higher p, lower peaks."""
    reach = steering.reach
    rows = _rows(reach)
    weight = np.ones((1, reach.taper.n_samples))
    reach.taper.apply(weight)
    scale = steering.solver.scale
    flat = rows.reshape(rows.shape[0], -1) * scale[:, None]
    every = np.tile(weight[0], rows.shape[1])
    g = _multiplier(flat, every, steering.goal * scale, p) @ flat
    voltage = (every * np.sign(g) * np.abs(g) ** (1 / (p - 1))).reshape(rows.shape[1:])
    return polished(steering, voltage)


def _multiplier(rows: FloatArray, weight: FloatArray, goal: FloatArray, p: float) -> FloatArray:
    """Return the multipliers that maximise the dual of the least p-norm."""
    from scipy.optimize import minimize

    q = p / (p - 1)
    start = np.linalg.solve((rows * weight) @ rows.T, goal)
    # Start from the solution for p = 2, scaled to maximise the dual along its direction.
    start = start * (float(goal @ start) / float((weight * np.abs(start @ rows) ** q).sum())) ** (p - 1)
    unit, total = float(np.abs(start).max()), float(goal @ start)

    def cost(point: FloatArray) -> tuple[float, FloatArray]:
        g = unit * point @ rows
        voltage = weight * np.sign(g) * np.abs(g) ** (q - 1)
        return float(voltage @ g / q - unit * goal @ point) / total, (rows @ voltage - goal) * (unit / total)

    def curvature(point: FloatArray) -> FloatArray:
        size = np.abs(unit * point @ rows)
        bent = weight * (q - 1) * np.maximum(size, _FLOOR * size.max()) ** (q - 2)
        return np.asarray((rows * bent) @ rows.T * (unit**2 / total))

    found = minimize(cost, start / unit, method="Newton-CG", jac=True, hess=curvature, tol=_CONVERGED)
    return np.asarray(unit * found.x)


def least_peak(steering: Steering) -> Drive:
    """Return the voltages of least peak that meet every condition, by a linear programme over multi-sample steps.

    They switch between the positive and negative peak, which excites unmodelled modes.
    """
    from scipy.optimize import linprog
    from scipy.sparse import bmat, csr_matrix, eye

    goal = steering.goal
    rows = _rows(steering.reach)
    n_before = rows.shape[2]
    # The first and the last sample stay at zero volts.
    step_of = np.minimum((np.arange(1, n_before - 1) * _HELD_STEPS) // n_before, _HELD_STEPS - 1)
    begins = np.flatnonzero(np.diff(step_of, prepend=-1))
    held = np.add.reduceat(rows[:, :, 1:-1], begins, axis=2)
    scale = 1 / np.sqrt((held**2).sum(axis=(1, 2)))
    flat = held.reshape(goal.size, -1) * scale[:, None]
    n = flat.shape[1]
    unit = float(np.abs(exact_drive(steering).voltage).max())
    # The unknowns are the steps v and their peak t, with v - t <= 0 and -v - t <= 0.
    ones = csr_matrix(np.ones((n, 1)))
    solved = linprog(
        np.append(np.zeros(n), 1.0),
        A_ub=bmat([[eye(n), -ones], [-eye(n), -ones]], format="csr"),
        b_ub=np.zeros(2 * n),
        A_eq=np.concatenate([flat * unit, np.zeros((goal.size, 1))], axis=1),
        b_eq=goal * scale,
        bounds=[(None, None)] * n + [(0, None)],
        method="highs",
    )
    if solved.x is None:
        raise ValueError(f"the linear programme has no solution: {solved.message}; take more held steps")
    voltage = np.zeros(rows.shape[1:])
    steps = solved.x[:-1].reshape(rows.shape[1], -1) * unit
    voltage[:, 1:-1] = np.repeat(steps, np.diff(np.append(begins, step_of.size)), axis=1)
    return polished(steering, voltage)


def _rows(reach: ReachabilityGramian) -> FloatArray:
    """Return the unweighted reachability matrix R, (n_conditions, n_channels, n_samples) array."""
    ago = np.arange(reach.taper.n_samples - 1, -1, -1)
    powers = decay(reach.exponent, reach.hold, ago)
    rows = (reach.row.reshape(-1, reach.exponent.size) @ powers).real
    return np.asarray(rows.reshape(*reach.row.shape[:2], -1))


_HALVINGS = 14
"""Bisections of log10(mu) over sixteen decades, which determine mu to 0.2 %."""

_BRACKET = -10.0, 6.0
"""Bracket of log10 of mu relative to the mean of the Gramian's diagonal."""


def level_first_drive(steering: Steering, shape: FloatArray, limit: float) -> Drive:
    r"""Return voltages that meet the level at the focus exactly, within the voltage limit if possible.

    They minimise :math:`v^T D^{-1} v + \mu^{-1} |x(t_F) - x_F|^2` over all modal states, subject to the level: with the
    level as an additional row of the reachability matrix, :math:`(W + \mu\,\mathrm{diag}(0, 1, \ldots)) y = b`. A
    larger :math:`\mu` lowers the voltage and increases the error of the field; :math:`\mu` is bisected until the peak
    voltage meets the limit.

    Parameters
    ----------
    steering : Steering
        Conditions of the whole field.
    shape : (n_modes,) array
        Mode shapes at the focus [1].
    limit : float
        Highest voltage at the beam [V].
    """
    whole = exact_drive(steering)
    if np.abs(whole.before_focus).max() <= limit:
        return whole
    n = steering.driven.size
    level = np.concatenate([shape[steering.driven], np.zeros(n)])
    rows = np.concatenate([level[None], np.eye(2 * n)])
    gram, goal = rows @ steering.reach.gramian() @ rows.T, rows @ steering.goal
    ridge = np.diag(np.append(0.0, np.ones(2 * n))) * np.trace(gram[1:, 1:]) / (2 * n)
    voltage = np.zeros_like(whole.voltage)
    before = voltage[:, : whole.n_before]

    def write(power: float) -> float:
        """Write the voltages for a mu, scaled to the level, and return their peak."""
        multiplier = np.linalg.lstsq(gram + 10.0**power * ridge, goal, rcond=None)[0]
        steering.reach.write(rows.T @ multiplier, before)
        short, _ = steering.short(before)
        before[:] *= goal[0] / (goal[0] - level @ short)
        return float(np.abs(before).max())

    low, high = _BRACKET
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if write(middle) > limit else (low, middle)
    write(high)
    short, state = steering.short(before)
    steering.end(voltage, state)
    return Drive(voltage, whole.condition_number, float(np.abs(short).max()), whole.n_before)


def paper_drive(steering: Steering) -> Drive:
    r"""Return the voltages of the paper, :math:`v = \sum_k 4 a_k \dot\eta_k(t) / G_k` until the focusing instant.

    Here :math:`\dot\eta_k = \dot\eta_k(t_F) e^{a_k (t - t_F)} \cos b_k (t - t_F)`; each mode is driven on its
    strongest channel, and sampled at the middle of each hold. Sample 0 is 0 V, the level at which the generator idles.
    The amplifier is not taken into account; modes with a target velocity of 0 are not driven, target displacements are
    ignored.

    References
    ----------
    Section II-C, equations (6) and (7), errata in the docstring of `drive`.
    """
    model, system, timing, target = steering.model, steering.system, steering.timing, steering.velocity
    check_drivable(model, target, timing)
    asked = np.flatnonzero(target)
    # As in the paper, each mode is driven by the channel with the largest gain.
    channel = np.abs(model.modal_gain).argmax(axis=1)[asked]
    exponent = model.exponent[asked]
    n_before = min(int(timing.focusing_instant * timing.sampling_rate + 0.5), timing.n_samples - 1)
    to_focus = timing.focusing_instant - (n_before - 0.5) * timing.hold
    amplitude = np.zeros((model.n_channels, asked.size), dtype=complex)
    force = -4 * exponent.real * target[asked] * np.exp(exponent * to_focus)
    amplitude[channel, np.arange(asked.size)] = force / model.modal_gain[asked, channel]
    voltage = np.zeros((model.n_channels, timing.n_samples))
    synthesise(amplitude, exponent, timing.hold, voltage[:, :n_before])
    voltage[:, 0] = 0.0
    instant, arrival = timing.focusing_instant, n_before * timing.hold + system.delay
    state = system.state_at(voltage, timing, instant)
    if steering.release == "braked":
        late = abs(arrival - instant) > 1e-9 * timing.hold
        steering.brake(voltage, n_before, system.state_at(voltage, timing, arrival) if late else state)
    reached, displacement = system.read(state)
    return Drive(voltage, 1.0, float(np.abs([reached - target, displacement]).max()), n_before)


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
    r"""Return the drive that takes the focus to its level with the least peak speed at other points.

    The highest speed s of the other points over the whole burst is minimised by a linear programme in the drive,
    :math:`\min s` subject to :math:`v_{focus}(t_F) = level`, :math:`|v_{zone}(t)| \le s` and
    :math:`|u(t)| \le limit`. The drives are drawn from one family: oscillations at the frequency of each mode, windowed
    by raised cosines that lengthen away from the focusing instant. The programme is solved by a barrier and Newton's
    method (Boyd and Vandenberghe 2004, sec. 11.3); its duality gap bounds the contrast of every drive of the family.

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
    weight, least = least_bound(rows @ first, rows @ rest, slack)
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


def least_bound(offset: FloatArray, rows: FloatArray, slack: FloatArray) -> tuple[FloatArray, float]:
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
