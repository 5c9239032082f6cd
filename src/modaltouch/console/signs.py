"""What an experimenter should look into while there is time: read from the record's trial events alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from modaltouch.practice import expected_answer

HASTY = 0.1
"""Nobody feels, decides and presses within this time: such an answer was ready before its question [s]."""
_FEWEST = 6
"""Fewer departures to one side say nothing."""
_LEVEL = 0.01
"""Level of the sign test; looked at after every answer, so this is a hint and no result [1]."""
_SIDES = {"left": -1, "both": 0, "right": 1}


def read_signs(trials: Sequence[dict[str, Any]], *, offers_none: bool = False) -> list[str]:
    """Return what is worth a look, in words; empty where nothing is.

    Parameters
    ----------
    trials : sequence of dict
        The trial events that count, practice left out.
    offers_none : bool
        Whether ``none`` can be answered: else no catch trial can be told from a real one.
    """
    missed = _count_missed(trials) if offers_none else ""
    signs = [find_side_bias(trials), _count_hasty(trials), missed, _count_doubles(trials)]
    return [sign for sign in signs if sign]


def find_side_bias(trials: Sequence[dict[str, Any]]) -> str:
    """Return to which side the answers lean, by a binomial test; empty if they do not.

    Each answer is compared with the one that the predicted speeds ask for: `left` for `both` and `both` for
    `right` are departures to the left. Without a bias they go to a side as often as trials leave room there: from
    `right` an answer can only depart to the left, so a run of one pair after the other, or one pair alone, tells none.
    """
    left = right = room_left = room_right = 0
    for event in trials:
        planned = event.get("planned", {})
        speeds = (planned.get("speed_left_mm_s", 0.0), planned.get("speed_right_mm_s", 0.0))
        answer, expected = event["response"]["answer"], expected_answer(*speeds)
        if answer in _SIDES and expected is not None and not is_catch(event):
            step = _SIDES[answer] - _SIDES[expected]
            left, right = left + (step < 0), right + (step > 0)
            room_left, room_right = room_left + (expected != "left"), room_right + (expected != "right")
    n = left + right
    if n < _FEWEST:
        return ""
    on_left = room_left / (room_left + room_right)
    side, more, share = ("left", left, on_left) if left > n * on_left else ("right", right, 1 - on_left)
    tail = math.fsum(math.comb(n, k) * share**k * (1 - share) ** (n - k) for k in range(more, n + 1))
    if 2 * tail > _LEVEL:
        return ""
    return f"answers lean to the {side}: {more} of {n} departures from what was predicted"


def is_hasty(event: dict[str, Any]) -> bool:
    """Return whether a trial was answered before anybody could have felt and decided."""
    response = event["response"]
    since = response["reaction_time"]
    if response.get("onset") == "first_burst" and response.get("question_after") is not None:
        since -= response["question_after"]
    return bool(since < HASTY)


def is_catch(event: dict[str, Any]) -> bool:
    """Return whether nothing was presented in a trial."""
    return bool(event["trial"]["condition"]["velocity_mm_s"] == 0)


def _count_hasty(trials: Sequence[dict[str, Any]]) -> str:
    hasty = [event["trial"]["index"] for event in trials if is_hasty(event)]
    if not hasty:
        return ""
    return f"{_times(len(hasty))} answered within {HASTY * 1e3:.0f} ms of the question, last in trial {hasty[-1]}"


def _count_missed(trials: Sequence[dict[str, Any]]) -> str:
    caught = [event for event in trials if is_catch(event)]
    missed = [event["trial"]["index"] for event in caught if event["response"]["answer"] != "none"]
    if not missed:
        return ""
    return f"{len(missed)} of {len(caught)} catch trials felt as real, last trial {missed[-1]}"


def _count_doubles(trials: Sequence[dict[str, Any]]) -> str:
    doubles = [event["trial"]["index"] for event in trials if event["response"].get("double")]
    return f"{_times(len(doubles))} two answers at once, last in trial {doubles[-1]}" if doubles else ""


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
