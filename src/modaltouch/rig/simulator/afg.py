"""The state of a simulated AFG3022B: channels, memories, trigger, error queue; no text and no transport."""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from modaltouch.rig.simulator.scpi import ScpiError
from modaltouch.rig.simulator.timeline import MID_CODE, Delays, Playback, Retrigger, Situation, Timeline
from modaltouch.system import SYSTEM_CLOCK, Clock


@dataclass(frozen=True)
class Behaviour:
    """What is not publicly known of the real instrument, or differs between units.

    Attributes
    ----------
    identity : str
        Reply to ``*IDN?``.
    idle_level : str
        Where the output rests between bursts: at the ``first`` or ``last`` point, or at the ``offset``.
    timer_digits : int
        Significant digits that the trigger timer keeps.
    copy_time : float
        How long storing a record in a USER memory takes [s].
    amplitude_ranges : tuple of float
        Amplitudes at which a range relay switches [V peak to peak, open circuit].
    limit_violation : str
        Whether a level beyond VOLTage:LIMit is refused (``error``) or cut (``clip``).
    block_end : bytes
        What follows a block reply.
    max_sessions : int
        Links accepted at the same time.
    queue_depth : int
        Errors kept.
    retrigger : str
        Whether a trigger inside a running burst is ``ignored``, without an error, or ``restarts`` the burst.
    """

    identity: str = "TEKTRONIX,AFG3022B,SIMULATED,SCPI:99.0 FV:3.2.2"
    idle_level: Literal["first", "last", "offset"] = "first"
    timer_digits: int = 9
    copy_time: float = 0.0
    amplitude_ranges: tuple[float, ...] = (0.2, 2.0)
    limit_violation: Literal["error", "clip"] = "error"
    block_end: bytes = b"\n"
    max_sessions: int = 16
    queue_depth: int = 32
    retrigger: Retrigger = "ignored"


OPEN = math.inf
"""Load impedance of an open circuit [ohm]."""

SOURCE_IMPEDANCE = 50.0
"""Output impedance of every channel [ohm]."""


@dataclass
class Channel:
    """Settings of one output; levels are kept as open-circuit volts, whatever load is configured."""

    function: str = "SIN"
    frequency: float = 1e6
    phase: float = 0.0
    amplitude: float = 2.0
    offset: float = 0.0
    unit: str = "VPP"
    limit_high: float = 10.0
    limit_low: float = -10.0
    load: float = SOURCE_IMPEDANCE
    polarity: str = "NORM"
    output: bool = False
    burst: bool = False
    burst_mode: str = "TRIG"
    n_cycles: float = 5.0
    delay: float = 0.0
    range_switches: int = 0

    @property
    def load_factor(self) -> float:
        """Volts at the configured load per open-circuit volt [1]."""
        return 1.0 if math.isinf(self.load) else self.load / (self.load + SOURCE_IMPEDANCE)

    @property
    def burst_length(self) -> float:
        """Time from a trigger to the end of its burst [s]."""
        return self.delay + self.n_cycles / self.frequency


MAX_CODE = 16382
"""Highest code of a point."""

MEMORIES = ("USER1", "USER2", "USER3", "USER4")
"""Non-volatile memories, common to both channels."""


