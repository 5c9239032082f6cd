"""YAML -> Protocol: what is presented, asked and repeated."""

from __future__ import annotations

import string
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

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
    continue_keys: tuple[str, ...] = ("space", "enter", "num_enter")


_PLACEHOLDERS: dict[str, frozenset[str]] = {
    "how_to_answer": frozenset({"pause_key"}),
    "place_fingers": frozenset({"left_finger", "left_zone", "right_finger", "right_zone"}),
    "trial_of": frozenset({"number", "total"}),
    "practice_of": frozenset({"number", "total"}),
    "pause": frozenset({"key", "end_key"}),
    "press_to_continue": frozenset({"key"}),
}
"""Words in braces that a text must contain; every other text must contain none."""


class Texts(Section):
    """Every word the participant reads, in one language."""

    language: str
    welcome: str
    instructions: str
    how_to_answer: str
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
    key_names: dict[str, str] = {}

    @field_validator("*")
    @classmethod
    def _holds_its_placeholders(cls, text: object, info: ValidationInfo) -> object:
        """Refuse an empty text, and one whose words in braces differ from what the window fills in."""
        if not isinstance(text, str):
            return text
        if not text.strip():
            raise ValueError(
                "given an empty text; allowed: at least one word; write what the participant reads"
            )
        wanted = _PLACEHOLDERS.get(str(info.field_name), frozenset())
        needed = ", ".join(f"{{{name}}}" for name in sorted(wanted)) or "no words in braces"
        try:
            fields = [field for field in string.Formatter().parse(text) if field[1] is not None]
        except ValueError as error:
            raise ValueError(f"given {text!r} ({error}); allowed: {needed}; close every brace") from None
        found = {str(name) for _, name, _, _ in fields}
        if found != wanted or any(spec or conversion for _, _, spec, conversion in fields):
            given = ", ".join(f"{{{name}}}" for name in sorted(found)) or "no words in braces"
            raise ValueError(f"given {given} in {text!r}; allowed: exactly {needed}; write each of them once")
        return text


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
