"""Assignment of poles to the modes of a free-free beam, by shape or frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modaltouch.lab.arrays import ComplexArray, FloatArray
from modaltouch.lab.identification.responses import ROWS_APART, Place, along
from modaltouch.stimulus import MeasuredShapes, characteristic_root, mode_shapes

ALIKE = 0.5
"""MAC of two shapes above which the points cannot distinguish them [1]."""

BELONGS = 0.8
"""Minimum MAC between a measured shape and the theoretical one of the same mode [1]."""


def mac(one: FloatArray, other: FloatArray) -> FloatArray:
    r"""Return the modal assurance criterion of shapes on the same points (Allemang 1982), (n_one, n_other) array [1].

    .. math:: MAC = \frac{|\varphi^T \psi|^2}{(\varphi^T \varphi)(\psi^T \psi)}

    Parameters
    ----------
    one, other : (n, n_points) array
        Shapes.
    """
    size = np.outer((one**2).sum(axis=1), (other**2).sum(axis=1))
    return np.asarray((one @ other.T) ** 2 / np.maximum(size, 1e-300))


def phase_collinearity(residue: ComplexArray) -> float:
    """Return the modal phase collinearity of a shape (Juang and Pappa 1985) [1]; NaN for a single point."""
    if residue.size < 2:
        return float("nan")
    size, turned = float((np.abs(residue) ** 2).sum()), abs(complex((residue**2).sum()))
    return (turned / size) ** 2


def phase_deviation(residue: ComplexArray) -> float:
    """Return the amplitude-weighted mean phase deviation of a shape (Reynders 2012) [rad]; NaN for a single point."""
    if residue.size < 2:
        return float("nan")
    straight = residue * np.exp(-0.5j * np.angle((residue**2).sum()))
    size = np.abs(straight)
    return float((size * np.arctan2(np.abs(straight.imag), np.abs(straight.real))).sum() / size.sum())


def check_points(positions: FloatArray, labels: Sequence[int], length: float) -> None:
    """Refuse points on which two modes have similar shapes, or too few points to draw the highest mode.

    Parameters
    ----------
    positions : (n_points,) array
        Measurement positions along the beam [m].
    labels : sequence of int
        Modes to be distinguished.
    length : float
        Length of the beam [m].

    Raises
    ------
    ValueError
        If the points do not suffice; the message states the similar pair and a sufficient number of points.
    """
    highest = max(labels)
    needed = int(np.ceil(1.5 * highest))
    shapes = mode_shapes(range(1, highest + 1), positions, length)
    likeness = mac(shapes, shapes) - np.eye(highest)
    one, other = np.unravel_index(int(likeness.argmax()), likeness.shape)
    if likeness[one, other] >= ALIKE or positions.size < highest:
        raise ValueError(
            f"{positions.size} points are too few to distinguish modes {one + 1} and {other + 1}, whose shapes are "
            f"alike there (MAC {likeness[one, other]:.2f}); give at least {needed} evenly spaced points"
        )
    if positions.size < needed:
        raise ValueError(
            f"{positions.size} points are too few to draw the shape of mode {highest}: give at least {needed} evenly "
            "spaced ones"
        )


def label_shapes(shapes: FloatArray, places: Sequence[Place], length: float) -> tuple[list[int | None], FloatArray]:
    """Return the label of each shape among the modes of a uniform free-free beam, and its MAC with that mode.

    Labels increase with frequency, which excludes a torsional mode that resembles a low bending mode on the mid-line;
    a shape that fits no label has None.

    Parameters
    ----------
    shapes : (n_modes, n_points) array
        In order of frequency.
    places : sequence of Place
        Places of the points.
    length : float
        Length of the beam [m].
    """
    return _in_order(bending_likeness(shapes, places, length))


def bending_likeness(shapes: FloatArray, places: Sequence[Place], length: float) -> FloatArray:
    """Return the MAC of shapes with all modes of a uniform free-free beam that the points resolve, from label 1 on."""
    n_labels = along(places)[0].size * 2 // 3
    return mac(shapes, mode_shapes(range(1, n_labels + 1), np.array(places)[:, 0], length))


def label_torsion(
    shapes: FloatArray, labels: Sequence[int | None], places: Sequence[Place], length: float
) -> tuple[list[int | None], FloatArray]:
    """Return the number of the torsional mode of a uniform free-free beam for each unlabelled shape, and its MAC.

    Torsion cannot be distinguished from bending on a single row, so no shape is assigned there.

    Parameters
    ----------
    shapes : (n_modes, n_points) array
        In order of frequency.
    labels : sequence of (int or None)
        Label of each shape.
    places : sequence of Place
        Places of the points.
    length : float
        Length of the beam [m].
    """
    if np.ptp(np.array(places)[:, 1]) <= ROWS_APART:
        return [None] * len(labels), np.zeros(len(labels))
    n_orders = max(1, along(places)[0].size * 2 // 3)
    likeness = mac(shapes, torsion_shapes(range(1, n_orders + 1), places, length))
    return _in_order(np.where([[label is None] for label in labels], likeness, 0.0))


def torsion_shapes(orders: Sequence[int], places: Sequence[Place], length: float) -> FloatArray:
    r"""Return torsion shapes of a uniform free-free beam, with unit mean square over the points, (n_orders, n_points).

    Saint-Venant's :math:`\varphi_n \propto y \cos(n \pi (x / L + 1/2))`, with the sign that makes it positive at the
    right end for y > 0.
    """
    x, y = np.array(places).T
    order = np.array(orders)[:, None]
    shape = y * (-1.0) ** order * np.cos(order * np.pi * (x / length + 0.5))
    return np.asarray(shape / np.maximum(np.sqrt((shape**2).mean(axis=1, keepdims=True)), 1e-300))


def _in_order(likeness: FloatArray) -> tuple[list[int | None], FloatArray]:
    """Return labels in increasing order, and the likeness of each shape to that of its label."""
    # Dynamic programming: maximise the total likeness over all labels in increasing order.
    gain = np.where(likeness >= BELONGS, likeness**4, 0.0)
    n_modes, n_labels = likeness.shape
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


def unit_shape(residue: FloatArray, places: Sequence[Place], label: int, length: float) -> FloatArray:
    """Return the common shape of several excitations' residues, of unit mean square, positive at the right end [1].

    Parameters
    ----------
    residue : (n_sets, n_points) array
        Residues of one mode: gain of each set times the shape, all with equal noise.
    places : sequence of Place
        Places of the points; the mean over the rows has unit mean square.
    label : int
        Label of the mode.
    length : float
        Length of the beam [m].
    """
    common = np.linalg.svd(residue, full_matrices=False)[2][0]
    mean = over_width(common, places)
    measured = MeasuredShapes((label,), along(places)[0], mean[None], length)
    at_end = float(measured.at([length / 2])[0, 0])
    size = float(measured.shape[0] @ mean / (mean @ mean))
    return np.asarray(common * size * (1.0 if at_end >= 0 else -1.0))


def shape_scatter(shape: FloatArray, places: Sequence[Place], label: int, length: float) -> float:
    """Return the relative standard deviation of a mode's gain due to the scatter of its shape's points [1].

    The difference between a measured shape and theory is smooth along the beam. Points with wrong positions, order or
    amplitude scatter about it, by an amount estimated from its second difference. A position offset common to all
    points does not count as scatter.

    Parameters
    ----------
    shape : (n_points,) array
        Shape of unit mean square.
    places : sequence of Place
        Places of the points.
    label : int
        Label of the mode.
    length : float
        Length of the beam [m].
    """
    measured, positions = over_width(shape, places), along(places)[0]
    step = 1e-4 * length
    inside = np.clip(positions, step - length / 2, length / 2 - step)
    theory = [mode_shapes([label], each, length)[0] for each in (positions, inside - step, inside + step)]
    course = np.stack([theory[0], theory[2] - theory[1]], axis=1)
    left = measured - course @ np.linalg.lstsq(course, measured)[0]
    return float(np.sqrt((np.diff(left, 2) ** 2).mean() / 6 / max(left.size - 2, 1)))


def over_width(shape: FloatArray, places: Sequence[Place]) -> FloatArray:
    """Return the mean of a shape over the rows at each position along the beam, (n_along,) array."""
    which = along(places)[1]
    return np.asarray(np.bincount(which, shape) / np.bincount(which))


WITHIN = 0.005
"""Largest relative deviation of a natural frequency from that of a free-free beam [1]."""

FEWEST = 3
"""Number of natural frequencies needed to recognise a beam; one more if shear and rotary inertia are fitted."""


@dataclass(frozen=True)
class FreeFree:
    """The free-free beam with the best fit to given natural frequencies.

    Attributes
    ----------
    recognised : bool
        Whether the natural frequencies are those of a free-free beam.
    first_frequency_Hz : float
        Natural frequency of its first bending mode [Hz].
    bending_modes : tuple of (int or None)
        Bending mode of each natural frequency, from 1; None for other motions.
    shear : float
        Parameter of shear and rotary inertia, which lower natural frequencies, ~(h/L)^2; 0 for Euler-Bernoulli [1].
    deviation : float
        Largest relative deviation of the natural frequencies of bending modes [1].
    """

    recognised: bool
    first_frequency_Hz: float  # noqa: N815
    bending_modes: tuple[int | None, ...]
    shear: float
    deviation: float


def recognise(natural_frequency: Sequence[float]) -> FreeFree | None:
    r"""Return the free-free beam with the best fit to given natural frequencies; None for fewer than three.

    For an Euler-Bernoulli beam :math:`f_n \propto \lambda_n^2`. Shear and rotary inertia lower it by a factor that is
    :math:`1/\sqrt{1 + s \lambda_n^2}` to first order in s, which is (h/L)^2 times a constant of the cross-section. Each
    of the three lowest frequencies is tried as each of the first three bending modes; other frequencies may belong to
    torsion or to lateral bending.

    Parameters
    ----------
    natural_frequency : sequence of float
        Natural frequencies, increasing [Hz].
    """
    measured = np.asarray(natural_frequency, dtype=float)
    if measured.size < FEWEST:
        return None
    square = np.array([characteristic_root(bending) for bending in range(1, measured.size + 9)]) ** 2
    tried = [
        _fit(measured, first, mode, float(shear), square)
        for first in range(min(3, measured.size))
        for mode in range(3)
        for shear in np.concatenate([[0.0], np.geomspace(1e-5, 1e-2, 121)])
    ]
    return max(tried, key=_worth)


def _fit(measured: FloatArray, first: int, mode: int, shear: float, square: FloatArray) -> FreeFree:
    """Fit a free-free beam with one of the measured frequencies assigned to a given bending mode."""
    course = square / np.sqrt(1 + shear * square)
    ratio = measured[:, None] / measured[first] * course[mode] / course
    nearest = np.abs(np.log(ratio)).argmin(axis=1)
    # Rescale by all frequencies that fit rather than a single one.
    fits = np.abs(ratio[np.arange(measured.size), nearest] - 1) <= WITHIN
    scale = float(np.median(measured[fits] / course[nearest[fits]]))
    off = np.abs(measured / (scale * course[nearest]) - 1)
    fits = off <= WITHIN
    labels = [int(k) + 1 if fit else None for k, fit in zip(nearest, fits, strict=True)]
    found = [label for label in labels if label is not None]
    enough = FEWEST if shear == 0 else FEWEST + 1
    # Allow successive modes only (one may be missing), each once: a selection from many high modes fits any data.
    successive = len(set(found)) == len(found) and bool(found) and max(found) - min(found) + 1 <= len(found) + 1
    deviation = float(off[fits].max()) if fits.any() else 1.0
    recognised = successive and len(found) >= enough and 2 * len(found) > measured.size
    return FreeFree(recognised, scale * float(course[0]), tuple(labels), shear, deviation)


def _worth(tried: FreeFree) -> tuple[bool, int, float]:
    """Rank a fit by recognition, number of modes, and deviation; shear and inertia are included only if needed."""
    n_found = sum(mode is not None for mode in tried.bending_modes)
    return tried.recognised, n_found, -tried.deviation - (WITHIN / 2 if tried.shear > 0 else 0.0)
