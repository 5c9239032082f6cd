"""Common parts of all simulated generators: messages, error queue, status, trigger, outputs, and their commands."""

from __future__ import annotations

import contextlib
import logging
import math
import threading
from abc import ABC, abstractmethod
from collections import ChainMap, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Literal, TypeVar

from modaltouch.rig.simulator.scpi import (
    Argument,
    Arguments,
    Command,
    CommandTable,
    Handler,
    ScpiError,
    asked,
    exactly,
    flag,
    is_word,
    one,
    read_boolean,
    read_choice,
    read_number,
    whole,
)
from modaltouch.rig.simulator.timeline import Delays, Playback, Situation, Timeline
from modaltouch.system import SYSTEM_CLOCK, Clock


@dataclass(frozen=True)
class Behaviour:
    """Behaviour of the real instrument that is not publicly known, or differs between units."""

    timer_digits: int = 9  # significant digits of the trigger timer
    # whether an amplitude beyond VOLTage:LIMit is rejected (``error``) or reduced (``clip``)
    limit_violation: Literal["error", "clip"] = "error"
    max_sessions: int = 16  # maximum number of simultaneous links
    queue_depth: int = 32  # capacity of the error queue


_log = logging.getLogger(__name__)

SOURCE_IMPEDANCE = 50.0
"""Output impedance of every channel [ohm]."""


@dataclass
class OutputChannel(ABC):
    """Output settings common to all generators; voltages are into an open circuit, for any load setting."""

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
    phase: float = 0.0

    @property
    @abstractmethod
    def cycle(self) -> float:
        """Length of one cycle [s]."""

    @property
    def is_simulated(self) -> bool:
        """Whether the channel, if in burst mode, plays one whole cycle at once: no other burst is simulated."""
        return not self.burst or (self.burst_mode, self.n_cycles, self.delay, self.phase) == ("TRIG", 1.0, 0.0, 0.0)

    @property
    def load_factor(self) -> float:
        """Voltage at the configured load per open-circuit voltage [V/V]."""
        return 1.0 if math.isinf(self.load) else self.load / (self.load + SOURCE_IMPEDANCE)


@dataclass(frozen=True)
class Reply:
    """The response of an instrument to a message."""

    data: bytes = b""  # response message; empty if the message contained no query
    delay: float = 0.0  # time until it can be read [s]; infinite for a reply that never arrives
    hang_up: bool = False  # whether the connection is reset immediately


C = TypeVar("C", bound=OutputChannel)


