"""Stored settings, status registers and other seldom used commands of the simulated generators; loaded on first use.

No condition that the twins simulate has a bit in the operation and questionable registers, so their events stay 0.
Stored settings include the states of the outputs.
"""

from __future__ import annotations

from dataclasses import replace

from modaltouch.rig.simulator import common, defaults
from modaltouch.rig.simulator.common import State, bare, register
from modaltouch.rig.simulator.scpi import Arguments, Command, ScpiError, exactly, flag, read_boolean, read_choice, whole

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
    missing = defaults.AFG3000 if tektronix else defaults.KEYSIGHT_33500B
    return common.noticed(state, commands, ()) | defaults.not_simulated(missing, form)


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
