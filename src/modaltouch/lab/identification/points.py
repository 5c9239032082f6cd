"""Detection of points with wrong responses or positions by comparison with the shapes of a free-free beam."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modaltouch.lab.arrays import FloatArray
from modaltouch.lab.identification.responses import Place
from modaltouch.lab.identification.shapes import label_shapes, mac
from modaltouch.stimulus import mode_shapes

FEWEST_MODES = 3
"""Minimum number of modes with a shape for the check of a point."""

OFF = 0.2
"""Minimum deviation of a faulty point's factor from 1 [1]."""

EXPLAINED, STANDS_OUT = 0.25, 3.0
"""Largest fraction of a faulty point's misfit that its factor leaves, and minimum ratio of misfit to median [1]."""


def refuse_odd_point(residue: FloatArray, places: Sequence[Place], length: float, sets: Sequence[str]) -> None:
    """Refuse responses in which one point is inverted, too large or too small compared with the others.

    Each point is predicted from the others with the shapes of a uniform free-free beam. One least-squares factor per
    set then relates its residues in all modes to the prediction.

    Parameters
    ----------
    residue : (n_modes, n_sets, n_points) array
        Gain times shape.
    places : sequence of Place
        Places of the points.
    length : float
        Length of the beam [m].
    sets : sequence of str
        Actuator sets.

    Raises
    ------
    ValueError
        If a point is faulty; the message states the point, its factor and the remedy.
    """
    if len(residue) < FEWEST_MODES:
        return
    size = np.linalg.norm(residue, axis=(1, 2), keepdims=True)
    measured = residue / np.maximum(size, 1e-300)
    seen = [_without(measured, places, length, point) for point in range(len(places))]
    factor, before, after = (np.array(column) for column in zip(*seen, strict=True))
    typical = np.median(before)
    odd = (np.abs(factor - 1) > OFF) & (after < EXPLAINED * before) & (before > STANDS_OUT * typical)
    # Drift of the beam affects many points, one of which may appear scaled.
    odd &= before == before.max(axis=0)
    if not odd.any():
        return
    if several := _several(measured, places, length):
        raise ValueError(several)
    set_index, point = divmod(int(np.where(odd.T, before.T, 0.0).argmax()), len(places))
    place, times = places[point], float(factor[point, set_index])
    whose = "" if odd[point].all() else f" to {sets[set_index]}"
    size = abs(times)
    what = "zero" if size == 0 else f"{size:.3g} times too large" if size > 1 else f"{1 / size:.3g} times too small"
    if times < 0:
        what = "inverted" if abs(size - 1) <= OFF else f"inverted and {what}"
    raise ValueError(
        f"the response{whose} at {place} is {what} compared with the other points, in all modes: check the sensor, its "
        f"sign and its position and measure that point again, or leave it out with --leave-out {place.along * 1e3:.6g}"
    )


def _several(measured: FloatArray, places: Sequence[Place], length: float) -> str:
    """Describe an error of several points, of which the faulty one is only the worst; empty if there is none."""
    if mixed := in_two_units(measured.reshape(-1, len(places)), places, length):
        return mixed
    common = np.array([np.linalg.svd(each, full_matrices=False)[2][0] for each in measured])
    labels, _ = label_shapes(common, places, length)
    known = [k for k, label in enumerate(labels) if label is not None]
    return misplaced(common[known], [labels[k] or 0 for k in known], places, length) if known else ""


