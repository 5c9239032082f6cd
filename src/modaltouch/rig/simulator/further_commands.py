"""Stored settings, status registers and other seldom used commands of the simulated generators; loaded on first use.

Settings that are not simulated, but read by third-party drivers, have their defaults.

No condition that the twins simulate has a bit in the operation and questionable registers, so their events stay 0.
Stored settings include the states of the outputs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from modaltouch.rig.simulator import common
from modaltouch.rig.simulator.common import State, bare, register
from modaltouch.rig.simulator.scpi import (
    HERTZ,
    PERCENT,
    SECONDS,
    Arguments,
    Command,
    ScpiError,
    exactly,
    flag,
    is_word,
    one,
    read_boolean,
    read_choice,
    read_number,
    short_form,
    whole,
)

HIGHEST_SETUP = 4


def status_commands(state: State) -> dict[str, Command]:
    """Return the commands of the status registers (SCPI-99, volume 2, chapter 20)."""

    def preset(_: int) -> None:
        state.operation_enable = state.questionable_enable = 0

    commands = {"STATus:PRESet": Command(set=bare(preset)), "*PSC": common.switch(state, "clears_status")}
    for node, enable in (("OPERation", "operation_enable"), ("QUEStionable", "questionable_enable")):
        commands[f"STATus:{node}[:EVENt]"] = commands[f"STATus:{node}:CONDition"] = Command(get=bare(lambda _: "0"))
        commands[f"STATus:{node}:ENABle"] = register(state, enable, 65535)
    return commands


def setup_commands(state: State) -> dict[str, Command]:
    """Return the commands of the stored settings."""

    def changeable(arguments: Arguments) -> int:
        number = whole(arguments, 0, HIGHEST_SETUP)
        if number in state.locked_setups:
            raise ScpiError(-221, f"setup {number} is locked")
        return number

    def save(_: int, arguments: Arguments) -> None:
        state.setups[changeable(arguments)] = state.settings()

    def delete(_: int, arguments: Arguments) -> None:
        state.setups.pop(changeable(arguments), None)

    def recall(_: int, arguments: Arguments) -> None:
        number = whole(arguments, 0, HIGHEST_SETUP)
        if number not in state.setups:
            raise ScpiError(-221, f"setup {number} is empty")
        state.restore(state.setups[number])

    def secure(_: int) -> None:
        state.setups.clear()
        state.locked_setups.clear()
        state.wipe()
        state.forget()
        state.reset()

    return {
        "*SAV": Command(set=save),
        "*RCL": Command(set=recall),
        "MEMory:STATe:VALid": Command(get=lambda n, a: flag(whole(a, 0, HIGHEST_SETUP) in state.setups)),
        "MEMory:STATe:DELete": Command(set=delete),
        "MEMory:STATe:RECall:AUTO": common.switch(state, "recalls_last"),
        "SYSTem:SECurity:IMMediate": Command(set=bare(secure)),
    }


def further_commands(state: State, form: str, *, tektronix: bool) -> dict[str, Command]:
    """Return the commands of this module, and those of settings that are not simulated; `form` is that of numbers."""
    commands = status_commands(state) | setup_commands(state)
    if tektronix:
        commands |= tektronix_commands(state)
    missing = AFG3000 if tektronix else KEYSIGHT_33500B
    return common.noticed(state, commands, ()) | not_simulated(missing, form)


def tektronix_commands(state: State) -> dict[str, Command]:
    """Return the commands that only an AFG3022B has."""

    def copy(_: int, arguments: Arguments) -> None:
        source, target = (int(read_choice(name, ("CH1", "CH2"))[2]) for name in exactly(arguments, 2))
        state.channels[target] = replace(state.channels[source], output=state.channels[target].output)

    def lock(_: int, arguments: Arguments) -> None:
        name, locks = exactly(arguments, 2)
        number = {whole((name,), 1, HIGHEST_SETUP)}
        state.locked_setups = state.locked_setups | number if read_boolean(locks) else state.locked_setups - number

    test = Command(set=bare(lambda _: None), get=bare(lambda _: "0"))
    return {
        "AFGControl:CSCopy": Command(set=copy),
        "MEMory:STATe:LOCK": Command(
            set=lock, get=lambda n, a: flag(whole(a, 1, HIGHEST_SETUP) in state.locked_setups)
        ),
        "DIAGnostic[:ALL]": test,
        "CALibration[:ALL]": test,
    }


Default = tuple[float | str, dict[str, float]]
"""Default of a setting (a bool for a boolean; synonyms of a keyword separated by ``|``), and its units."""

_MODULATION: dict[str, Default] = {
    "INTernal:FREQuency": (10e3, HERTZ),
    "INTernal:FUNCtion": ("SINusoid", {}),
    "INTernal:FUNCtion:EFILe": ("", {}),
    "SOURce": ("INTernal", {}),
    "STATe": (False, {}),
}
AFG3000: dict[str, Default] = {
    **{f"[SOURce#]:{way}:{header}": each for way in ("AM", "FM", "PM", "PWM") for header, each in _MODULATION.items()},
    "[SOURce#]:AM[:DEPTh]": (50.0, PERCENT),
    "[SOURce#]:FM[:DEViation]": (1e6, HERTZ),
    "[SOURce#]:PM[:DEViation]": (math.pi / 2, {"RAD": 1.0, "DEG": math.pi / 180}),
    "[SOURce#]:PWM[:DEViation]:DCYCle": (5.0, PERCENT),
    "[SOURce#]:FSKey[:FREQuency]": (1e6, HERTZ),
    "[SOURce#]:FSKey:INTernal:RATE": (50.0, HERTZ),
    "[SOURce#]:FSKey:SOURce": ("INTernal", {}),
    "[SOURce#]:FSKey:STATe": (False, {}),
    "[SOURce#]:FREQuency:MODE": ("CW|FIXed", {}),
    "[SOURce#]:FREQuency:STARt": (100e3, HERTZ),
    "[SOURce#]:FREQuency:STOP": (1e6, HERTZ),
    "[SOURce#]:FREQuency:CENTer": (550e3, HERTZ),
    "[SOURce#]:FREQuency:SPAN": (900e3, HERTZ),
    "[SOURce#]:SWEep:TIME": (10e-3, SECONDS),
    "[SOURce#]:SWEep:HTIMe": (0.0, SECONDS),
    "[SOURce#]:SWEep:RTIMe": (1e-3, SECONDS),
    "[SOURce#]:SWEep:MODE": ("AUTO", {}),
    "[SOURce#]:SWEep:SPACing": ("LINear", {}),
    "[SOURce#]:PULSe:DELay": (0.0, SECONDS),
    "[SOURce#]:PULSe:HOLD": ("DUTY", {}),
    "[SOURce#]:PULSe:PERiod": (1e-6, SECONDS),
    "[SOURce#]:PULSe:TRANsition[:LEADing]": (18e-9, SECONDS),
    "[SOURce#]:PULSe:TRANsition:TRAiling": (18e-9, SECONDS),
    "[SOURce#]:PULSe:WIDTh": (500e-9, SECONDS),
    "[SOURce#]:FUNCtion:EFILe": ("", {}),
    "[SOURce#]:COMBine:FEED": ("", {}),
    "SOURce3|SOURce4:POWer[:LEVel][:IMMediate][:AMPLitude]": (10.0, PERCENT),
    "SYSTem:BEEPer:STATe": (True, {}),
    "SYSTem:KCLick[:STATe]": (True, {}),
    "SYSTem:KLOCk[:STATe]": (False, {}),
    "TRIGger[:SEQuence]:SLOPe": ("POSitive", {}),
}
"""Settings of an AFG3022B missing from its twin, with their values after ``*RST`` (user manual, default settings)."""

KEYSIGHT_33500B: dict[str, Default] = {
    "[SOURce#]:FREQuency:MODE": ("CW|FIXed", {}),
    "[SOURce#]:VOLTage:UNIT": ("VPP", {}),
    "[SOURce#]:PHASe": (0.0, {"DEG": 1.0}),
    "[SOURce#]:FUNCtion:SQUare:DCYCle": (50.0, PERCENT),
    "[SOURce#]:FUNCtion:RAMP:SYMMetry": (100.0, PERCENT),
    "[SOURce#]:FUNCtion:PULSe:HOLD": ("WIDTh", {}),
    "[SOURce#]:FUNCtion:PULSe:PERiod": (1e-3, SECONDS),
    "[SOURce#]:FUNCtion:PULSe:WIDTh": (100e-6, SECONDS),
    "[SOURce#]:FUNCtion:PULSe:DCYCle": (10.0, PERCENT),
    "[SOURce#]:FUNCtion:PULSe:TRANsition[:BOTH]": (10e-9, SECONDS),
    "[SOURce#]:BURSt:GATE:POLarity": ("NORMal", {}),
    "TRIGger#:SLOPe": ("POSitive", {}),
    "TRIGger#:COUNt": (1.0, {"": 1.0}),
    "OUTPut:SYNC": (True, {}),
    "OUTPut:SYNC:SOURce": ("CH1", {}),
}
"""Settings of a 33500B missing from its twin, with their values after ``*RST`` (the guide's factory settings)."""


def not_simulated(defaults: Mapping[str, Default], form: str) -> dict[str, Command]:
    """Return the commands of settings that are not simulated: each reads as its default and rejects any other value.

    A driver can thus read and restore all settings, but change only simulated ones.
    """
    return {header: _fixed(default, units, form) for header, (default, units) in defaults.items()}


def _fixed(default: float | str, units: dict[str, float], form: str) -> Command:
    def keep(channel: int, arguments: Arguments) -> None:
        given = one(arguments)
        if isinstance(default, str):
            same = any(is_word(str(given).upper(), synonym) for synonym in default.split("|"))
        elif isinstance(default, bool):
            same = read_boolean(given) == default
        else:
            value = read_number(given, units=units, minimum=-9.9e37, maximum=9.9e37, default=default)
            same = math.isclose(value, default, rel_tol=1e-4)
        if not same:
            raise ScpiError(-241, f"not simulated: {given!s:.40}")

    if isinstance(default, str):
        reply = short_form(default.partition("|")[0]) or '""'
    else:
        reply = flag(default) if isinstance(default, bool) else form.format(default)
    return Command(set=keep, get=lambda channel, arguments: reply)
