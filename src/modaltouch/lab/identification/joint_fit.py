"""Joint fit of all responses: search for poles and delay, and intervals over repeated measurements."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.common import ComplexArray, FloatArray, low_pass
from modaltouch.lab.identification.kernel import Bins, Evaluation, LeastSquaresProblem, Poles, evaluate
from modaltouch.lab.identification.modal_parameters import (
    Estimate,
    Identification,
    IdentifiedMode,
    ModalParameters,
)
from modaltouch.lab.identification.peaks import (
    DAMPING_BOUNDS,
    MOST_POLES,
    SIGNIFICANT,
    first_poles,
)
from modaltouch.lab.identification.responses import FrequencyResponses


def make_problem(
    responses: FrequencyResponses, poles: Poles, phase_at: float | None = None, noise: FloatArray | None = None
) -> LeastSquaresProblem:
    """Return the least-squares problem for the responses, with bins grouped according to approximate poles.

    Without `noise` [response squared], (n_sets, n_bins), it is that of the responses.
    """
    bins = Bins.near(responses.frequency, poles.natural_frequency, poles.damping_ratio)
    noise = responses.noise if noise is None else noise
    # All sets share a noise profile over frequency and hence the columns; a set's noise level scales its responses.
    level = np.median(noise, axis=1)
    profile = bins.mean(np.median(noise / level[:, None], axis=0))
    weight = np.sqrt(bins.size / profile.real) * np.sqrt(2.0)
    scaled = responses.response / np.sqrt(level)[:, None, None]
    flat = scaled.reshape(-1, scaled.shape[-1])
    grouped = bins.mean(flat) * weight
    return LeastSquaresProblem(bins, np.asarray(grouped.T), weight, responses.bandwidth, phase_at)


def refine(problem: LeastSquaresProblem, poles: Poles, *, most: int = 60) -> Evaluation:
    """Return the fit at the least-squares poles and delay."""
    from scipy.optimize import minimize

    n = poles.natural_frequency.size

    @lru_cache(maxsize=4)
    def evaluated(key: bytes) -> Evaluation:
        step = np.frombuffer(key)
        frequency = poles.natural_frequency * np.exp(np.clip(step[:n] * poles.damping_ratio, -0.5, 0.5))
        damping = np.clip(poles.damping_ratio * np.exp(np.clip(step[n : 2 * n], -3, 3)), *DAMPING_BOUNDS)
        return evaluate(problem, Poles(frequency, damping, poles.delay + float(step[-1]) / problem.highest))

    def at(step: FloatArray) -> Evaluation:
        return evaluated(step.tobytes())

    def slope(step: FloatArray) -> FloatArray:
        return at(step).gradient * _unit(at(step), poles)

    def curvature(step: FloatArray) -> FloatArray:
        unit = _unit(at(step), poles)
        return at(step).curvature * np.outer(unit, unit)

    def stop(intermediate_result: object) -> None:
        step = intermediate_result.x  # type: ignore[attr-defined]
        gradient = slope(step)
        gain = gradient @ np.linalg.lstsq(curvature(step), gradient, rcond=1e-12)[0]
        if gain < 1e-5:  # of a cost in units of the noise
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
    return evaluate(problem, at(found.x).poles.sorted())


def _unit(evaluation: Evaluation, start: Poles) -> FloatArray:
    """Return the units of the search relative to those of the kernel's parameters, which change with the damping."""
    n = evaluation.n_modes
    return np.concatenate([start.damping_ratio / evaluation.poles.damping_ratio, np.ones(n), [1.0]])


def find_more(responses: FrequencyResponses, fit: Evaluation, most: int) -> Evaluation:
    """Add poles wherever the residual has a peak that noise does not explain, and return the fit with them."""
    fit = _keep_sound_poles(responses, fit, SURE / 2)
    passed: list[tuple[float, float]] = []
    # Add the modes beyond the band first, otherwise a pole within the band would fit their flanks.
    low, high = float(responses.frequency[0]), float(responses.frequency[-1])
    ends = [(high * FAR_BEYOND, 0.01), (low / FAR_BEYOND, 0.01)]
    for attempt in range(most):
        peak = ends.pop() if ends else _left_over(fit, passed)
        if peak is None or fit.n_modes >= MOST_POLES or len(passed) == 3:
            break
        frequency, ratio = np.append(fit.poles.natural_frequency, peak[0]), np.append(fit.poles.damping_ratio, peak[1])
        tried = Poles(frequency, ratio, fit.poles.delay).sorted()
        finer = make_problem(responses, tried)
        before = refine(finer, fit.poles, most=3)
        after = _keep_sound_poles(responses, refine(finer, tried), SURE / 2)
        grown = after.n_modes > fit.n_modes
        new = grown or after.poles.near(*peak) > fit.poles.near(*peak) or not low <= peak[0] <= high
        if new and after.cost < before.cost - 0.5 * SIGNIFICANT * fit.rest.shape[1] ** 0.5:
            fit = after
        elif attempt > 1:
            passed.append(peak)
    # Not earlier, since the residual of a missing mode inflates the deviations of the others.
    return _keep_sound_poles(responses, fit, SURE)


