"""Sections ``stimulus``, ``stimuli``, ``intervals`` and ``masking``: what beam and loudspeaker play in a trial."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, Tag

from modaltouch.protocol.reading import Reading, repeats
from modaltouch.protocol.section import (
    NUMBER_OR_LIST,
    Count,
    Label,
    NotNegative,
    Number,
    Positive,
    Section,
    Step,
    Text,
    Word,
    described,
)
from modaltouch.protocol.source import Problem
from modaltouch.protocol.trial import Condition

if TYPE_CHECKING:
    from modaltouch.protocol.apparatus import Apparatus, Sound


NO_FINGERS = "none"
"""Value of `stimulus.fingers` if the stimulus is designed for the untouched beam."""

MEASURED = "measured"
"""Value of `stimulus.fingers` if fingers are measured in the session, at each placement."""

ZoneName = Annotated[Word, Field(json_schema_extra={"x-allowed": "the name of a zone of the beam"})]
SampleCount = Annotated[int, Field(strict=True, ge=2, le=524_288, multiple_of=2)]
"""At most the memory of the largest known generator; that of the apparatus is checked with its other limits."""


class FieldSection(Section):
    """Target velocity field at the focusing instant."""

    shape: Literal[
        "triangle",
        "box",
        "half_cosine",
        "raised_cosine",
        "gaussian",
        "sampled",
    ] = described("Shape of the velocity along the beam; sampled: straight lines between points.", default="triangle")
    base_mm: Positive = described(
        "Width of its base; for the gaussian, its full width at half maximum [mm].", default=56.0
    )
    points: Annotated[tuple[tuple[Number, Number], ...], Field(min_length=2, max_length=10_000)] | None = described(
        "Points of a sampled field: position [mm from mid-beam] and velocity, in any unit, since the level sets the "
        "velocity at the centre of the focus zone.",
        default=None,
    )
    file: Text | None = described(
        "File of the points of a sampled field, with the columns position_mm and velocity, relative to this file.",
        default=None,
    )


Selection = Annotated[
    Annotated[Count, Tag("number")] | Annotated[tuple[Label, ...], Field(min_length=1), Tag("list")], NUMBER_OR_LIST
]


class StimulusSection(Section):
    """The burst played in every trial, except for its level."""

    law: Literal["exact", "paper"] = described(
        "Drive law: exact (least energy, every modelled mode on target) or paper (the paper's equations 6 and 7).",
        default="exact",
    )
    design: Literal["least_energy", "norm_4", "norm_8", "least_peak"] = described(
        "Which voltages the exact law chooses: those with least energy, or those with less peak voltage but more "
        "energy, down to the least peak, which switches between the extremes and excites modes that are not modelled.",
        default="least_energy",
    )
    focus: ZoneName = described("Zone whose centre reaches the peak velocity.")
    further_foci: Annotated[tuple[ZoneName, ...], Field(max_length=20)] = described(
        "Further zones that are focused at the same time, with the same shape.", default=()
    )
    field: FieldSection = described("Target velocity field at the focusing instant.", default=FieldSection())
    decomposed_modes: Annotated[Count, Field(le=1000)] = described(
        "Number of modes onto which the target field is projected.", default=50
    )
    selected_modes: Selection = described(
        "Number of modelled modes to drive, strongest first, or a list of their labels.", default=6
    )
    focusing_instant_ms: Positive = described(
        "Focusing instant, when the field reaches its target [ms from the start].", default=25.0
    )
    duration_ms: Positive = described("Length of a burst [ms].", default=50.0)
    release: Literal["braked", "free"] = described(
        "After the focusing instant: braked to rest at the end of the burst, or free to decay.", default="braked"
    )
    n_samples: SampleCount = described(
        "Number of samples of a burst; with 125,000, the generator holds each for exactly 100 clock cycles.",
        default=125_000,
    )
    repetition_rate_Hz: Positive = described("Bursts per second [Hz].", default=7.0)  # noqa: N815
    fingers: Text = described(
        "Fingers that the stimulus is designed for, with one design for each pair of zones: none (the untouched beam), "
        "a file (relative to this file), shipped fingers such as typical, or measured (with a vibrometer, at each "
        "placement).",
        default=NO_FINGERS,
    )
    priority: Literal["field", "level"] = described(
        "What has priority if the amplifier does not allow both: the whole field, at a level that the amplifier "
        "allows; or the exact level at the focus, with the field as close as the amplifier allows, which changes the "
        "spectrum.",
        default="field",
    )
    equalise_band_Hz: tuple[Positive, Positive] | None = described(  # noqa: N815
        "Band, from and to [Hz], in which the root mean square velocity at the focus is made the same at every "
        "placement as at the first, by scaling the levels of the others. Null for the same peak.",
        default=None,
        exclude_if=lambda given: given is None,
    )


class StimulusVariant(Section):
    """One of several stimuli, by its differences from the section ``stimulus``."""

    law: Literal["exact", "paper"] | None = described("As in the section stimulus.", default=None)
    design: Literal["least_energy", "norm_4", "norm_8", "least_peak"] | None = described(
        "As in the section stimulus.", default=None
    )
    focus: ZoneName | None = described("As in the section stimulus.", default=None)
    further_foci: Annotated[tuple[ZoneName, ...], Field(max_length=20)] | None = described(
        "As in the section stimulus.", default=None
    )
    field: FieldSection | None = described("As in the section stimulus.", default=None)
    decomposed_modes: Annotated[Count, Field(le=1000)] | None = described("As in the section stimulus.", default=None)
    selected_modes: Selection | None = described("As in the section stimulus.", default=None)
    focusing_instant_ms: Positive | None = described("As in the section stimulus.", default=None)
    duration_ms: Positive | None = described("As in the section stimulus.", default=None)
    release: Literal["braked", "free"] | None = described("As in the section stimulus.", default=None)
    n_samples: SampleCount | None = described("As in the section stimulus.", default=None)
    repetition_rate_Hz: Positive | None = described("As in the section stimulus.", default=None)  # noqa: N815
    presentation_bursts: Annotated[Count, Field(le=100_000)] | None = described(
        "Number of bursts of this stimulus if it stops before the question; null for the number in the section "
        "answers.",
        default=None,
        exclude_if=lambda given: given is None,
    )
    masked: Annotated[bool, Field(strict=True)] | None = described(
        "Whether the masking noise is on with this stimulus; null for on, if there is a section masking.",
        default=None,
        exclude_if=lambda given: given is None,
    )

    def applied(self, base: StimulusSection) -> StimulusSection:
        """Return a stimulus with the keys of this variant applied."""
        own = {key: getattr(self, key) for key in type(self).model_fields if key in StimulusSection.model_fields}
        return base.model_copy(update={key: value for key, value in own.items() if value is not None})


IntervalNumber = Annotated[int, Field(strict=True, ge=1, le=3)]
Meaning = IntervalNumber | Literal["same", "different"]
"""Meaning of an answer: an interval, or whether all intervals were alike."""

STANDARD_LEVEL = ("intervals", "standard", "velocity_mm_s")
"""Path of the standard's level."""


