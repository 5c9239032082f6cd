"""Settings that are not simulated but read by third-party drivers; imported when one of them is used."""

from __future__ import annotations

import math

from modaltouch.rig.simulator.scpi import (
    HERTZ,
    PERCENT,
    SECONDS,
    Arguments,
    Command,
    ScpiError,
    flag,
    is_word,
    one,
    read_boolean,
    read_number,
    short_form,
)

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
    "[SOURce#]:FREQuency:CONCurrent[:STATe]": (False, {}),
    "[SOURce#]:VOLTage:CONCurrent[:STATe]": (False, {}),
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


def not_simulated(defaults: dict[str, Default], form: str) -> dict[str, Command]:
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
