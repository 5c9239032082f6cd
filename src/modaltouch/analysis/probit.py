"""Ordered probit of left < both < right, told apart from a fit that separation has broken.

References
----------
McCullagh, "Regression models for ordinal data", J. R. Stat. Soc. B 42 (1980) 109-142.
Albert and Anderson, Biometrika 71 (1984) 1-10 (separation).
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.analysis.intervals import CONFIDENCE, Interval

FEW = 30
"""Participants below which clustered standard errors are known to be too small."""

LARGEST = 10.0
"""A coefficient or standard error beyond this is taken as a sign of separation (probit units)."""


@dataclass(frozen=True)
class ProbitFit:
    """An ordered probit fit.

    Attributes
    ----------
    slope : Interval
        Coefficient with its interval over participants; not a number where it cannot be estimated.
    separated : bool
        Whether separation, or lack of variation, made the fit meaningless.
    note : str
        What a reader must know.
    """

    slope: Interval
    separated: bool
    note: str


def fit_ordered_probit(predictor: ArrayLike, answers: ArrayLike, participants: ArrayLike) -> ProbitFit:
    """Return the ordered probit of answers on one predictor, errors clustered by participant; never a p value.

    Parameters
    ----------
    predictor : (n,) array
        Predictor, finite.
    answers : (n,) array of int
        0 left, 1 both, 2 right.
    participants : (n,) array
        Who answered.
    """
    x, y = np.asarray(predictor, dtype=float), np.asarray(answers, dtype=int)
    _, groups = np.unique(np.asarray(participants), return_inverse=True)
    reason = _unfit(x, y, groups)
    if reason:
        return ProbitFit(Interval(math.nan, math.nan, math.nan, 0.0), True, f"not estimable: {reason}")
    slope, error = _maximise(x, y, groups)
    if not (math.isfinite(slope) and math.isfinite(error)) or abs(slope) > LARGEST or error > LARGEST:
        note = f"not estimable: separation (coefficient {slope:.3g}, standard error {error:.3g})"
        return ProbitFit(Interval(math.nan, math.nan, math.nan, 0.0), True, note)
    from statistics import NormalDist

    half = NormalDist().inv_cdf(1 - (1 - CONFIDENCE) / 2) * error
    n = int(groups.max()) + 1
    note = f"secondary model; standard error {error:.2g} clustered over {n} participants"
    note += f", which is too small for fewer than {FEW} of them" if n < FEW else ""
    return ProbitFit(Interval(slope, slope - half, slope + half, n), False, note)


def _unfit(x: np.ndarray, y: np.ndarray, groups: np.ndarray) -> str:
    if not np.isfinite(x).all():
        return "a speed ratio is zero or not a number"
    if np.ptp(x) == 0:
        return "all ratios are the same"
    if len(np.unique(y)) < 2:
        return "all answers are the same"
    if len(np.unique(groups)) < 2:
        return "one participant only"
    # Complete or quasi-complete separation along one predictor: sorted by x, the answers are sorted too.
    for sign in (1, -1):
        cuts = np.unique(y)[1:]
        if any((sign * x[y >= cut]).min() >= (sign * x[y < cut]).max() for cut in cuts):
            return "the predictor separates the answers"
    return ""


def _maximise(x: np.ndarray, y: np.ndarray, groups: np.ndarray) -> tuple[float, float]:
    from statsmodels.miscmodels.ordinal_model import OrderedModel

    codes = np.unique(y, return_inverse=True)[1]
    with warnings.catch_warnings():
        # What a broken fit warns of is judged below by its numbers, which are said in the note.
        warnings.simplefilter("ignore")
        fit: Any = OrderedModel(codes, x[:, np.newaxis], distr="probit").fit(
            method="bfgs", disp=False, maxiter=200, cov_type="cluster", cov_kwds={"groups": groups}
        )
    if not fit.mle_retvals.get("converged", False):
        return math.nan, math.nan
    return float(fit.params[0]), float(fit.bse[0])
