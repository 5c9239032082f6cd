"""The SCPI commands of the AFG3000 series, bound to the state of a simulated instrument."""

from __future__ import annotations

import math
import re
from collections import ChainMap
from collections.abc import Callable
from typing import Any

import numpy as np

from modaltouch.rig.simulator.afg import MAX_CODE, MEMORIES, Afg, Channel
from modaltouch.rig.simulator.common import (
    PERCENT,
    bare,
    choice,
    common_commands,
    get_number,
    get_of,
    keyword,
    noticed,
    number,
    on,
    switch,
)
from modaltouch.rig.simulator.scpi import (
    Argument,
    Arguments,
    Command,
    CommandTable,
    ScpiError,
    asked,
    exactly,
    flag,
    one,
    quantity,
    read_boolean,
    read_choice,
    read_number,
    whole,
)
from modaltouch.rig.simulator.state import SOURCE_IMPEDANCE, Behaviour

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
    per_rms = _per_rms(channel, unit)
    if unit == "VRMS":
        bounds = low / per_rms, high / per_rms
        return per_rms * read_number(argument, units={"VRMS": 1.0}, minimum=bounds[0], maximum=bounds[1])
    least, most = (amplitude_in_unit(bound, channel, "DBM") for bound in (low, high))
    level = read_number(argument, units={"DBM": 1.0}, minimum=least, maximum=most)
    return per_rms * math.sqrt(MILLIWATT * channel.load * 10 ** (level / 10))


