"""What the answers of a design mean: which interval they name, whether they say same or different, what is rated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import pandas as pd

from modaltouch.protocol import AnswerList

COMPARISON, STANDARD = "comparison", "standard"
CORRECT, INCORRECT = "correct", "incorrect"


@dataclass(frozen=True)
class TrialTask:
    """What a trial asks.

    Attributes
    ----------
    n_intervals : int
        Stimuli in sequence; 1 where there is one alone.
    named : dict of str to int
        Interval that each answer names, from 1.
    different, same : frozenset of str
        Answers that say that the stimuli of a trial differ, and that they do not.
    standard : float
        Level of the stimulus in the other intervals [mm/s]; 0 where nothing is driven in them, not a number where it
        is that of the comparison.
    stimulus : str
        Which of several stimuli it is; empty where it is that of the comparison.
    asks_stronger : bool
        Whether the interval of the higher level is the right answer; else that of the comparison.
    places : tuple of int
        Intervals in which the comparison may stand; empty for all.
    """

    n_intervals: int = 1
    named: Mapping[str, int] = field(default_factory=dict)
    different: frozenset[str] = frozenset()
    same: frozenset[str] = frozenset()
    standard: float = 0.0
    stimulus: str = ""
    asks_stronger: bool = False
    places: tuple[int, ...] = ()

    @classmethod
    def of(cls, design: Mapping[str, Any]) -> TrialTask:
        """Return the task of a protocol, as a record keeps it.

        Parameters
        ----------
        design : mapping
            The protocol's sections.
        """
        section, meant = design.get("intervals") or {}, (design.get("answers") or {}).get("intervals") or {}
        if not section:
            return cls()
        standard, level = section["standard"], section["standard"].get("velocity_mm_s")
        return cls(
            int(section["number"]),
            {name: int(place) for name, place in meant.items() if place not in ("same", "different")},
            frozenset(name for name, place in meant.items() if place == "different"),
            frozenset(name for name, place in meant.items() if place == "same"),
            math.nan if level is None else float(level),
            str(standard.get("stimulus") or ""),
            section.get("asked") == "stronger",
            tuple(section.get("comparison_in") or ()),
        )

    def turns(self, level: float) -> bool:
        """Return whether the right answer at a level is the standard's interval, not that of the comparison."""
        return self.asks_stronger and self.n_intervals == 2 and level < self.standard

    def tells(self, level: float) -> bool:
        """Return whether an answer at a level is right or wrong, not one of several that are both the stronger."""
        return not self.asks_stronger or level > self.standard or self.turns(level)

    def told(self, frame: pd.DataFrame, level: str) -> pd.DataFrame:
        """Return the answers that say something of the intervals; all where none can.

        Parameters
        ----------
        frame, level
            As for `is_same`; of three intervals two are the stronger where the comparison is the weaker one.
        """
        words = self.different | self.same if self.different else self.named.keys()
        if not words:
            return frame
        is_open = self.asks_stronger and self.n_intervals > 2
        return frame[frame["response"].isin(words) & ~((frame[level] < self.standard) & is_open)]

    @property
    def why_no_d_prime(self) -> str:
        """Why no model gives a d' for which interval was named, or for same and different; else empty."""
        if self.n_intervals == 3 and self.different:
            return "whether three intervals are the same: the differencing model is for two"
        if self.n_intervals == 3 and len(self.places or self.named) < 3:
            return "a comparison in only some of the three intervals: the models assume all three"
        return ""

    @property
    def seeks_odd(self) -> bool:
        """Whether the odd one of three is asked for, whichever way it differs."""
        return self.n_intervals == 3 and not self.asks_stronger and not self.detects

    def is_same(self, frame: pd.DataFrame, level: str) -> pd.Series:
        """Return in which trials the comparison is the standard.

        Parameters
        ----------
        frame : DataFrame
            Tidy answers.
        level : str
            Column of the levels.
        """
        alike = (frame[level] == self.standard) | math.isnan(self.standard)
        return alike & (frame["stimulus"] == self.stimulus) if self.stimulus and "stimulus" in frame.columns else alike

    @property
    def detects(self) -> bool:
        """Whether the other intervals are silent, so that one answer is correct at any level."""
        return self.standard == 0

    @property
    def words(self) -> tuple[str, str]:
        """What an answer that names the interval of the comparison is called, and any other."""
        return (CORRECT, INCORRECT) if self.detects else (COMPARISON, STANDARD)

    def by_choice(self, frame: pd.DataFrame, answers: AnswerList) -> tuple[pd.DataFrame, AnswerList]:
        """Return answers by what they choose, and all that can be: the comparison or the standard, or correct or not.

        Parameters
        ----------
        frame : DataFrame
            Tidy answers; those that name no interval stay.
        answers : AnswerList
            What could be answered.
        """
        place, named = frame["interval"].astype(int), frame["response"].astype(str).map(self.named)
        chosen = frame["response"].astype(str).where(named.isna(), self.words[1]).where(named != place, self.words[0])
        names = [*self.words, *(name for name in answers.names if name not in self.named)]
        return frame.assign(response=pd.Categorical(chosen, names)), AnswerList.of({"keys": names})
