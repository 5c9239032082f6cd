"""Fit of an observer to the answers in a results tree or a CSV, for planning the next study."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from modaltouch.analysis import AnswerCounts, Responses, TableFormat, read_responses
from modaltouch.planning.observer import Observer
from modaltouch.planning.observer.fit import Fit, RecordedAnswers, fit_observer
from modaltouch.planning.presented import felt_speeds, refuse_unlike
from modaltouch.preflight import Preflight
from modaltouch.protocol import InputError


@dataclass(frozen=True, eq=False)
class Fitted:
    """An observer fitted to recorded answers.

    Attributes
    ----------
    fit : Fit
        The fit.
    responses : tuple of Responses
        Answers to each stimulus.
    n_participants : int
        Number of participants.
    """

    not_identifiable: ClassVar[str] = (
        "Noise, criterion, one plus suppression, side bias and its spread are known only relative to each other; their "
        "scale is the prior's. The front end, detection speed, internal noise and near miss are taken from the given "
        "observer, not fitted; nor are reaction times. Lapses can be separated from noise only where some ratios "
        "of speeds are unmistakable."
    )

    fit: Fit
    responses: tuple[Responses, ...]
    n_participants: int

    def as_dict(self) -> dict[str, Any]:
        """Return all results as plain values, as printed by ``modaltouch fit --json``."""
        return {
            "observer": self.fit.observer.as_dict(),
            "parameters": [asdict(estimate) for estimate in self.fit.parameters],
            "identified": [asdict(estimate) for estimate in self.fit.identified],
            "not_identifiable": self.not_identifiable,
            "log_likelihood": self.fit.log_likelihood,
            "converged": self.fit.converged,
            "n_answers": self.fit.n_answers,
            "n_participants": self.n_participants,
            # Excluded sessions are the same for all stimuli.
            "left_out": [{"source": item.source, "reason": item.reason} for item in self.responses[0].left_out],
        }


def fit_answers(preflight: Preflight, path: Path, prior: Observer, *, mode: str | None = None) -> Fitted:
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

    Raises
    ------
    InputError
        If the protocol or the answers cannot be used, or the answers name a zone that the beam does not have.
    """
    _refuse_adaptive(path, is_adaptive=preflight.experiment.protocol.adaptive is not None)
    refuse_unlike(preflight)
    is_table = path.is_file() and path.suffix != ".jsonl"
    if is_table and preflight.variants:
        raise InputError.of(
            path,
            "a CSV file, which does not say which stimulus an answer belongs to",
            f"sessions with {', '.join(preflight.variants)}",
            "give the sessions themselves",
        )
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
    offered = preflight.experiment.protocol.answers.offered
    taken = {
        name: read_responses(
            path, mode=mode, stimulus=name or None, table_format=TableFormat(offered) if is_table else None
        )
        for name in preflight.parts
    }
    recorded = [
        _record(_count(part, path, taken[name]), felt_speeds(part, prior.front_end))
        for name, part in preflight.parts.items()
    ]
    # Every session presents all stimuli, so the participants are the same for each.
    return Fitted(fit_observer(RecordedAnswers.joined(recorded), prior), tuple(taken.values()), len(recorded[0].facing))


def _refuse_adaptive(path: Path, *, is_adaptive: bool) -> None:
    if is_adaptive:
        raise InputError.of(
            path,
            "adaptive sessions, which have no table of counts",
            "sessions with fixed levels",
            "see them with `modaltouch analyse`",
        )


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
            known = ", ".join(zones)
            raise InputError.of(path, f"answers about the zone {zone!r}", known, remedy)
    return answers


def _record(answers: AnswerCounts, felt: Callable[[str, str, str, float], tuple[float, float]]) -> RecordedAnswers:
    """Return counts in the form used by the fit, without answers that name no finger."""
    speeds = [
        felt(condition, pair.left, pair.right, level * 1e-3)
        for condition in answers.finger_conditions
        for pair in answers.pairs
        for level in answers.levels
    ]
    n_each = len(answers.pairs) * len(answers.levels)
    return RecordedAnswers(
        counts=answers.compared().reshape(answers.n_participants, -1, 3),
        speeds=np.array(speeds),
        finger_conditions=tuple(name for name in answers.finger_conditions for _ in range(n_each)),
        facing=answers.facing.astype(float),
    )