def amplitude_in_unit(vpp: float, channel: Channel, unit: str | None = None) -> float:
    """Return an amplitude [V peak to peak at the load] in a unit, by default the channel's.

    The rms value of an arbitrary record is not computed: its amplitude is always given in volts peak to peak.
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


SHAPES = ("SINusoid", "SQUare", "PULSe", "RAMP", "PRNoise", "DC", "SINC", "GAUSsian", "LORentz", "ERISe", "EDECay")
HIGHEST_BURST_FREQUENCY = 6.25e6

FORCED = ("*TRG", "TRIGger[:SEQuence][:IMMediate]")
"""Trigger commands, which change no setting and must not be delayed."""


def afg_twin(model: str, behaviour: Behaviour | None, **hardware: Any) -> tuple[Afg, CommandTable]:
    """Return the state of a simulated AFG3022B, whatever the model, and its command table."""
    afg = Afg(behaviour or Behaviour(), **hardware)
    groups = (
        common_commands,
        _record_commands,
        _point_commands,
        _user_commands,
        _waveform,
        _levels,
        _burst,
        _trigger,
    )
    commands = noticed(afg, ChainMap(*(group(afg) for group in groups)), FORCED)
    return afg, CommandTable(commands, afg.n_channels, further=_further)


def _further() -> dict[str, Command]:
    from modaltouch.rig.simulator.defaults import AFG3000, not_simulated

    return not_simulated(AFG3000, "{:.4E}")


def _waveform(afg: Afg) -> dict[str, Command]:
    def shape(number: int, arguments: Arguments) -> None:
        name = one(arguments)
        chosen = read_choice("USER1" if str(name).upper() == "USER" else name, (*SHAPES, *MEMORIES, "EMEMory"))
        afg.select(number, chosen)

    def highest(channel: Channel) -> float:
        return 25e6 if channel.function == "SIN" else HIGHEST_BURST_FREQUENCY if channel.burst else 12.5e6

    def frequency(number: int, arguments: Arguments) -> None:
        channel = afg.channels[number]
        value = quantity(arguments, {"HZ": 1.0}, 1e-3, highest(channel), 1e6)
        for target in afg.channels.values() if afg.frequency_concurrent else (channel,):
            target.frequency = float(f"{value:.11e}")

    return {
        "[SOURce#]:FUNCtion[:SHAPe]": Command(set=shape, get=get_of(afg, lambda channel: channel.function)),
        "[SOURce#]:FUNCtion:RAMP:SYMMetry": number(afg, "symmetry", PERCENT, 0, 100, "{:.4E}", 50.0),
        "[SOURce#]:PULSe:DCYCle": number(afg, "duty_cycle", PERCENT, 0.001, 99.999, "{:.4E}", 50.0),
        "[SOURce#]:FREQuency[:CW|FIXed]": Command(
            set=frequency,
            get=lambda number, arguments: get_number(afg, "frequency", 1e-3, highest(afg.channels[number]), "{:.11E}")(
                number, arguments
            ),
        ),
        "[SOURce#]:FREQuency:CONCurrent[:STATe]": switch(afg, "frequency_concurrent"),
        "[SOURce#]:PHASe[:ADJust]": Command(
            set=lambda n, a: setattr(
                afg.channels[n],
                "phase",
                quantity(a, {"RAD": 1.0, "DEG": math.pi / 180}, -math.pi, math.pi, 0.0),
            ),
            get=get_number(afg, "phase", -math.pi, math.pi, "{:.4E}"),
        ),
        "[SOURce#]:PHASe:INITiate": Command(set=bare(lambda _: afg.align())),
    }


def _levels(afg: Afg) -> dict[str, Command]:
    def amplitude(number: int, arguments: Arguments) -> None:
        channel = afg.channels[number]
        factor = channel.load_factor
        value = amplitude_in_vpp(one(arguments), channel)
        value = float(f"{value:.3e}") if value >= 1 else round(value, 4)
        for each in afg.channels if afg.level_concurrent else (number,):
            afg.set_levels(each, amplitude=value / factor)

    def offset(number: int, arguments: Arguments) -> None:
        factor = afg.channels[number].load_factor
        afg.set_levels(number, offset=quantity(arguments, {"V": 1.0}, -10 * factor, 10 * factor, 0.0) / factor)

    def limit(side: str) -> Command:
        def set_limit(number: int, arguments: Arguments) -> None:
            factor = afg.channels[number].load_factor
            value = quantity(arguments, {"V": 1.0}, -10 * factor, 10 * factor, None) / factor
            afg.set_limit(number, **{side.removeprefix("limit_"): value})

        return Command(set=set_limit, get=_get_level(afg, side, -10, 10))

    def end(sign: int) -> Command:
        def change(number: int, arguments: Arguments) -> None:
            channel, factor = afg.channels[number], afg.channels[number].load_factor
            value = quantity(arguments, {"V": 1.0}, -10 * factor, 10 * factor, None) / factor
            other = channel.offset - sign * channel.amplitude / 2
            if sign * (value - other) < LOWEST * (1 - 1e-9):
                raise ScpiError(-222, f"{value * factor:g} V: the high level lies above the low one")
            afg.set_levels(number, amplitude=sign * (value - other), offset=(value + other) / 2)

        return Command(
            set=change, get=get_of(afg, lambda c: f"{(c.offset + sign * c.amplitude / 2) * c.load_factor:.4E}")
        )

    level = "[SOURce#]:VOLTage[:LEVel][:IMMediate]"
    return {
        f"{level}[:AMPLitude]": Command(set=amplitude, get=_get_amplitude(afg)),
        f"{level}:HIGH": end(1),
        f"{level}:LOW": end(-1),
        f"{level}:OFFSet": Command(set=offset, get=_get_level(afg, "offset", -10, 10)),
        "[SOURce#]:VOLTage:LIMit:HIGH": limit("limit_high"),
        "[SOURce#]:VOLTage:LIMit:LOW": limit("limit_low"),
        "[SOURce#]:VOLTage:UNIT": keyword(afg, "unit", ("VPP", "VRMS", "DBM")),
        "[SOURce#]:VOLTage:CONCurrent[:STATe]": switch(afg, "level_concurrent"),
        "OUTPut#:IMPedance": number(afg, "load", {"OHM": 1.0}, 1, 10e3, "{:.4E}", SOURCE_IMPEDANCE, endless=True),
        "OUTPut#:POLarity": keyword(afg, "polarity", ("NORMal", "INVerted")),
        "OUTPut#[:STATe]": on(afg, "output"),
    }


def _burst(afg: Afg) -> dict[str, Command]:
    def state(number: int, arguments: Arguments) -> None:
        on = read_boolean(one(arguments))
        channel = afg.channels[number]
        if on and channel.frequency > HIGHEST_BURST_FREQUENCY and channel.function != "SIN":
            raise ScpiError(-221, f"{channel.frequency:g} Hz is too fast for a burst")
        channel.burst = on

    return {
        "[SOURce#]:BURSt[:STATe]": Command(set=state, get=get_of(afg, lambda c: flag(c.burst))),
        "[SOURce#]:BURSt:MODE": keyword(afg, "burst_mode", ("TRIGgered", "GATed")),
        "[SOURce#]:BURSt:NCYCles": number(afg, "n_cycles", {}, 1, 1e6, "{:.4E}", 5.0, endless=True),
        "[SOURce#]:BURSt:TDELay": number(afg, "delay", {"S": 1.0}, 0, 85, "{:.4E}", 0.0),
    }


def _trigger(afg: Afg) -> dict[str, Command]:
    def timer(channel: int, arguments: Arguments) -> None:
        value = quantity(arguments, {"S": 1.0}, 1e-6, 500, 1e-3)
        afg.timer = float(f"{value:.{afg.behaviour.timer_digits - 1}e}")

    return {
        "TRIGger[:SEQuence]:SOURce": choice(afg, "trigger_source", ("TIMer", "EXTernal")),
        "TRIGger[:SEQuence]:TIMer": Command(
            set=timer, get=lambda c, a: f"{asked(a, afg.timer, 1e-6, 500):.{afg.behaviour.timer_digits - 1}E}"
        ),
        "TRIGger[:SEQuence][:IMMediate]": Command(set=bare(lambda _: afg.trigger())),
        "SOURce:ROSCillator:SOURce": choice(afg, "clock_source", ("INTernal", "EXTernal")),
        "OUTPut:TRIGger:MODE": choice(afg, "trigger_output", ("TRIGger", "SYNC")),
    }


def _get_level(afg: Afg, name: str, low: float, high: float) -> Callable[[int, Arguments], str]:
    """Return the handler of a query for a voltage, in volts at the configured load."""

    def get(number: int, arguments: Arguments) -> str:
        channel = afg.channels[number]
        return f"{asked(arguments, getattr(channel, name), low, high) * channel.load_factor:.4E}"

    return get


def _get_amplitude(afg: Afg) -> Callable[[int, Arguments], str]:
    """Return the handler of the query for the amplitude, in the channel's unit at the configured load."""
    vpp = _get_level(afg, "amplitude", LOWEST, HIGHEST)
    return lambda number, arguments: f"{amplitude_in_unit(float(vpp(number, arguments)), afg.channels[number]):.4E}"


