"""Results of rounds of practice."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.trial import SIDES, Trial


@dataclass(frozen=True)
class Round:
    """Result of a round of practice: number of trials with an expected answer, and of those answered so."""

    n_judged: int
    n_agreed: int

    def passes(self, criterion: float | None) -> bool:
        """Test whether the round meets a criterion."""
        return criterion is None or self.n_agreed >= criterion * self.n_judged - 1e-9


def judge_round(events: Iterable[Mapping[str, Any]], number: int, n_trials: int, protocol: Protocol) -> Round:
    """Return the result of a round of practice, from 1, of `n_trials` each, from the events of the session log."""
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
    return Round(len(judged), sum(judged.values()))