def _sound(fit: Evaluation, frequency: FloatArray, sure: float) -> NDArray[np.bool_]:
    """Return a mask of modes: poles whose damping differs significantly from zero, each once, unlike chance peaks."""
    (low, high), own, ratio = DAMPING_BOUNDS, fit.poles.natural_frequency, fit.poles.damping_ratio
    possible = (ratio > 2 * low) & (ratio < 0.9 * high)
    # A pole beyond either end of the band represents the modes there; only its flank is visible.
    beyond = (own < frequency[0]) | (own > frequency[-1])
    apart = np.append(True, np.diff(own) > 0.05 * (ratio * own)[:-1])
    return np.asarray(apart & (beyond | (possible & (fit.deviation[fit.n_modes : -1] < 1 / sure))))


def _keep_sound_poles(responses: FrequencyResponses, fit: Evaluation, sure: float) -> Evaluation:
    """Refit with the poles that are modes; keep all if none in the band is, since their intervals then show that."""
    kept, own = _sound(fit, responses.frequency, sure), fit.poles.natural_frequency
    inside = (own >= responses.frequency[0]) & (own <= responses.frequency[-1])
    if kept.all() or not (kept & inside).any():
        return fit
    fewer = Poles(fit.poles.natural_frequency[kept], fit.poles.damping_ratio[kept], fit.poles.delay)
    return _keep_sound_poles(responses, refine(make_problem(responses, fewer), fewer), sure)


