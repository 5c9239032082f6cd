"""The residual of a fit about a mode: its size, and whether noise, nonlinearity, drift or a missing mode causes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modaltouch.lab.identification.kernel import Evaluation, LeastSquaresProblem

SMOOTH = 0.5
"""Correlation of the residual between neighbouring bins above which it is not noise [1]."""

ALIKE = 0.6
"""Squared cosine between two vectors over the responses above which one explains the other [1]."""

FEWEST = 8
"""Least number of groups of bins about a mode for their correlation to be meaningful."""

REMEDIES = {
    "noise": "average more, or drive harder",
    "nonlinearity": "drive at half the voltage, and compare; if nothing changes, check the sensor's filters, and the "
    "window and the trigger of the records",
    "drift": "let the beam warm up, and scan again",
    "a missing mode": "measure with finer bins or at more points, or leave that band out",
    "nonlinearity or a missing mode": "drive at half the voltage, and compare, or measure with finer bins",
}
"""What to do about each cause."""


@dataclass(frozen=True)
class Rest:
    """The residual of a fit within one half-power bandwidth of a mode on either side.

    Attributes
    ----------
    share : float
        Its amplitude beyond the noise, relative to that of the responses [1].
    smooth : float
        The same for its part that is smooth over frequency, unlike noise [1].
    cause : str
        The most probable cause, a key of `REMEDIES`.
    """

    share: float
    smooth: float
    cause: str


def rest_about(problem: LeastSquaresProblem, fit: Evaluation, k: int, n_sets: int) -> Rest:
    """Return the residual of a fit about its mode `k`, with its most probable cause.

    For a nonlinear beam the residual over the responses has the mode's own shape; for a beam that drifts while its
    points are scanned from end to end, that shape times the position; for a missing mode, another shape.
    """
    n = problem.bins.start.size
    own = float(fit.natural_frequency[k])
    spacing = float(problem.bins.frequency[1] - problem.bins.frequency[0])
    near = np.abs(problem.bins.centre - own) <= 2 * max(float(fit.damping_ratio[k]) * own, spacing)
    left = (fit.rest[:n] + 1j * fit.rest[n:])[near]
    power = max(float((np.abs(problem.response[near]) ** 2).sum()), 1e-300)
    share = float(np.sqrt(max(float((np.abs(left) ** 2).sum()) - 2 * left.size, 0.0) / power))
    if left.shape[0] < FEWEST:
        return Rest(share, 0.0, "nonlinearity or a missing mode")
    shape = np.linalg.eigh((left.conj().T @ left).real)[1][:, -1]
    course = left @ shape
    neighbours = float((np.conj(course[:-1]) * course[1:]).real.sum())
    if neighbours < SMOOTH * float((np.abs(course) ** 2).sum()):
        return Rest(share, 0.0, "noise")
    smooth = float(np.sqrt(neighbours / power))
    if shape.size == n_sets:
        return Rest(share, smooth, "nonlinearity or a missing mode")
    residue = fit.residue[k].reshape(n_sets, -1)
    along = (residue * np.linspace(-1, 1, residue.shape[1])).ravel()
    residue = residue.ravel()
    along = along - residue * (along @ residue) / (residue @ residue)
    likeness = [float((shape @ each) ** 2 / (each @ each)) for each in (residue, along)]
    causes = ("nonlinearity", "drift")
    return Rest(share, smooth, causes[int(np.argmax(likeness))] if max(likeness) > ALIKE else "a missing mode")
