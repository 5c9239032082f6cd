"""Whether a round of practice was passed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.trial import SIDES, Trial


@dataclass(frozen=True)
class Round:
    """One round of practice.

    Attributes
    ----------
    number : int
        Which round, from 1.
    n_judged : int
        Trials whose answer can be right or wrong.
    n_agreed : int
        Those answered as predicted.
    """

    number: int
    n_judged: int
    n_agreed: int

    def passes(self, criterion: float | None) -> bool:
        """Return whether the round meets a criterion: a share of the trials that can be judged, or None.

        Parameters
        ----------
        criterion : float or None
            Least share answered as predicted [1]; None is always met.
        """
        if criterion is None or self.n_judged == 0:
            return True
        return self.n_agreed >= criterion * self.n_judged - 1e-9


def judge_round(events: Iterable[Mapping[str, Any]], number: int, n_trials: int, protocol: Protocol) -> Round:
    """Return how a round of practice went, from the session's log.

    Parameters
    ----------
    events : iterable of dict
        Events of the session log.
    number : int
        Which round, from 1.
    n_trials : int
        Practice trials of a round.
    protocol : Protocol
        Tells which answer is right.
    """
    first, last = (number - 1) * n_trials + 1, number * n_trials
    judged: dict[int, bool] = {}
    for event in events:
        if event.get("event") != "trial" or not event["trial"]["practice"]:
            continue
        index, planned = event["trial"]["index"], event["planned"]
        speeds = [planned[name] for name in map("speed_{}_mm_s".format, SIDES[3]) if name in planned]
        expected = protocol.expected(Trial.from_dict(event["trial"]), speeds)
        if first <= index <= last and expected is not None:
            judged[index] = event["response"]["answer"] == expected
    return Round(number, len(judged), sum(judged.values()))
