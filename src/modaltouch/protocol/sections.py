"""Protocol file: stimuli, questions and repetitions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from modaltouch.protocol.conditions import AdaptiveSection, Cell, CellsSection, ConditionsSection, FingerCondition
from modaltouch.protocol.people import PersonField, model_of
from modaltouch.protocol.questions import AskedSection, KeyName, QuestionSection
from modaltouch.protocol.reading import read
from modaltouch.protocol.schedule_section import Overrides, ScheduleSection
from modaltouch.protocol.section import Count, FileName, NotNegative, Positive, Section, Text, Word, described
from modaltouch.protocol.source import Source
from modaltouch.protocol.stimulus_sections import (
    IntervalsSection,
    MaskingSection,
    Meaning,
    StimulusSection,
    StimulusVariant,
)
from modaltouch.protocol.trial import AnswerList, Side, Trial


class CalibrationLimits(Section):
    """Upper bounds of the errors of a calibration, including uncertainty; one that exceeds them is marked."""

    velocity_mm_s: Positive = described("Error of a modal velocity at the focusing instant [mm/s].", default=0.3)
    displacement_mm_s: Positive = described(
        "Modal displacement times angular frequency at that instant; the target is 0 [mm/s].", default=0.3
    )
    level_percent: Positive = described("Deviation of a level at the focus [percent].", default=1.0)


class CalibrationSection(Section):
    """Calibration required by the stimulus."""

    file: Text | None = described(
        "Calibration file written by `modaltouch calibrate`, relative to this file; null for none.", default=None
    )
    max_age_days: Positive | None = described(
        "Maximum age of the calibration when a session begins [days]; null for no limit.", default=None
    )
    required: bool = Field(
        strict=True, default=False, description="Whether a session without a calibration is refused."
    )
    limits: CalibrationLimits = described(
        "Largest errors that a calibration may leave, including their uncertainty but not that of the vibrometer's "
        "sensitivity; a calibration that misses them is marked.",
        default=CalibrationLimits(),
    )


class MarkersSection(Section):
    """Markers sent to other devices while a session runs."""

    lsl: bool = described(
        "Whether each stimulus, question and answer is sent as a marker of the Lab Streaming Layer, in the stream "
        "`modaltouch` of type Markers; needs the extra `lsl`.",
        default=False,
    )


AnswerWay = Literal["free_hand", "lifting", "foot_switch", "experimenter"]
Seconds = Annotated[NotNegative, Field(le=600)]

USUAL_PRESENTATION, USUAL_LONGEST = 2.0, 60.0
"""Default duration of a stimulus that stops before the question, and of an unanswered one [s]."""


def whole_bursts(seconds: float, rate: float) -> int:
    """Return the number of bursts, at least one, closest to a duration [s] at a repetition rate [Hz]."""
    return max(round(seconds * rate), 1)


class AnswersSection(AskedSection):
    """The question and its answers."""

    given_by: Literal["participant", "experimenter"] = described(
        "Who types the answer: the participant, or the experimenter for them.", default="participant"
    )
    ways: dict[FingerCondition, AnswerWay] = described(
        "How the participant gives the answer: with a free hand, by lifting a finger off the beam, or by a foot "
        "switch that types keys. By default: lifting in two_hands, otherwise a free hand; for a finger condition of "
        "your own with both hands on the beam, an entry is required.",
        default={},
    )
    change_until_confirmed: bool = Field(
        strict=True, default=False, description="Whether an answer may be changed until it is chosen a second time."
    )
    stimulus_until: Literal["answer", "question"] = described(
        "Whether the stimulus plays until the answer, or stops before the question.", default="answer"
    )
    presentation_bursts: Annotated[Count, Field(le=100_000)] | None = described(
        "Number of bursts of a stimulus that stops before the question; null if presentation_s gives its length.",
        default=None,
    )
    presentation_s: Annotated[Positive, Field(le=600)] | None = described(
        "Length of a stimulus that stops before the question, a whole number of bursts [s]; null for the number "
        "nearest to 2 s.",
        default=None,
    )
    longest_presentation_s: Annotated[Positive, Field(le=600)] | None = described(
        "Maximum length of a stimulus that plays until the answer, a whole number of bursts [s]; null for the number "
        "nearest to 60 s.",
        default=None,
    )
    after_longest: Literal["ask", "time_out"] = described(
        "What happens at the maximum length: the question stays with the beam at rest, or the trial ends as timed out.",
        default="ask",
    )
    question_delay_s: Seconds = described("Time from the first burst to the question [s].", default=0.5)
    pause_s: Seconds = described(
        "Time from an answer, or a continue key, to the next stimulus [s]; settling_s applies instead if it is longer "
        "and a hand has to return to the beam.",
        default=1.0,
    )
    settling_s: Seconds = described(
        "The same time if a hand or finger that rests on the beam presses the key: in two_hands without foot switch or "
        "experimenter, and in lifting [s]; the participant sees a countdown.",
        default=1.5,
    )
    then: dict[Word, QuestionSection] = described(
        "Further questions after the answer of each trial, by the name of their column, in this order: for example, "
        "how sure the participant is. They are asked once the stimulus is confirmed to have ended, and not after a "
        "time-out.",
        default={},
        exclude_if=lambda given: not given,
    )
    fingers: dict[Word, tuple[Side, ...]] = described(
        "Fingers that answers with other names stand for, by their place on the beam: [left], [right], [left, right], "
        "[between] for the middle one of three, or [] for felt nowhere. An answer without an entry says nothing about "
        "the fingers.",
        default={},
        exclude_if=lambda given: not given,
    )
    below: tuple[Word, ...] = described(
        "Answers whose buttons are placed below the others; the button for felt nowhere always is if there are two or "
        "more other answers.",
        default=(),
        exclude_if=lambda given: not given,
    )
    intervals: dict[Word, Meaning] = described(
        "What each answer, by its name, says about the intervals of a trial: the number of an interval, as in {first: "
        "1, second: 2}, or same and different if all are compared.",
        default={},
        exclude_if=lambda given: not given,
    )
    continue_keys: tuple[KeyName, ...] = described(
        "Keys that continue from a screen that waits.", default=("space", "enter", "num_enter"), min_length=1
    )
    emergency_keys: tuple[KeyName, ...] = described(
        "Keys that switch the outputs off at once and end the session, on every screen and at the console.",
        default=("f12",),
    )

    @property
    def offered(self) -> AnswerList:
        """The answers in screen order."""
        return AnswerList.of({name: getattr(self, name) for name in ("keys", "fingers", "below", "intervals", "scale")})

    @property
    def further(self) -> dict[str, AnswersSection]:
        """Answer settings of each further question, by name."""
        return self.asking(self.then)

    def asking(self, questions: Mapping[str, QuestionSection]) -> dict[str, AnswersSection]:
        """Return the settings of each question: those of the main one, except for text, answers and time-out."""
        none = {"fingers": {}, "below": (), "intervals": {}, "then": {}, "change_until_confirmed": False}
        return {
            name: self.model_copy(update=none | vars(asked) | {"question": asked.question or name})
            for name, asked in questions.items()
        }

    @property
    def has_none_answer(self) -> bool:
        """Whether "felt nowhere" is one of the answers."""
        return self.offered.naming() is not None

    def n_bursts(self, rate: float) -> int:
        """Return the number of bursts of a stimulus, or the maximum until the answer, at a repetition rate [Hz]."""
        if self.stimulus_until == "answer":
            return whole_bursts(self.longest_presentation_s or USUAL_LONGEST, rate)
        return self.presentation_bursts or whole_bursts(self.presentation_s or USUAL_PRESENTATION, rate)

    def way(self, finger_condition: str) -> AnswerWay:
        """Return the way in which answers are given in a finger condition."""
        if self.given_by == "experimenter":
            return "experimenter"
        return self.ways.get(finger_condition, "lifting" if finger_condition == "two_hands" else "free_hand")

    def settles(self, finger_condition: str) -> bool:
        """Test whether a hand or finger leaves the beam to press the key, and so must settle on it again."""
        way = self.way(finger_condition)
        return way == "lifting" or (way == "free_hand" and finger_condition == "two_hands")

    def pause(self, finger_condition: str) -> float:
        """Return the time from an answer, or a continue key, to the next stimulus [s]."""
        return max(self.pause_s, self.settling_s) if self.settles(finger_condition) else self.pause_s


class AnalysisSection(Section):
    """Criteria of the analysis, fixed before data are taken."""

    equivalence_margin: Annotated[float, Field(strict=True, gt=0, lt=1)] | None = described(
        "Largest difference in the share of an answer at which finger conditions count as equivalent; null for no such "
        "test.",
        default=None,
    )


class Protocol(Section):
    """A complete experiment."""

    protocol: FileName = described("Name of the protocol, and of the folder of its results.")
    title: Text = described("Title on reports.", default="")
    apparatus: Text = described("File of the apparatus, relative to this file.")
    texts: Text = described("File of the participant's texts, relative to this file.")
    stimulus: StimulusSection = described("The burst that every trial plays, at the level of the trial.")
    stimuli: dict[Word, StimulusVariant] = described(
        "Several stimuli, by name; every condition is presented with each of them, each in its own memories. The "
        "section stimulus contains what they share. Empty for that one stimulus only.",
        default={},
    )
    conditions: ConditionsSection = described("The cells of the design.")
    intervals: IntervalsSection | None = described(
        "Several stimuli per trial, one after the other, as in a forced choice between two intervals; null for one.",
        default=None,
        exclude_if=lambda given: given is None,
    )
    schedule: ScheduleSection = described("Order of the trials.", default=ScheduleSection())
    groups: dict[Word, Overrides] = described(
        "Groups of participants, by name, and what differs for each, such as {low: {conditions: {peak_velocities_mm_s: "
        "[80]}}, high: {}}. Participants are assigned in turn, or as schedule.balance says.",
        default={},
        exclude_if=lambda given: not given,
    )
    masking: MaskingSection | None = described(
        "Noise that prevents the participant from hearing the beam; null for none.", default=None
    )
    markers: MarkersSection | None = described(
        "Markers for other devices, such as an EEG amplifier; null for none.",
        default=None,
        exclude_if=lambda given: given is None,
    )
    speech: dict[str, object] | None = described("No longer used: screens are not spoken.", default=None)
    adaptive: AdaptiveSection | None = described(
        "Adaptive runs, in which the answers determine the next level; the peak velocities are then the lowest and the "
        "highest level. Null for fixed levels.",
        default=None,
    )
    answers: AnswersSection = described("How the question is asked and answered.")
    calibration: CalibrationSection = described("Which calibration the stimulus needs.", default=CalibrationSection())
    analysis: AnalysisSection = described("Criteria of the analysis.", default=AnalysisSection())
    people: dict[Word, PersonField] = described(
        "Questions that each participant is asked once, before the first session, by the name of their column in "
        "participants.tsv; nothing that identifies a person.",
        default={},
        exclude_if=lambda given: not given,
    )
    form: dict[Word, QuestionSection] = described(
        "Questions at the end of each session, by the name of their column, in this order.",
        default={},
        exclude_if=lambda given: not given,
    )
    instructions: Text | None = described(
        "What the experiment asks of the participant, written out, or the name of a text under `further` in the texts; "
        "null for the text `instructions`, which follows the design in the shipped texts.",
        default=None,
        exclude_if=lambda given: given is None,
    )

    @property
    def task(self) -> str:
        """Name of the question in the protocol, or one derived from the meaning of its answers."""
        answers, intervals = self.answers, self.intervals
        if answers.question is not None:
            return answers.question
        if answers.scale is not None:
            return "magnitude" if answers.scale.kind == "number" else "strength"
        meanings = {answer.interval for answer in answers.offered}
        if intervals is None or meanings == {None}:
            most = max(map(len, self.conditions.contacts))
            if most > 1 and any(answer.fingers for answer in answers.offered):
                return "where"
            return "detection" if answers.has_none_answer else "other"
        if "different" in meanings:
            return "same_different"
        standard = intervals.standard
        if standard.velocity_mm_s == 0:
            return "which_vibrated"
        if intervals.number == 3:
            return "odd_one"
        above = standard.stimulus is None and min(self.conditions.peak_velocities_mm_s) > (standard.velocity_mm_s or 0)
        return "comparison" if intervals.asked == "stronger" or above else "other"

    @property
    def closing(self) -> dict[str, AnswersSection]:
        """Answer settings of each question of the form at the end, by name."""
        return self.answers.asking(self.form)

    def read_people(self, path: Path) -> dict[str, float | str | None]:
        """Read a participant's answers from a YAML file; raise InputError if it has problems."""
        return read(Source.load(path), model_of(self.people)).require().model_dump()

    @property
    def n_trials(self) -> int:
        """Number of trials that count, over all finger conditions."""
        n_driven = [len(self.cells(name)) * self.scheduled_repetitions for name in self.conditions.finger_conditions]
        return sum(n_driven) + len(n_driven) * self.schedule.catch_trials

    @property
    def uncrossed_by(self) -> tuple[str, ...]:
        """Path of the first key that makes the design uncrossed; empty for a crossed design."""
        if ((own := self.conditions).cells or own.exclude) and not self.are_crossed(own.model_dump(), self.stimuli):
            return ("conditions", next(key for key in ("table", "cells", "exclude") if getattr(own, key)))
        kinds = {kind.name: kind.analysed for kind in self.schedule.session_kinds}
        return ("groups",) if self.groups else ("schedule", "sessions") if kinds and sum(kinds.values()) != 1 else ()

    @staticmethod
    def are_crossed(conditions: Mapping[str, Any], stimuli: Iterable[str]) -> bool:
        """Test whether a section ``conditions`` gives a crossed design, as by `cell_table.are_crossed`."""
        from modaltouch.protocol.cell_table import are_crossed

        return are_crossed(conditions, stimuli)

    def cells(self, finger_condition: str, *, excluded: bool = False) -> list[Cell]:
        """Return the cells of a finger condition in order, each as often as its weight.

        Parameters
        ----------
        finger_condition : str
            Name of the finger condition.
        excluded : bool
            Whether to include cells that the protocol excludes.
        """
        conditions = self.conditions
        listed = conditions.cells or [
            CellsSection.model_construct(pair=pair, peak_velocities_mm_s=self.scheduled_levels)
            for pair in conditions.contacts
        ]
        cells = [
            (each.pair, level, stimulus)
            for each in listed
            if finger_condition in (each.finger_conditions or (finger_condition,))
            for level in each.peak_velocities_mm_s
            for stimulus in each.stimuli or self.stimulus_names
            for _ in range(each.weight)
        ]
        left_out = () if excluded else conditions.exclude
        return [cell for cell in cells if not any(each.holds(finger_condition, cell) for each in left_out)]

    @property
    def scheduled_levels(self) -> tuple[float, ...]:
        """Peak velocities of scheduled trials [mm/s].

        In adaptive runs, this is the level of the first trial. Sensation levels are those for the highest possible
        threshold until the participant's threshold is known (`with_levels`).
        """
        if self.adaptive is not None:
            return (self.adaptive.start_mm_s,)
        velocities, own = self.conditions.peak_velocities_mm_s, self.conditions.sensation_levels
        return velocities if own is None else own.levels(own.thresholds(min(velocities), max(velocities))[1])

    @property
    def scheduled_repetitions(self) -> int:
        """Number of trials of each pair, scheduled level and stimulus in a block."""
        if self.adaptive is not None:
            return self.adaptive.trials
        return self.schedule.repetitions

    @property
    def stimulus_names(self) -> tuple[str, ...]:
        """Names of the stimuli; a single empty name if the protocol has no section ``stimuli``."""
        return tuple(self.stimuli) or ("",)

    def stimulus_of(self, name: str) -> StimulusSection:
        """Return the stimulus with a name; the shared section for a catch trial, which has none."""
        return self.stimuli[name].applied(self.stimulus) if name in self.stimuli else self.stimulus

    def presented(self, trial: Trial) -> tuple[Trial, ...]:
        """Return the trial once per interval, with the condition presented there; once if it has no intervals."""
        if self.intervals is None:
            return (trial,)
        standard = replace(trial, condition=self.intervals.standard_of(trial.condition))
        return tuple(trial if n == trial.interval else standard for n in range(1, self.intervals.number + 1))

    def expected(self, trial: Trial, speeds: Sequence[float]) -> str | None:
        """Return the expected answer to a trial, from its intervals or the speeds under the fingers; None if unclear.

        Parameters
        ----------
        trial : Trial
            The trial.
        speeds : sequence of float
            Predicted peak speeds under the fingers, from left to right, in one unit.
        """
        if self.intervals is None:
            return self.answers.offered.expected(*speeds)
        return next((name for name in self.answers.offered.names if self.is_correct(trial, name)), None)

    def is_correct(self, trial: Trial, answer: str) -> bool | None:
        """Score an answer on intervals; None if it does not refer to them, or if any of them may be correct."""
        if self.intervals is None:
            return None
        return self.intervals.is_correct(self.answers.offered.named(answer).interval, trial.condition, trial.interval)

    def n_bursts(self, name: str) -> int:
        """Return the number of bursts of a stimulus, or the maximum until the answer; empty name for a catch trial."""
        own = self.stimuli[name].presentation_bursts if name in self.stimuli else None
        return own or self.answers.n_bursts(self.stimulus_of(name).repetition_rate_Hz)

    def longest_s(self, name: str) -> float:
        """Return the time from the start of a stimulus to the end of its last burst [s]."""
        stimulus = self.stimulus_of(name)
        return (self.n_bursts(name) - 1) / stimulus.repetition_rate_Hz + stimulus.duration_ms * 1e-3

    def is_masked(self, name: str) -> bool:
        """Test whether the masking noise, if any, is on during a stimulus."""
        return name not in self.stimuli or self.stimuli[name].masked is not False

    def with_stimulus(self, name: str) -> Protocol:
        """Return the protocol with one stimulus alone, crossed with its levels; no intervals unless standard."""
        levels = self.conditions.peak_velocities_mm_s
        standard = None if self.intervals is None else self.intervals.standard
        # Stimuli that differ only in rate, masking and number of bursts share their records and hence their levels.
        records = [
            self.stimulus_of(each).model_copy(update={"repetition_rate_Hz": 1}) for each in (name, *self.stimuli)
        ]
        alike = [each for each, own in zip(self.stimuli, records[1:], strict=True) if own == records[0]]
        fits = standard is not None and standard.stimulus in (None, *alike)
        at_every_level = standard is not None and standard.velocity_mm_s is None and standard.stimulus in alike
        # Catch trials use the settings of the lowest level.
        if (self.conditions.cells or self.conditions.exclude) and not (self.schedule.catch_trials or at_every_level):
            cells = [cell for fingers in self.conditions.finger_conditions for cell in self.cells(fingers)]
            own_levels = {level for _, level, stimulus in cells if stimulus in alike}
            levels = tuple(level for level in levels if level in own_levels)
            levels = levels or ((standard.velocity_mm_s,) if fits and standard and standard.velocity_mm_s else ())
        crossed = self.conditions.model_copy(update={"cells": (), "exclude": (), "peak_velocities_mm_s": levels})
        own = {"stimulus": self.stimulus_of(name), "stimuli": {}, "intervals": self.intervals if fits else None}
        return self.model_copy(update={**own, "conditions": crossed})

    def with_levels(self, levels_mm_s: tuple[float, ...]) -> Protocol:
        """Return the protocol with a participant's levels [mm/s] in place of sensation levels."""
        own = self.conditions.model_copy(update={"peak_velocities_mm_s": levels_mm_s, "sensation_levels": None})
        return self.model_copy(update={"conditions": own})
