"""What the generator is set to: each setting with its command, its query, and what confirms it. Pure values."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol import Apparatus
from modaltouch.rig.interface import RigError
from modaltouch.stimulus import MID_CODE, Burst

LOWEST_AMPLITUDE = 20e-3
"""Smallest amplitude of an AFG3022B into an open circuit [V peak to peak]."""

QUIET_AMPLITUDE = 0.1
"""Where the level waits [V peak to peak]: above every minimum that is told of these instruments."""

MAX_POINTS = 131_072
"""Longest record of an AFG3022B [points]."""

HIGHEST_LEVEL = 10.0
"""Highest output of an AFG3022B into an open circuit [V]."""

LARGEST_STEP = 0.01
"""How far from zero a record may begin and end, as a part of its full scale [1]."""

KNOWN_MODELS = ("AFG3022B", "AFG3022C")
"""Models whose commands and limits are those above; any other is taken only if the apparatus file names it."""


@dataclass(frozen=True)
class Setting:
    """One setting of the instrument.

    Attributes
    ----------
    header : str
        SCPI header.
    value : float or str
        A number, or a keyword in its short form.
    unit : str
        Sent with a number.
    tolerance : float
        Relative difference that a number may have when it is read back [1].
    of : str
        What it is a setting of, where the header does not say.
    """

    header: str
    value: float | str
    unit: str = ""
    tolerance: float = 1e-4
    of: str = ""

    @property
    def command(self) -> str:
        """What sets it."""
        if isinstance(self.value, str):
            return f"{self.header} {self.of},{self.value}" if self.of else f"{self.header} {self.value}"
        return f"{self.header} {self.value:.12g}{self.unit}"

    @property
    def query(self) -> str:
        """What asks for it."""
        return f"{self.header}? {self.of}" if self.of else f"{self.header}?"

    def confirmed_by(self, reply: str) -> bool:
        """Return whether a reply says what was set."""
        if isinstance(self.value, str) and self.value != "INF":
            return reply.upper() in _LONG_FORMS.get(self.value, (self.value,))
        try:
            number = float(reply)
        except ValueError:
            return False
        if isinstance(self.value, str):
            return number >= 9.9e37
        return math.isclose(number, self.value, rel_tol=self.tolerance, abs_tol=0.0 if self.value else 1e-4)


_LONG_FORMS = {
    "ON": ("ON", "1"),
    "OFF": ("OFF", "0"),
    "NORM": ("NORM", "NORMAL"),
    "TRIG": ("TRIG", "TRIGGERED"),
    "TIM": ("TIM", "TIMER"),
    "EXT": ("EXT", "EXTERNAL"),
    "USER1": ("USER1", "USER"),
}


ARMED = Setting("TRIG:SOUR", "TIM")
STOPPED = Setting("TRIG:SOUR", "EXT")
"""The trigger runs from the timer, or waits for a command or a pulse at its input."""


@dataclass(frozen=True)
class Limits:
    """What may leave the generator.

    Attributes
    ----------
    level : float
        Highest output voltage, either sign, open circuit [V].
    beam : float
        Highest voltage at the beam [V].
    gain : float
        Volts at the beam per open-circuit volt of the generator [1].
    velocity : float
        Highest peak velocity [m/s].
    """

    level: float
    beam: float
    gain: float
    velocity: float

    @classmethod
    def of(cls, apparatus: Apparatus) -> Limits:
        """Return the limits that an apparatus sets."""
        return cls(
            highest_level(apparatus),
            apparatus.amplifier.limit_V,
            _gain(apparatus),
            apparatus.safety.velocity_limit_mm_s * 1e-3,
        )


def highest_level(apparatus: Apparatus) -> float:
    """Return the highest output, either sign, that amplifier and generator allow, open circuit [V]."""
    # Rounded down to 10 mV, so that the instrument's own rounding cannot lift it.
    return min(math.floor(apparatus.amplifier.limit_V / _gain(apparatus) * 100 + 1e-6) / 100, HIGHEST_LEVEL)


def _gain(apparatus: Apparatus) -> float:
    return apparatus.amplifier.gain_V_per_V * apparatus.generator.load_factor


def record_peaks(burst: Burst) -> tuple[float, ...]:
    """Return the highest value of each channel's record, as a part of half its amplitude [1]."""
    peaks = np.abs(burst.codes.astype(np.int32) - MID_CODE).max(axis=1) / MID_CODE
    return tuple(float(peak) for peak in peaks)


def refuse_steps(burst: Burst) -> None:
    """Refuse a burst that does not rise from zero and fall back to it.

    Raises
    ------
    RigError
        If a record begins or ends further from zero than `LARGEST_STEP`.
    """
    ends = np.abs(burst.codes[:, [0, -1]].astype(np.int32) - MID_CODE).max(axis=1) / MID_CODE
    for number, end in enumerate(ends, start=1):
        if end > LARGEST_STEP:
            raise RigError(
                f"the record of output {number} begins or ends at {end:.1%} of its full scale: at most "
                f"{LARGEST_STEP:.0%} is allowed, for the outputs rest there between bursts; the outputs are off; "
                "ramp it on and off"
            )


