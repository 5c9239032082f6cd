r"""Other voltages that reach the same states: less peak voltage for more energy, and what that shakes up.

The least p-norm under :math:`R v = x_F` is :math:`v = D\,\mathrm{sign}(g)|g|^{1/(p-1)}` with :math:`g =
R^T\lambda`; its dual in the few multipliers is smooth and convex, and is solved by Newton's method. The least
peak is a linear programme. Either is polished by the least energy that takes the last rounding out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.drive import Drive, brake, exact_drive, steering
from modaltouch.stimulus.dynamics import modal_system
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.reachability import GramianSolver, ReachabilityGramian
from modaltouch.stimulus.synthesis import decay
from modaltouch.stimulus.vibration import states_by_channel
from modaltouch.stimulus.voltages import Voltages

FloatArray = NDArray[np.float64]

MAX_HELD_STEPS = 8192
"""Most steps of the linear programme: beyond, it takes minutes and gains nothing."""

_NEWTON_STEPS = 60
_CONVERGED = 1e-11
_FLOOR = 1e-9
"""Smallest |g|, relative to the largest, whose curvature counts: p > 2 has infinite curvature at g = 0."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """Voltages until the focusing instant, and what they cost.

    Attributes
    ----------
    name : str
        How they were found.
    voltage : (n_channels, n_before) array
        At the beam [V].
    residual : float
        Largest deviation of a state at the focusing instant from its target [m/s].
    """

    name: str
    voltage: FloatArray
    residual: float

    @property
    def peak_voltage(self) -> float:
        """Highest voltage of any channel, either sign [V]."""
        return float(np.abs(self.voltage).max())

    def energy(self, hold: float) -> float:
        """Return the integral of the squared voltages [V^2 s].

        Parameters
        ----------
        hold : float
            Length of a sample [s].
        """
        return float((self.voltage**2).sum() * hold)


def alternative_drive(stimulus: Voltages, design: str) -> Drive:
    """Return the voltages of a design, braked as the exact law brakes."""
    if design == "least_energy":
        return _least_energy(stimulus)
    orders = {"norm_4": 4.0, "norm_8": 8.0}
    found = least_peak(stimulus) if design == "least_peak" else least_norm(stimulus, orders[design])
    model, system, timing = stimulus.model, stimulus.system, stimulus.timing
    reach, _, _, braked_from = steering(model, system, timing, *stimulus.aim)
    n_before = reach.taper.n_samples
    voltage = np.zeros((model.n_channels, timing.n_samples))
    voltage[:, :n_before] = found.voltage
    if stimulus.release == "braked":
        state = states_by_channel(system, found.voltage, timing, timing.focusing_instant).sum(axis=0)
        ahead = braked_from * timing.hold + system.delay - timing.focusing_instant
        brake(model, system, timing, voltage, braked_from, state * np.exp(system.exponent * ahead))
    return Drive(voltage, GramianSolver.of(reach.gramian()).condition_number, found.residual, n_before)


def least_norm(stimulus: Voltages, p: float = 4.0) -> Alternative:
    """Return the voltages of least weighted p-norm that meet every modelled mode.

    Parameters
    ----------
    stimulus : Voltages
        The design whose targets, timing and taper are kept.
    p : float
        Order of the norm, from 2 (the exact law) to about 8; higher flattens the peaks [1].

    Raises
    ------
    ValueError
        If the order lies below 2 or above 16.
    """
    if not 2 <= p <= 16:
        raise ValueError(f"the norm's order is {p}; it must lie between 2 and 16: take 2, 4 or 8")
    reach, wished = _problem(stimulus)
    rows = _rows(reach)
    weight = np.ones((1, reach.taper.n_samples))
    reach.taper.apply(weight)
    scale = GramianSolver.of(reach.gramian())
    flat = rows.reshape(rows.shape[0], -1) * scale.scale[:, None]
    every = np.tile(weight[0], rows.shape[1])
    goal = wished * scale.scale
    multiplier = _newton(flat, every, goal, p)
    g = multiplier @ flat
    voltage = (every * np.sign(g) * np.abs(g) ** (1 / (p - 1))).reshape(rows.shape[1:])
    return _polished(stimulus, reach, voltage, wished, f"{p:g}-norm")


def _newton(rows: FloatArray, weight: FloatArray, goal: FloatArray, p: float) -> FloatArray:
    """Return the multipliers that maximise the dual of the least p-norm."""
    q = p / (p - 1)
    multiplier = np.linalg.solve((rows * weight) @ rows.T, goal)
    # From the solution for p = 2, scaled so that the dual is largest along it.
    size = float((weight * np.abs(multiplier @ rows) ** q).sum())
    multiplier = multiplier * (float(goal @ multiplier) / size) ** (p - 1)
    largest = float(np.abs(goal).max())
    for _ in range(_NEWTON_STEPS):
        g = multiplier @ rows
        magnitude = np.abs(g)
        short = goal - rows @ (weight * np.sign(g) * magnitude ** (q - 1))
        if float(np.abs(short).max()) <= _CONVERGED * largest:
            break
        floor = np.maximum(magnitude, _FLOOR * magnitude.max())
        curvature = (rows * (weight * (q - 1) * floor ** (q - 2))) @ rows.T
        step = np.linalg.solve(curvature, short)
        multiplier = multiplier + _step_length(rows, weight, goal, multiplier, step, q) * step
    return np.asarray(multiplier)


def _step_length(
    rows: FloatArray, weight: FloatArray, goal: FloatArray, start: FloatArray, step: FloatArray, q: float
) -> float:
    """Return the length at which the dual has risen enough, halving from one."""
    g, change = start @ rows, step @ rows

    def dual(length: float) -> float:
        return float(goal @ (start + length * step) - (weight * np.abs(g + length * change) ** q).sum() / q)

    length, here = 1.0, dual(0.0)
    while length > 1e-6 and dual(length) < here:
        length /= 2
    return length


def least_peak(stimulus: Voltages, held_steps: int = 1024) -> Alternative:
    """Return the voltages of least peak that meet every modelled mode: a linear programme on held steps.

    They jump between the peak and its negative, and shake whatever the model leaves out.

    Parameters
    ----------
    stimulus : Voltages
        The design whose targets and timing are kept.
    held_steps : int
        Steps of equal length until the focusing instant, at most 8192; each holds several samples.

    Raises
    ------
    ValueError
        If there are too many steps, or fewer than conditions.
    """
    from scipy.optimize import linprog

    reach, wished = _problem(stimulus)
    if not wished.size < held_steps <= MAX_HELD_STEPS:
        raise ValueError(
            f"{held_steps} held steps; a linear programme of {wished.size} conditions takes more than that "
            f"and at most {MAX_HELD_STEPS}: take 1024"
        )
    rows = _rows(reach)
    n_before = rows.shape[2]
    # The first and the last sample stay at zero volts.
    step_of = np.minimum((np.arange(1, n_before - 1) * held_steps) // n_before, held_steps - 1)
    begins = np.flatnonzero(np.diff(step_of, prepend=-1))
    held = np.add.reduceat(rows[:, :, 1:-1], begins, axis=2)
    scale = 1 / np.sqrt((held**2).sum(axis=(1, 2)))
    flat = held.reshape(wished.size, -1) * scale[:, None]
    n = flat.shape[1]
    unit = float(np.abs(_least_energy(stimulus).voltage).max())
    identity = np.concatenate([flat * unit, np.zeros((wished.size, 1))], axis=1)
    bound = _peak_bounds(n)
    solved = linprog(
        np.append(np.zeros(n), 1.0),
        A_ub=bound,
        b_ub=np.zeros(bound.shape[0]),
        A_eq=identity,
        b_eq=wished * scale,
        bounds=[(None, None)] * n + [(0, None)],
        method="highs",
    )
    if solved.x is None:
        raise ValueError(f"the linear programme has no solution: {solved.message}; take more held steps")
    steps = solved.x[:-1].reshape(rows.shape[1], -1) * unit
    voltage = np.zeros(rows.shape[1:])
    lengths = np.diff(np.append(begins, step_of.size))
    voltage[:, 1:-1] = np.repeat(steps, lengths, axis=1)
    return _polished(stimulus, reach, voltage, wished, "least peak")


def _peak_bounds(n: int) -> Any:
    """Return the sparse rows of v <= t and -v <= t."""
    from scipy.sparse import csr_matrix, eye, hstack, vstack

    ones = csr_matrix(np.ones((n, 1)))
    return vstack([hstack([eye(n), -ones]), hstack([-eye(n), -ones])]).tocsr()


def _least_energy(stimulus: Voltages) -> Drive:
    """Return the voltages of the exact law."""
    velocity, displacement = stimulus.aim
    return exact_drive(stimulus.model, stimulus.system, stimulus.timing, velocity, stimulus.release, displacement)


def _problem(stimulus: Voltages) -> tuple[ReachabilityGramian, FloatArray]:
    """Return how the samples before the focus reach the states of the driven modes, and the states wished."""
    reach, _, wished, _ = steering(stimulus.model, stimulus.system, stimulus.timing, *stimulus.aim)
    return reach, wished


def _rows(reach: ReachabilityGramian) -> FloatArray:
    """Return R, unweighted, (n_conditions, n_channels, n_samples) array."""
    ago = np.arange(reach.taper.n_samples - 1, -1, -1)
    powers = decay(reach.exponent, reach.hold, ago)
    rows = (reach.row.reshape(-1, reach.exponent.size) @ powers).real
    return np.asarray(rows.reshape(*reach.row.shape[:2], -1))


def _polished(
    stimulus: Voltages, reach: ReachabilityGramian, voltage: FloatArray, wished: FloatArray, name: str
) -> Alternative:
    """Return the voltages with the least energy added that takes their residual out."""
    timing, system = stimulus.timing, stimulus.system
    read = steering(stimulus.model, system, timing, *stimulus.aim)[1]
    solver = GramianSolver.of(reach.gramian())
    change = np.empty_like(voltage)
    residual = np.inf
    for _ in range(3):
        state = states_by_channel(system, voltage, timing, timing.focusing_instant).sum(axis=0)
        short = wished - (read @ state).real
        now = float(np.abs(short).max())
        if now >= residual:
            break
        residual = now
        reach.write(reach.amplitudes(solver.solve(short)), change)
        voltage = voltage + change
    state = states_by_channel(system, voltage, timing, timing.focusing_instant).sum(axis=0)
    return Alternative(name, voltage, float(np.abs(wished - (read @ state).real).max()))


def trade(stimulus: Voltages, alternatives: list[Alternative], unmodelled: ModalModel) -> list[dict[str, float | str]]:
    """Return what each set of voltages costs, and how fast it leaves a mode that the model lacks.

    Parameters
    ----------
    stimulus : Voltages
        The design; the voltages of least energy make the first row.
    alternatives : list of Alternative
        Others for the same targets.
    unmodelled : ModalModel
        Modes that the design knows nothing of, on the same channels.

    Returns
    -------
    list of dict
        ``name``, ``peak_voltage`` [V], ``energy`` [V^2 s], ``residual`` [m/s] and ``unmodelled_speed``, the
        largest of |velocity| and |w eta| of those modes at the focusing instant [m/s].
    """
    timing = stimulus.timing
    exact = _least_energy(stimulus)
    own = Alternative("exact", exact.voltage[:, : exact.n_before], exact.residual)
    system = modal_system(unmodelled, stimulus.amplifier)
    rows: list[dict[str, float | str]] = []
    for one in (own, *alternatives):
        state = states_by_channel(system, one.voltage, timing, timing.focusing_instant).sum(axis=0)
        speeds = np.abs(np.concatenate([(system.velocity @ state).real, (system.displacement @ state).real]))
        rows.append(
            {
                "name": one.name,
                "peak_voltage": one.peak_voltage,
                "energy": one.energy(timing.hold),
                "residual": one.residual,
                "unmodelled_speed": float(speeds.max()),
            }
        )
    return rows
