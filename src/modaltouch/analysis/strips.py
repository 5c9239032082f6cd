"""Every participant's answer in every cell, as letters on colours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from modaltouch.analysis.counts import AnswerCounts, Pair
from modaltouch.analysis.words import say_condition

MOST_PARTICIPANTS = 40
"""Participants that one page of strips can show."""

ZONE_COLOURS = ("#a9c3ee", "#e6e9ee", "#f2b196")
"""Dominant zone, both, other zone: light enough for dark letters, also in print."""
OTHER_COLOURS = ("#f6e08a", "#a6dcc0", "#d7b9e0", "#9fe0f5", *ZONE_COLOURS)
"""Answers that name no zone; the last are left to zones where there are any."""
TIED, NOTHING = "#ffffff", "#c3c8d0"


@dataclass(frozen=True)
class Kind:
    """What a cell can hold: an answer, or a tie between repetitions (place -1); with its letter and colour."""

    place: int
    name: str
    letter: str
    colour: str


def kinds_of(answers: AnswerCounts, pair: Pair) -> list[Kind]:
    """Return what the cells of a pair can hold, in the order of the legend.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers.
    pair : Pair
        One of its pairs.
    """
    kinds = []
    if answers.compares:
        dominant, both, other = ZONE_COLOURS
        kinds = [Kind(answers.dominant_place(pair), "dominant zone", pair.dominant, dominant)]
        if (place := answers.both_place) is not None:
            kinds.append(Kind(place, answers.answers[place].name, "&", both))
        kinds.append(Kind(answers.other_place(pair), "other zone", pair.other, other))
    rest = {p: answers.answers[p].name for p in answers.felt if p not in {kind.place for kind in kinds}}
    # Two letters tell them apart, or else their places.
    is_clear = len({name[:2] for name in rest.values()}) == len(rest)
    letters = [name[:2] if is_clear else str(place + 1) for place, name in rest.items()]
    kinds += [Kind(*each) for each in zip(rest, rest.values(), letters, OTHER_COLOURS, strict=False)]
    kinds += [Kind(p, each.name, "–", NOTHING) for p, each in enumerate(answers.answers) if each.says_nothing_felt]
    return [*kinds, Kind(-1, "no answer, or a tie between repetitions", "?", TIED)]


def participant_strips(answers: AnswerCounts) -> dict[str, Any]:
    """Return each participant's most frequent answer in each cell, for a table of each finger condition.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers; the first `MOST_PARTICIPANTS` are taken.
    """
    modal = answers.modal()[:MOST_PARTICIPANTS]
    kinds = [kinds_of(answers, pair) for pair in answers.pairs]
    by_place = [{kind.place: kind for kind in own} for own in kinds]
    rows = {
        say_condition(condition): {
            name: [[by_place[q][place] for place in cells] for q, cells in enumerate(own[f].tolist())]
            for name, own in zip(answers.participants, modal, strict=False)
        }
        for f, condition in enumerate(answers.finger_conditions)
    }
    legend = [kind for kind in kinds[0] if kind.place >= 0 or (modal < 0).any()]
    return {"rows": rows, "legend": legend, "n_shown": len(modal)}