def _without(
    measured: FloatArray, places: Sequence[Place], length: float, point: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a point's factor for each set, and its squared misfit without and with the factor, (n_sets,) arrays."""
    others = np.delete(np.arange(len(places)), point)
    common = np.array([np.linalg.svd(each[:, others], full_matrices=False)[2][0] for each in measured])
    labels, _ = label_shapes(common, [*places[:point], *places[point + 1 :]], length)
    known = [k for k, label in enumerate(labels) if label is not None]
    n_sets = measured.shape[1]
    if len(known) < FEWEST_MODES:
        return np.ones(n_sets), np.zeros(n_sets), np.zeros(n_sets)
    shapes = mode_shapes([labels[k] or 0 for k in known], np.array(places)[:, 0], length)
    inside = shapes[:, others]
    gain = (measured[known][:, :, others] * inside[:, None]).sum(axis=2) / (inside**2).sum(axis=1)[:, None]
    predicted, seen = gain * shapes[:, point, None], measured[known, :, point]
    factor = (seen * predicted).sum(axis=0) / np.maximum((predicted**2).sum(axis=0), 1e-300)
    before, after = ((seen - each * predicted) ** 2 for each in (1.0, factor))
    return factor, before.sum(axis=0), after.sum(axis=0)


def unevenness(shapes: FloatArray, labels: Sequence[int], positions: FloatArray, length: float) -> float:
    """Return the rms deviation of the points' factors from each other that is common to two halves of the modes [1].

    Noise and deviations of the shapes from theory differ between modes; the effect of a sensor's angle does not.
    """
    theory = mode_shapes(labels, positions, length)
    gain = (shapes * theory).sum(axis=1, keepdims=True) / (theory**2).sum(axis=1, keepdims=True)
    # Assign modes to the halves in alternating pairs, so that both contain symmetric and antisymmetric ones.
    second = np.arange(len(labels)) // 2 % 2 == 1
    weight = np.array([(theory[half] ** 2).sum(axis=0) for half in (~second, second)])
    off = np.array([(theory * (shapes / gain - theory))[half].sum(axis=0) for half in (~second, second)])
    common = (off / np.maximum(weight, 1e-12)).prod(axis=0)
    return float(np.sqrt(max(0.0, np.average(common, weights=weight.min(axis=0)))))


STRETCH, SHIFT = 0.02, 0.01
"""Minimum reported errors of all positions: of their scale, and of their origin relative to the length [1]."""


def misplaced(shapes: FloatArray, labels: Sequence[int], places: Sequence[Place], length: float) -> str:
    """Describe an error of all positions, or of the length, that explains shapes of a free-free beam; else empty.

    The shapes of several modes determine factor and shift, since nodes are closer together in higher modes. They are
    reported only if they explain most of the difference between the shapes and theory.

    Parameters
    ----------
    shapes : (n_modes, n_points) array
        Shapes of bending modes.
    labels : sequence of int
        Labels of the modes.
    places : sequence of Place
        Places of the points as given.
    length : float
        Length of the beam [m].
    """
    from scipy.optimize import minimize

    positions = np.array(places)[:, 0]

    def lacking(error: FloatArray) -> float:
        moved = np.clip(positions * (1 + error[0]) + length * error[1], -length / 2, length / 2)
        return float(np.sum(1 - np.diag(mac(shapes, mode_shapes(labels, moved, length)))))

    steps = [[0.0, 0.0], [STRETCH, 0.0], [0.0, SHIFT]]
    found = minimize(lacking, steps[0], method="Nelder-Mead", options={"initial_simplex": steps, "xatol": 1e-4})
    stretch, shift = (float(value) for value in found.x)
    is_told = len(labels) >= FEWEST_MODES and (abs(stretch) > STRETCH or abs(shift) > SHIFT)
    if not is_told or found.fun >= EXPLAINED * lacking(np.zeros(2)):
        return ""
    off = [
        *([f"{1 + stretch:.3f} times as far from mid-beam"] if abs(stretch) > STRETCH / 2 else []),
        *([f"{shift * length * 1e3:+.2g} mm away"] if abs(shift) > SHIFT / 2 else []),
    ]
    return (
        f"the shapes are those of a free beam whose points lie {' and '.join(off)}, so the gains are wrong: check the "
        "scale and the origin of the positions, and the length of the beam in the apparatus file"
    )


GRAVITY = 9.80665
"""Standard acceleration of free fall [m/s^2]."""

SPREAD = 0.1
"""Relative tolerance of a factor between units that are often confused [1]."""

APART = 3.0
"""Minimum factor between the magnitudes of two separate groups of points for different units [1]."""

USUAL = (1, 2, 3, 4, 5, 6)
"""Modes from which the larger amplitude of all shapes near the ends of a beam is computed."""


def in_two_units(shapes: FloatArray, places: Sequence[Place], length: float) -> str:
    """Describe points with far larger values than the others in most modes; empty unless both groups have several.

    Parameters
    ----------
    shapes : (n_modes, n_points) array
        Shapes of any scale.
    places : sequence of Place
        Places of the points.
    length : float
        Length of the beam [m].
    """
    if len(places) < 4:
        return ""
    usual = np.linalg.norm(mode_shapes(USUAL, np.array(places)[:, 0], length), axis=0)
    norm = np.linalg.norm(shapes, axis=1, keepdims=True)
    size = np.median(np.abs(shapes) / np.maximum(norm, 1e-300), axis=0) / usual
    order = np.argsort(size)
    steps = size[order][1:] / np.maximum(size[order][:-1], 1e-300)
    low, high = np.split(order, [int(steps.argmax()) + 1])
    if steps.max() < APART or min(low.size, high.size) < 2:
        return ""
    named = ", ".join(str(places[point]) for point in np.sort(high))
    factor = np.median(size[high]) / np.median(size[low])
    return (
        f"the responses at {named} are about {factor:.3g} times as large as those at the other points: check whether "
        "all points have the same units, range and gain"
    )
