"""Task of the participant in designs with several intervals: which interval, or same or different."""

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
    """Task of the participant in a trial.

    Attributes
    ----------
    n_intervals : int
        Number of intervals.
    named : dict of str to int
        Interval named by each answer, from 1.
    different, same : frozenset of str
        Answers meaning "different" and "same".
    standard : float
        Level of the standard [mm/s]; 0 for no stimulus, NaN for the level of the comparison.
    stimulus : str
        Stimulus of the standard; empty for that of the comparison.
    asks_stronger : bool
        Whether the correct answer is the interval with the higher level, rather than that with the comparison.
    places : tuple of int
        Possible intervals of the comparison; empty for all.
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
            Sections of the protocol.
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

    def wants_standard(self, level: float) -> bool:
        """Return whether the correct answer at a level is the interval of the standard, not of the comparison."""
        return self.asks_stronger and self.n_intervals == 2 and level < self.standard

    def has_correct_answer(self, level: float) -> bool:
        """Return whether answers at a level are correct or incorrect; neither if two intervals have equal levels."""
        return not self.asks_stronger or level > self.standard or self.wants_standard(level)

    def informative(self, frame: pd.DataFrame, level: str) -> pd.DataFrame:
        """Return the informative answers about intervals; all answers if none names an interval.

        If the strongest of three intervals is asked for, trials with a comparison below the standard are excluded.

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
        """Reason why no model gives d' for the task; empty if there is one."""
        if self.n_intervals == 3 and self.different:
            return "whether three intervals are the same: the differencing model is for two"
        if self.n_intervals == 3 and len(self.places or self.named) < 3:
            return "a comparison in only some of the three intervals: the models assume all three"
        return ""

    def is_same(self, frame: pd.DataFrame, level: str) -> pd.Series:
        """Return a mask of the trials whose comparison equals the standard.

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
        """Whether the other intervals have no stimulus, so that there is a correct answer at any level."""
        return self.standard == 0

    @property
    def words(self) -> tuple[str, str]:
        """Names of a choice of the interval of the comparison, and of another interval."""
        return (CORRECT, INCORRECT) if self.detects else (COMPARISON, STANDARD)

    def by_choice(self, frame: pd.DataFrame, answers: AnswerList) -> tuple[pd.DataFrame, AnswerList]:
        """Recode answers as comparison or standard, or as correct or incorrect, and return them with their list.

        Parameters
        ----------
        frame : DataFrame
            Tidy answers; those that name no interval are kept.
        answers : AnswerList
            The answers offered.
        """
        place, named = frame["interval"].astype(int), frame["response"].astype(str).map(self.named)
        chosen = frame["response"].astype(str).where(named.isna(), self.words[1]).where(named != place, self.words[0])
        names = [*self.words, *(name for name in answers.names if name not in self.named)]
        return frame.assign(response=pd.Categorical(chosen, names)), AnswerList.of({"keys": names})
