"""One point that is inverted or scaled: found by what the others say of it, over all modes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modaltouch.lab.arrays import FloatArray
from modaltouch.lab.identification.shapes import label_shapes
from modaltouch.stimulus import mode_shapes

FEWEST_MODES = 3
"""Modes with a shape from which a point is judged."""

OFF = 0.2
"""How far the factor of a point lies from 1 at least [1]."""

EXPLAINED, STANDS_OUT = 0.25, 3.0
"""What a factor leaves at most of the misfit of its point, and that misfit over the median one at least [1]."""


def refuse_odd_point(residue: FloatArray, positions: FloatArray, length: float, sets: Sequence[str]) -> None:
    """Refuse responses of which one point is inverted, or too large or too small, beside the others.

    Each point is predicted from the shapes of a uniform free-free beam that the others fit. Its responses over all
    modes are then the prediction times one factor, by least squares.

    Parameters
    ----------
    residue : (n_modes, n_sets, n_points) array
        Gain times shape.
    positions : (n_points,) array
        Origin at mid-beam [m].
    length : float
        Length of the beam [m].
    sets : sequence of str
        Actuator sets.

    Raises
    ------
    ValueError
        With the point, its factor and the remedy.
    """
    size = np.linalg.norm(residue, axis=(1, 2), keepdims=True)
    measured = residue / np.maximum(size, 1e-300)
    seen = [_without(measured, positions, length, point) for point in range(positions.size)]
    factor, before, after = (np.array(column) for column in zip(*seen, strict=True))
    typical = np.median(before)
    odd = (np.abs(factor - 1) > OFF) & (after < EXPLAINED * before) & (before > STANDS_OUT * typical)
    # A beam that drifts spoils many points, and one of them may look scaled.
    odd &= before == before.max(axis=0)
    if not odd.any():
        return
    set_index, point = divmod(int(np.where(odd.T, before.T, 0.0).argmax()), positions.size)
    place, times = positions[point] * 1e3, float(factor[point, set_index])
    whose = "" if odd[point].all() else f" to {sets[set_index]}"
    what = (
        "inverted" if times < 0 else f"{times:.3g} times too large" if times > 1 else f"{1 / times:.3g} times too small"
    )
    if times < 0 and abs(times + 1) > OFF:
        what += f" and {-times:.3g} times too large" if times < -1 else f" and {-1 / times:.3g} times too small"
    raise ValueError(
        f"the response{whose} at {place:.6g} mm is {what} beside the other points, in all modes: see the sensor "
        f"and its sign there and measure that point again, or leave it out with --leave-out {place:.6g}"
    )


def _without(
    measured: FloatArray, positions: FloatArray, length: float, point: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the factor of a point to each set by the others, and its misfit before and after it, (n_sets,) arrays."""
    others = np.delete(np.arange(positions.size), point)
    common = np.array([np.linalg.svd(each[:, others], full_matrices=False)[2][0] for each in measured])
    labels, _ = label_shapes(common, positions[others], length)
    known = [k for k, label in enumerate(labels) if label is not None]
    n_sets = measured.shape[1]
    if len(known) < FEWEST_MODES:
        return np.ones(n_sets), np.zeros(n_sets), np.zeros(n_sets)
    shapes = mode_shapes([labels[k] or 0 for k in known], positions, length)
    inside = shapes[:, others]
    gain = (measured[known][:, :, others] * inside[:, None]).sum(axis=2) / (inside**2).sum(axis=1)[:, None]
    predicted, seen = gain * shapes[:, point, None], measured[known, :, point]
    factor = (seen * predicted).sum(axis=0) / np.maximum((predicted**2).sum(axis=0), 1e-300)
    before, after = ((seen - each * predicted) ** 2 for each in (1.0, factor))
    return factor, before.sum(axis=0), after.sum(axis=0)
