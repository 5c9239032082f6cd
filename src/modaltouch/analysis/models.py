"""Mixed models, as often requested by reviewers: a tidy table, an R script that fits the models, and a fit here.

Models of zones require answers that name each finger alone; tidy models accept any answers, and ratings. The fit, by
statsmodels, is a mixed logistic regression of choosing the dominant zone, with a check for separation.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.columns import label_zones
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.findings import Finding, finding_of
from modaltouch.analysis.intervals import CONFIDENCE, Interval
from modaltouch.report import render_page

if TYPE_CHECKING:
    from modaltouch.analysis.designs import Question
    from modaltouch.analysis.responses import Responses


FACTORS = ("group", "session_kind", "stimulus", "finger_condition", "pair")


def answer_table(answers: AnswerCounts, frame: pd.DataFrame, asked: Sequence[Question] = ()) -> pd.DataFrame:
    """Return one row per answer with participant, factors, level and ratings, and the zone named if fingers compare.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers.
    frame : DataFrame
        Tidy answers; a column ``focus`` takes precedence over the focus of the counts.
    asked : sequence of Question
        Rating questions.
    """
    rows, scale = frame.loc[frame.index.repeat(frame["n"])], answers.scale
    rows, level = rows.assign(pair=label_zones(rows)), rows[scale.column].astype(float)
    named = [name for name in FACTORS if name in rows.columns and (rows[name] != "").any()]
    table = pd.DataFrame({
        **{name: rows[name].astype(str) for name in ("participant", *named)}, scale.column: level,
        "level": (level - (level.min() + level.max()) / 2) / scale.step,
        "response": rows["response"].astype(str),
        **({"interval": rows["interval"].astype(int)} if "interval" in rows.columns else {}),
        **{each.column: each.modelled(rows) for each in asked},
    })  # fmt: skip
    if answers.compares:
        side = table["response"].map({each.name: each.side for each in answers.answers if each.fingers})
        focus = rows["focus"] if "focus" in rows.columns else answers.focus
        is_dominant = side == np.where(rows["zone_right"].astype(str) == focus, 1, -1)
        table["zone"] = np.select([side == 0, is_dominant, side.notna()], ["both", "dominant", "other"], "")
        return table.assign(dominant=is_dominant.astype("Int64").where(side.notna()))
    if len(answers.answers) > 1:
        table["chosen"] = (table["response"] == answers.answers.names[0]).astype(int)
    return table


def terms_of(table: pd.DataFrame) -> list[str]:
    """Return the varying columns of the table, as terms of a model formula."""
    return [name for name in (*FACTORS, "level") if name in table and table[name].nunique() > 1]


def model_files(answers: AnswerCounts, responses: Responses) -> dict[str, Any]:
    """Return the tidy table and the R script of the models, by file name."""
    asked: Sequence[Question] = ()
    if responses.has_individual_results:
        from modaltouch.analysis.designs import questions_of

        asked = questions_of(responses.design, responses.frame)
    table = answer_table(answers, responses.by_choice().frame, asked)
    zones = [zone for zone in ("other", "both", "dominant") if zone != "both" or answers.both_place is not None]
    script = render_page(
        "modaltouch.analysis", "models.R.j2" if answers.compares else "tidy_models.R.j2",
        terms=" + ".join(terms_of(table)) or "1", words=[*map(str, table.select_dtypes(exclude="number"))], zones=zones,
        names=answers.answers.names, effect=answers.answers.names[0], asked=asked, scale=answers.scale,
    )  # fmt: skip
    return {"answers.csv": table.to_csv(index=False, lineterminator="\n"), "models.R": script}


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
    table = answer_table(answers, frame).dropna(subset="dominant")
    columns = {"intercept": np.ones(len(table))}
    # `models.R` has groups, labs, kinds of session and stimuli as well.
    for term in (each for each in terms_of(table) if each in ("finger_condition", "pair", "level")):
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
    note += "; how often this interval misses the true value has not been simulated"
    for name, mean, error in zip(names, means, errors, strict=True):
        interval = Interval(mean, mean - half * error, mean + half * error, n)
        yield finding_of("model", _NAME, name, None, "log odds of the dominant zone", interval, n, notes=[note])


def _separation(predictors: NDArray[np.float64], chosen: NDArray[np.int64], names: list[str]) -> str:
    from scipy.optimize import linprog

    if np.ptp(chosen) == 0:
        return "separation: all answers are alike"
    signed = predictors * np.where(chosen > 0, 1.0, -1.0)[:, np.newaxis]
    found = linprog(-signed.sum(axis=0), A_ub=-signed, b_ub=np.zeros(len(signed)), bounds=(-1, 1))
    if -found.fun < 1e-6:
        return ""
    separating = [name for name, value in zip(names[1:], found.x[1:], strict=True) if abs(value) > 1e-6]
    return f"separation: the answers are split by {', '.join(separating)}"


def _fit(
    predictors: NDArray[np.float64], chosen: NDArray[np.int64], participants: NDArray[Any]
) -> tuple[list[float], list[float], float] | None:
    """Return coefficients, posterior SDs and the SD of random intercepts [logit]; None without convergence."""
    from statsmodels.genmod.bayes_mixed_glm import BinomialBayesMixedGLM

    known, who = np.unique(participants, return_inverse=True)
    own = np.eye(len(known))[who]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = BinomialBayesMixedGLM(
            chosen, predictors, own, np.zeros(len(known), dtype=int), vcp_p=PRIOR_SPREAD, fe_p=PRIOR_EFFECT
        )
        fitted = model.fit_map(rng=1)
    if any("converge" in str(each.message) for each in caught) or not np.isfinite(fitted.fe_sd).all():
        return None
    return fitted.fe_mean.tolist(), fitted.fe_sd.tolist(), float(np.exp(fitted.vcp_mean[0]))
