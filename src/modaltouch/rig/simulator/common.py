"""SCPI commands that all simulated generators have, and the parts that their tables are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from modaltouch.rig.simulator.scpi import (
    Arguments,
    Command,
    asked,
    exactly,
    flag,
    one,
    quantity,
    read_boolean,
    read_choice,
    whole,
)
from modaltouch.rig.simulator.state import GeneratorState

State = GeneratorState[Any]

PERCENT, SECONDS, HERTZ = {"PCT": 1.0}, {"S": 1.0}, {"HZ": 1.0}
"""Units that settings have."""


def noticed(state: State, commands: Mapping[str, Command], forced: tuple[str, ...]) -> dict[str, Command]:
    """Return commands whose settings end what they change of a running burst; triggers, which set nothing, are not."""
    return {header: command if header in forced else _changing(state, command) for header, command in commands.items()}


def _changing(state: State, command: Command) -> Command:
    """Return a command whose setting ends what it changes of a running burst."""
    carry_out = command.set
    if carry_out is None:
        return command

    def change(channel: int, arguments: Arguments) -> None:
        with state.changing():
            carry_out(channel, arguments)

    return replace(command, set=change)


def common_commands(state: State) -> dict[str, Command]:
    """Return the common commands of IEEE 488.2, and those that SCPI requires."""

    def clear(channel: int, arguments: Arguments) -> None:
        state.errors.clear()
        state.event_status = 0

    def event_status(channel: int, arguments: Arguments) -> str:
        value, state.event_status = state.event_status, 0
        return str(value)

    def complete(channel: int, arguments: Arguments) -> None:
        state.event_status |= 1

    return {
        "*IDN": Command(get=lambda c, a: state.identity),
        "*OPT": Command(get=lambda c, a: "0"),
        "*CLS": Command(set=clear),
        "*RST": Command(set=lambda c, a: state.reset()),
        "*OPC": Command(set=complete, get=lambda c, a: "1"),
        "*WAI": Command(set=lambda c, a: None),
        "*TST": Command(get=lambda c, a: "0"),
        "*ESR": Command(get=event_status),
        "*ESE": _register(state, "event_enable"),
        "*SRE": _register(state, "service_enable"),
        "*STB": Command(get=lambda c, a: str(state.status_byte)),
        "*TRG": Command(set=lambda c, a: state.trigger()),
        "SYSTem:ERRor[:NEXT]": Command(get=lambda c, a: state.next_error()),
        "SYSTem:VERSion": Command(get=lambda c, a: "1999.0"),
    }


def _register(state: State, name: str) -> Command:
    return Command(
        set=lambda c, a: setattr(state, name, whole(a, 0, 255)),
        get=lambda c, a: str(getattr(state, name)),
    )


def get_of(state: State, read: Callable[[Any], str]) -> Callable[[int, Arguments], str]:
    """Return what answers a query with what is read of a channel."""

    def get(number: int, arguments: Arguments) -> str:
        exactly(arguments, 0)
        return read(state.channels[number])

    return get


def get_number(state: State, name: str, low: float, high: float, form: str) -> Callable[[int, Arguments], str]:
    """Return what answers a query with a number of a channel, or with its limits."""
    return lambda number, arguments: form.format(asked(arguments, getattr(state.channels[number], name), low, high))


def number(
    state: State, name: str, units: dict[str, float], low: float, high: float, form: str, default: float | None = None
) -> Command:
    """Return the command of a number of a channel."""
    return Command(
        set=lambda n, a: setattr(state.channels[n], name, quantity(a, units, low, high, default)),
        get=get_number(state, name, low, high, form),
    )


def on(state: State, name: str) -> Command:
    """Return the command of a switch of a channel."""
    return Command(
        set=lambda n, a: setattr(state.channels[n], name, read_boolean(one(a))),
        get=get_of(state, lambda channel: flag(getattr(channel, name))),
    )


def keyword(state: State, name: str, choices: tuple[str, ...]) -> Command:
    """Return the command of a keyword of a channel."""
    return Command(
        set=lambda n, a: setattr(state.channels[n], name, read_choice(one(a), choices)),
        get=get_of(state, lambda channel: str(getattr(channel, name))),
    )


def choice(state: State, name: str, choices: tuple[str, ...]) -> Command:
    """Return the command of a keyword of the whole instrument."""
    return Command(
        set=lambda n, a: setattr(state, name, read_choice(one(a), choices)), get=lambda n, a: str(getattr(state, name))
    )


def switch(state: State, name: str) -> Command:
    """Return the command of a switch of the whole instrument."""
    return Command(
        set=lambda n, a: setattr(state, name, read_boolean(one(a))), get=lambda n, a: flag(getattr(state, name))
    )
