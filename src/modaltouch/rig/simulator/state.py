"""The state that all simulated generators have: error queue, status, trigger and outputs."""

from __future__ import annotations

import contextlib
import math
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Generic, Literal, TypeVar

from modaltouch.rig.simulator.scpi import ScpiError
from modaltouch.rig.simulator.timeline import Delays, Playback, Retrigger, Situation, Timeline
from modaltouch.system import SYSTEM_CLOCK, Clock


@dataclass(frozen=True)
class Behaviour:
    """Behaviour of the real instrument that is not publicly known, or differs between units.

    Attributes
    ----------
    idle_level : str
        Where the output rests between bursts: at the ``first`` or ``last`` point, or at the ``offset``.
    timer_digits : int
        Significant digits of the trigger timer.
    copy_time : float
        Time that storing a record in a USER memory takes [s].
    limit_violation : str
        Whether an amplitude beyond VOLTage:LIMit is refused (``error``) or reduced (``clip``).
    max_sessions : int
        Highest number of simultaneous links.
    queue_depth : int
        Capacity of the error queue.
    retrigger : str
        Whether a trigger during a burst is ``ignored``, without an error, or ``restarts`` the burst.
    """

    idle_level: Literal["first", "last", "offset"] = "first"
    timer_digits: int = 9
    copy_time: float = 0.0
    limit_violation: Literal["error", "clip"] = "error"
    max_sessions: int = 16
    queue_depth: int = 32
    retrigger: Retrigger = "ignored"


SOURCE_IMPEDANCE = 50.0
"""Output impedance of every channel [ohm]."""


@dataclass
class OutputChannel(ABC):
    """Settings of one output that all generators have; voltages are into an open circuit, whatever the load setting."""

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
    n_cycles: float = 1.0
    delay: float = 0.0

    @property
    @abstractmethod
    def cycle(self) -> float:
        """Length of one cycle [s]."""

    @property
    def burst_length(self) -> float:
        """Time from a trigger to the end of its burst [s]."""
        return self.delay + self.n_cycles * self.cycle

    @property
    def load_factor(self) -> float:
        """Volts at the configured load per open-circuit volt [1]."""
        return 1.0 if math.isinf(self.load) else self.load / (self.load + SOURCE_IMPEDANCE)


C = TypeVar("C", bound=OutputChannel)


@dataclass
class GeneratorState(ABC, Generic[C]):
    """What all simulated two-channel generators have in common.

    Attributes
    ----------
    behaviour : Behaviour
        Behaviour of the real one that is not publicly known.
    n_channels : int
        Number of channels.
    delays : Delays
        Delays of the hardware.
    seed : int
        Seed of the timer's phase and of the latencies.
    clock : Clock
        Clock by which bursts begin and end.
    link : int
        Number of the link whose message is being carried out; 0 for the front panel.
    identity : str
        Reply to ``*IDN?``.
    """

    behaviour: Behaviour = field(default_factory=Behaviour)
    n_channels: int = 2
    delays: Delays = Delays()
    seed: int = 0
    clock: Clock = SYSTEM_CLOCK
    link: int = 0
    identity: str = ""
    lock: threading.RLock = field(default_factory=threading.RLock, repr=False)
    channels: dict[int, C] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.errors: deque[str] = deque()
        self.timeline = Timeline(self.delays, self.behaviour.retrigger, self.seed)
        self.power_on()

    @abstractmethod
    def reset(self) -> None:
        """Reset as ``*RST`` does; status and errors are kept."""

    @abstractmethod
    def forget(self) -> None:
        """Lose the memories that a power cut erases."""

    @abstractmethod
    def tick(self) -> float | None:
        """Return the time between the generator's internal triggers [s]; None if it waits for external ones."""

    @abstractmethod
    def sent(self, channel: C) -> Playback | None:
        """Return a single burst of a channel, or what it repeats without a trigger; None if it plays no record."""

    @property
    def takes_external_trigger(self) -> bool:
        """Whether pulses at the trigger input start bursts."""
        return self.tick() is None

    @contextlib.contextmanager
    def changing(self) -> Iterator[None]:
        """Context in which settings may change: until now the outputs follow the old ones, from now on the new ones."""
        with self.lock:
            self.timeline.advance(self.clock.now())
            try:
                yield
            finally:
                self.timeline.change(self.clock.now(), self._situation())

    def settle(self) -> None:
        """Report every burst that has ended by now."""
        with self.lock:
            self.timeline.advance(self.clock.now())

    def power_off(self) -> None:
        """End whatever plays, at once."""
        with self.lock:
            self.timeline.power_cut(self.clock.now())

    def power_on(self) -> None:
        """Start as after a power cut: outputs off, and defaults for everything that is not kept."""
        self.power_off()
        with self.lock:
            self.errors.clear()
            self.event_status, self.event_enable, self.service_enable = 128, 0, 0
            self.forget()
            self.reset()
            self.timeline.change(self.clock.now(), self._situation())

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
        """Remove the oldest error and return it."""
        return self.errors.popleft() if self.errors else '0,"No error"'

    @property
    def status_byte(self) -> int:
        """Bits 2 (error queue) and 5 (event status); bit 4 (message available) belongs to a link."""
        return (4 if self.errors else 0) | (32 if self.event_status & self.event_enable else 0)

    # trigger

    def trigger(self) -> None:
        """Trigger both channels once."""
        with self.lock:
            if not any(channel.burst for channel in self.channels.values()):
                raise ScpiError(-211, "no channel is in burst")
            self.timeline.trigger(self.clock.now(), self.link)

    def abort(self) -> None:
        """Reset the trigger system; a triggered burst ends now."""
        self.timeline.abort(self.clock.now())

    def align(self) -> None:
        """Restart the records that repeat without a trigger."""
        self.timeline.align(self.clock.now())

    # what comes out

    def playback(self, number: int) -> Playback | None:
        """Return what a channel sends; None if its output is off or it plays no arbitrary record.

        If bursts wait for triggers, this is the latest burst, provided one came since the outputs were last switched;
        its period is the latest interval between triggers, to the millisecond.
        """
        with self.lock:
            self.timeline.advance(self.clock.now())
            channel, tick = self.channels[number], self.tick()
            sent = self.sent(channel) if channel.output else None
            if sent is None or not channel.burst:
                return sent
            endless = math.isinf(channel.burst_length)
            if tick is not None:
                # An endless burst has a single trigger, the first.
                return sent if endless else replace(sent, period=tick)
            triggers = self.timeline.triggers
            if not triggers or endless:
                return sent if triggers else None
            interval = round(triggers[-1] - triggers[0], 3)
            return sent if len(triggers) == 1 else replace(sent, period=max(interval, channel.burst_length))

    def _situation(self) -> Situation:
        channels, pulses = tuple(self.channels.values()), self.delays.pulses
        heard = None if pulses is None or not self.takes_external_trigger else 1 / pulses
        return Situation(
            sent=tuple(self.sent(channel) for channel in channels),
            length=tuple((each.n_cycles if each.burst else 1.0) * each.cycle for each in channels),
            in_burst=tuple(each.burst for each in channels),
            outputs=tuple(each.output for each in channels),
            tick=self.tick() or heard,
        )
