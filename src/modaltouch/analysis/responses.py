"""Answers ready to be analysed: one tidy table, every cell of the design filled, and where they come from.

The tidy table has one row for an answer (or, with a column ``n``, for a count of equal answers)::

    participant, finger_condition, zone_left, zone_right, velocity_mm_s, response

Of sessions with levels calibrated by participant it has ``multiple_of_threshold`` in place of ``velocity_mm_s``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from modaltouch.analysis.scale import scale_of

if TYPE_CHECKING:
    import pandas as pd

    from modaltouch.analysis.provenance import SessionFacts

REQUIRED = ("participant", "finger_condition", "zone_left", "zone_right", "velocity_mm_s", "response")
CELL = ("finger_condition", "zone_left", "zone_right", "velocity_mm_s")


def cell_of(columns: Container[str]) -> tuple[str, ...]:
    """Return what tells the cells of the design apart in a table with these columns."""
    return (*CELL[:3], scale_of(columns).column)


def keys_of(columns: Container[str]) -> tuple[str, ...]:
    """Return what tells the answers of a balanced table apart: who gave them, and in which cell."""
    return ("participant", *cell_of(columns))


@dataclass(frozen=True)
class ExcludedSource:
    """Something that was found but not analysed.

    Attributes
    ----------
    source : str
        File, folder or rows.
    reason : str
        Why it stays out.
    """

    source: str
    reason: str


@dataclass(frozen=True)
class AnswerSource:
    """Where the answers come from.

    Attributes
    ----------
    path : str
        File or folder as it was named.
    kind : str
        ``csv`` or ``results``.
    sha256 : str
        Hash of the file, or of the hashes of the logs.
    mode : str
        ``real``, ``pilot`` or ``simulated``; empty for a CSV, which does not say.
    """

    path: str
    kind: str
    sha256: str
    mode: str = ""


@dataclass(frozen=True, eq=False)
class Responses:
    """Answers ready to be analysed.

    Attributes
    ----------
    frame : DataFrame
        Tidy table; ``response`` is categorical over all answers that could be given, ``n`` counts equal answers.
    sessions : tuple of SessionFacts
        What the log of each recorded session tells beside its answers; empty for a CSV.
    left_out : tuple of ExcludedSource
        What was found but not used, and why.
    source : AnswerSource
        Where the answers come from.
    focus : str
        Zone at which the vibration was focused, if known.
    start : dict
        Start record of the first session; empty for a CSV.
    catches : dict of str to Counter
        Answers to catch trials by participant, which are not in the table; empty without any.
    stimulus : str
        Which of several stimuli the answers are to; empty where there is one.
    foci : dict of str to str
        Zone in focus of each of several stimuli.
    """

    frame: pd.DataFrame
    sessions: tuple[SessionFacts, ...]
    left_out: tuple[ExcludedSource, ...]
    source: AnswerSource
    focus: str = ""
    start: dict[str, Any] = field(default_factory=dict)
    catches: dict[str, Counter[str]] = field(default_factory=dict)
    stimulus: str = ""
    foci: dict[str, str] = field(default_factory=dict)

    @property
    def is_adaptive(self) -> bool:
        """Whether the levels followed from the answers, so that there are runs and no table of counts."""
        return bool(self.start.get("design", {}).get("adaptive"))
