r"""Fit of an observer to the answers in a results tree or a CSV by maximum likelihood, for planning the next study.

The likelihood of a participant's answers is the product of the probabilities of the single answers, averaged over the
population on a quasi-random grid. Priors are normal on the fitted scale and centred on a given observer, so parameters
that the answers do not determine keep its values.

Answers cannot determine:

- The scale. Multiplying noise, criterion, one plus the suppressions, side bias and its spread by a common factor
  changes no probability. Only ratios are identifiable: the speed ratio named half the time, exp(c / (1 + s)), and the
  noise of a compared log ratio, sigma / (1 + s). The priors fix the rest: this experiment measures neither suppression
  itself nor a Weber fraction separate from it.
- The front end, which is given. If all pairs of zones have the same ratio of speeds, or its inverse, a front end
  with another ratio fits equally well with another scale.
- Detection speed, internal noise and near miss, which are held fixed: they require levels near the threshold.
- Lapses separately from noise, unless some ratios are unmistakable.
- Spreads, with few participants or few answers of each.
- Reaction times, which are not fitted.

References
----------
Wichmann and Hill, Perception & Psychophysics 63 (2001) 1293-1313 (lapses and bias of fits without them).
Moscatelli, Mezzetti, Lacquaniti, J. Vision 12(11):26 (2012) (populations of psychometric functions).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis import AnswerCounts, Responses, TableFormat, read_responses
from modaltouch.planning.design import felt_speeds, of_analysed_kind, refuse_unlike
from modaltouch.planning.experiments import answer_shares
from modaltouch.planning.observer import FloatArray, Observer
from modaltouch.preflight import Preflight
from modaltouch.protocol import InputError

N_NODES = 512
"""Number of points for the average over the population."""

_LEAST_SHARE = 1e-9


@dataclass(frozen=True, eq=False)
class RecordedAnswers:
    """Answers to fit.

    Attributes
    ----------
    counts : (n_participants, n_cells, 3) array of int
        Counts of the answers left, both and right by participant and cell; left and right are those of the beam.
    speeds : (n_cells, 2) array
        Speeds felt by the left and the right finger in each cell [m/s].
    finger_conditions : tuple of str
        Finger condition of each cell.
    facing : (n_participants,) array
        1, or -1 for participants for whom the beam was turned end to end.
    offers_nothing : bool
        Whether nothing felt was among the answers; such answers are not counted.
    """

    counts: NDArray[np.int64]
    speeds: FloatArray
    finger_conditions: tuple[str, ...]
    facing: FloatArray
    offers_nothing: bool = False

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Concatenate the answers of the same participants to several stimuli along the cells."""
        return cls(
            counts=np.concatenate([part.counts for part in parts], axis=1),
            speeds=np.concatenate([part.speeds for part in parts]),
            finger_conditions=tuple(name for part in parts for name in part.finger_conditions),
            facing=parts[0].facing,
            offers_nothing=parts[0].offers_nothing,
        )


def log_likelihood(observer: Observer, recorded: RecordedAnswers) -> float:
    """Return the log likelihood of recorded answers, averaged over the population."""
    crowd = observer.participants_at(_grid())
    total = 0.0
    for side in np.unique(recorded.facing):
        left, right, *nothing = answer_shares(
            crowd, recorded.speeds, recorded.finger_conditions, side, offers_nothing=recorded.offers_nothing
        )
        felt = 1 - nothing[0] if nothing else 1.0
        shares = (np.stack([left, felt - left - right, right]) / felt).transpose(1, 2, 0).reshape(N_NODES, -1)
        own = recorded.counts[recorded.facing == side].reshape(-1, shares.shape[1])
        # einsum runs in one thread, so sums are the same in every process; the product is small.
        logs = np.einsum("pc,nc->pn", own.astype(float), np.log(np.maximum(shares, _LEAST_SHARE)))
        top = logs.max(axis=1, keepdims=True)
        total += float((top[:, 0] + np.log(np.exp(logs - top).mean(axis=1))).sum())
    return total


@lru_cache(maxsize=1)
def _grid() -> FloatArray:
    """Return quasi-random points of the population, (5, N_NODES) array of normal deviates; the pace is fixed."""
    from scipy.special import ndtri

    # The generalised golden ratio in four dimensions fills the cube evenly (Roberts 2018).
    ratio = 1.0
    for _ in range(50):
        ratio = (1 + ratio) ** (1 / 5)
    steps = ratio ** -np.arange(1.0, 5.0)
    cube = (0.5 + steps[:, None] * np.arange(1, N_NODES + 1)) % 1
    return np.concatenate([ndtri(cube), np.zeros((1, N_NODES))])


