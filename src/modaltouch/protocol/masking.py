"""The section ``masking``: noise that masks the sound of the beam."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field

from modaltouch.protocol.apparatus import Apparatus, Sound
from modaltouch.protocol.problems import Problem
from modaltouch.protocol.reading import Reading
from modaltouch.protocol.section import Positive, Section, described

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
        """Return the level relative to a full-scale sine [dB FS]; None if the level or its calibration is missing.

        Parameters
        ----------
        sound : Sound
            The audio device.
        """
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
        said = " and ".join(given) or "no level"
        allowed = "one of level_dB_FS and level_dB_SPL"
        yield protocol.problem(("masking",), said, allowed, "give the noise one level")
    elif given == ["level_dB_SPL"] and apparatus.sound("sound", "full_scale_dB_SPL") is None:
        said = f"{protocol.sound('masking', 'level_dB_SPL'):g} dB SPL, but the loudspeaker is not calibrated"
        remedy = "measure the level of a full-scale sine at the ear, or give level_dB_FS"
        yield protocol.problem(
            ("masking", "level_dB_SPL"), said, "only if the apparatus has sound.full_scale_dB_SPL", remedy
        )
