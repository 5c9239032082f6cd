"""Which calibration a protocol needs."""

from __future__ import annotations

from pydantic import Field

from modaltouch.protocol.section import Positive, Section, Text, described


class CalibrationLimits(Section):
    """What a calibration may leave at most, its uncertainty included; one that misses them is marked."""

    velocity_mm_s: Positive = described("Error of a modal velocity at the focusing instant [mm/s].", default=0.3)
    displacement_mm_s: Positive = described(
        "Modal displacement times angular frequency there, desired to be 0 [mm/s].", default=0.3
    )
    level_percent: Positive = described("Deviation of a level at the focus [percent].", default=1.0)


class CalibrationSection(Section):
    """Which calibration the stimulus needs."""

    file: Text | None = described(
        "File of the calibration that `modaltouch calibrate` wrote, seen from this file; null for none.", default=None
    )
    max_age_days: Positive | None = described(
        "Oldest calibration that a session may begin with [days]; null for any.", default=None
    )
    required: bool = Field(
        strict=True, default=False, description="Whether a session without a calibration is refused."
    )
    limits: CalibrationLimits = described(
        "What a calibration may leave at most, its uncertainty included; one that misses them is marked.",
        default=CalibrationLimits(),
    )
