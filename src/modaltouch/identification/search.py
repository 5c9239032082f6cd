"""Refines the poles jointly, and adds more while something is left that noise does not explain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modaltouch.identification.kernel import Bins, Evaluation, Problem, evaluate
from modaltouch.identification.peaks import DAMPING_BOUNDS, MOST_POLES, SIGNIFICANT, Poles
from modaltouch.identification.responses import FrequencyResponses

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def make_problem(responses: FrequencyResponses, poles: Poles, phase_at: float | None = None) -> Problem:
    """Return the least-squares problem of responses, binned for poles that are roughly known."""
    bins = Bins.near(responses.frequency, poles.natural_frequency, poles.damping_ratio)
    noise = responses.noise
    # One profile over frequency for all sets, so that all share their columns; a set's level scales its responses.
    level = np.median(noise, axis=1)
    profile = bins.mean(np.median(noise / level[:, None], axis=0))
    weight = np.sqrt(bins.size / profile.real) * np.sqrt(2.0)
    scaled = responses.response / np.sqrt(level)[:, None, None]
    flat = scaled.reshape(-1, scaled.shape[-1])
    grouped = bins.mean(flat) * weight
    return Problem(bins, np.asarray(grouped.T), weight, responses.bandwidth, phase_at)


def refine(problem: Problem, poles: Poles, *, tolerance: float = 1e-5, most: int = 60) -> tuple[Poles, Evaluation]:
    """Return the poles and the delay of least squares, and the fit there.

    Parameters
    ----------
    problem : Problem
        The responses.
    poles : Poles
        Where to begin.
    tolerance : float
        Ends when the expected gain of a step is below this part of a degree of freedom [1].
    most : int
        Longest search [iterations].
    """
    from scipy.optimize import minimize

    scale = 1 / float(problem.omega[-1])
    n = poles.natural_frequency.size
    start = poles
    known: dict[bytes, Evaluation] = {}

    def at(step: FloatArray) -> Evaluation:
        key = step.tobytes()
        if key not in known:
            if len(known) > 3:
                known.pop(next(iter(known)))
            frequency = start.natural_frequency * np.exp(np.clip(step[:n] * start.damping_ratio, -0.5, 0.5))
            damping = np.clip(start.damping_ratio * np.exp(np.clip(step[n : 2 * n], -3, 3)), *DAMPING_BOUNDS)
            known[key] = evaluate(problem, frequency, damping, start.delay + scale * float(step[-1]), scale)
        return known[key]

    def slope(step: FloatArray) -> FloatArray:
        return at(step).gradient * _unit(at(step), start)

    def curvature(step: FloatArray) -> FloatArray:
        unit = _unit(at(step), start)
        return at(step).curvature * np.outer(unit, unit)

    def stop(intermediate_result: object) -> None:
        step = intermediate_result.x  # type: ignore[attr-defined]
        gradient = slope(step)
        gain = gradient @ np.linalg.lstsq(curvature(step), gradient, rcond=1e-12)[0]
        if gain < tolerance:
            raise StopIteration

    found = minimize(
        lambda step: at(step).cost,
        np.zeros(2 * n + 1),
        jac=slope,
        hess=curvature,
        method="trust-exact",
        callback=stop,
        options={"initial_trust_radius": 1.0, "max_trust_radius": 20.0, "gtol": 1e-6, "maxiter": most},
    )
    best = at(found.x)
    ordered = np.argsort(best.natural_frequency)
    refined = Poles(best.natural_frequency[ordered], best.damping_ratio[ordered], best.delay)
    return refined, evaluate(problem, refined.natural_frequency, refined.damping_ratio, refined.delay, scale)


def _unit(evaluation: Evaluation, start: Poles) -> FloatArray:
    """Return what a step of the search is in the parameters of the kernel, whose unit moves with the damping."""
    n = evaluation.n_modes
    return np.concatenate([start.damping_ratio / evaluation.damping_ratio, np.ones(n), [1.0]])


def find_more(
    responses: FrequencyResponses, poles: Poles, problem: Problem, fit: Evaluation, most: int
) -> tuple[Poles, Problem, Evaluation]:
    """Return the poles with further ones where the fit leaves a peak that noise does not explain."""
    for _ in range(most):
        peak = _left_over(problem, fit)
        if peak is None or poles.natural_frequency.size >= MOST_POLES:
            break
        tried = poles.and_one(*peak)
        finer = make_problem(responses, tried)
        _, before = refine(finer, poles, most=3)
        refined, after = refine(finer, tried)
        new = np.ptp(refined.natural_frequency) > 0 and _sound(refined)
        if not new or after.cost > before.cost - 0.5 * SIGNIFICANT * problem.response.shape[1] ** 0.5:
            break
        poles, problem, fit = refined, finer, after
    return poles, problem, fit


def _sound(poles: Poles) -> bool:
    """Return whether every pole is a mode, apart from its neighbours."""
    apart = np.diff(poles.natural_frequency) > 0.05 * (poles.damping_ratio * poles.natural_frequency)[:-1]
    low, high = DAMPING_BOUNDS
    return bool(apart.all() and (poles.damping_ratio > 2 * low).all() and (poles.damping_ratio < 0.9 * high).all())


def _left_over(problem: Problem, fit: Evaluation) -> tuple[float, float] | None:
    """Return frequency and rough damping of the highest peak of what a fit leaves, or None."""
    n = problem.bins.start.size
    left = (fit.rest[:n] + 1j * fit.rest[n:]).T
    frequency = problem.bins.centre
    best, where = SIGNIFICANT**2, None
    for ratio in (0.004, 0.012, 0.03):
        # Each response against the course of a mode there: what it would explain, summed over the responses.
        candidate = frequency[:: max(1, n // 1500)]
        course = _course(problem, candidate, ratio, fit.delay)
        overlap = (np.conj(course) @ left.T).real / np.linalg.norm(course, axis=1)[:, None]
        n_responses = left.shape[0]
        height = ((overlap**2).sum(axis=1) - n_responses) / np.sqrt(2 * n_responses)
        index = int(height.argmax())
        if height[index] ** 2 > best and height[index] > 0:
            best, where = float(height[index] ** 2), (float(candidate[index]), ratio)
    return where


def _course(problem: Problem, natural_frequency: FloatArray, ratio: float, delay: float) -> ComplexArray:
    """Return the responses of modes at the centres of the bins, (n_modes, n_groups) array."""
    omega = 2 * np.pi * problem.bins.centre
    own = 2 * np.pi * natural_frequency[:, None]
    turn = np.exp(-1j * omega * delay)
    if problem.bandwidth is not None:
        turn = turn / (1 + 1j * problem.bins.centre / problem.bandwidth)
    course = 1j * omega * turn / (own**2 - omega**2 + 2j * ratio * own * omega)
    return np.asarray(course * problem.weight)