@dataclass(frozen=True)
class _Quantity:
    """A fitted parameter: its name in an observer, the scale of the fit, and the prior on that scale."""

    name: str
    of_typical: bool
    scale: str
    prior_deviation: float
    tied: bool

    def value(self, observer: Observer) -> float:
        return float(getattr(observer.typical if self.of_typical else observer, self.name))

    def is_free(self, observer: Observer) -> bool:
        top = 1 if self.scale == "logit" else math.inf
        return self.scale in ("plain", "log1p") or 0 < self.value(observer) < top


_TO_FIT: dict[str, Callable[[float], float]] = {
    "log": math.log,
    "log1p": math.log1p,
    "logit": lambda x: math.log(x / (1 - x)),
    "plain": float,
}
_FROM_FIT: dict[str, Callable[[float], float]] = {
    "log": math.exp,
    "log1p": math.expm1,
    "logit": lambda x: 1 / (1 + math.exp(-x)),
    "plain": float,
}

QUANTITIES = (
    _Quantity("noise", True, "log", 0.4, True),
    _Quantity("criterion", True, "log", 0.6, True),
    _Quantity("suppression", True, "log1p", 0.3, True),
    _Quantity("suppression_across_hands", True, "log1p", 0.3, True),
    _Quantity("side_bias", True, "plain", 0.3, True),
    _Quantity("lapse_rate", True, "logit", 1.2, False),
    _Quantity("side_bias_spread", False, "log", 0.7, True),
    _Quantity("noise_spread", False, "log", 0.5, False),
    _Quantity("criterion_spread", False, "log", 0.6, False),
    _Quantity("suppression_spread", False, "log", 0.5, False),
)
"""Parameters to fit; one at the end of its range in the given observer (such as a spread of 0) is held fixed."""


@dataclass(frozen=True)
class FittedParameter:
    """A fitted parameter with its 95 % interval.

    Attributes
    ----------
    name : str
        Name of the parameter.
    value, low, high : float
        Estimate and ends of the interval.
    learned : float
        Share of the prior variance removed by the answers [1]; near 0, the estimate is that of the prior.
    tied_to_scale : bool
        Whether it is identifiable only relative to the other tied parameters; the scale of its interval then comes
        from the priors, not the answers.
    """

    name: str
    value: float
    low: float
    high: float
    learned: float
    tied_to_scale: bool