ROOT = "TRACe|DATA"


def _record_commands(afg: Afg) -> dict[str, Command]:
    def write(channel: int, arguments: Arguments) -> None:
        (block,) = _of_edit(arguments, 2)
        if not isinstance(block, bytes):
            raise ScpiError(-104, "a definite block is needed")
        afg.write_edit(block)

    def read(channel: int, arguments: Arguments) -> bytes:
        _of_edit(arguments, 1)
        length = str(len(afg.edit))
        return f"#{len(length)}{length}".encode() + afg.edit

    return {f"{ROOT}[:DATA]": Command(set=write, get=read)}


def _point_commands(afg: Afg) -> dict[str, Command]:
    def define(channel: int, arguments: Arguments) -> None:
        (size,) = _of_edit(arguments, 2)
        if isinstance(size, str) and size.upper().startswith("USER"):
            afg.copy_from_user(_user(size))
        else:
            afg.define_edit(whole((size,), afg.min_points, afg.max_points))

    def points(channel: int, arguments: Arguments) -> str:
        _of_edit(arguments or ("EMEM",), 1)
        return str(len(afg.edit) // 2)

    def set_value(channel: int, arguments: Arguments) -> None:
        place, code = _of_edit(arguments, 3)
        codes = np.frombuffer(afg.edit, ">u2").copy()
        codes[whole((place,), 1, codes.size) - 1] = whole((code,), 0, MAX_CODE)
        afg.write_edit(codes.tobytes())

    def value(channel: int, arguments: Arguments) -> str:
        (place,) = _of_edit(arguments, 2)
        at = 2 * (whole((place,), 1, len(afg.edit) // 2) - 1)
        return str(int.from_bytes(afg.edit[at : at + 2], "big"))

    def line(channel: int, arguments: Arguments) -> None:
        numbers = _of_edit(arguments, 5)
        codes = np.frombuffer(afg.edit, ">u2").copy()
        start, end = (whole((place,), 1, codes.size) for place in numbers[::2])
        first, last = (whole((code,), 0, MAX_CODE) for code in numbers[1::2])
        codes[start - 1 : end] = np.round(np.linspace(first, last, max(end - start + 1, 0)))
        afg.write_edit(codes.tobytes())

    return {
        f"{ROOT}[:DATA]:LINE": Command(set=line),
        f"{ROOT}[:DATA]:VALue": Command(set=set_value, get=value),
        f"{ROOT}:DEFine": Command(set=define),
        f"{ROOT}:POINts": Command(
            set=lambda c, a: afg.define_edit(whole(a[1:], afg.min_points, afg.max_points)), get=points
        ),
    }


def _user_commands(afg: Afg) -> dict[str, Command]:
    def copy(channel: int, arguments: Arguments) -> None:
        target, source = arguments if len(arguments) == 2 else (one(arguments), "EMEM")
        if isinstance(target, str) and target.upper().startswith("USER"):
            _of_edit((source,), 1)
            afg.copy_to_user(_user(target))
        else:
            _of_edit((target,), 1)
            afg.copy_from_user(_user(source))

    def catalogue(_: int) -> str:
        filled = [f'"USER{number}"' for number, record in afg.user.items() if record is not None]
        return ",".join([*filled, '"EMEM"'])

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
    """Return the arguments after the first of n, which must name the edit memory."""
    name, *rest = exactly(arguments, n)
    read_choice(name, ("EMEMory", "EMEMory1"))
    return tuple(rest)


def _user(name: Argument) -> int:
    return int(read_choice("USER1" if str(name).upper() == "USER" else name, MEMORIES)[4:])