def _left_over(fit: Evaluation, passed: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """Return frequency and approximate damping ratio of the highest peak of the residual not yet passed, or None."""
    left, frequency = fit.left.T, fit.problem.bins.centre
    best, where = SIGNIFICANT**2, None
    for ratio in (0.004, 0.012, 0.03):
        # Power explained by a mode at each candidate, summed over the responses.
        beyond = frequency[-1] * np.array([1.02, 1.06, 1.15, 1.3])
        candidate = np.append(frequency[:: max(1, frequency.size // 1500)], beyond)
        candidate = candidate[[all(abs(own / f - 1) > max(2 * wide, NEAR) for f, wide in passed) for own in candidate]]
        course = _course(fit.problem, candidate, ratio, fit.poles.delay)
        overlap = (np.conj(course) @ left.T).real / np.linalg.norm(course, axis=1)[:, None]
        n_responses = left.shape[0]
        height = ((overlap**2).sum(axis=1) - n_responses) / np.sqrt(2 * n_responses)
        index = int(height.argmax())
        if height[index] ** 2 > best and height[index] > 0:
            best, where = float(height[index] ** 2), (float(candidate[index]), ratio)
    return where


def _course(problem: LeastSquaresProblem, natural_frequency: FloatArray, ratio: float, delay: float) -> ComplexArray:
    """Return the responses of modes at the centres of the groups of bins, (n_modes, n_groups) array."""
    omega = 2 * np.pi * problem.bins.centre
    own = 2 * np.pi * natural_frequency[:, None]
    turn = np.exp(-1j * omega * delay) * low_pass(problem.bins.centre, problem.bandwidth)
    course = 1j * omega * turn / (own**2 - omega**2 + 2j * ratio * own * omega)
    return np.asarray(course * problem.weight)


WINDOW, FEWEST_IN_WINDOW = 10.0, 20
"""Half-width of the window around a peak in units of damping ratio times frequency, and its minimum number of bins."""

BACKGROUND = 1e-3
"""Half-width of a 95 % interval of a pole fitted in a window, relative to its distance from the imaginary axis [1]."""

SURE = 6.0
"""Minimum ratio of a pole's damping ratio to its standard deviation for the pole to count as a mode [1]."""

FAR_OFF = 100.0
"""Misfit above which the search restarts from the peaks above a frequency-independent noise [1]."""

FAR_BEYOND = 3.0
"""Initial frequency of a pole for all modes above the band, relative to its upper end; the lower end divided by it is
used below the band [1]."""

NEAR = 0.01
"""Relative distance from a rejected peak within which no further pole is tried [1]."""

MOST_ADDED = 20
"""Maximum number of poles added to those of the first peaks."""


def identify(
    responses: FrequencyResponses,
    length: float | None = None,
    *,
    start: Poles | None = None,
    most: int = MOST_ADDED,
    clock_tolerance: float = 0.0,
    phase_at: float | None = None,
) -> Identification:
    """Identify the modes by a joint fit of all responses.

    Parameters
    ----------
    responses : FrequencyResponses
        Velocity responses; conjugated ones or another quantity are refused (see `first_poles`).
    length : float, optional
        Length of the beam [m], for shapes and labels.
    start : Poles, optional
        Initial poles; at the peaks of the responses if not given.
    most : int
        Maximum number of poles added where the residual has peaks that noise does not explain.
    clock_tolerance : float
        Relative error of the scope's clock, as the half-width of a 95 % interval [1].
    phase_at : float, optional
        Frequency that turns the delay into a phase equal at all frequencies [Hz], for a narrow band.

    Raises
    ------
    ValueError
        If no resonance stands out, or the responses cannot be those of a velocity.
    """
    if start is None:
        responses = responses.aligned()

    def fitted(poles: Poles) -> Evaluation:
        fit = refine(make_problem(responses, poles, phase_at), poles)
        return find_more(responses, fit, most) if most else fit

    fit = fitted(first_poles(responses, length) if start is None else start)
    if start is None and responses.coherence is not None and fit.variance > FAR_OFF:
        # Leakage counts as noise and peaks with the responses, so the peaks relative to it vanish or shift.
        again = fitted(first_poles(replace(responses, coherence=None), length))
        fit = min(fit, again, key=lambda each: each.variance)
    return ModalParameters(responses, length, fit, clock_tolerance).identification()


def identify_each(responses: FrequencyResponses) -> Identification:
    """Identify the modes separately, each in a window around its peak.

    For files that do not state the positions of their responses and may contain other motions of the structure: modes
    cannot be distinguished by shape and have no common delay. Each window has a phase of its own.

    Parameters
    ----------
    responses : FrequencyResponses
        Velocity responses.

    Raises
    ------
    ValueError
        If no resonance stands out or can be fitted, or the responses cannot be those of a velocity.
    """
    responses = responses.aligned()
    poles = first_poles(responses, None)
    middle = (poles.natural_frequency[1:] + poles.natural_frequency[:-1]) / 2
    left = np.append(responses.frequency[0], middle)
    right = np.append(middle, responses.frequency[-1])
    modes, misfit = [], []
    fitted = np.full(responses.response.shape, np.nan, dtype=complex)
    for own, ratio, low, high in zip(poles.natural_frequency, poles.damping_ratio, left, right, strict=True):
        reach = max(WINDOW * ratio * own, 0.6 * FEWEST_IN_WINDOW * responses.spacing)
        inside = (max(low, own - reach), min(high, own + reach))
        if inside[1] - inside[0] < FEWEST_IN_WINDOW * responses.spacing:
            continue
        window = responses.between(*inside)
        at_peak = int(np.abs(window.frequency - own).argmin())
        phase = float(np.angle((window.response[..., at_peak] ** 2).sum())) / 2
        start = Poles(np.array([own]), np.array([ratio]), -phase / (2 * np.pi * float(own)))
        found = identify(window, start=start, most=0, phase_at=float(own))
        mode = found.modes[0]
        # A pole that leaves its window, or whose damping ratio may be zero, is not a resonance.
        if not low <= mode.natural_frequency.value <= high or mode.damping_ratio.low <= 0:
            continue
        # The linear background only approximates the modes outside the window.
        own = mode.natural_frequency.widened(BACKGROUND * mode.damping_ratio.value)
        ratio = mode.damping_ratio.widened(BACKGROUND)
        modes.append(replace(mode, natural_frequency=own, damping_ratio=ratio))
        misfit.append(found.misfit)
        fitted[..., np.isin(responses.frequency, window.frequency)] = found.fitted
    if not modes:
        raise ValueError("no peak of the responses can be fitted by a resonance: average more, or use finer bins")
    unknown = Estimate(float("nan"), float("nan"), float("nan"))
    return Identification(tuple(modes), unknown, float(np.median(misfit)), responses, None, fitted)


FROM_ZERO = "check where the axis begins, and export the responses from 0 Hz on"
"""End of the words on a frequency axis that is off."""

CLEARLY = 16.0
"""Decrease of the residual's sum of squares, in units of the noise, for another frequency axis."""

MOSTLY, NEARLY_NOISE = 2.0, 0.1
"""Factor by which another axis must reduce the misfit beyond the noise, and misfit beyond it that may be noise [1]."""


def axis_error(found: Identification) -> str:
    """Describe frequencies, of all sets or of one, that are a bin too high or too low; empty if there are none.

    Moved resonances look equally plausible, but a response is symmetric about 0 Hz: its values below the first
    resonance, and the flanks of all, tell where 0 Hz is.
    """
    poles, (_, second, *_) = found.poles, found.responses.frequency
    if poles is None:
        return ""
    responses = replace(found.responses, repeats=()).between(second, math.inf)

    def cost(n_bins: int) -> float:
        lower = n_bins * responses.spacing
        own = np.maximum(poles.natural_frequency - lower, responses.spacing)
        start = Poles(own, poles.damping_ratio * poles.natural_frequency / own, poles.delay)
        # The same weights for all axes, though noise without a coherence follows the frequency.
        problem = make_problem(replace(responses, frequency=responses.frequency - lower), start, noise=responses.noise)
        return refine(problem, start, most=10).cost

    def cost_of_set(n_bins: int, which: int) -> float:
        moved = responses.response.copy()
        moved[which] = np.roll(moved[which], -n_bins, axis=-1)
        # The values that come round lie beyond the band.
        inner = replace(responses, response=moved).between(*responses.frequency[[1, -2]])
        problem = make_problem(inner, poles, noise=responses.noise[:, 1:-1])
        return refine(problem, poles, most=10).cost

    given, (least, n_bins) = cost(0), min((cost(n_bins), n_bins) for n_bins in (-1, 1))
    off = f"the frequencies are at least one bin, {responses.spacing:.4g} Hz, too {'high' if n_bins > 0 else 'low'}"
    if found.misfit > 1 + NEARLY_NOISE and len(responses.sets) > 1:
        of_set = itertools.product((-1, 1), range(len(responses.sets)))
        own, n_bins, which = min((cost_of_set(*each), *each) for each in of_set)
        if own < least:
            # Resonances tell only which set is higher than another.
            least, side = own, "higher than others" if n_bins > 0 else "lower than others"
            off = f"the frequencies of {responses.sets[which]} are at least one bin, {responses.spacing:.4g} Hz, {side}"
    # Another axis also absorbs a little of any other error, such as of a truncated decay.
    is_wrong = MOSTLY * (1 - least / given) * found.misfit > found.misfit - 1 - NEARLY_NOISE
    if 2 * (given - least) <= CLEARLY * found.misfit or not is_wrong:
        return ""
    return f"{off}, judging by the values off resonance: {FROM_ZERO}"


SAME_MODE = 0.005
"""Relative difference in natural frequency below which unlabelled modes are the same [1]."""


def over_repeats(found: Identification) -> Identification:
    """Include the scatter over the repeats of the responses in the intervals of the modes.

    Each repeat is fitted separately, since the resonances of mean responses are broadened if the natural frequencies
    vary. A parameter has Student's interval over the repeats or that of the joint fit, whichever is wider. A mode found
    in fewer than two repeats keeps the interval of the joint fit.
    """
    repeats = [_fit_repeat(found, repeat) for repeat in range(len(found.responses.repeats))]
    return replace(found, modes=tuple(_over(mode, [_same(mode, each) for each in repeats]) for mode in found.modes))


def _fit_repeat(found: Identification, repeat: int) -> Sequence[IdentifiedMode]:
    """Return the modes of one repeat; empty if it cannot be fitted."""
    responses = found.responses.repeats[repeat].aligned()
    try:
        if found.poles is None:
            return identify_each(responses).modes
        start = replace(found.poles, delay=found.delay.value - responses.offset)
        return identify(responses, found.length, start=start, most=0).modes
    except ValueError:
        return ()


def _same(mode: IdentifiedMode, others: Sequence[IdentifiedMode]) -> IdentifiedMode | None:
    """Find the same mode among others by its label or else by its natural frequency."""
    own = mode.natural_frequency.value
    alike = [
        (abs(each.natural_frequency.value / own - 1), each)
        for each in others
        if each.label == mode.label and (mode.label or abs(each.natural_frequency.value / own - 1) < SAME_MODE)
    ]
    return min(alike, key=lambda each: each[0])[1] if alike else None


def _over(mode: IdentifiedMode, repeats: Sequence[IdentifiedMode | None]) -> IdentifiedMode:
    """Include the scatter over the repeats in the intervals of a mode."""
    known = [each for each in repeats if each is not None]
    if len(known) < 2:
        return mode
    gains = zip(mode.gain, *(each.gain for each in known), strict=True)
    return replace(
        mode,
        natural_frequency=_widened(mode.natural_frequency, [each.natural_frequency for each in known]),
        damping_ratio=_widened(mode.damping_ratio, [each.damping_ratio for each in known]),
        gain=tuple(_widened(joint, each) for joint, *each in gains),
        n_repeats=len(known),
    )


def _widened(joint: Estimate, repeats: Sequence[Estimate]) -> Estimate:
    """Return the mean of repeats with Student's interval or that of the joint fit, whichever is wider."""
    from scipy.stats import t

    values, n = [each.value for each in repeats], len(repeats)
    scatter = float(np.std(values, ddof=1)) / math.sqrt(n) * float(t.ppf(0.975, n - 1))
    half, mean = max((joint.high - joint.low) / 2, scatter), float(np.mean(values))
    return Estimate(mean, mean - half, mean + half)