@dataclass(frozen=True, eq=False)
class Fit:
    """An observer fitted to answers.

    Attributes
    ----------
    observer : Observer
        The most likely observer.
    parameters : tuple of FittedParameter
        Fitted parameters; see `learned` of each.
    identified : tuple of FittedParameter
        Combinations that the answers determine independently of the scale.
    log_likelihood : float
        Log likelihood of the answers, without the priors.
    n_answers, n_participants : int
        Number of answers, and of participants.
    converged : bool
        Whether the search ended at a maximum.
    responses : tuple of Responses
        Answers to each stimulus, as read.
    """

    not_identifiable: ClassVar[str] = (
        "Noise, criterion, one plus suppression, side bias and its spread are known only relative to each other; their "
        "scale is the prior's. The front end, detection speed, internal noise and near miss are taken from the given "
        "observer, not fitted; nor are reaction times. Lapses can be separated from noise only where some ratios "
        "of speeds are unmistakable."
    )

    observer: Observer
    parameters: tuple[FittedParameter, ...]
    identified: tuple[FittedParameter, ...]
    log_likelihood: float
    n_answers: int
    n_participants: int
    converged: bool
    responses: tuple[Responses, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return all results as plain values, as printed by ``modaltouch fit --json``."""
        return {
            "observer": self.observer.as_dict(),
            "parameters": [asdict(estimate) for estimate in self.parameters],
            "identified": [asdict(estimate) for estimate in self.identified],
            "not_identifiable": self.not_identifiable,
            "log_likelihood": self.log_likelihood,
            "converged": self.converged,
            "n_answers": self.n_answers,
            "n_participants": self.n_participants,
            # Excluded sessions are the same for all stimuli.
            "left_out": [{"source": item.source, "reason": item.reason} for item in self.responses[0].left_out],
        }


def fit_observer(recorded: RecordedAnswers, prior: Observer) -> Fit:
    """Fit an observer to recorded answers."""
    from scipy.optimize import minimize

    fitted = [quantity for quantity in QUANTITIES if quantity.is_free(prior)]
    centre = np.array([_TO_FIT[quantity.scale](quantity.value(prior)) for quantity in fitted])
    deviation = np.array([quantity.prior_deviation for quantity in fitted])

    def cost(point: FloatArray) -> float:
        off = (point - centre) / deviation
        return float(off @ off) / 2 - log_likelihood(_observer_at(prior, fitted, point), recorded)

    bounds = [(0.0, None) if quantity.scale == "log1p" else (None, None) for quantity in fitted]
    found = minimize(cost, centre, method="L-BFGS-B", bounds=bounds, options={"maxiter": 300, "ftol": 1e-10})
    point = np.asarray(found.x)
    covariance = _covariance(cost, point, deviation)
    observer = replace(_observer_at(prior, fitted, point), name="")
    parameters = tuple(
        _estimate(q.name, _FROM_FIT[q.scale], point[i], covariance[i, i], deviation[i] ** 2)
        for i, q in enumerate(fitted)
    )
    names = [quantity.name for quantity in fitted]
    return Fit(
        observer=observer,
        parameters=parameters,
        identified=tuple(_identified(names, point, covariance, deviation, recorded.finger_conditions)),
        log_likelihood=log_likelihood(observer, recorded),
        n_answers=int(recorded.counts.sum()),
        n_participants=len(recorded.facing),
        converged=bool(found.success),
    )


def _observer_at(prior: Observer, fitted: Sequence[_Quantity], point: ArrayLike) -> Observer:
    values = np.asarray(point, dtype=float).tolist()
    natural = {q.name: max(_FROM_FIT[q.scale](x), 0.0) if q.scale == "log1p" else _FROM_FIT[q.scale](x)
               for q, x in zip(fitted, values, strict=True)}  # fmt: skip
    of_typical: dict[str, Any] = {q.name: natural[q.name] for q in fitted if q.of_typical}
    of_observer: dict[str, Any] = {q.name: natural[q.name] for q in fitted if not q.of_typical}
    return replace(prior, typical=replace(prior.typical, **of_typical), **of_observer)


def _covariance(cost: Callable[[FloatArray], float], point: FloatArray, deviation: FloatArray) -> FloatArray:
    from statsmodels.tools.numdiff import approx_hess3

    scaled = approx_hess3(np.zeros(point.size), lambda step: cost(point + step * deviation), 0.05)
    values, vectors = np.linalg.eigh(scaled)
    # In units of the prior, the curvature is at least 1; less is numerical noise.
    inverse = (vectors / np.maximum(values, 1.0)) @ vectors.T
    return np.asarray(inverse * np.outer(deviation, deviation))


def _estimate(
    name: str, natural: Callable[[float], float], middle: float, variance: float, prior_variance: float
) -> FittedParameter:
    reach = 1.959964 * math.sqrt(max(variance, 0.0))
    learned = min(max(1 - float(variance) / float(prior_variance), 0.0), 1.0)
    ends = (natural(middle - reach), natural(middle + reach))
    if natural is math.expm1:
        ends = (max(ends[0], 0.0), ends[1])
    tied = any(quantity.tied and quantity.name == name for quantity in QUANTITIES)
    return FittedParameter(name, natural(middle), *ends, learned, tied)


def _identified(
    names: Sequence[str],
    point: FloatArray,
    covariance: FloatArray,
    deviation: FloatArray,
    finger_conditions: Sequence[str],
) -> list[FittedParameter]:
    """Return the combinations that are invariant under a change of scale."""
    found = []
    suppressions = {"one_hand": "suppression", "two_hands": "suppression_across_hands"}
    for kind in dict.fromkeys(finger_conditions):
        for words, first in (("speed ratio named half the time", "criterion"), ("noise of the log ratio", "noise")):
            if first not in names:
                continue
            direction = np.zeros(point.size)
            direction[names.index(first)] = 1.0
            direction[names.index(suppressions[kind])] = -1.0
            natural = (lambda x: math.exp(math.exp(x))) if first == "criterion" else math.exp
            variance, before = float(direction @ covariance @ direction), float(direction**2 @ deviation**2)
            found.append(_estimate(f"{words}, {kind}", natural, float(direction @ point), variance, before))
    return found


def fit_answers(
    preflight: Preflight,
    path: Path,
    prior: Observer,
    *,
    mode: str | None = None,
    words: tuple[Mapping[str, str], tuple[str, ...]] = ({}, ()),
) -> Fit:
    """Fit an observer to recorded answers, jointly to all stimuli if there are several.

    Parameters
    ----------
    preflight : Preflight
        The checked protocol of the answers, which determines the felt speeds.
    path : Path
        A results folder or a tidy CSV.
    prior : Observer
        Centre of the priors, and front end.
    mode : {"real", "pilot", "simulated"}, optional
        Which sessions of a results tree to use.
    words : (dict of str to str, tuple of str)
        Answers for the words of a CSV, and words that stand for no answer.

    Raises
    ------
    InputError
        If the protocol or the answers cannot be used, or the answers name a zone that the beam does not have.
    """
    _refuse_adaptive(path, is_adaptive=preflight.experiment.protocol.adaptive is not None)
    preflight = of_analysed_kind(preflight)
    refuse_unlike(preflight, "see these answers with `modaltouch analyse`")
    if preflight.findings.measured:
        raise InputError(
            [
                preflight.findings.problem(
                    ("stimulus", "fingers"),
                    "measured, so each participant felt different speeds",
                    "fingers that are the same for all",
                    "see `modaltouch analyse --speed predicted`",
                )
            ]
        )
    is_table = any(words) or (path.is_file() and path.suffix != ".jsonl")
    # An observer is a function of speed, so a pilot at other levels informs about it as well.
    table_format = replace(TableFormat.of(preflight.findings, *words), is_pilot=True) if is_table else None
    taken = {
        name: read_responses(path, mode=mode, stimulus=name or None, table_format=table_format)
        for name in preflight.parts
    }
    counted = _of_everybody([_count(part, path, taken[name]) for name, part in preflight.parts.items()])
    felt = (felt_speeds(part, prior.front_end) for part in preflight.parts.values())
    recorded = [*map(_record, counted, felt)]
    return replace(fit_observer(RecordedAnswers.joined(recorded), prior), responses=tuple(taken.values()))


def _refuse_adaptive(path: Path, *, is_adaptive: bool) -> None:
    if is_adaptive:
        given, remedy = "adaptive sessions, which have no table of counts", "see them with `modaltouch analyse`"
        raise InputError.of(path, given, "sessions with fixed levels", remedy)


def _count(preflight: Preflight, path: Path, responses: Responses) -> AnswerCounts:
    """Count the answers to one stimulus; refuse zones that the beam does not have."""
    experiment, remedy = preflight.experiment, "give the protocol that these answers belong to"
    _refuse_adaptive(path, is_adaptive=responses.is_adaptive)
    if responses.in_multiples:
        raise InputError.of(
            path,
            "sessions with levels calibrated by participant, so each felt different velocities",
            "sessions with the same levels for all",
        )
    answers = responses.count(experiment.protocol.stimulus.focus)
    zones = experiment.apparatus.zones
    for zone in dict.fromkeys(zone for pair in answers.pairs for zone in (pair.left, pair.right)):
        if zone not in zones:
            raise InputError.of(path, f"answers about the zone {zone!r}", ", ".join(zones), remedy)
    return answers


def _of_everybody(counted: Sequence[AnswerCounts]) -> Iterator[AnswerCounts]:
    """Yield counts with the same participants for each stimulus; in a table, some may lack answers to one."""
    people = tuple(dict.fromkeys(who for answers in counted for who in answers.participants))
    mirrored = frozenset(who for answers in counted for who in answers.mirrored)
    for answers in counted:
        counts = np.zeros((len(people), *answers.counts.shape[1:]), dtype=np.int64)
        counts[[people.index(who) for who in answers.participants]] = answers.counts
        yield replace(answers, participants=people, counts=counts, mirrored=mirrored)


def _record(answers: AnswerCounts, felt: Callable[[str, str, str, float], tuple[float, float]]) -> RecordedAnswers:
    """Return counts in the form used by the fit, without answers that name no finger."""
    speeds = [
        felt(condition, pair.left, pair.right, level * 1e-3)
        for condition in answers.finger_conditions
        for pair in answers.pairs
        for level in answers.levels
    ]
    return RecordedAnswers(
        counts=answers.compared().reshape(answers.n_participants, -1, 3),
        speeds=np.array(speeds),
        finger_conditions=tuple(
            name for name in answers.finger_conditions for _ in range(len(speeds) // len(answers.finger_conditions))
        ),
        facing=answers.facing.astype(float),
        offers_nothing=answers.has_none_answer,
    )
