"""Levels calibrated by participant: multiples of the participant's own threshold, found in an earlier session."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from modaltouch.protocol.document.section import FileName, Section, described

Multiple = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1000)]


class SensationLevelsSection(Section):
    """Levels as multiples of a participant's own threshold: the sensation level, as a ratio and not in dB."""

    thresholds_from: FileName = described(
        "Name of the adaptive protocol whose latest complete session tells the participant's threshold: the geometric "
        "mean over its runs."
    )
    multiples: tuple[Multiple, ...] = described(
        "Levels as multiples of that threshold [1].",
        min_length=1,
        max_length=100,
        json_schema_extra={"uniqueItems": True},
    )

    def levels(self, threshold_mm_s: float) -> tuple[float, ...]:
        """Return the levels of a participant [mm/s], to four digits as the generator's amplitude has them.

        Parameters
        ----------
        threshold_mm_s : float
            The participant's own threshold [mm/s].
        """
        return tuple(float(f"{multiple * threshold_mm_s:.4g}") for multiple in self.multiples)

    def thresholds(self, lowest_mm_s: float, highest_mm_s: float) -> tuple[float, float]:
        """Return between which thresholds all levels lie within bounds [mm/s].

        Parameters
        ----------
        lowest_mm_s, highest_mm_s : float
            Lowest and highest level that any participant may get.
        """
        return lowest_mm_s / min(self.multiples), highest_mm_s / max(self.multiples)