@dataclass
class GeneratorState(ABC, Generic[C]):
    """Base class of all simulated two-channel generators."""

    # behaviour of the real instrument that is not publicly known
    behaviour: Behaviour = field(default_factory=Behaviour)
    delays: Delays = Delays()
    seed: int = 0  # seed of the timer's phase and of the latencies
    clock: Clock = SYSTEM_CLOCK
    link: int = 0  # number of the link whose message is being executed; 0 for the front panel
    identity: str = ""  # reply to ``*IDN?``
    lock: threading.RLock = field(default_factory=threading.RLock, repr=False)  # held while a message is executed
    channels: dict[int, C] = field(default_factory=dict, init=False)
    table: CommandTable = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.errors: deque[str] = deque()
        self.timeline = Timeline(self.delays, self.seed)
        # Executes a message that a fault affects; returns None for one that no fault affects.
        self.intercept: Callable[[bytes, int], Reply | None] = lambda message, link: None
        self._is_silent = False  # whether an output is on that is not simulated
        self.n_starts = 0  # number of power-ons, each of which ends all connections
        self.power_on()

    @abstractmethod
    def reset(self) -> None:
        """Reset as ``*RST`` does; status and errors are kept."""

    @abstractmethod
    def forget(self) -> None:
        """Clear the volatile memories."""

    @abstractmethod
    def tick(self) -> float | None:
        """Return the time between internal triggers [s]; None if the generator waits for external ones."""

    @abstractmethod
    def sent(self, channel: C) -> Playback | None:
        """Return a single burst of a channel, or its record repeated without a trigger; None if it plays no record."""

    @property
    def takes_external_trigger(self) -> bool:
        """Whether pulses at the trigger input start bursts."""
        return self.tick() is None

    @property
    def shows_bursts(self) -> bool:
        """Whether a pulse at the trigger output accompanies each burst."""
        return True

    @contextlib.contextmanager
    def changing(self) -> Iterator[None]:
        """Context for changes of settings: the outputs follow the old settings up to now, and then the new ones."""
        with self.lock:
            self.timeline.advance(self.clock.now())
            try:
                yield
            finally:
                self.timeline.change(self.clock.now(), self._situation())
                # The instrument would play it, so that there is no error in its queue.
                silent = any(channel.output and not channel.is_simulated for channel in self.channels.values())
                if silent and not self._is_silent:
                    _log.warning("not simulated, so it plays nothing: several cycles, a gate, a delay or a phase")
                self._is_silent = silent

    def settle(self) -> None:
        """Report all bursts that have ended by now."""
        with self.lock:
            self.timeline.advance(self.clock.now())

    def power_off(self) -> None:
        """Stop all output immediately."""
        with self.lock:
            self.timeline.power_cut(self.clock.now())

    def power_on(self) -> None:
        """Start as after a power failure: outputs off, and defaults for everything volatile."""
        self.power_off()
        with self.lock:
            self.n_starts += 1
            self.errors.clear()
            self.event_status = 128
            self.event_enable = self.service_enable = 0
            self.forget()
            self.reset()
            self.timeline.change(self.clock.now(), self._situation())

    # messages

    def execute(self, message: bytes, link: int = 1) -> Reply:
        """Execute a message received over a link, one at a time."""
        return self.intercept(message, link) or self.run(message, link)

    def run(self, message: bytes, link: int) -> Reply:
        """Execute a message without faults; link 0 is the front panel."""
        with self.lock:
            self.link = link
            replies = self.table.run(message, fail=self.fail)
        return Reply(b";".join(replies) + b"\n" if replies else b"")

    # errors and status

    def fail(self, error: ScpiError) -> None:
        """Queue an error and set its bit of the event status register."""
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

    def align(self) -> None:
        """Restart the records repeated without a trigger."""
        self.timeline.align(self.clock.now())

    # what comes out

    def playback(self, number: int) -> Playback | None:
        """Return the current output of a channel; None if it is off or plays no arbitrary record.

        If bursts wait for triggers, this is the latest burst, if any since the outputs were last switched; its period
        is the latest interval between triggers, rounded to 1 ms.
        """
        with self.lock:
            self.timeline.advance(self.clock.now())
            channel, tick = self.channels[number], self.tick()
            sent = self.sent(channel) if channel.output else None
            if sent is None or not channel.burst:
                return sent
            if tick is not None:
                # A trigger during a burst is lost, and the next one counts.
                return replace(sent, period=tick * max(1, math.ceil(sent.duration / tick - 1e-9)))
            triggers = self.timeline.triggers
            if len(triggers) < 2:
                return sent if triggers else None
            return replace(sent, period=max(round(triggers[-1] - triggers[0], 3), sent.duration))

    def _situation(self) -> Situation:
        channels, pulses = tuple(self.channels.values()), self.delays.pulses
        heard = None if pulses is None or not self.takes_external_trigger else 1 / pulses
        return Situation(
            sent=tuple(self.sent(channel) for channel in channels),
            in_burst=tuple(each.burst for each in channels),
            outputs=tuple(each.output for each in channels),
            tick=self.tick() or heard,
            shows_bursts=self.shows_bursts,
        )


State = GeneratorState[Any]


def command_table(
    state: State,
    groups: Iterable[Callable[[Any], dict[str, Command]]],
    family: str,
    form: str,
) -> CommandTable:
    """Return the command table of a generator: the common commands, its own groups, and settings not simulated.

    Parameters
    ----------
    state, groups
        The generator, and functions that return its own commands.
    family, form : str
        ``AFG3000`` or ``KEYSIGHT_33500B``, whose other settings are not simulated, and the format of their numbers.
    """

    def further() -> dict[str, Command]:
        from modaltouch.rig.simulator import defaults

        return defaults.not_simulated(getattr(defaults, family), form)

    commands = ChainMap(*(group(state) for group in (common_commands, *groups)))
    return CommandTable(commands, len(state.channels), further, state.changing)


