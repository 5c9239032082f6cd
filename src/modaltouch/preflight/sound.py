"""Whether the masking noise fits the sound device's range, and whether ears bear it."""

from __future__ import annotations

import math
from collections.abc import Iterator

from modaltouch.protocol import Apparatus, Findings, Problem, Protocol
from modaltouch.window import Masking

LOUD = 80.0
"""Level at which hearing protection begins to be a matter of hours (2003/10/EC, lower action value) [dB SPL]."""


def check_masking_level(findings: Findings) -> Iterator[Problem]:
    """Yield the level of a masking noise whose peaks would pass full scale."""
    protocol, apparatus = findings.protocol, findings.apparatus
    if protocol is None or apparatus is None or findings.problems:
        return
    if protocol.value is None or apparatus.value is None or protocol.value.masking is None:
        return
    section, sound = protocol.value.masking, apparatus.value.sound
    level = section.level(sound)
    highest = Masking.highest_level(section.noise, sound.sampling_rate_Hz)
    if level is None or level <= highest:
        return
    unit = section.level_key.removeprefix("level_").replace("_", " ")
    shift = 0.0 if section.level_dB_FS is not None else sound.full_scale_dB_SPL or 0.0
    given = f"{level + shift:g} {unit}, at which the peaks of the {section.noise} noise pass full scale"
    # Rounded down, so that what is allowed is allowed.
    allowed = f"at most {math.floor((highest + shift) * 10) / 10:g} {unit}"
    yield protocol.problem(("masking", section.level_key), given, allowed, "lower it, and turn the amplifier up")


def sound_warnings(protocol: Protocol, apparatus: Apparatus) -> list[str]:
    """Return what a lab should know of its masking noise."""
    section, sound = protocol.masking, apparatus.sound
    if section is None:
        return []
    level = section.level(sound)
    if level is None:
        return []
    if sound.full_scale_dB_SPL is None:
        return [f"masking noise at {level:g} dB FS: its level at the ear is unknown, as the device is not calibrated"]
    if level + sound.full_scale_dB_SPL > LOUD:
        return [
            f"masking noise at {level + sound.full_scale_dB_SPL:g} dB SPL: above {LOUD:g} dB it may harm hearing "
            "within hours; keep sessions short and the total of a day in mind"
        ]
    return []
