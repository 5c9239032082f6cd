"""What the participant sees and hears with: screen and sound."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from modaltouch.protocol.section import Count, Positive, Section, Text, described


class ScreenSection(Section):
    """The participant's screen, as it stands."""

    width_mm: Positive = described("Width of the picture [mm], such as 531 for 24 inches of 16:9.")
    width_px: Count = described("Width of the picture [pixels], such as 1920.")
    height_px: Count = described("Height of the picture [pixels], such as 1080.")
    distance_mm: Positive = described("From the participant's eyes to the screen [mm], such as 700.")


class Sound(Section):
    """What plays sound to the participant."""

    device: Text = described("Part of the sound device's name; empty for the system's own choice.", default="")
    sampling_rate_Hz: Annotated[float, Field(strict=True, ge=8000, le=192_000)] = described(  # noqa: N815
        "Samples per second [Hz].", default=48_000.0
    )
    full_scale_dB_SPL: Annotated[float, Field(strict=True, ge=0, le=200)] | None = described(  # noqa: N815
        "Sound pressure level at the ear for a sine of full scale [dB SPL]; null where it was not measured.",
        default=None,
    )
