"""Whether natural frequencies are those of a free-free beam: their ratios, by Euler and Bernoulli or by Timoshenko."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.shapes import characteristic_root

FloatArray = NDArray[np.float64]

WITHIN = 0.005
"""Largest deviation from the ratios of a free-free beam by which they count as recognised [1]."""

FEWEST = 3
"""Natural frequencies that it takes to recognise a beam; one more where shear and inertia are free."""


@dataclass(frozen=True)
class FreeFree:
    """The free-free beam that natural frequencies fit best.

    Attributes
    ----------
    first_frequency : float
        Of its first bending mode [Hz].
    shear : float
        How much shear and rotary inertia lower its modes, of the order (h/L)^2; 0 by Euler and Bernoulli [1].
    mode : tuple of (int or None)
        Bending mode of each natural frequency, from 1; None for what is none.
    deviation : float
        Largest relative deviation of the natural frequencies that are bending modes [1].
    recognised : bool
        Whether they are a free-free beam's.
    """

    first_frequency: float
    shear: float
    mode: tuple[int | None, ...]
    deviation: float
    recognised: bool


def roots(n: int) -> FloatArray:
    """Return the first roots of cos(x) cosh(x) = 1 above 0, (n,) array [1]."""
    return np.array([characteristic_root(k) for k in range(1, n + 1)])


def recognise(natural_frequency: Sequence[float]) -> FreeFree | None:
    r"""Return the free-free beam that natural frequencies fit best; None for fewer than three.

    By Euler and Bernoulli :math:`f_n \propto \lambda_n^2`. Shear and rotary inertia lower it by a factor that is
    :math:`1/\sqrt{1 + s \lambda_n^2}` to first order in s, the squared slenderness times a constant of the section. The
    lowest frequency is tried as each of the first three bending modes; others may be of torsion or across.

    Parameters
    ----------
    natural_frequency : sequence of float
        Increasing [Hz].
    """
    measured = np.asarray(natural_frequency, dtype=float)
    if measured.size < FEWEST:
        return None
    square = roots(measured.size + 8) ** 2
    tried = [
        _fit(measured, first, mode, float(shear), square)
        for first in range(min(3, measured.size))
        for mode in range(3)
        for shear in np.concatenate([[0.0], np.geomspace(1e-5, 1e-2, 121)])
    ]
    return max(tried, key=_worth)


def _fit(measured: FloatArray, first: int, mode: int, shear: float, square: FloatArray) -> FreeFree:
    """Return the beam of which one frequency is a given bending mode."""
    course = square / np.sqrt(1 + shear * square)
    ratio = measured[:, None] / measured[first] * course[mode] / course
    nearest = np.abs(np.log(ratio)).argmin(axis=1)
    # The scale that suits all that fit, instead of that of one alone.
    fits = np.abs(ratio[np.arange(measured.size), nearest] - 1) <= WITHIN
    scale = float(np.median(measured[fits] / course[nearest[fits]]))
    off = np.abs(measured / (scale * course[nearest]) - 1)
    fits = off <= WITHIN
    labels = [int(k) + 1 if fit else None for k, fit in zip(nearest, fits, strict=True)]
    found = [label for label in labels if label is not None]
    enough = FEWEST if shear == 0 else FEWEST + 1
    # Successive modes, each once: many high ones match anything.
    successive = len(set(found)) == len(found) and bool(found) and max(found) - min(found) + 1 <= len(found) + 1
    deviation = float(off[fits].max()) if fits.any() else 1.0
    recognised = successive and len(found) >= enough and 2 * len(found) > measured.size
    return FreeFree(scale * float(course[0]), shear, tuple(labels), deviation, recognised)


def _worth(tried: FreeFree) -> tuple[bool, int, float]:
    """Rank what was tried: recognised, with many modes, near them; shear and inertia only where they are needed."""
    n_found = sum(mode is not None for mode in tried.mode)
    return tried.recognised, n_found, -tried.deviation - (WITHIN / 2 if tried.shear > 0 else 0.0)