class StandardSection(Section):
    """The reference stimulus in the other intervals, under the same fingers."""

    velocity_mm_s: NotNegative | None = described(
        "Level of the standard [mm/s], such as 100; 0 for a silent interval; null for the level of the comparison.",
        default=None,
    )
    stimulus: Word | None = described(
        "Name, under stimuli, of the stimulus that is the standard; null for that of the comparison.", default=None
    )


class IntervalsSection(Section):
    """Multi-interval trials: one interval presents the condition of the trial, the others the standard."""

    number: Annotated[int, Field(strict=True, ge=2, le=3)] = described("Number of intervals in each trial.", default=2)
    gap_s: Annotated[NotNegative, Field(le=60)] = described(
        "Time from the end of an interval's last burst until the next interval is prepared, with the outputs off [s]. "
        "Its first burst comes about a tenth of a second later; the instant is in the record.",
        default=0.5,
    )
    standard: StandardSection = described("What the other intervals present: a level, a stimulus, or both.")
    comparison_in: tuple[IntervalNumber, ...] | None = described(
        "Intervals that may contain the comparison, the trial's condition: each is used equally often in each "
        "condition. Null for all; [2] puts the standard first in every trial.",
        default=None,
        json_schema_extra={"uniqueItems": True},
    )
    asked: Literal["comparison", "stronger"] = described(
        "Which interval is correct: the one with the comparison (which one was different, which one vibrated), or the "
        "one with the higher level (which one was stronger), which may be the standard.",
        default="comparison",
    )

    @property
    def places(self) -> tuple[int, ...]:
        """Intervals that may hold the comparison."""
        return self.comparison_in or tuple(range(1, self.number + 1))

    def standard_of(self, comparison: Condition) -> Condition:
        """Return the condition of the intervals that do not hold the comparison."""
        given = self.standard
        velocity = comparison.velocity_mm_s if given.velocity_mm_s is None else given.velocity_mm_s
        return replace(comparison, velocity_mm_s=velocity, stimulus=given.stimulus or comparison.stimulus)

    def is_correct(self, meaning: Meaning | None, comparison: Condition, interval: int) -> bool | None:
        """Score an answer; None if it does not refer to the intervals, or if any of them may be correct."""
        standard = self.standard_of(comparison)
        if meaning is None or isinstance(meaning, str):
            return None if meaning is None else (standard == comparison) is (meaning == "same")
        above = comparison.velocity_mm_s - standard.velocity_mm_s
        if standard == comparison or (self.asked == "stronger" and (above == 0 or (above < 0 and self.number > 2))):
            return None
        return meaning == (3 - interval if self.asked == "stronger" and above < 0 else interval)


