"""YAML -> Protocol: what is presented, asked and repeated."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from modaltouch.apparatus import Positive, Section

Label = Annotated[int, Field(strict=True, ge=1)]
Count = Annotated[int, Field(strict=True, ge=1)]
FingerCondition = Literal["one_hand", "two_hands"]


class WishedField(Section):
    """The velocity map wished at the focusing instant."""

    shape: Literal["triangle", "box", "half_cosine", "raised_cosine", "gaussian"] = "triangle"
    base_mm: Positive = 56.0


class StimulusSection(Section):
    """The burst that every trial plays, up to its level."""

    law: Literal["exact", "paper"] = "exact"
    focus: str
    field: WishedField = WishedField()
    decomposed_modes: Count = 50
    selected_modes: Count | tuple[Label, ...] = 6
    focusing_instant_ms: Positive = 25.0
    duration_ms: Positive = 50.0
    release: Literal["braked", "free"] = "braked"
    n_samples: Count = 125_000
    repetition_rate_Hz: Positive = 7.0  # noqa: N815


class ConditionsSection(Section):
    """The cells of the design."""

    finger_conditions: tuple[FingerCondition, ...]
    hand: Literal["right", "left"] = "right"
    zone_pairs: tuple[tuple[str, str], ...]
    peak_velocities_mm_s: tuple[Positive, ...]


class ScheduleSection(Section):
    """How the trials are ordered."""

    repetitions: Count = 1
    max_same_pair_running: Count | None = None
    counterbalance_finger_conditions: bool = True
    practice_trials: Annotated[int, Field(strict=True, ge=0)] = 0
    break_after_trials: Count | None = None


class AnswersSection(Section):
    """How the question is asked and answered."""

    given_by: Literal["participant", "experimenter"] = "participant"
    stimulus_until: Literal["answer", "question"] = "answer"
    presentation_s: Positive = 2.0
    question_delay_s: Annotated[float, Field(strict=True, ge=0)] = 0.5
    pause_s: Annotated[float, Field(strict=True, ge=0)] = 1.0
    keys: dict[Literal["left", "both", "right"], tuple[str, ...]]


class Texts(Section):
    """Every word the participant reads, in one language."""

    language: str
    welcome: str
    instructions: str
    place_fingers: str
    practice: str
    start: str
    feel: str
    question: str
    left: str
    both: str
    right: str
    trial_of: str
    practice_of: str
    rest: str
    pause: str
    goodbye: str
    press_to_continue: str
    experimenter_answers: str
    right_index: str
    right_middle: str
    left_index: str
    left_middle: str


class Protocol(Section):
    """The whole experiment as one frozen value."""

    protocol: str
    title: str = ""
    apparatus: str
    texts: str
    stimulus: StimulusSection
    conditions: ConditionsSection
    schedule: ScheduleSection = ScheduleSection()
    answers: AnswersSection
