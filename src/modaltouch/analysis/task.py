"""What the answers of a design mean: which interval they name, or whether they say same or different."""

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
    """What a trial asks of the participant.

    Attributes
    ----------
    n_intervals : int
        Number of intervals.
    named : dict of str to int
        Interval that each answer names, from 1.
    different, same : frozenset of str
        Answers that say that the stimuli of a trial differ, and that they do not.
    standard : float
        Level of the standard [mm/s]; 0 if nothing is driven in its intervals, NaN if it is the level of the comparison.
    stimulus : str
        Stimulus of the standard; empty if it is that of the comparison.
    asks_stronger : bool
        Whether the interval of the higher level is the right answer; else that of the comparison.
    places : tuple of int
        Intervals that may hold the comparison; empty for all.
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
        """Return the task of a protocol.

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
        """Return whether the right answer at a level is the interval of the standard, not of the comparison."""
        return self.asks_stronger and self.n_intervals == 2 and level < self.standard

    def tells(self, level: float) -> bool:
        """Return whether an answer at a level is right or wrong; it is neither if two intervals are equally strong."""
        return not self.asks_stronger or level > self.standard or self.turns(level)

    def told(self, frame: pd.DataFrame, level: str) -> pd.DataFrame:
        """Return the answers that say something about the intervals; all if none can.

        If the stronger of three intervals is asked for, trials whose comparison is below the standard say nothing.

        Parameters
        ----------
        frame, level
            As for `is_same`.
        """
        words = self.different | self.same if self.different else self.named.keys()
        if not words:
            return frame
        is_open = self.asks_stronger and self.n_intervals > 2
        return frame[frame["response"].isin(words) & ~((frame[level] < self.standard) & is_open)]

    @property
    def no_d_prime_reason(self) -> str:
        """Why no model gives a d' for the interval named, or for same and different; empty if one does."""
        if self.n_intervals == 3 and self.different:
            return "whether three intervals are the same: the differencing model is for two"
        if self.n_intervals == 3 and len(self.places or self.named) < 3:
            return "a comparison in only some of the three intervals: the models assume all three"
        return ""

    def is_same(self, frame: pd.DataFrame, level: str) -> pd.Series:
        """Return in which trials the comparison equals the standard.

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
        """Words for an answer that names the interval of the comparison, and for one that names another."""
        return (CORRECT, INCORRECT) if self.detects else (COMPARISON, STANDARD)

    def by_choice(self, frame: pd.DataFrame, answers: AnswerList) -> tuple[pd.DataFrame, AnswerList]:
        """Return answers by what they choose, comparison or standard, or correct or incorrect, and the list of these.

        Parameters
        ----------
        frame : DataFrame
            Tidy answers; those that name no interval are kept.
        answers : AnswerList
            The answers that could be given.
        """
        place, named = frame["interval"].astype(int), frame["response"].astype(str).map(self.named)
        chosen = frame["response"].astype(str).where(named.isna(), self.words[1]).where(named != place, self.words[0])
        names = [*self.words, *(name for name in answers.names if name not in self.named)]
        return frame.assign(response=pd.Categorical(chosen, names)), AnswerList.of({"keys": names})