def amplitudes(burst: Burst, peaks: tuple[float, ...], velocity: float, limits: Limits) -> tuple[float, ...]:
    """Return the amplitude of each channel at a level, or refuse it.

    Parameters
    ----------
    burst : Burst
        The records.
    peaks : tuple of float
        Of each record, as `record_peaks` returns them.
    velocity : float
        Peak velocity at the focus [m/s].
    limits : Limits
        What may leave the generator.

    Returns
    -------
    tuple of float
        Amplitude of each channel, open circuit [V peak to peak].

    Raises
    ------
    RigError
        If the level cannot be played, or must not.
    """
    if not (math.isfinite(velocity) and 0 < velocity <= limits.velocity):
        raise RigError(
            f"a peak velocity of {velocity * 1e3:g} mm/s was asked for: allowed above 0, up to the safety "
            f"limit of {limits.velocity * 1e3:g} mm/s; the outputs stay off; change the protocol, or the "
            "limit in the apparatus file"
        )
    channels = zip(burst.amplitude_for(velocity), peaks, strict=True)
    return tuple(
        _playable(number, amplitude, peak, velocity, limits)
        for number, (amplitude, peak) in enumerate(channels, start=1)
    )


def _playable(number: int, amplitude: float, peak: float, velocity: float, limits: Limits) -> float:
    where = f"{velocity * 1e3:g} mm/s needs {amplitude:g} V peak to peak of output {number}"
    remedy = "the outputs stay off; lower the velocity, or correct the apparatus file"
    if peak == 0:
        return quiet_level(limits)
    beam = amplitude / 2 * peak * limits.gain
    if not beam <= limits.beam * (1 + 1e-9):
        raise RigError(f"{where}, {beam:.1f} V at the beam: allowed at most {limits.beam:g} V; {remedy}")
    if not LOWEST_AMPLITUDE <= amplitude <= 2 * limits.level:
        raise RigError(f"{where}: allowed {LOWEST_AMPLITUDE:g} to {2 * limits.level:g} V; {remedy}")
    return amplitude


def quiet_level(limits: Limits) -> float:
    """Return the amplitude of a channel that plays nothing [V peak to peak]."""
    return min(QUIET_AMPLITUDE, 2 * limits.level)


def quiet_settings(channel: int, limits: Limits) -> tuple[Setting, ...]:
    """Return what is set once, before anything is loaded: scale of the numbers, lowest level, limits."""
    source = f"SOUR{channel}"
    return (
        Setting(f"OUTP{channel}:IMP", "INF"),
        Setting(f"OUTP{channel}:POL", "NORM"),
        Setting(f"{source}:VOLT:UNIT", "VPP"),
        Setting(f"{source}:VOLT:OFFS", 0.0, "V"),
        Setting(f"{source}:VOLT", quiet_level(limits), "VPP"),
        Setting(f"{source}:VOLT:LIM:HIGH", limits.level, "V"),
        Setting(f"{source}:VOLT:LIM:LOW", -limits.level, "V"),
    )


def guarded_settings(limits: Limits) -> tuple[Setting, ...]:
    """Return the quiet settings of both channels that still hold at every firing: all but the level."""
    both = [setting for channel in (1, 2) for setting in quiet_settings(channel, limits)]
    return tuple(setting for setting in both if not setting.header.endswith(":VOLT"))


def burst_settings(channel: int, slot: int, burst: Burst) -> tuple[Setting, ...]:
    """Return what makes a channel play a USER memory once at each trigger."""
    source = f"SOUR{channel}"
    return (
        Setting(f"{source}:FREQ", 1 / burst.duration, "HZ", tolerance=1e-6),
        Setting(f"{source}:FUNC", f"USER{slot}"),
        Setting(f"{source}:BURS:MODE", "TRIG"),
        Setting(f"{source}:BURS:NCYC", 1.0),
        Setting(f"{source}:BURS:TDEL", 0.0, "S"),
        Setting(f"{source}:PHAS", 0.0, "RAD"),
        Setting(f"{source}:BURS:STAT", "ON"),
    )


def continuous_settings(channel: int, slot: int, burst: Burst) -> tuple[Setting, ...]:
    """Return what makes a channel repeat a USER memory without trigger."""
    source = f"SOUR{channel}"
    return (
        Setting(f"{source}:FREQ", burst.repetition_rate, "HZ", tolerance=1e-6),
        Setting(f"{source}:FUNC", f"USER{slot}"),
        Setting(f"{source}:PHAS", 0.0, "RAD"),
        Setting(f"{source}:BURS:STAT", "OFF"),
    )


def lock_setting(slot: int, state: str) -> Setting:
    """Return whether a USER memory can be overwritten, at the front panel as well."""
    return Setting("DATA:LOCK:STAT", state, of=f"USER{slot}")


def timer_setting(burst: Burst) -> Setting:
    """Return the time between triggers, of which the instrument may keep as few as four digits."""
    return Setting("TRIG:TIM", 1 / burst.repetition_rate, "S", tolerance=5e-4)


def level_setting(channel: int, amplitude: float) -> Setting:
    """Return an amplitude, open circuit [V peak to peak]."""
    return Setting(f"SOUR{channel}:VOLT", amplitude, "VPP")


def continuous_codes(burst: Burst) -> NDArray[np.uint16]:
    """Return one record that holds a whole repetition, burst and silence, for a generator without burst mode.

    The burst's steps fall on the nearest of 131,072 points a period, so that it cannot be exact: at 7 Hz a step
    is late or early by up to 0.55 us, and of the shipped stimulus a mode is missed by 0.014 mm/s in 200, where the
    burst itself misses 1e-5 mm/s (`modaltouch.preflight.checked` computes it).

    Returns
    -------
    (n_channels, 131072) array of uint16
        Codes.
    """
    n_channels, n_samples = burst.codes.shape
    middles = (np.arange(MAX_POINTS) + 0.5) / (MAX_POINTS * burst.repetition_rate)
    held = np.floor(middles / burst.duration * n_samples).astype(int)
    codes = np.full((n_channels, MAX_POINTS), MID_CODE, dtype=np.uint16)
    playing = held < n_samples
    codes[:, playing] = burst.codes[:, held[playing]]
    return codes