@dataclass
class Afg:
    """A two-channel arbitrary function generator.

    Attributes
    ----------
    clip_amplitude : float
        Fault: amplitude beyond which the output stage silently stays behind [V peak to peak, open circuit].
    delays : Delays
        How long the hardware takes.
    seed : int
        Of the phase of its timer, and of its latencies.
    clock : Clock
        By which bursts begin and end.
    link : int
        Number of the link whose message is being carried out; 0 for the front panel.
    """

    behaviour: Behaviour = field(default_factory=Behaviour)
    n_channels: int = 2
    min_points: int = 2
    max_points: int = 131_072
    clip_amplitude: float = math.inf
    delays: Delays = Delays()
    seed: int = 0
    clock: Clock = SYSTEM_CLOCK
    link: int = 0
    lock: threading.RLock = field(default_factory=threading.RLock, repr=False)

    def __post_init__(self) -> None:
        self.user: dict[int, bytes | None] = dict.fromkeys(range(1, len(MEMORIES) + 1))
        self.locked: dict[int, bool] = dict.fromkeys(self.user, False)
        self.saved: dict[int, tuple[dict[int, Channel], str, float]] = {}
        self.errors: deque[str] = deque()
        self.timeline = Timeline(self.delays, self.behaviour.retrigger, self.seed)
        self.power_on()

    @contextlib.contextmanager
    def changing(self) -> Iterator[None]:
        """Let what is sent be as set before until now, and as set within from now on."""
        with self.lock:
            self.timeline.advance(self.clock.now())
            try:
                yield
            finally:
                self.timeline.change(self.clock.now(), self._situation())

    def settle(self) -> None:
        """Have every burst told that has ended by now."""
        with self.lock:
            self.timeline.advance(self.clock.now())

    def power_off(self) -> None:
        """End whatever plays, at once."""
        with self.lock:
            self.timeline.power_cut(self.clock.now())

    def power_on(self) -> None:
        """Start as after a power cut: USER memories kept, everything else at its default, outputs off."""
        self.power_off()
        with self.lock:
            self.errors.clear()
            self.event_status, self.event_enable, self.service_enable = 128, 0, 0
            self.edit = blank_record(1000)
            self.reset()
            self.timeline.change(self.clock.now(), self._situation())

    def reset(self) -> None:
        """Do what ``*RST`` does; USER memories, status and errors stay."""
        with self.lock:
            self.channels = {number: Channel() for number in range(1, self.n_channels + 1)}
            self.trigger_source, self.timer = "TIM", 1e-3
            self.level_concurrent = self.frequency_concurrent = False
            self.trigger_output = "TRIG"
            self.clock_source = "INT"
            self.recall_automatically = False

    # errors and status

    def fail(self, error: ScpiError) -> None:
        """Put an error in the queue and set its bit of the event status register."""
        bits = {1: 32, 2: 16, 3: 8, 4: 4}
        with self.lock:
            self.event_status |= bits.get(-error.code // 100, 8)
            if len(self.errors) < self.behaviour.queue_depth:
                self.errors.append(str(error))
            elif self.errors:
                self.errors[-1] = str(ScpiError(-350))

    def next_error(self) -> str:
        """Return and forget the oldest error."""
        return self.errors.popleft() if self.errors else '0,"No error"'

    @property
    def status_byte(self) -> int:
        """Bits 2 (error queue) and 5 (event status); bit 4 (message available) belongs to a link."""
        return (4 if self.errors else 0) | (32 if self.event_status & self.event_enable else 0)

    # memories

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
        with self.lock:
            self.edit = bytes(block)

    def define_edit(self, n_points: int) -> None:
        """Reset the edit memory to a number of points at zero volts."""
        with self.lock:
            self.edit = blank_record(n_points)

    def copy_to_user(self, number: int) -> None:
        """Store the edit memory; a playing channel that selects the memory plays the new record."""
        if self.locked[number]:
            raise ScpiError(-221, f"USER{number} is locked")
        self.clock.sleep(self.behaviour.copy_time)
        with self.lock:
            self.user[number] = self.edit

    def copy_from_user(self, number: int) -> None:
        """Load the edit memory from a USER memory."""
        record = self.user[number]
        if record is None:
            raise ScpiError(-224, f"USER{number} is empty")
        with self.lock:
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
        """Set amplitude [V peak to peak] or offset [V], open circuit, within VOLTage:LIMit."""
        channel = self.channels[number]
        amplitude = channel.amplitude if amplitude is None else amplitude
        offset = channel.offset if offset is None else offset
        room = min(channel.limit_high - offset, offset - channel.limit_low)
        if amplitude / 2 > room * (1 + 1e-9):
            if self.behaviour.limit_violation == "error":
                raise ScpiError(-222, f"{amplitude:g} Vpp at {offset:g} V exceeds VOLTage:LIMit")
            amplitude = max(2 * room, 0.0)
        amplitude = min(amplitude, self.clip_amplitude)
        ranges = self.behaviour.amplitude_ranges
        crossed = sum((channel.amplitude > border) != (amplitude > border) for border in ranges)
        channel.range_switches += crossed
        channel.amplitude, channel.offset = amplitude, offset

    def set_limit(self, number: int, *, high: float | None = None, low: float | None = None) -> None:
        """Set an output limit, open circuit [V]; refused where the present level exceeds it."""
        channel = self.channels[number]
        limit_high = channel.limit_high if high is None else high
        limit_low = channel.limit_low if low is None else low
        half = channel.amplitude / 2
        if channel.offset + half > limit_high * (1 + 1e-9) or channel.offset - half < limit_low * (1 + 1e-9):
            raise ScpiError(-221, f"the level {2 * half:g} Vpp at {channel.offset:g} V exceeds the new limit")
        channel.limit_high, channel.limit_low = limit_high, limit_low

    # trigger

    def trigger(self) -> None:
        """Force one trigger, for both channels."""
        with self.lock:
            if not any(channel.burst for channel in self.channels.values()):
                raise ScpiError(-211, "no channel is in burst")
            self.timeline.trigger(self.clock.now(), self.link)

    def abort(self) -> None:
        """Reset the trigger system; a burst that it began ends here."""
        with self.lock:
            self.timeline.abort(self.clock.now())

    def align(self) -> None:
        """Begin anew what repeats without trigger."""
        with self.lock:
            self.timeline.align(self.clock.now())

    def copy_channel(self, target: int, source: int) -> None:
        """Give a channel the settings of the other; its output stays as it is."""
        self.channels[target] = replace(self.channels[source], output=self.channels[target].output)

    # save and recall

    def save(self, place: int) -> None:
        """Keep the settings under a number."""
        channels = {number: replace(channel) for number, channel in self.channels.items()}
        self.saved[place] = (channels, self.trigger_source, self.timer)

    def recall(self, place: int) -> None:
        """Restore settings; the outputs come back off."""
        if place not in self.saved:
            raise ScpiError(-224, f"nothing saved under {place}")
        channels, self.trigger_source, self.timer = self.saved[place]
        self.channels = {number: replace(channel, output=False) for number, channel in channels.items()}

    # what comes out

    def playback(self, number: int) -> Playback | None:
        """Return what a channel sends, None where its output is off or no arbitrary record is playing.

        Where bursts wait for an external trigger this is the latest of them, if one came since the outputs were
        switched, and their period is the latest interval, to the millisecond.
        """
        with self.lock:
            self.timeline.advance(self.clock.now())
            channel = self.channels[number]
            sent = self._sent(channel) if channel.output else None
            if sent is None or not channel.burst:
                return sent
            endless = math.isinf(channel.burst_length)
            if self.trigger_source == "TIM":
                # A burst without end has one trigger, the first.
                return sent if endless else replace(sent, period=self.timer)
            triggers = self.timeline.triggers
            if not triggers or endless:
                return sent if triggers else None
            interval = round(triggers[-1] - triggers[0], 3)
            return sent if len(triggers) == 1 else replace(sent, period=max(interval, channel.burst_length))

    def _sent(self, channel: Channel) -> Playback | None:
        """Return a burst of a channel, alone, or what it repeats without trigger; None where it has no record."""
        if not channel.function.startswith(("USER", "EMEM")):
            return None
        record = self.edit if channel.function == "EMEM" else self.user[int(channel.function[4:])]
        if record is None:
            return None
        # A phase is where in its record a channel begins.
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

    def _situation(self) -> Situation:
        """Return the settings that bursts depend on."""
        channels = tuple(self.channels.values())
        pulses = self.delays.pulses
        return Situation(
            sent=tuple(self._sent(channel) for channel in channels),
            length=tuple((each.n_cycles if each.burst else 1.0) / each.frequency for each in channels),
            in_burst=tuple(each.burst for each in channels),
            outputs=tuple(each.output for each in channels),
            tick=self.timer if self.trigger_source == "TIM" else None if pulses is None else 1 / pulses,
        )


def blank_record(n_points: int) -> bytes:
    """Return a record at zero volts."""
    return MID_CODE.to_bytes(2, "big") * n_points
