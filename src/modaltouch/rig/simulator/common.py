"""SCPI commands that all simulated generators have, and the parts of which their tables are made."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from modaltouch.rig.simulator.scpi import (
    Arguments,
    Command,
    Handler,
    asked,
    exactly,
    flag,
    is_word,
    one,
    quantity,
    read_boolean,
    read_choice,
    whole,
)
from modaltouch.rig.simulator.state import GeneratorState

State = GeneratorState[Any]

PERCENT, SECONDS, HERTZ = {"PCT": 1.0}, {"S": 1.0}, {"HZ": 1.0}
"""Units of settings."""


def noticed(state: State, commands: Mapping[str, Command], forced: tuple[str, ...]) -> dict[str, Command]:
    """Return commands that cut a running burst if they change what it depends on; those in `forced` are unchanged."""
    return {header: command if header in forced else _changing(state, command) for header, command in commands.items()}


def _changing(state: State, command: Command) -> Command:
    """Return a command that cuts a running burst if it changes what that depends on."""
    carry_out = command.set
    if carry_out is None:
        return command

    def change(channel: int, arguments: Arguments) -> None:
        with state.changing():
            carry_out(channel, arguments)

    return replace(command, set=change)


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

    return {
        "*IDN": Command(get=bare(lambda _: state.identity)),
        "*OPT": Command(get=bare(lambda _: "0")),
        "*CLS": Command(set=bare(clear)),
        "*RST": Command(set=bare(lambda _: state.reset())),
        "*OPC": Command(set=bare(complete), get=bare(lambda _: "1")),
        "*WAI": Command(set=bare(lambda _: None)),
        "*TST": Command(get=bare(lambda _: "0")),
        "*ESR": Command(get=bare(event_status)),
        "*ESE": _register(state, "event_enable"),
        "*SRE": _register(state, "service_enable"),
        "*STB": Command(get=bare(lambda _: str(state.status_byte))),
        "*TRG": Command(set=bare(lambda _: state.trigger())),
        "ABORt": Command(set=bare(lambda _: state.abort())),
        "SYSTem:BEEPer[:IMMediate]": Command(set=bare(lambda _: None)),
        "SYSTem:ERRor[:NEXT]": Command(get=bare(lambda _: state.next_error())),
        "SYSTem:VERSion": Command(get=bare(lambda _: "1999.0")),
    }


def _register(state: State, name: str) -> Command:
    return Command(
        set=lambda c, a: setattr(state, name, whole(a, 0, 255)),
        get=lambda c, a: str(getattr(state, name)),
    )


def bare(carry_out: Callable[[int], str | None]) -> Handler:
    """Return a handler that takes no parameters, only the number of a channel."""

    def handle(number: int, arguments: Arguments) -> str | None:
        exactly(arguments, 0)
        return carry_out(number)

    return handle


def get_of(state: State, read: Callable[[Any], str]) -> Handler:
    """Return a handler that answers a query with the result of `read` for the channel."""
    return bare(lambda number: read(state.channels[number]))


def get_number(state: State, name: str, low: float, high: float, form: str) -> Callable[[int, Arguments], str]:
    """Return a handler that answers a query with a number of a channel, or with its limits."""

    def get(number: int, arguments: Arguments) -> str:
        value = asked(arguments, getattr(state.channels[number], name), low, high)
        # SCPI's infinity as instruments print it; 9.9E37 has no exact binary form.
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
    """Return the command for a number of a channel, an integer if it has no units; `endless` permits ``INFinity``."""

    def change(number: int, arguments: Arguments) -> None:
        word = one(arguments)
        infinite = endless and isinstance(word, str) and is_word(word.upper(), "INFinity")
        value = math.inf if infinite else quantity(arguments, units, low, high, default)
        setattr(state.channels[number], name, value if units or infinite else float(round(value)))

    return Command(set=change, get=get_number(state, name, low, high, form))


def on(state: State, name: str) -> Command:
    """Return the command for a switch of a channel."""
    return Command(
        set=lambda n, a: setattr(state.channels[n], name, read_boolean(one(a))),
        get=get_of(state, lambda channel: flag(getattr(channel, name))),
    )


def keyword(state: State, name: str, choices: tuple[str, ...]) -> Command:
    """Return the command for a keyword of a channel."""
    return Command(
        set=lambda n, a: setattr(state.channels[n], name, read_choice(one(a), choices)),
        get=get_of(state, lambda channel: str(getattr(channel, name))),
    )


def choice(state: State, name: str, choices: tuple[str, ...]) -> Command:
    """Return the command for a keyword of the whole instrument."""
    return Command(
        set=lambda n, a: setattr(state, name, read_choice(one(a), choices)), get=bare(lambda _: getattr(state, name))
    )


def switch(state: State, name: str) -> Command:
    """Return the command for a switch of the whole instrument."""
    return Command(
        set=lambda n, a: setattr(state, name, read_boolean(one(a))), get=bare(lambda _: flag(getattr(state, name)))
    )
