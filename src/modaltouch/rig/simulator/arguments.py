"""What the arguments of SCPI commands say: numbers with units, truth values, keywords."""

from __future__ import annotations

import re
from collections.abc import Mapping

from modaltouch.rig.simulator.scpi import LONGEST_TEXT, Argument, ScpiError

Arguments = tuple[Argument, ...]

_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:\s*[eE]\s*[+-]?\d+)?)\s*([A-Za-z]*)$")
_MULTIPLIERS = {"G": 1e9, "MA": 1e6, "K": 1e3, "": 1.0, "M": 1e-3, "U": 1e-6, "N": 1e-9, "P": 1e-12}


def read_number(
    argument: Argument,
    *,
    units: Mapping[str, float],
    minimum: float,
    maximum: float,
    default: float | None = None,
) -> float:
    """Return a numeric argument in the first unit of `units`.

    Parameters
    ----------
    argument : str or bytes
        As sent: ``1.5``, ``15E-1``, ``1500 mVPP``, ``MIN``, ``MAXimum``, ``DEFault``.
    units : mapping of str to float
        Upper-case unit -> factor; ``M`` is milli, save before HZ and OHM, where it is mega.
    minimum, maximum, default : float
        Range, ends included, and what ``DEF`` means.

    Raises
    ------
    ScpiError
        -104 for what is not a number, -131 for a foreign unit, -222 for a value out of range.
    """
    if isinstance(argument, bytes):
        raise ScpiError(-104, "a block where a number belongs")
    if len(argument) > LONGEST_TEXT:
        raise ScpiError(-124, argument[:20])
    word = argument.upper()
    if is_word(word, "MINimum"):
        return minimum
    if is_word(word, "MAXimum"):
        return maximum
    if is_word(word, "DEFault") and default is not None:
        return default
    if is_word(word, "INFinity"):
        value, unit = 9.9e37, ""
    else:
        found = _NUMBER.match(argument)
        if found is None:
            raise ScpiError(-104, argument)
        value, unit = float(re.sub(r"\s", "", found[1])), found[2].upper()
    value *= _factor(unit, units)
    if not minimum <= value <= maximum:
        raise ScpiError(-222, f"{argument}: allowed {minimum:g} to {maximum:g}")
    return value


def _factor(unit: str, units: Mapping[str, float]) -> float:
    if unit == "" or unit in units:
        return units.get(unit, 1.0)
    for name, factor in units.items():
        prefix = unit.removesuffix(name)
        if name and prefix != unit and prefix in _MULTIPLIERS:
            mega = prefix == "M" and name in ("HZ", "OHM")
            return factor * (1e6 if mega else _MULTIPLIERS[prefix])
    raise ScpiError(-131, unit)


def read_boolean(argument: Argument) -> bool:
    """Return ON, OFF or a number as a truth value."""
    word = argument.upper() if isinstance(argument, str) else ""
    if word in ("ON", "OFF"):
        return word == "ON"
    return round(read_number(argument, units={}, minimum=-9.9e37, maximum=9.9e37)) != 0


def read_choice(argument: Argument, choices: tuple[str, ...]) -> str:
    """Return the short form of a keyword, given in its short or long form."""
    for choice in choices:
        if isinstance(argument, str) and is_word(argument.upper(), choice):
            return short_form(choice)
    raise ScpiError(-224, str(argument)[:40])


def short_form(mnemonic: str) -> str:
    """Return the capitals and digits of a mnemonic: ``EXT`` of ``EXTernal``."""
    return "".join(letter for letter in mnemonic if not letter.islower())


def is_word(word: str, mnemonic: str) -> bool:
    """Return whether an upper-case word is the short or the long form of a mnemonic."""
    return word in (short_form(mnemonic), mnemonic.upper())


def exactly(arguments: Arguments, n: int) -> Arguments:
    """Return the arguments if there are `n` of them."""
    if len(arguments) < n:
        raise ScpiError(-109)
    if len(arguments) > n:
        raise ScpiError(-108)
    return arguments


def one(arguments: Arguments) -> Argument:
    """Return the only argument."""
    return exactly(arguments, 1)[0]


def whole(arguments: Arguments, low: int, high: int) -> int:
    """Return the only argument as a whole number."""
    return round(read_number(one(arguments), units={}, minimum=low, maximum=high))


def quantity(arguments: Arguments, units: dict[str, float], low: float, high: float, default: float | None) -> float:
    """Return the only argument as a number in the first of its units."""
    return read_number(one(arguments), units=units, minimum=low, maximum=high, default=default)


def asked(arguments: Arguments, value: float, low: float, high: float) -> float:
    """Return the value of a query, or the limit that ``MIN`` or ``MAX`` asks for."""
    if not arguments:
        return value
    return low if read_choice(one(arguments), ("MINimum", "MAXimum")) == short_form("MINimum") else high


def flag(state: bool) -> str:
    """Return a truth value as a reply."""
    return "1" if state else "0"
