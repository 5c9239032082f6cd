"""A simulated AFG3022B: its state, and the SCPI commands of the AFG3000 series.

Not modelled: bursts of several cycles, gated or delayed bursts, and records with a phase. Such a channel plays nothing
and logs a warning.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from modaltouch.rig.simulator import common
from modaltouch.rig.simulator.common import Behaviour, GeneratorState, OutputChannel, bare, get_of
from modaltouch.rig.simulator.scpi import (
    PERCENT,
    Argument,
    Arguments,
    Command,
    CommandTable,
    ScpiError,
    asked,
    exactly,
    flag,
    one,
    read_boolean,
    read_choice,
    read_number,
    whole,
)
from modaltouch.rig.simulator.timeline import MID_CODE, Playback


@dataclass
class Channel(OutputChannel):
    """Settings of one output of an AFG3022B."""

    function: str = "SIN"
    frequency: float = 1e6
    n_cycles: float = 5.0
    symmetry: float = 50.0
    duty_cycle: float = 50.0

    @property
    def cycle(self) -> float:
        """Length of one cycle [s]."""
        return 1 / self.frequency

    @property
    def is_simulated(self) -> bool:
        """Whether the channel plays whole cycles, one at once if in burst mode: nothing else is simulated."""
        return super().is_simulated and self.phase == 0


MAX_CODE = 16382  # of a point
MIN_POINTS, MAX_POINTS = 2, 131_072  # of a record
NUMBERS = (1, 2, 3, 4)
MEMORIES = tuple(f"USER{number}" for number in NUMBERS)
"""Non-volatile memories, shared by both channels."""


@dataclass
class Afg(GeneratorState[Channel]):
    """A two-channel arbitrary function generator.

    Attributes
    ----------
    clip_amplitude : float
        Fault: the output stage silently clips amplitudes to this value [V peak to peak, open circuit].
    user, locked : dict
        Record of each USER memory, None if it is empty, and whether it is locked.
    """

    identity: str = "TEKTRONIX,AFG3022B,SIMULATED,SCPI:99.0 FV:3.2.2"
    clip_amplitude: float = math.inf
    user: dict[int, bytes | None] = field(default_factory=lambda: dict.fromkeys(NUMBERS), init=False)
    locked: dict[int, bool] = field(default_factory=lambda: dict.fromkeys(NUMBERS, False), init=False)

    def forget(self) -> None:
        """Lose the edit memory; USER memories are kept."""
        self.edit = blank_record(1000)

    def reset(self) -> None:
        """Reset as ``*RST`` does; USER memories, status and errors are kept."""
        self.channels = {1: Channel(), 2: Channel()}
        self.trigger_source, self.timer = "TIM", 1e-3
        self.trigger_output, self.clock_source = "TRIG", "INT"

    # memories; methods that change one are called with `lock` held

    def write_edit(self, block: bytes) -> None:
        """Replace the edit memory."""
        n_points, rest = divmod(len(block), 2)
        if rest or n_points < MIN_POINTS:
            raise ScpiError(-161, f"{len(block)} bytes")
        if n_points > MAX_POINTS:
            raise ScpiError(-223, f"{n_points} points: at most {MAX_POINTS}")
        highest = int(np.frombuffer(block, ">u2").max())
        if highest > MAX_CODE:
            raise ScpiError(-222, f"code {highest}: at most {MAX_CODE}")
        self.edit = bytes(block)

    def copy_from_user(self, number: int) -> None:
        """Copy a USER memory to the edit memory."""
        record = self.user[number]
        if record is None:
            raise ScpiError(-224, f"USER{number} is empty")
        self.edit = record

    def erase(self, number: int) -> None:
        """Erase a USER memory; rejected while it is locked or selected."""
        if self.locked[number] or any(channel.function == f"USER{number}" for channel in self.channels.values()):
            raise ScpiError(-221, f"USER{number} is locked or selected")
        self.user[number] = None

    def change(self, number: int, **settings: Any) -> None:
        """Change amplitude, offset or limits, into an open circuit [V]; reject outputs beyond the limits."""
        channel = replace(self.channels[number], **settings)
        room = min(channel.limit_high - channel.offset, channel.offset - channel.limit_low)
        if channel.amplitude / 2 > room * (1 + 1e-9):
            why = f"{channel.amplitude:g} Vpp at {channel.offset:g} V exceeds VOLTage:LIMit"
            if not settings.keys() & {"amplitude", "offset"}:
                raise ScpiError(-221, why)
            if self.behaviour.limit_violation == "error":
                raise ScpiError(-222, why)
            channel.amplitude = max(2 * room, 0.0)
        channel.amplitude = min(channel.amplitude, self.clip_amplitude)
        self.channels[number] = channel

    # what comes out

    def tick(self) -> float | None:
        """Return the time between timer triggers [s]; None if another trigger source is selected."""
        return self.timer if self.trigger_source == "TIM" else None

    def sent(self, channel: Channel) -> Playback | None:
        """Return a single burst of a channel, or its record repeated without a trigger; None if it plays no record."""
        if not (channel.function.startswith(("USER", "EMEM")) and channel.is_simulated):
            return None
        record = self.edit if channel.function == "EMEM" else self.user[int(channel.function[4:])]
        if record is None:
            return None
        sign = -1.0 if channel.polarity == "INV" else 1.0
        # As far as is known, the output rests at the first point between bursts.
        idle_code = int.from_bytes(record[:2], "big")
        level = sign * channel.amplitude, channel.offset
        return Playback(record, *level, channel.cycle, math.inf if channel.burst else channel.cycle, idle_code)


def blank_record(n_points: int) -> bytes:
    """Return a record at 0 V."""
    return MID_CODE.to_bytes(2, "big") * n_points


LOWEST, HIGHEST, DEFAULT = 20e-3, 20.0, 2.0
"""Range and default of the amplitude into an open circuit [V peak to peak]."""

PEAK_TO_PEAK_PER_RMS = {"SIN": 2 * math.sqrt(2.0), "SQU": 2.0, "RAMP": 2 * math.sqrt(3.0)}
"""Ratio for the waveforms whose rms value does not depend on a record [1]."""

MILLIWATT = 1e-3


def amplitude_in_vpp(argument: Argument, channel: Channel) -> float:
    """Return the amplitude given by an argument, at the configured load [V peak to peak]."""
    factor = channel.load_factor
    low, high = LOWEST * factor, HIGHEST * factor
    named = re.search(r"(VPP|VRMS|DBM)\s*$", argument, re.IGNORECASE) if isinstance(argument, str) else None
    bare = isinstance(argument, str) and re.search(r"[A-Za-z]", argument.upper().replace("E", "")) is None
    unit = named[1].upper() if named else channel.unit if bare else "VPP"
    if unit == "VPP":
        return read_number(argument, units={"V": 1.0, "VPP": 1.0}, minimum=low, maximum=high, default=DEFAULT * factor)
    least, most = (amplitude_in_unit(bound, channel, unit) for bound in (low, high))
    value = read_number(argument, units={unit: 1.0}, minimum=least, maximum=most)
    rms = value if unit == "VRMS" else math.sqrt(MILLIWATT * channel.load * 10 ** (value / 10))
    return rms * _per_rms(channel, unit)


def amplitude_in_unit(vpp: float, channel: Channel, unit: str) -> float:
    """Return an amplitude [V peak to peak at the load] in a unit."""
    if unit == "VPP":
        return vpp
    rms = vpp / _per_rms(channel, unit)
    return rms if unit == "VRMS" else 10 * math.log10(rms**2 / channel.load / MILLIWATT)


def _per_rms(channel: Channel, unit: str) -> float:
    if channel.function not in PEAK_TO_PEAK_PER_RMS:
        raise ScpiError(-221, f"{channel.function} has no amplitude in {unit}: give it in VPP")
    if unit == "DBM" and math.isinf(channel.load):
        raise ScpiError(-221, "no power goes into an open circuit: give the amplitude in VPP")
    return PEAK_TO_PEAK_PER_RMS[channel.function]


SHAPES = (
    "SINusoid",
    "SQUare",
    "PULSe",
    "RAMP",
    "PRNoise",
    "DC",
    "SINC",
    "GAUSsian",
    "LORentz",
    "ERISe",
    "EDECay",
    "HAVersine",
)
HIGHEST_BURST_FREQUENCY = 6.25e6


def afg_twin(model: str, behaviour: Behaviour | None, **hardware: Any) -> tuple[Afg, CommandTable]:
    """Return the state of a simulated AFG3022B, whatever the model, and its command table."""
    afg = Afg(behaviour or Behaviour(), **hardware)
    groups = (_memories, _user_memories, _waveform, _levels, _triggers)
    return afg, common.command_table(afg, groups, "AFG3000", "{:.4E}")


def _waveform(afg: Afg) -> dict[str, Command]:
    def shape(number: int, arguments: Arguments) -> None:
        chosen = read_choice(_numbered(one(arguments)), (*SHAPES, *MEMORIES, "EMEMory"))
        if chosen.startswith("USER") and afg.user[int(chosen[4:])] is None:
            raise ScpiError(-224, f"{chosen} is empty")
        afg.channels[number].function = chosen

    def highest(channel: Channel) -> float:
        return 25e6 if channel.function == "SIN" else HIGHEST_BURST_FREQUENCY if channel.burst else 12.5e6

    def frequency(number: int, arguments: Arguments) -> None:
        channel = afg.channels[number]
        value = read_number(one(arguments), {"HZ": 1.0}, 1e-3, highest(channel), 1e6)
        channel.frequency = float(f"{value:.11e}")

    return {
        "[SOURce#]:FUNCtion[:SHAPe]": Command(set=shape, get=get_of(afg, lambda channel: channel.function)),
        "[SOURce#]:FUNCtion:RAMP:SYMMetry": common.number(afg, "symmetry", PERCENT, 0, 100, "{:.4E}", 50.0),
        "[SOURce#]:PULSe:DCYCle": common.number(afg, "duty_cycle", PERCENT, 0.001, 99.999, "{:.4E}", 50.0),
        "[SOURce#]:FREQuency[:CW|FIXed]": Command(
            set=frequency,
            get=lambda number, arguments: common.get_number(
                afg, "frequency", 1e-3, highest(afg.channels[number]), "{:.11E}"
            )(number, arguments),
        ),
        "[SOURce#]:PHASe[:ADJust]": common.number(
            afg, "phase", {"RAD": 1.0, "DEG": math.pi / 180}, -math.pi, math.pi, "{:.4E}", 0.0
        ),
        "[SOURce#]:PHASe:INITiate": Command(set=bare(lambda _: afg.align())),
    }


def _levels(afg: Afg) -> dict[str, Command]:
    def amplitude(number: int, arguments: Arguments) -> None:
        channel = afg.channels[number]
        value = amplitude_in_vpp(one(arguments), channel)
        value = float(f"{value:.3e}") if value >= 1 else round(value, 4)
        afg.change(number, amplitude=value / channel.load_factor)

    def volts(number: int, arguments: Arguments, default: float | None = None) -> float:
        factor = afg.channels[number].load_factor
        return read_number(one(arguments), {"V": 1.0}, -10 * factor, 10 * factor, default) / factor

    def told(name: str, low: float = -10, high: float = 10) -> Callable[[int, Arguments], str]:
        return common.get_number(afg, name, low, high, "{:.4E}", at_load=True)

    def limit(side: str) -> Command:
        return Command(
            set=lambda n, a: afg.change(n, **{side: volts(n, a)}),
            get=told(side),
        )

    def shown_unit(number: int) -> str:
        # The rms value of an arbitrary record is not computed; its amplitude is always in volts peak to peak.
        channel = afg.channels[number]
        return channel.unit if channel.function in PEAK_TO_PEAK_PER_RMS else "VPP"

    vpp = told("amplitude", LOWEST, HIGHEST)
    level = "[SOURce#]:VOLTage[:LEVel][:IMMediate]"
    return {
        f"{level}[:AMPLitude]": Command(
            set=amplitude,
            get=lambda n, a: f"{amplitude_in_unit(float(vpp(n, a)), afg.channels[n], shown_unit(n)):.4E}",
        ),
        f"{level}:HIGH": common.edge(afg, 1, LOWEST, "{:.4E}"),
        f"{level}:LOW": common.edge(afg, -1, LOWEST, "{:.4E}"),
        f"{level}:OFFSet": Command(
            set=lambda n, a: afg.change(n, offset=volts(n, a, 0.0)),
            get=told("offset"),
        ),
        "[SOURce#]:VOLTage:LIMit:HIGH": limit("limit_high"),
        "[SOURce#]:VOLTage:LIMit:LOW": limit("limit_low"),
        "[SOURce#]:VOLTage:UNIT": common.keyword(afg, "unit", ("VPP", "VRMS", "DBM")),
        "OUTPut#:IMPedance": common.number(
            afg, "load", {"OHM": 1.0}, 1, 10e3, "{:.4E}", common.SOURCE_IMPEDANCE, endless=True
        ),
        "OUTPut#:POLarity": common.keyword(afg, "polarity", ("NORMal", "INVerted")),
        "OUTPut#[:STATe]": common.switch(afg, "output"),
    }


def _triggers(afg: Afg) -> dict[str, Command]:
    def burst(number: int, arguments: Arguments) -> None:
        on = read_boolean(one(arguments))
        channel = afg.channels[number]
        if on and channel.frequency > HIGHEST_BURST_FREQUENCY and channel.function != "SIN":
            raise ScpiError(-221, f"{channel.frequency:g} Hz is too fast for a burst")
        channel.burst = on

    def timer(_: int, arguments: Arguments) -> None:
        value = read_number(one(arguments), {"S": 1.0}, 1e-6, 500, 1e-3)
        afg.timer = float(f"{value:.{afg.behaviour.timer_digits - 1}e}")

    return {
        "[SOURce#]:BURSt[:STATe]": Command(set=burst, get=get_of(afg, lambda c: flag(c.burst))),
        "[SOURce#]:BURSt:MODE": common.keyword(afg, "burst_mode", ("TRIGgered", "GATed")),
        "[SOURce#]:BURSt:NCYCles": common.number(afg, "n_cycles", {}, 1, 1e6, "{:.4E}", 5.0, endless=True),
        "[SOURce#]:BURSt:TDELay": common.number(afg, "delay", {"S": 1.0}, 0, 85, "{:.4E}", 0.0),
        "TRIGger[:SEQuence]:SOURce": common.keyword(afg, "trigger_source", ("TIMer", "EXTernal")),
        "TRIGger[:SEQuence]:TIMer": Command(
            set=timer, get=lambda c, a: f"{asked(a, afg.timer, 1e-6, 500):.{afg.behaviour.timer_digits - 1}E}"
        ),
        "TRIGger[:SEQuence][:IMMediate]": Command(set=bare(lambda _: afg.trigger())),
        "SOURce:ROSCillator:SOURce": common.keyword(afg, "clock_source", ("INTernal", "EXTernal")),
        "OUTPut:TRIGger:MODE": common.keyword(afg, "trigger_output", ("TRIGger", "SYNC")),
    }


ROOT = "TRACe|DATA"


def _memories(afg: Afg) -> dict[str, Command]:
    def write(channel: int, arguments: Arguments) -> None:
        (block,) = _of_edit(arguments, 2)
        if not isinstance(block, bytes):
            raise ScpiError(-104, "a definite block is needed")
        afg.write_edit(block)

    def read(channel: int, arguments: Arguments) -> bytes:
        _of_edit(arguments, 1)
        length = str(len(afg.edit))
        return f"#{len(length)}{length}".encode() + afg.edit

    def define(channel: int, arguments: Arguments) -> None:
        (size,) = _of_edit(arguments if len(arguments) != 1 else (*arguments, "1000"), 2)
        if isinstance(size, str) and size.upper().startswith("USER"):
            afg.copy_from_user(_user(size))
        else:
            afg.edit = blank_record(whole((size,), MIN_POINTS, MAX_POINTS))

    def points(channel: int, arguments: Arguments) -> str:
        name, *limit = arguments or ("EMEM",)
        _of_edit((name,), 1)
        return f"{asked(tuple(limit), len(afg.edit) // 2, MIN_POINTS, MAX_POINTS):.0f}"

    def set_value(channel: int, arguments: Arguments) -> None:
        place, code = _of_edit(arguments, 3)
        codes = np.frombuffer(afg.edit, ">u2").copy()
        codes[whole((place,), 1, codes.size) - 1] = whole((code,), 0, MAX_CODE)
        afg.write_edit(codes.tobytes())

    def value(channel: int, arguments: Arguments) -> str:
        (place,) = _of_edit(arguments, 2)
        return str(np.frombuffer(afg.edit, ">u2")[whole((place,), 1, len(afg.edit) // 2) - 1])

    def line(channel: int, arguments: Arguments) -> None:
        numbers, codes = _of_edit(arguments, 5), np.frombuffer(afg.edit, ">u2").copy()
        start, end = (whole((place,), 1, codes.size) for place in numbers[::2])
        first, last = (whole((code,), 0, MAX_CODE) for code in numbers[1::2])
        codes[start - 1 : end] = np.round(np.linspace(first, last, max(end - start + 1, 0)))
        afg.write_edit(codes.tobytes())

    return {
        f"{ROOT}[:DATA]": Command(set=write, get=read),
        f"{ROOT}[:DATA]:LINE": Command(set=line),
        f"{ROOT}[:DATA]:VALue": Command(set=set_value, get=value),
        f"{ROOT}:DEFine": Command(set=define),
        f"{ROOT}:POINts": Command(set=define, get=points),
    }


def _user_memories(afg: Afg) -> dict[str, Command]:
    def copy(channel: int, arguments: Arguments) -> None:
        target, source = arguments if len(arguments) == 2 else (one(arguments), "EMEM")
        if isinstance(target, str) and target.upper().startswith("USER"):
            _of_edit((source,), 1)
            number = _user(target)
            if afg.locked[number]:
                raise ScpiError(-221, f"USER{number} is locked")
            # A channel playing this memory plays the new record.
            afg.user[number] = afg.edit
        else:
            _of_edit((target,), 1)
            afg.copy_from_user(_user(source))

    def catalogue(_: int) -> str:
        return ",".join([f'"USER{number}"' for number, record in afg.user.items() if record] + ['"EMEM"'])

    def lock(channel: int, arguments: Arguments) -> None:
        name, state = exactly(arguments, 2)
        afg.locked[_user(name)] = read_boolean(state)

    return {
        f"{ROOT}:COPY": Command(set=copy),
        f"{ROOT}:CATalog": Command(get=bare(catalogue)),
        f"{ROOT}:LOCK[:STATe]": Command(set=lock, get=lambda c, a: flag(afg.locked[_user(one(a))])),
        f"{ROOT}:DELete[:NAME]": Command(set=lambda c, a: afg.erase(_user(one(a)))),
    }


def _of_edit(arguments: Arguments, n: int) -> Arguments:
    """Return the arguments after the first of n, which must be the name of the edit memory."""
    name, *rest = exactly(arguments, n)
    read_choice(_numbered(name), ("EMEMory",))
    return tuple(rest)


def _user(name: Argument) -> int:
    return int(read_choice(_numbered(name), MEMORIES)[4:])


def _numbered(name: Argument) -> Argument:
    return {"USER": "USER1", "EMEM1": "EMEM", "EMEMORY1": "EMEM"}.get(str(name).upper(), name)
