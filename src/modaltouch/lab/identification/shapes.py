"""From residues to shapes, labels and gains: which mode of a free-free beam each pole is, and how hard it is driven."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus import MeasuredShapes, mode_shapes

FloatArray = NDArray[np.float64]

ALIKE = 0.5
"""MAC of two shapes on their points from which the points cannot tell them apart [1]."""

BELONGS = 0.8
"""Least MAC of a measured shape and a theoretical one of the same mode [1]."""


def mac(one: FloatArray, other: FloatArray) -> FloatArray:
    r"""Return the modal assurance criterion of shapes on equal points (Allemang 1982), (n_one, n_other) array [1].

    .. math:: MAC = \frac{|\varphi^T \psi|^2}{(\varphi^T \varphi)(\psi^T \psi)}

    Parameters
    ----------
    one, other : (n, n_points) array
        Shapes.
    """
    size = np.outer((one**2).sum(axis=1), (other**2).sum(axis=1))
    return np.asarray((one @ other.T) ** 2 / np.maximum(size, 1e-300))


def fewest_points(highest: int) -> int:
    """Return how many evenly spaced points it takes to draw the shape of a label."""
    return int(np.ceil(highest * 1.5))


def check_points(positions: FloatArray, labels: Sequence[int], length: float) -> None:
    """Refuse points on which modes look alike, or too few to draw the highest of them.

    Parameters
    ----------
    positions : (n_points,) array
        Where the shapes are to be measured [m].
    labels : sequence of int
        Modes to be told apart.
    length : float
        Length of the beam [m].

    Raises
    ------
    ValueError
        With the pair that looks alike, and how many points are enough.
    """
    highest, needed = max(labels), fewest_points(max(labels))
    shapes = mode_shapes(range(1, highest + 1), positions, length)
    likeness = mac(shapes, shapes) - np.eye(highest)
    one, other = np.unravel_index(int(likeness.argmax()), likeness.shape)
    if likeness[one, other] >= ALIKE or positions.size < highest:
        raise ValueError(
            f"{positions.size} points are too few to tell modes {one + 1} and {other + 1} apart: on them their shapes "
            f"are alike (MAC {likeness[one, other]:.2f}); give at least {needed} evenly spaced points"
        )
    if positions.size < needed:
        raise ValueError(
            f"{positions.size} points are too few to draw the shape of mode {highest}: give at least {needed} evenly "
            "spaced ones"
        )


def label_shapes(shapes: FloatArray, positions: FloatArray, length: float) -> tuple[list[int | None], FloatArray]:
    """Return which mode of a uniform free-free beam each shape is, and its MAC with it.

    Labels increase with frequency, so that a torsion that looks like a low bending mode on the mid-line is told from
    it; what fits no label gets none.

    Parameters
    ----------
    shapes : (n_modes, n_points) array
        In order of frequency.
    positions : (n_points,) array
        Origin at mid-beam [m].
    length : float
        Length of the beam [m].
    """
    n_labels = positions.size * 2 // 3
    likeness = mac(shapes, mode_shapes(range(1, n_labels + 1), positions, length))
    # The most likeness in all that labels in increasing order can have.
    gain = np.where(likeness >= BELONGS, likeness**4, 0.0)
    n_modes = shapes.shape[0]
    best = np.zeros((n_modes + 1, n_labels + 1))
    for k in range(n_modes):
        for label in range(1, n_labels + 1):
            taken = best[k, label - 1] + gain[k, label - 1] if gain[k, label - 1] > 0 else 0.0
            best[k + 1, label] = max(best[k, label], best[k + 1, label - 1], taken)
    labels: list[int | None] = [None] * n_modes
    label = n_labels
    for k in range(n_modes, 0, -1):
        while label > 0 and best[k, label] == best[k, label - 1]:
            label -= 1
        if label > 0 and best[k, label] > best[k - 1, label]:
            labels[k - 1] = label
            label -= 1
    worth = [likeness[k, each - 1] if each else likeness[k].max() for k, each in enumerate(labels)]
    return labels, np.array(worth)


def unit_shape(residue: FloatArray, positions: FloatArray, label: int, length: float) -> FloatArray:
    """Return the shape that residues of several excitations share: unit mean square, positive at the right end [1].

    Parameters
    ----------
    residue : (n_sets, n_points) array
        Of one mode; gain of each set times the shape, with equal noise.
    positions : (n_points,) array
        Origin at mid-beam [m].
    label : int
        Of the mode.
    length : float
        Length of the beam [m].
    """
    common = np.linalg.svd(residue, full_matrices=False)[2][0]
    measured = MeasuredShapes((label,), positions, common[None], length)
    at_end = float(measured.at([length / 2])[0, 0])
    return np.asarray(measured.shape[0] * (1.0 if at_end >= 0 else -1.0))
