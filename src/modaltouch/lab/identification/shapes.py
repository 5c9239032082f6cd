"""Measured shapes and those of a free-free beam: labels, and faulty points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modaltouch.lab.common import ComplexArray, FloatArray
from modaltouch.lab.identification.responses import ROWS_APART, Place, along
from modaltouch.stimulus import MeasuredShapes, mode_shapes

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


def straightened(residue: ComplexArray) -> ComplexArray:
    """Return a complex shape rotated so that its common line is real."""
    return np.asarray(residue * np.exp(-0.5j * np.angle((residue**2).sum())))


def check_points(positions: FloatArray, labels: Sequence[int], length: float) -> None:
    """Refuse points on which two modes have similar shapes, or too few points to draw the highest mode.

    Parameters
    ----------
    positions : (n_points,) array
        Measurement positions along a beam of this length [m].
    labels : sequence of int
        Modes to be distinguished.

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
        alike = (
            f"modes {one + 1} and {other + 1}, whose shapes are alike there (MAC {likeness[one, other]:.2f}); give at "
            f"least {needed} evenly spaced points"
        )
        ends = f"{positions.min() * 1e3:.4g} to {positions.max() * 1e3:.4g} mm"
        raise ValueError(
            f"{positions.size} points are too few to distinguish {alike}"
            if positions.size < needed
            else f"the points from {ends} do not distinguish {alike} from end to end, and check the unit of the "
            "positions"
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
        In order of frequency, at the places of the points on a beam of this length [m].
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
        In order of frequency, with their bending labels, at the places of the points on a beam of this length [m].
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
        Residues of the mode with this label: gain of each set times the shape, all with equal noise. The mean over the
        rows of places has unit mean square.
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


FEWEST_MODES = 3
"""Minimum number of modes with a shape for the check of a point."""

CERTAIN = 0.95
"""Minimum MAC of a shape with the theoretical one that serves to judge a point [1]."""

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
        Gain times shape, by the actuator sets, at the places of the points on a beam of this length [m].

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
    labels, likeness = label_shapes(common, [*places[:point], *places[point + 1 :]], length)
    known = [k for k, label in enumerate(labels) if label is not None and likeness[k] > CERTAIN]
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
        Shapes of the bending modes with these labels, at the places of the points as given; the length is in m.
    """
    from scipy.optimize import minimize

    positions = np.array(places)[:, 0]

    def lacking(error: FloatArray) -> float:
        moved = np.clip(positions * (1 + error[0]) + length * error[1], -length / 2, length / 2)
        return float(np.sum(1 - np.diag(mac(shapes, mode_shapes(labels, moved, length)))))

    steps = [[0.0, 0.0], [STRETCH, 0.0], [0.0, SHIFT]]
    found = minimize(lacking, steps[0], method="Nelder-Mead", options={"initial_simplex": steps, "xatol": 1e-4})
    stretch, shift = (float(value) for value in found.x)
    is_large = len(labels) >= FEWEST_MODES and (abs(stretch) > STRETCH or abs(shift) > SHIFT)
    if not is_large or found.fun >= EXPLAINED * lacking(np.zeros(2)):
        return ""
    off = [
        *([f"{1 + stretch:.3f} times as far from mid-beam"] if abs(stretch) > STRETCH / 2 else []),
        *([f"{shift * length * 1e3:+.2g} mm away"] if abs(shift) > SHIFT / 2 else []),
    ]
    return (
        f"the shapes are those of a free beam whose points lie {' and '.join(off)}, so the gains are wrong: check the "
        "scale and the origin of the positions, and the length of the beam in the apparatus file"
    )


APART = 3.0
"""Minimum factor between the magnitudes of two separate groups of points for different units [1]."""


def in_two_units(shapes: FloatArray, places: Sequence[Place], length: float) -> str:
    """Describe points with far larger values than the others in most modes; empty unless both groups have several.

    The shapes, an (n_modes, n_points) array, may have any scale.
    """
    if len(places) < 4:
        return ""
    # All shapes have larger amplitudes near the ends of a beam.
    usual = np.linalg.norm(mode_shapes(range(1, 7), np.array(places)[:, 0], length), axis=0)
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
        "all points have the same units, range, gain and sign of the phase"
    )
