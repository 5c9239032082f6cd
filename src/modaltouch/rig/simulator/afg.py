"""The state of a simulated AFG3022B: channels, memories, amplitudes; neither SCPI nor transport."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from modaltouch.rig.simulator.scpi import ScpiError
from modaltouch.rig.simulator.state import GeneratorState, OutputChannel
from modaltouch.rig.simulator.timeline import MID_CODE, Playback


@dataclass
class Channel(OutputChannel):
    """Settings of one output of an AFG3022B."""

    function: str = "SIN"
    frequency: float = 1e6
    phase: float = 0.0
    n_cycles: float = 5.0
    symmetry: float = 50.0
    duty_cycle: float = 50.0

    @property
    def cycle(self) -> float:
        """Length of one cycle [s]."""
        return 1 / self.frequency


MAX_CODE = 16382
"""Highest code of a point."""

MEMORIES = ("USER1", "USER2", "USER3", "USER4")
"""Non-volatile memories, common to both channels."""


@dataclass
class Afg(GeneratorState[Channel]):
    """A two-channel arbitrary function generator.

    Attributes
    ----------
    clip_amplitude : float
        Fault: the output stage silently clips amplitudes to this value [V peak to peak, open circuit].
    """

    identity: str = "TEKTRONIX,AFG3022B,SIMULATED,SCPI:99.0 FV:3.2.2"
    min_points: int = 2
    max_points: int = 131_072
    clip_amplitude: float = math.inf

    def __post_init__(self) -> None:
        self.user: dict[int, bytes | None] = dict.fromkeys(range(1, len(MEMORIES) + 1))
        self.locked: dict[int, bool] = dict.fromkeys(self.user, False)
        super().__post_init__()

    def forget(self) -> None:
        """Lose the edit memory; USER memories are kept."""
        self.edit = blank_record(1000)

    def reset(self) -> None:
        """Reset as ``*RST`` does; USER memories, status and errors are kept."""
        self.channels = {number: Channel() for number in range(1, self.n_channels + 1)}
        self.trigger_source, self.timer = "TIM", 1e-3
        self.level_concurrent = self.frequency_concurrent = False
        self.trigger_output = "TRIG"
        self.clock_source = "INT"

    # memories; methods that change one are called with `lock` held

    def write_edit(self, block: bytes) -> None:
        """Replace the edit memory."""
        n_points, rest = divmod(len(block), 2)
        if rest or n_points < self.min_points:
            raise ScpiError(-161, f"{len(block)} bytes")
        if n_points > self.max_points:
            raise ScpiError(-223, f"{n_points} points: at most {self.max_points}")
        highest = int(np.frombuffer(block, ">u2").max())
        if highest > MAX_CODE:
            raise ScpiError(-222, f"code {highest}: at most {MAX_CODE}")
        self.edit = bytes(block)

    def define_edit(self, n_points: int) -> None:
        """Fill the edit memory with a number of points at 0 V."""
        self.edit = blank_record(n_points)

    def copy_to_user(self, number: int) -> None:
        """Copy the edit memory to a USER memory; a channel that is playing that memory plays the new record."""
        if self.locked[number]:
            raise ScpiError(-221, f"USER{number} is locked")
        self.clock.sleep(self.behaviour.copy_time)
        self.user[number] = self.edit

    def copy_from_user(self, number: int) -> None:
        """Copy a USER memory to the edit memory."""
        record = self.user[number]
        if record is None:
            raise ScpiError(-224, f"USER{number} is empty")
        self.edit = record

    def erase(self, number: int) -> None:
        """Empty a USER memory; refused while it is locked or selected."""
        if self.locked[number] or any(channel.function == f"USER{number}" for channel in self.channels.values()):
            raise ScpiError(-221, f"USER{number} is locked or selected")
        self.user[number] = None

    def select(self, number: int, function: str) -> None:
        """Choose a channel's waveform."""
        if function.startswith("USER") and self.user[int(function[4:])] is None:
            raise ScpiError(-224, f"{function} is empty")
        self.channels[number].function = function

    # levels

    def set_levels(self, number: int, *, amplitude: float | None = None, offset: float | None = None) -> None:
        """Set amplitude [V peak to peak] or offset [V], into an open circuit, within VOLTage:LIMit."""
        channel = self.channels[number]
        amplitude = channel.amplitude if amplitude is None else amplitude
        offset = channel.offset if offset is None else offset
        room = min(channel.limit_high - offset, offset - channel.limit_low)
        if amplitude / 2 > room * (1 + 1e-9):
            if self.behaviour.limit_violation == "error":
                raise ScpiError(-222, f"{amplitude:g} Vpp at {offset:g} V exceeds VOLTage:LIMit")
            amplitude = max(2 * room, 0.0)
        channel.amplitude, channel.offset = min(amplitude, self.clip_amplitude), offset

    def set_limit(self, number: int, *, high: float | None = None, low: float | None = None) -> None:
        """Set an output limit, into an open circuit [V]; refused if the present output exceeds it."""
        channel = self.channels[number]
        limit_high = channel.limit_high if high is None else high
        limit_low = channel.limit_low if low is None else low
        half = channel.amplitude / 2
        if channel.offset + half > limit_high * (1 + 1e-9) or channel.offset - half < limit_low * (1 + 1e-9):
            raise ScpiError(-221, f"the level {2 * half:g} Vpp at {channel.offset:g} V exceeds the new limit")
        channel.limit_high, channel.limit_low = limit_high, limit_low

    # what comes out

    def tick(self) -> float | None:
        """Return the time between triggers of its timer [s]; None if another trigger source is selected."""
        return self.timer if self.trigger_source == "TIM" else None

    def sent(self, channel: Channel) -> Playback | None:
        """Return a single burst of a channel, or what it repeats without a trigger; None if it plays no record."""
        if not channel.function.startswith(("USER", "EMEM")):
            return None
        record = self.edit if channel.function == "EMEM" else self.user[int(channel.function[4:])]
        if record is None:
            return None
        # The phase selects the point of the record at which a channel begins.
        first = 2 * round(channel.phase / (2 * math.pi) * (len(record) // 2)) % len(record)
        record = record[first:] + record[:first]
        sign = -1.0 if channel.polarity == "INV" else 1.0
        idle = {"first": record[:2], "last": record[-2:]}.get(self.behaviour.idle_level)
        idle_code = MID_CODE if idle is None else int.from_bytes(idle, "big")
        duration = 1 / channel.frequency
        level = sign * channel.amplitude, channel.offset
        if math.isinf(channel.burst_length) or not channel.burst:
            return Playback(record, *level, duration, duration, idle_code)
        return Playback(record, *level, duration, math.inf, idle_code, int(channel.n_cycles), channel.delay)


def blank_record(n_points: int) -> bytes:
    """Return a record at 0 V."""
    return MID_CODE.to_bytes(2, "big") * n_points
