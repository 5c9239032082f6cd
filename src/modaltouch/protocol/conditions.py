"""The section ``conditions`` of a protocol: fingers, zones and levels, and the design that they define."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from modaltouch.protocol.adaptive import SensationLevelsSection
from modaltouch.protocol.section import Count, Positive, Section, Text, Word, described
from modaltouch.protocol.stimulus_sections import ZoneName
from modaltouch.protocol.trial import Condition

FingerCondition = Annotated[Word, Field(json_schema_extra={"x-allowed": "one_hand, two_hands or a name of your own"})]
FingerName = Literal[
    "left little", "left ring", "left middle", "left index", "left thumb",
    "right thumb", "right index", "right middle", "right ring", "right little",
]  # fmt: skip
"""Fingers from left to right, palms down."""
Placement = Literal["normal", "mirrored", "swapped", "mirrored_swapped"]

_UNIQUE = {"uniqueItems": True}

Cell = tuple[tuple[str, ...], float, str]
"""The zones under the fingers, a peak velocity [mm/s], and the name of a stimulus."""

_TWO = (
    "a list of exactly 2, each the name of a zone of the beam; for one finger or three, conditions.zones and "
    "conditions.fingers"
)
ZonePair = Annotated[tuple[ZoneName, ZoneName], Field(json_schema_extra={"x-allowed": _TWO})]
Contacts = Annotated[tuple[ZoneName, ...], Field(min_length=1, max_length=3)]


class CellsSection(Section):
    """Cells of an uncrossed design: one pair of zones at one or more levels."""

    pair: Contacts = described(
        "Zones under the fingers, from left to right as the participant sees the beam: usually two; one or three for "
        "finger conditions with that many fingers."
    )
    peak_velocities_mm_s: Annotated[tuple[Positive, ...], Field(min_length=1)] = described(
        "Peak velocities of this pair at the centre of the focus zone at the focusing instant [mm/s]."
    )
    finger_conditions: tuple[Word, ...] = described(
        "Finger conditions that contain these cells; all if omitted.", default=()
    )
    stimuli: tuple[Word, ...] = described("Names of the stimuli presented in these cells; all if omitted.", default=())
    weight: Annotated[Count, Field(le=10_000)] = described(
        "Number of trials of each of these cells per repetition (schedule.repetitions), such as 2 for twice as many.",
        default=1,
    )


class ExcludedCells(Section):
    """Cells excluded from the crossed design: those that match all given keys."""

    pair: Contacts | None = described("Zones as in zone_pairs or zones; null for any.", default=None)
    peak_velocity_mm_s: Positive | None = described("Peak velocity [mm/s]; null for any.", default=None)
    finger_condition: Word | None = described("Finger condition; null for any.", default=None)
    stimulus: Word | None = described("Name of a stimulus; null for any.", default=None)

    def holds(self, finger_condition: str, cell: Cell) -> bool:
        """Test whether a cell of a finger condition is excluded."""
        wanted = (self.finger_condition, self.pair, self.peak_velocity_mm_s, self.stimulus)
        return all(want in (None, own) for want, own in zip(wanted, (finger_condition, *cell), strict=True))


class ConditionsSection(Section):
    """The cells of the design: every finger condition with every pair and peak velocity, or the cells listed."""

    model_config = ConfigDict(
        json_schema_extra={
            "required": [],
            "allOf": [{"anyOf": [{"required": [key]} for key in ("zone_pairs", "zones", "cells", "table")]}],
        }
    )

    finger_conditions: tuple[FingerCondition, ...] = described(
        "one_hand: index and middle finger of one hand; two_hands: both index fingers; or names defined under fingers.",
        min_length=1,
        json_schema_extra=_UNIQUE,
    )
    fingers: dict[FingerCondition, Annotated[tuple[FingerName, ...], Field(min_length=1, max_length=3)]] = described(
        "Your own finger conditions: a name, and one to three fingers from left to right as the participant sees "
        "them, palms down, such as `three_fingers: [left index, right index, right middle]`.",
        default={},
        exclude_if=lambda given: not given,
    )
    hand: Literal["right", "left"] = described("The hand used in one_hand.", default="right")
    placements: tuple[Placement, ...] = described(
        "Placements that alternate between participants, so that effects of zone, side and finger can be separated: "
        "normal; mirrored, with the beam turned end to end; swapped, with the other hand, or with crossed hands if "
        "both are on the beam as in two_hands; or both.",
        default=("normal",),
        min_length=1,
        json_schema_extra=_UNIQUE,
    )
    zone_pairs: tuple[ZonePair, ...] = described(
        "Zones under the two fingers, left and right as the participant sees the beam. For one finger or three, give "
        "zones instead.",
        default=(),
        min_length=1,
        max_length=100,
        json_schema_extra=_UNIQUE,
        exclude_if=lambda given: not given,
    )
    zones: tuple[Contacts, ...] = described(
        "Zones under one to three fingers, from left to right as the participant sees the beam, in place of "
        "zone_pairs: [[C], [E]] for one finger, [[A, C, E]] for three. To use a place that is not a zone yet, define "
        "it in the apparatus file (centre_mm, width_mm).",
        default=(),
        min_length=1,
        max_length=100,
        json_schema_extra=_UNIQUE,
        exclude_if=lambda given: not given,
    )
    peak_velocities_mm_s: tuple[Positive, ...] = described(
        "Peak velocities at the centre of the focus zone at the focusing instant [mm/s].",
        min_length=1,
        max_length=100,
        json_schema_extra=_UNIQUE,
    )
    cells: Annotated[tuple[CellsSection, ...], Field(max_length=10_000)] = described(
        "The cells one by one, in place of zone_pairs and peak_velocities_mm_s, for a design that is not crossed: "
        "levels of each pair, weights, an order of your own (schedule.order: as_listed), such as "
        "{pair: [A, C], peak_velocities_mm_s: [80, 100], weight: 2}.",
        default=(),
        exclude_if=lambda given: not given,
    )
    table: Text | None = described(
        "CSV file with the cells, relative to this file, in place of zone_pairs and peak_velocities_mm_s: one line per "
        "cell, with the columns zone_left, zone_right (empty for one finger), peak_velocity_mm_s and, where needed, "
        "zone_between, finger_condition, stimulus and weight (as under cells). Null for none.",
        default=None,
        exclude_if=lambda given: given is None,
    )
    exclude: tuple[ExcludedCells, ...] = described(
        "Cells left out of the design, such as {pair: [A, C], peak_velocity_mm_s: 80}: all cells that match every key "
        "given.",
        default=(),
        exclude_if=lambda given: not given,
    )
    sensation_levels: SensationLevelsSection | None = described(
        "Levels calibrated for each participant, as multiples of their own threshold; the peak velocities are then the "
        "lowest and the highest level that anyone may receive. Null for the same levels for all.",
        default=None,
    )

    @property
    def contacts(self) -> tuple[tuple[str, ...], ...]:
        """Zones under the fingers, from left to right: those of `zones`, or of `zone_pairs`."""
        return self.zones or self.zone_pairs

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The entries of `contacts` with two zones."""
        return tuple((zones[0], zones[1]) for zones in self.contacts if len(zones) == 2)

    def fingers_of(self, condition: Condition) -> tuple[str, ...]:
        """Return the fingers on the zones of a condition, from left to right."""
        return condition.fingers(self.hand, self.fingers)

    @property
    def fingers_used(self) -> list[str]:
        """All fingers that rest on the beam in any condition."""
        laid = (Condition(name, "", "", 0.0, place) for name in self.finger_conditions for place in self.placements)
        return sorted({finger for each in laid for finger in self.fingers_of(each)})