def common_commands(state: State) -> dict[str, Command]:
    """Return the common commands of IEEE 488.2, and the SCPI commands of all simulated generators."""

    def clear(_: int) -> None:
        state.errors.clear()
        state.event_status = 0

    def event_status(_: int) -> str:
        value, state.event_status = state.event_status, 0
        return str(value)

    def complete(_: int) -> None:
        state.event_status |= 1

    def register(argument: Argument) -> int:
        return whole((argument,), 0, 255)

    return {
        "*IDN": Command(get=bare(lambda _: state.identity)),
        "*OPT": Command(get=bare(lambda _: "0")),
        "*CLS": Command(set=bare(clear)),
        "*RST": Command(set=bare(lambda _: state.reset())),
        "*OPC": Command(set=bare(complete), get=bare(lambda _: "1")),
        "*WAI": Command(set=bare(lambda _: None)),
        "*TST": Command(get=bare(lambda _: "0")),
        "*ESR": Command(get=bare(event_status)),
        "*ESE": setting(state, "event_enable", register, str),
        "*SRE": setting(state, "service_enable", register, str),
        "*STB": Command(get=bare(lambda _: str(state.status_byte))),
        "*TRG": Command(set=bare(lambda _: state.trigger())),
        "ABORt": Command(set=bare(lambda _: state.timeline.abort(state.clock.now()))),
        "SYSTem:BEEPer[:IMMediate]": Command(set=bare(lambda _: None)),
        "SYSTem:ERRor[:NEXT]": Command(get=bare(lambda _: state.next_error())),
        "SYSTem:VERSion": Command(get=bare(lambda _: "1999.0")),
    }


def bare(carry_out: Callable[[int], str | None]) -> Handler:
    """Return a handler without parameters, called with the channel number only."""

    def handle(number: int, arguments: Arguments) -> str | None:
        exactly(arguments, 0)
        return carry_out(number)

    return handle


def get_of(state: State, read: Callable[[Any], str]) -> Handler:
    """Return a handler that answers a query with the result of `read` for the channel."""
    return bare(lambda number: read(state.channels[number]))


def get_number(
    state: State, name: str, low: float, high: float, form: str, *, at_load: bool = False
) -> Callable[[int, Arguments], str]:
    """Return a handler that answers a query with a numeric setting of a channel, or with its limits.

    A voltage is given `at_load`.
    """

    def get(number: int, arguments: Arguments) -> str:
        channel = state.channels[number]
        value = asked(arguments, getattr(channel, name), low, high) * (channel.load_factor if at_load else 1.0)
        # SCPI infinity as printed by instruments; 9.9E37 has no exact binary form.
        return form.format(9.9).replace("E+00", "E+37") if math.isinf(value) else form.format(value)

    return get


def number(
    state: State,
    name: str,
    units: dict[str, float],
    low: float,
    high: float,
    form: str,
    default: float | None = None,
    *,
    endless: bool = False,
) -> Command:
    """Return the command for a numeric setting of a channel (integer without units); `endless` allows ``INFinity``."""

    def change(number: int, arguments: Arguments) -> None:
        word = one(arguments)
        infinite = endless and isinstance(word, str) and is_word(word.upper(), "INFinity")
        value = math.inf if infinite else read_number(one(arguments), units, low, high, default)
        setattr(state.channels[number], name, value if units or infinite else float(round(value)))

    return Command(set=change, get=get_number(state, name, low, high, form))


def edge(state: Any, sign: int, lowest: float, form: str) -> Command:
    """Return the command for the high (1) or low (-1) level of a channel, with the `lowest` amplitude [V]."""

    def change(number: int, arguments: Arguments) -> None:
        channel = state.channels[number]
        factor = channel.load_factor
        value = read_number(one(arguments), {"V": 1.0}, -10 * factor, 10 * factor, None) / factor
        other = channel.offset - sign * channel.amplitude / 2
        if sign * (value - other) < lowest * (1 - 1e-9):
            raise ScpiError(-222, f"{value * factor:g} V: the high level lies above the low one")
        state.change(number, amplitude=sign * (value - other), offset=(value + other) / 2)

    read = get_of(state, lambda each: form.format((each.offset + sign * each.amplitude / 2) * each.load_factor))
    return Command(set=change, get=read)


def setting(state: State, name: str, read: Callable[[Argument], object], show: Callable[[Any], str]) -> Command:
    """Return the command for a setting of the instrument or of a channel, which `read` converts and `show` formats."""

    def holder(number: int) -> Any:
        return state if hasattr(state, name) else state.channels[number]

    return Command(
        set=lambda n, a: setattr(holder(n), name, read(one(a))),
        get=bare(lambda n: show(getattr(holder(n), name))),
    )


def switch(state: State, name: str) -> Command:
    """Return the command for a boolean setting."""
    return setting(state, name, read_boolean, flag)


def keyword(state: State, name: str, choices: tuple[str, ...]) -> Command:
    """Return the command for a keyword setting."""
    return setting(state, name, lambda argument: read_choice(argument, choices), str)
