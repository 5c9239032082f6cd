"""The most probable cause of a residual: the pattern over points and modes that explains most of it.

The responses are fitted again with one pole for each pair of close poles, which drift splits. The residual is then
projected on the changes that a fault makes to first order: of natural frequencies, by point, by set or by the mass of a
sensor that moves along the beam; of the phase, by point, in proportion to the frequency or not; of the phase, by mode.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from modaltouch.lab.common import FloatArray
from modaltouch.lab.identification.joint_fit import make_problem, refine
from modaltouch.lab.identification.kernel import Evaluation, Poles
from modaltouch.lab.identification.modal_parameters import REMEDIES, Identification

EXPLAINS = 0.4
"""Minimum share of the residual that a pattern explains if it is the cause [1]."""

ALMOST = 0.85
"""Share explained by a second pattern, relative to the first, above which both are named [1]."""

FILTERED = 0.05
"""Minimum share of the residual explained by one phase for each mode if a filter is the cause [1]."""


def probable_cause(found: Identification) -> str:
    """Describe the most probable cause of the residual with its remedy, or the two most probable; empty if unclear."""
    poles = found.poles
    if poles is None or not found.responses.places:
        return ""
    poles = _merged(found, poles)
    fit = refine(make_problem(found.responses, poles), poles)
    shares, moved, sensor = _shares(fit, *found.responses.response.shape[:2])
    first, second, *_ = sorted(shares, key=lambda each: -shares[each])
    if shares[first] < EXPLAINS:
        return _common_cause(found, fit)
    if first == "drift":
        return _other_beam(found, moved) or _named(first)
    size = f"about {sensor:.2g} of the beam's; " if first.startswith("the mass") else ""
    return _named(first, *([second] if shares[second] > ALMOST * shares[first] else []), size=size)


def _named(first: str, *others: str, size: str = "") -> str:
    also = "".join(f"; or {other}: {REMEDIES[other]}" for other in others)
    return f"the most probable cause is {first}: {size}{REMEDIES[first]}{also}"


def _merged(found: Identification, poles: Poles) -> Poles:
    """Return the poles with one in place of two within a half-power bandwidth that are not both known modes."""
    own, ratio = poles.natural_frequency, poles.damping_ratio
    known = [mode.natural_frequency.value for mode in found.modes if mode.label or mode.torsion]
    named = np.isin(own.round(6), np.round(known, 6))
    apart = [
        other - one > 2 * wide * one or (named[k] and named[k + 1])
        for k, ((one, other), wide) in enumerate(zip(pairwise(own), ratio, strict=False))
    ]
    start = np.flatnonzero(np.append(True, apart))
    number = np.diff(np.append(start, own.size))
    return Poles(np.add.reduceat(own, start) / number, np.add.reduceat(ratio, start) / number, poles.delay)


def _shares(fit: Evaluation, n_sets: int, n_points: int) -> tuple[dict[str, float], FloatArray, float]:
    """Return the share of the residual that each pattern explains, the points' frequency changes, and a moved mass."""
    n, rest, residue = fit.n_modes, fit.rest, fit.residue
    by_frequency = fit.slope[:, :n] / fit.poles.damping_ratio
    omega = 2 * np.pi * fit.poles.natural_frequency / fit.problem.highest
    by_phase = fit.turned[:, :n] / omega
    total = max(float((rest**2).sum()) - rest.size, 1e-300)

    def explained(pattern: FloatArray, axis: int) -> tuple[FloatArray, float]:
        """Return the factors of a pattern, one for each point or set, and the share that it explains."""
        overlap = (pattern * rest).sum(axis=0).reshape(n_sets, n_points).sum(axis=axis)
        size = np.maximum((pattern**2).sum(axis=0).reshape(n_sets, n_points).sum(axis=axis), 1e-300)
        return overlap / size, float((overlap**2 / size).sum()) / total

    moved = by_frequency @ residue[:n]
    factor, drift = explained(moved, 0)
    # A sensor lowers each natural frequency by its mass and the square of the shape where it is.
    common = np.array(
        [np.linalg.svd(each.reshape(n_sets, n_points), full_matrices=False)[2][0] for each in residue[:n]]
    )
    square, power = n_points * np.tile(common**2, n_sets), residue[:n] ** 2
    mean = (square * power).sum(axis=1, keepdims=True) / power.sum(axis=1, keepdims=True)
    loaded = by_frequency @ (residue[:n] * (square - mean))
    mass = float((loaded * rest).sum() / max(float((loaded**2).sum()), 1e-300))
    shares = {
        "drift": drift,
        "drift between the sets": explained(moved, 1)[1] if n_sets > 1 else 0.0,
        "the mass of a sensor that is moved": mass**2 * float((loaded**2).sum()) / total * (mass < 0),
        "a trigger that is late at some points": explained(fit.turned @ residue, 0)[1],
        "a phase that differs between the points": explained(by_phase @ residue[:n], 0)[1],
    }
    return shares, factor, -2 * mass


def _common_cause(found: Identification, fit: Evaluation) -> str:
    """Describe a residual that has the shapes of the modes themselves; empty if it has not."""
    n, rest, left = fit.n_modes, fit.rest, fit.left
    power = float((rest**2).sum()) - rest.size
    nearest = np.abs(np.log(fit.problem.bins.centre[:, None] / fit.poles.natural_frequency)).argmin(axis=1)
    shape = fit.residue[nearest] / np.linalg.norm(fit.residue[nearest], axis=1, keepdims=True)
    if (np.abs((left * shape).sum(axis=1)) ** 2).sum() - 2 * len(left) < EXPLAINS * power:
        return ""
    by_phase = fit.turned[:, :n]
    overlap = ((by_phase.T @ rest) * fit.residue[:n]).sum(axis=1)
    curvature = (by_phase.T @ by_phase) * (fit.residue[:n] @ fit.residue[:n].T)
    if overlap @ np.linalg.lstsq(curvature, overlap, rcond=1e-12)[0] > FILTERED * power:
        alone = any(not (mode.label or mode.torsion) for mode in found.modes)
        return _named("a filter that is not listed", *(["aliasing"] if alone else []))
    first = found.responses.frequency[0] / found.responses.spacing
    if abs(first - round(first)) > 1e-3 * max(1.0, first / 1e3):
        return _named("interpolation of the responses", "nonlinearity")
    return _named("nonlinearity")


def _other_beam(found: Identification, moved: FloatArray) -> str:
    """Describe points of which all natural frequencies differ alike from those of the others; empty if there are none.

    Those of a beam that drifts change gradually, and those of one that was changed during the scan once.
    """
    order = np.argsort(moved)
    at = int(np.diff(moved[order]).argmax()) + 1
    groups = order[:at], order[at:]
    step = float(moved[groups[1]].mean() - moved[groups[0]].mean())
    high = np.isin(np.arange(moved.size), groups[1])
    if max(moved[each].std() for each in groups) > step / 8 or np.count_nonzero(np.diff(high)) < 2:
        return ""
    few = min(groups, key=len)
    named = ", ".join(str(found.responses.places[point]) for point in np.sort(few))
    size = f"{step:.2%} {'higher' if few is groups[1] else 'lower'}"
    return (
        f"the responses at {named} have resonances of their own, {size} than those of the other points: "
        f"{REMEDIES['a strange point']}"
    )