def presented_levels(reading: Reading[Any]) -> dict[tuple[Step, ...], float]:
    """Return the valid levels of a protocol by path [mm/s], including that of the standard if not among them."""
    section = ("conditions", "peak_velocities_mm_s")
    levels: dict[tuple[Step, ...], float] = {(*section, index): level for index, level in reading.items(*section)}
    presented = reading.value is None or reading.value.intervals is not None
    if presented and (standard := reading.sound(*STANDARD_LEVEL)) and standard not in levels.values():
        levels[STANDARD_LEVEL] = standard
    return levels


Points = tuple[tuple[float, float], ...]


_FIELD = ("stimulus", "field")


POINT_COLUMNS = ("position_mm", "velocity")
"""Header of a file of points."""


def check_target_field(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield a problem for each inconsistency between the valid keys of the target field."""
    shape = reading.sound(*_FIELD, "shape")
    # For one of several stimuli, the merged value counts rather than the section in the file.
    held = reading.sound if reading.value is not None else lambda *path: reading.find(path)
    named = [key for key in ("points", "file") if held(*_FIELD, key) is not None]
    if shape == "sampled" and len(named) != 1:
        yield reading.problem(
            (*_FIELD, "shape"),
            "a sampled field with " + ("points and a file" if named else "neither points nor a file"),
            "one of points, file",
            f"write `points: [[-20, 0], [0, 1], [20, 0]]`, or `file:` with the columns {', '.join(POINT_COLUMNS)}",
        )
    if shape is not None and shape != "sampled":
        for key in named:
            yield reading.problem(
                (*_FIELD, key),
                f"{key} for a field whose shape is {shape}",
                "only with `shape: sampled`",
                "write `shape: sampled`",
            )
    foci = reading.items("stimulus", "further_foci")
    focus = reading.sound("stimulus", "focus")
    if shape == "sampled" and foci:
        yield reading.problem(
            ("stimulus", "further_foci"), "further foci of a sampled field", "none", "include them in the points"
        )
    for index, zone, _ in repeats([("", focus), *foci]):
        yield reading.problem(
            ("stimulus", "further_foci", index), f"{zone}, which is already a focus", "each zone once", "remove it"
        )
    for index, problem in unordered(reading.sound(*_FIELD, "points") or ()):
        yield reading.problem((*_FIELD, "points", index), problem, "increasing positions", "sort the points")


def unordered(points: Points | list[tuple[float, float]]) -> Iterator[tuple[int, str]]:
    """Yield the index of each point that does not lie right of the one before, and both positions in words."""
    for index in range(1, len(points)):
        if points[index][0] <= points[index - 1][0]:
            yield index, f"{points[index][0]:g} mm after {points[index - 1][0]:g} mm"


Decibels = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-120, le=140)]


class MaskingSection(Section):
    """Masking noise, played continuously from before the first trial until after the last."""

    noise: Literal["pink", "white"] = described(
        "pink: equal power per octave; white: equal power per hertz; both from 20 Hz to 20 kHz.", default="pink"
    )
    level_dB_FS: Decibels | None = described(  # noqa: N815
        "Level of the noise relative to a full-scale sine [dB FS, rms].", default=None
    )
    level_dB_SPL: Decibels | None = described(  # noqa: N815
        "Level at the ear instead [dB SPL]; needs sound.full_scale_dB_SPL in the apparatus.", default=None
    )
    fade_s: Annotated[Positive, Field(le=60)] = described("Time to fade in and out [s].", default=2.0)
    required: bool = Field(
        strict=True,
        default=True,
        description="Whether a session must not begin or continue without the noise; if not required, the record says "
        "where it is missing.",
    )

    def level(self, sound: Sound) -> float | None:
        """Return the level relative to a full-scale sine [dB FS]; None if the level or its calibration is missing."""
        if self.level_dB_FS is not None:
            return self.level_dB_FS
        if self.level_dB_SPL is None or sound.full_scale_dB_SPL is None:
            return None
        return self.level_dB_SPL - sound.full_scale_dB_SPL

    @property
    def level_key(self) -> str:
        """The key that gives the level."""
        return "level_dB_FS" if self.level_dB_FS is not None else "level_dB_SPL"


def check_masking(protocol: Reading[Any], apparatus: Reading[Apparatus]) -> Iterator[Problem]:
    """Yield the problems of the level of the masking noise, as far as both files are valid."""
    if protocol.keys("masking") is None:
        return
    given = [key for key in ("level_dB_FS", "level_dB_SPL") if protocol.sound("masking", key) is not None]
    if any(problem.path.startswith("masking.level") for problem in protocol.problems):
        return
    if len(given) != 1:
        listed = " and ".join(given) or "no level"
        yield protocol.problem(("masking",), listed, "one of level_dB_FS and level_dB_SPL", "give the noise one level")
    elif given == ["level_dB_SPL"] and apparatus.sound("sound", "full_scale_dB_SPL") is None:
        listed = f"{protocol.sound('masking', 'level_dB_SPL'):g} dB SPL, but the loudspeaker is not calibrated"
        yield protocol.problem(
            ("masking", "level_dB_SPL"),
            listed,
            "only if the apparatus has sound.full_scale_dB_SPL",
            "measure the level of a full-scale sine at the ear, or give level_dB_FS",
        )
