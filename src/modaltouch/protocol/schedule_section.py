"""How trials are ordered and sessions follow each other, as the file gives it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from modaltouch.protocol.occasions import SessionKind, Sessions
from modaltouch.protocol.section import Count, Positive, Section, described

_ABSENT: dict[str, Any] = {"default": None, "exclude_if": lambda given: given is None}


class ResumeSection(Section):
    """How an interrupted session is resumed."""

    at: Literal["trial", "block", "restart"] = described(
        "trial: with the next trial; block: the block that was cut from its first trial on, its answers kept but not "
        "counted; restart: as a new session in the same order, the old one closed.",
        default="trial",
    )
    within_hours: Positive | None = described(
        "Longest interruption after which it may be resumed [h]; null for no limit.", default=None
    )


class ScheduleSection(Section):
    """How the trials are ordered."""

    repetitions: Annotated[Count, Field(le=10_000)] = described("Trials of each condition.", default=1)
    order: Literal["shuffled", "by_pair", "by_velocity", "latin_square", "as_listed"] = described(
        "Order within a finger condition: shuffled, pairs or velocities one after the other, every participant "
        "another row of a balanced Latin square, or for all as the cells are listed (conditions.cells or table).",
        default="shuffled",
    )
    max_same_pair_running: Count | None = described(
        "Most trials in a row with the same pair of zones, in shuffled orders; null for no limit.", default=None
    )
    max_same_level_running: Count | None = described(
        "Most trials in a row with the same peak velocity, in shuffled orders; null for no limit.", **_ABSENT
    )
    max_same_stimulus_running: Count | None = described(
        "Most trials in a row with the same of several stimuli, in shuffled orders; null for no limit.", **_ABSENT
    )
    max_same_side_running: Count | None = described(
        "Most trials in a row with the focus under the finger of the same side, in shuffled orders, so that the same "
        "answer is not expected too often in a row; pairs without the focus break a row. Null for no limit.",
        **_ABSENT,
    )
    min_same_cell_distance: Annotated[Count, Field(ge=2)] | None = described(
        "Least number of trials from one of a cell (pair, peak velocity and stimulus) to the next of the same, in "
        "shuffled orders: 2 for never twice running, 3 for at least one other between. Null for any.",
        **_ABSENT,
    )
    counterbalance_finger_conditions: bool = Field(
        strict=True,
        default=True,
        description="Whether participants take turns in which finger condition comes first.",
    )
    catch_trials: Annotated[int, Field(strict=True, ge=0, le=100)] = described(
        "Trials without a stimulus among those of each finger condition; none is the first, no two are neighbours.",
        default=0,
    )
    balance: Literal["by_number", "least_filled"] = described(
        "How participants take turns in orders, placements and rows of a Latin square: by their number, or each new "
        "one gets the turn that fewest of those on record have filled, so that dropouts are replaced.",
        default="by_number",
    )
    sessions: Sessions = described(
        "Sessions of each participant, each with the turn after the one before: their number, or the kinds of session "
        "in their order, such as [{name: training, analysed: false, schedule: {repetitions: 1}}, {name: test, "
        "min_gap_days: 1}].",
        default=1,
    )
    practice_trials: Annotated[int, Field(strict=True, ge=0, le=1000)] = described(
        "Trials before the ones that count.", default=0
    )
    practice_feedback: bool = Field(
        strict=True,
        default=False,
        description="Whether a practice trial is followed by where it was stronger, or by the right answer.",
    )
    practice_criterion: Annotated[float, Field(strict=True, gt=0, le=1)] | None = described(
        "Share of the practice trials to be answered rightly; null where practice cannot fail.", default=None
    )
    practice_rounds: Annotated[Count, Field(le=10)] = described(
        "Most rounds of practice, where the criterion is not met at once.", default=1
    )
    after_failed_practice: Literal["continue", "stop"] = described(
        "What follows when no round met the criterion.", default="continue"
    )
    break_after_trials: Count | None = described("Trials between two breaks; null for no breaks.", default=None)
    break_after_min: Positive | None = described(
        "Minutes between two breaks, at the next trial; null for no breaks by time.", default=None
    )
    resume: ResumeSection = described("How an interrupted session is resumed.", default=ResumeSection())

    @property
    def session_kinds(self) -> tuple[SessionKind, ...]:
        """Kind of each of a participant's sessions in order; empty where they are all alike."""
        kinds = () if isinstance(self.sessions, int) else self.sessions
        return tuple(kind for kind in kinds for _ in range(kind.times))

    @property
    def n_sessions(self) -> int:
        """Sessions of each participant."""
        return self.sessions if isinstance(self.sessions, int) else len(self.session_kinds)

    def kind_of(self, session: int) -> SessionKind | None:
        """Return the kind of a participant's session, from 1; of one beyond the last, the last's."""
        return self.session_kinds[: max(session, 1)][-1] if self.session_kinds else None

    @property
    def all_practice_trials(self) -> int:
        """Number of practice trials in all the rounds there may be."""
        return self.practice_trials * (self.practice_rounds if self.practice_criterion is not None else 1)
