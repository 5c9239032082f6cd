"""Outputs of a generator over time: start, end and truncation of bursts, and the parts that pass the output relays."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from modaltouch.stimulus import Converter

CONVERTER = Converter(mid_code=8191, max_points=1 << 22, clock_rate=250e6, amplitude_digits=4, amplitude_decimals=4)
"""Converter of a twin of the AFG3022B, independent of that of the driver; its limit on points is higher."""

MID_CODE = CONVERTER.mid_code
"""Code of the converter for 0 V."""

FINEST = 1e-3
"""Interval below which bursts repeated without commands are reported only once in about this time [s]."""

ROUNDING = 1e-9
"""Tolerance for a burst that directly follows the previous one [s]."""


@dataclass(frozen=True)
class Playback:
    """The output of one channel."""

    record: bytes  # codes, two bytes each, big-endian
    # amplitude, offset: amplitude of the full range of codes [V peak to peak] and offset [V], into an open circuit
    amplitude: float
    offset: float
    duration: float  # of the record [s]
    # time from one trigger to the next [s]; infinite for a single trigger, `duration` if repeated without triggers
    period: float
    idle_code: int  # code at which the output rests between bursts
    converter: Converter = CONVERTER  # converter of the codes to voltages


@dataclass(frozen=True)
class Delays:
    """Delays of the hardware, and pulses at its trigger input."""

    latency: tuple[float, float] = (1e-4, 3e-4)  # bounds of the time from a trigger command to the first sample [s]
    relay: float = 4e-3  # time from a command to the switching of an output relay, on or off [s]
    pulses: float | None = None  # rate of the pulses at the trigger input [Hz]; None if nothing is connected


@dataclass(frozen=True)
class Situation:
    """All settings that affect bursts, with one value per channel."""

    # output of each channel while its relay is closed: a single burst, or a record repeated without a trigger
    sent: tuple[Playback | None, ...] = ()
    in_burst: tuple[bool, ...] = ()  # whether each channel waits for triggers
    outputs: tuple[bool, ...] = ()  # whether each output is commanded on
    tick: float | None = None  # time between triggers without commands [s]; None if there are none
    shows_bursts: bool = True  # whether a pulse at the trigger output accompanies each burst


@dataclass(frozen=True)
class PlayedBurst:
    """A burst, or the part of it that passed the relays."""

    # start, end: first and last instant at which any part of it passed a relay [s]
    start: float
    end: float
    whole: bool  # whether all of it passed at every output
    sent: tuple[Playback | None, ...]  # output of each channel; None if no part of it passed
    # start and end of the part that passed at each output, relative to the first sample of the channel [s]
    passed: tuple[tuple[float, float] | None, ...]
    link: int | None  # number of the link that triggered it, 0 for the front panel; None without a command


@dataclass
class _Run:
    """A burst in progress: start and end on each channel, and start and end of the part that passed each relay."""

    sent: tuple[Playback | None, ...]
    spans: dict[int, tuple[float, float]]
    link: int | None
    passed: dict[int, tuple[float, float]] = field(default_factory=dict)

    @property
    def end(self) -> float:
        return max(last for _, last in self.spans.values())


class Timeline:
    """Outputs of a generator over time, with settings constant between calls.

    A trigger during a burst is ignored, without an error. `seed` is that of the phase of timer and pulses, and of the
    latencies. `on_burst` is called with each burst when it ends; `triggers` are the onsets of the latest two triggered
    bursts since outputs or internal triggers were last changed [s]; `caught` is the output of each channel in the first
    burst shown at the trigger output after this was set to None; `shown` is the instant of the latest pulse at the
    trigger output after a command [s].
    """

    def __init__(self, delays: Delays, seed: int = 0) -> None:
        self._delays = delays
        self._random = random.Random(seed)
        self._phase = self._random.random()
        self.on_burst: Callable[[PlayedBurst], None] | None = None
        self.triggers: tuple[float, ...] = ()
        self.caught: tuple[Playback | None, ...] | None = None
        self.shown: float | None = None
        self._now = -math.inf
        self._situation = Situation()
        self._closed: dict[int, float] = {}
        self._switching: list[tuple[float, int, bool]] = []
        self._cycle_length = self._reach = self._aligned = 0.0
        # The key is whether the burst was triggered.
        self._running: dict[bool, _Run] = {}

    def change(self, now: float, situation: Situation) -> None:
        """Apply new settings; a burst in progress that they change ends now."""
        self.advance(now)
        before, self._situation = self._situation, situation
        if before == situation:
            return
        self._cycle_length, self._reach = _cycle_length(situation), _reach(situation)
        if (before.sent, before.in_burst) != (situation.sent, situation.in_burst):
            self._cut(now)
            self.align(now)
        if (before.outputs, before.tick) != (situation.outputs, situation.tick):
            self.triggers = ()
        for channel, on in enumerate(situation.outputs):
            if on != (channel < len(before.outputs) and before.outputs[channel]):
                self._switching.append((now + self._delays.relay, channel, on))

    def trigger(self, now: float, link: int) -> None:
        """Execute a trigger command received over a link."""
        self.advance(now)
        begin = now + self._random.uniform(*self._delays.latency)
        if self._situation.shows_bursts:
            self.shown = begin
        self._take(now, begin, link)

    def abort(self, now: float) -> None:
        """End a triggered burst."""
        self.advance(now)
        self._end(now, in_burst=True)
        self.triggers = ()

    def align(self, now: float) -> None:
        """Restart the records repeated without a trigger."""
        self.advance(now)
        self._end(now, in_burst=False)
        self._aligned = now
        self._begin(now, None, in_burst=False)

    def power_cut(self, now: float) -> None:
        """End all bursts and open the relays immediately."""
        self.advance(now)
        self._cut(now)
        self._closed, self._switching, self.triggers = {}, [], ()
        self._situation, self._cycle_length, self._reach = Situation(), 0.0, 0.0

    def advance(self, now: float) -> None:
        """Advance to an instant [s]; earlier instants are ignored."""
        if now <= self._now:
            return
        target = now - self._reach
        if target > self._now and (self.on_burst is None or not (self._closed or self._switching)):
            # Most of a long span is skipped if bursts are not reported or no relay is closed.
            self._settle(target)
            self._now = target
        while True:
            tick, cycle = self._next_tick(), self._cycle_length
            beat = _after(self._now, self._aligned, cycle) if cycle else math.inf
            ends = (run.end for run in self._running.values())
            instant = min([tick, beat, *ends, *(switched for switched, *_ in self._switching[:1])])
            if instant > now:
                break
            self._now = max(self._now, instant)
            self._settle(instant)
            if tick == instant:
                self._take(instant, instant, None)
            if beat == instant:
                self._end(None, in_burst=False)
                self._begin(instant, None, in_burst=False)
        self._now = now

    def _settle(self, now: float) -> None:
        """Switch the relays that are due and end the bursts that are over."""
        self._switch(now)
        for in_burst in [each for each, run in self._running.items() if run.end <= now]:
            self._end(None, in_burst=in_burst)

    def _next_tick(self) -> float:
        """Return the instant of the next trigger without a command [s]; its clock is independent of other settings."""
        situation = self._situation
        if situation.tick is None or not any(situation.in_burst):
            return math.inf
        period = situation.tick * math.ceil(FINEST / situation.tick)
        return _after(self._now, self._phase * period, period)

    def _begin(self, begin: float, link: int | None, *, in_burst: bool) -> None:
        """Begin the output of the channels in burst mode, or of the others."""
        situation = self._situation
        spans = {}
        for channel, sent in enumerate(situation.sent):
            if sent is not None and situation.in_burst[channel] == in_burst:
                spans[channel] = begin, begin + (sent.duration if in_burst else self._cycle_length)
        if spans and self.caught is None and any(situation.outputs) and (situation.shows_bursts or not in_burst):
            self.caught = tuple(s if on else None for s, on in zip(situation.sent, situation.outputs, strict=True))
        if spans:
            self._running[in_burst] = _Run(situation.sent, spans, link)

    def _take(self, now: float, begin: float, link: int | None) -> None:
        running = self._running.get(True)
        if running is not None and now < running.end - ROUNDING:
            return
        self._end(None, in_burst=True)
        self._begin(begin, link, in_burst=True)
        if True in self._running:
            self.triggers = (*self.triggers[-1:], begin)

    def _switch(self, now: float) -> None:
        """Switch the relays that are due."""
        while self._switching and self._switching[0][0] <= now:
            instant, channel, on = self._switching.pop(0)
            if on:
                self._closed.setdefault(channel, instant)
                continue
            for run in self._running.values():
                self._pass(run, channel, instant)
            self._closed.pop(channel, None)
            for run in self._running.values():
                if not any(each in self._closed for each in run.spans):
                    self._report(run)

    def _cut(self, now: float) -> None:
        for in_burst in list(self._running):
            self._end(now, in_burst=in_burst)

    def _end(self, at: float | None, *, in_burst: bool) -> None:
        """End a burst in progress at an instant, or at its regular end."""
        run = self._running.pop(in_burst, None)
        if run is not None:
            for channel in run.spans:
                self._pass(run, channel, run.end if at is None else at)
            self._report(run)

    def _pass(self, run: _Run, channel: int, until: float) -> None:
        """Note the part of a burst that passed a relay closed until now."""
        if channel in run.spans and channel in self._closed:
            first, last = max(self._closed[channel], run.spans[channel][0]), min(until, run.spans[channel][1])
            if last > first:
                run.passed[channel] = first, last

    def _report(self, run: _Run) -> None:
        """Report the part of a burst that passed the relays, once."""
        passed, run.passed = run.passed, {}
        if not passed or self.on_burst is None:
            return
        outputs = self._situation.outputs
        due = [channel for channel in run.spans if channel in passed or outputs[channel]]
        n_channels = range(len(run.sent))
        self.on_burst(
            PlayedBurst(
                start=min(first for first, _ in passed.values()),
                end=max(last for _, last in passed.values()),
                whole=all(passed.get(channel) == run.spans[channel] for channel in due),
                sent=tuple(run.sent[channel] if channel in passed else None for channel in n_channels),
                passed=tuple(
                    (passed[n][0] - run.spans[n][0], passed[n][1] - run.spans[n][0]) if n in passed else None
                    for n in n_channels
                ),
                link=run.link,
            )
        )


def _cycle_length(situation: Situation) -> float:
    """Return the cycle length of records repeated without a trigger, on the slower channel [s]; 0 for none."""
    rows = zip(situation.sent, situation.in_burst, strict=True)
    length = max((sent.duration for sent, in_burst in rows if sent is not None and not in_burst), default=0.0)
    return length * math.ceil(FINEST / length) if length else 0.0


def _reach(situation: Situation) -> float:
    """Return the largest age of events that still matter, including the interval between triggers [s]."""
    return 3 * max([situation.tick or 0.0, *(sent.duration for sent in situation.sent if sent is not None)])


def _after(now: float, origin: float, period: float) -> float:
    """Return the first of the instants ``origin + n period`` after `now` [s]."""
    n = math.floor((now - origin) / period) + 1
    while origin + n * period <= now:
        n += 1
    return origin + n * period
