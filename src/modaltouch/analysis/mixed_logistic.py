"""Mixed logistic regression of choosing the dominant zone with statsmodels, with a check for separation."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from statistics import NormalDist
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.findings import Finding, finding_of
from modaltouch.analysis.intervals import CONFIDENCE, Interval
from modaltouch.analysis.models import model_table, terms_of_model

PRIOR_EFFECT, PRIOR_SPREAD = 5.0, 0.5
"""Standard deviations of the normal priors of the coefficients and the log of the random intercepts' SD [logit]."""

_NAME = "mixed logistic model, Laplace approximation"


def model_findings(answers: AnswerCounts, frame: pd.DataFrame) -> Iterator[Finding]:
    """Yield the coefficients of the mixed logistic model of choosing the dominant zone, without p values.

    If the predictors separate the answers, there is no finite estimate, and the model is not fitted.

    References
    ----------
    Albert and Anderson, Biometrika 71 (1984) 1-10; Konis, thesis, Oxford (2007) (separation by linear programming).
    """
    table = model_table(answers, frame).dropna(subset="dominant")
    columns = {"intercept": np.ones(len(table))}
    for term in terms_of_model(answers):
        if term == "level":
            columns[f"level, per {answers.scale.step_in_words}"] = table["level"].to_numpy()
            continue
        first, *others = sorted(set(table[term]))
        columns |= {f"{other} - {first}": (table[term] == other).to_numpy(dtype=float) for other in others}
    predictors, chosen = np.column_stack(list(columns.values())), table["dominant"].to_numpy(np.int64)
    names, n = list(columns), answers.n_participants
    reason, fitted = _separation(predictors, chosen, names), None
    if n < 2:
        reason = "only one participant, so participants cannot be distinguished"
    if not reason:
        fitted = _fit(predictors, chosen, table["participant"].to_numpy())
        reason = "" if fitted else "the fit did not converge"
    if fitted is None:
        nothing = Interval(math.nan, math.nan, math.nan, 0.0)
        yield finding_of("model", _NAME, "all", None, "log odds ratio", nothing, n, notes=[f"not fitted: {reason}"])
        return
    means, errors, spread = fitted
    half = NormalDist().inv_cdf(1 - (1 - CONFIDENCE) / 2)
    note = f"participants spread by {spread:.2g} logit; priors normal, {PRIOR_EFFECT:g} and {PRIOR_SPREAD:g} logit wide"
    for name, mean, error in zip(names, means, errors, strict=True):
        interval = Interval(mean, mean - half * error, mean + half * error, n)
        yield finding_of("model", _NAME, name, None, "log odds of the dominant zone", interval, n, notes=[note])


def _separation(predictors: NDArray[np.float64], chosen: NDArray[np.int64], names: list[str]) -> str:
    """Return the predictors that separate the answers; empty if none do."""
    from scipy.optimize import linprog

    if np.ptp(chosen) == 0:
        return "separation: all answers are alike"
    signed = predictors * np.where(chosen > 0, 1.0, -1.0)[:, np.newaxis]
    found = linprog(-signed.sum(axis=0), A_ub=-signed, b_ub=np.zeros(len(signed)), bounds=(-1, 1))
    if -found.fun < 1e-6:
        return ""
    told = [name for name, value in zip(names[1:], found.x[1:], strict=True) if abs(value) > 1e-6]
    return f"separation: the answers are split by {', '.join(told)}"


def _fit(
    predictors: NDArray[np.float64], chosen: NDArray[np.int64], participants: NDArray[Any]
) -> tuple[list[float], list[float], float] | None:
    """Return coefficients, posterior SDs and the SD of random intercepts [logit]; None without convergence."""
    from statsmodels.genmod.bayes_mixed_glm import BinomialBayesMixedGLM

    known, who = np.unique(participants, return_inverse=True)
    own = np.eye(len(known))[who]
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        model = BinomialBayesMixedGLM(
            chosen, predictors, own, np.zeros(len(known), dtype=int), vcp_p=PRIOR_SPREAD, fe_p=PRIOR_EFFECT
        )
        fitted = model.fit_map(rng=1)
    if any("converge" in str(each.message) for each in said) or not np.isfinite(fitted.fe_sd).all():
        return None
    return fitted.fe_mean.tolist(), fitted.fe_sd.tolist(), float(np.exp(fitted.vcp_mean[0]))
