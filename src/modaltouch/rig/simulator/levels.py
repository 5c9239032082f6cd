"""Amplitudes in volts peak to peak, volts rms and dBm, at the load that a channel is told."""

from __future__ import annotations

import math
import re

from modaltouch.rig.simulator.arguments import read_number
from modaltouch.rig.simulator.channel import Channel
from modaltouch.rig.simulator.scpi import Argument, ScpiError

LOWEST, HIGHEST, DEFAULT = 20e-3, 20.0, 2.0
"""Amplitude into an open circuit [V peak to peak]."""

PEAK_TO_PEAK_PER_RMS = {"SIN": 2 * math.sqrt(2.0), "SQU": 2.0, "RAMP": 2 * math.sqrt(3.0)}
"""Of the waveforms whose rms does not depend on a record [1]."""

MILLIWATT = 1e-3


def amplitude_in_vpp(argument: Argument, channel: Channel) -> float:
    """Return an amplitude that was sent, at the configured load [V peak to peak].

    Parameters
    ----------
    argument : str or bytes
        A number with or without unit; without one it is in the channel's.
    channel : Channel
        Its unit, waveform and load.

    Raises
    ------
    ScpiError
        -131 for a foreign unit, -221 where the waveform or load has no such unit, -222 out of range.
    """
    factor = channel.load_factor
    low, high = LOWEST * factor, HIGHEST * factor
    named = re.search(r"(VPP|VRMS|DBM)\s*$", argument, re.IGNORECASE) if isinstance(argument, str) else None
    bare = isinstance(argument, str) and re.search(r"[A-Za-z]", argument.upper().replace("E", "")) is None
    unit = named[1].upper() if named else channel.unit if bare else "VPP"
    if unit == "VPP":
        return read_number(argument, units={"V": 1.0, "VPP": 1.0}, minimum=low, maximum=high, default=DEFAULT * factor)
    per_rms = _per_rms(channel, unit)
    if unit == "VRMS":
        bounds = low / per_rms, high / per_rms
        return per_rms * read_number(argument, units={"VRMS": 1.0}, minimum=bounds[0], maximum=bounds[1])
    least, most = (amplitude_in_unit(bound, channel, "DBM") for bound in (low, high))
    level = read_number(argument, units={"DBM": 1.0}, minimum=least, maximum=most)
    return per_rms * math.sqrt(MILLIWATT * channel.load * 10 ** (level / 10))


def amplitude_in_unit(vpp: float, channel: Channel, unit: str | None = None) -> float:
    """Return an amplitude [V peak to peak at the load] in a unit, the channel's if none is named.

    An arbitrary record has no rms of its own here: it is told in volts peak to peak.
    """
    unit = unit or channel.unit
    if unit == "VPP" or channel.function not in PEAK_TO_PEAK_PER_RMS:
        return vpp
    rms = vpp / _per_rms(channel, unit)
    return rms if unit == "VRMS" else 10 * math.log10(rms**2 / channel.load / MILLIWATT)


def _per_rms(channel: Channel, unit: str) -> float:
    if channel.function not in PEAK_TO_PEAK_PER_RMS:
        raise ScpiError(-221, f"{channel.function} has no amplitude in {unit}: give it in VPP")
    if unit == "DBM" and math.isinf(channel.load):
        raise ScpiError(-221, "no power goes into an open circuit: give the amplitude in VPP")
    return PEAK_TO_PEAK_PER_RMS[channel.function]
