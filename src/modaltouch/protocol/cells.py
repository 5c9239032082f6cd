"""Cells that are listed in the protocol, with weights, and cells left out: designs that are not crossed."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from modaltouch.protocol.section import Count, Positive, Section, Word, described
from modaltouch.protocol.stimulus_sections import ZoneName

Cell = tuple[tuple[str, ...], float, str]
"""The zones under the fingers, a peak velocity [mm/s], and the name of a stimulus."""

ZonePair = tuple[ZoneName, ZoneName]
Contacts = Annotated[tuple[ZoneName, ...], Field(min_length=1, max_length=3)]


class CellsSection(Section):
    """Cells of a design that is not crossed: one pair of zones at one level or several."""

    pair: Contacts = described(
        "Zones under the fingers, from left to right as the participant sees the beam: mostly two, or one or three for "
        "finger conditions of as many fingers."
    )
    peak_velocities_mm_s: Annotated[tuple[Positive, ...], Field(min_length=1)] = described(
        "Peak velocities of this pair at the centre of the focus zone at the focusing instant [mm/s]."
    )
    finger_conditions: tuple[Word, ...] = described(
        "Finger conditions that have these cells; all if omitted.", default=()
    )
    stimuli: tuple[Word, ...] = described(
        "Names of the stimuli that these cells are presented with; all if omitted.", default=()
    )
    weight: Annotated[Count, Field(le=10_000)] = described(
        "Trials of each of these cells for each of schedule.repetitions, such as 2 for twice as many.", default=1
    )


class ExcludedCells(Section):
    """Cells that are left out of the crossed design: those that agree with every key that is given."""

    pair: Contacts | None = described("Zones as in zone_pairs or zones; null for any.", default=None)
    peak_velocity_mm_s: Positive | None = described("Peak velocity [mm/s]; null for any.", default=None)
    finger_condition: Word | None = described("Finger condition; null for any.", default=None)
    stimulus: Word | None = described("Name of a stimulus; null for any.", default=None)

    def holds(self, finger_condition: str, cell: Cell) -> bool:
        """Return whether a cell of a finger condition is among them."""
        wanted = (self.finger_condition, self.pair, self.peak_velocity_mm_s, self.stimulus)
        return all(want in (None, own) for want, own in zip(wanted, (finger_condition, *cell), strict=True))
