"""The SCPI commands of the AFG3000 series that move records between edit memory and USER memories."""

from __future__ import annotations

import numpy as np

from modaltouch.rig.simulator.afg import MAX_CODE, MEMORIES, Afg
from modaltouch.rig.simulator.arguments import Arguments, exactly, flag, is_word, one, read_boolean, read_choice, whole
from modaltouch.rig.simulator.command_table import Command
from modaltouch.rig.simulator.scpi import Argument, ScpiError

ROOT = "TRACe|DATA"


def memory_commands(afg: Afg) -> dict[str, Command]:
    """Return the commands of the edit memory and the USER memories."""
    return _record_commands(afg) | _point_commands(afg) | _user_commands(afg)


def _record_commands(afg: Afg) -> dict[str, Command]:
    def write(channel: int, arguments: Arguments) -> None:
        name, block = exactly(arguments, 2)
        _edit_memory(name)
        if not isinstance(block, bytes):
            raise ScpiError(-104, "a definite block is needed")
        afg.write_edit(block)

    def read(channel: int, arguments: Arguments) -> bytes:
        _edit_memory(one(arguments))
        length = str(len(afg.edit))
        return f"#{len(length)}{length}".encode() + afg.edit + afg.behaviour.block_end.strip(b"\n")

    return {f"{ROOT}[:DATA]": Command(set=write, get=read)}


def _point_commands(afg: Afg) -> dict[str, Command]:
    def define(channel: int, arguments: Arguments) -> None:
        name, size = exactly(arguments, 2)
        _edit_memory(name)
        if isinstance(size, str) and size.upper().startswith("USER"):
            afg.copy_from_user(_user(size))
        else:
            afg.define_edit(whole((size,), afg.min_points, afg.max_points))

    def points(channel: int, arguments: Arguments) -> str:
        if arguments:
            _edit_memory(arguments[0])
        return str(len(afg.edit) // 2)

    def set_value(channel: int, arguments: Arguments) -> None:
        name, place, code = exactly(arguments, 3)
        _edit_memory(name)
        codes = np.frombuffer(afg.edit, ">u2").copy()
        codes[whole((place,), 1, codes.size) - 1] = whole((code,), 0, MAX_CODE)
        afg.write_edit(codes.tobytes())

    def value(channel: int, arguments: Arguments) -> str:
        name, place = exactly(arguments, 2)
        _edit_memory(name)
        at = 2 * (whole((place,), 1, len(afg.edit) // 2) - 1)
        return str(int.from_bytes(afg.edit[at : at + 2], "big"))

    def line(channel: int, arguments: Arguments) -> None:
        name, *numbers = exactly(arguments, 5)
        _edit_memory(name)
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
            _edit_memory(source)
            afg.copy_to_user(_user(target))
        else:
            _edit_memory(target)
            afg.copy_from_user(_user(source))

    def catalogue(channel: int, arguments: Arguments) -> str:
        filled = [f'"USER{number}"' for number, record in afg.user.items() if record is not None]
        return ",".join([*filled, '"EMEM"'])

    def lock(channel: int, arguments: Arguments) -> None:
        name, state = exactly(arguments, 2)
        afg.locked[_user(name)] = read_boolean(state)

    return {
        f"{ROOT}:COPY": Command(set=copy),
        f"{ROOT}:CATalog": Command(get=catalogue),
        f"{ROOT}:LOCK[:STATe]": Command(set=lock, get=lambda c, a: flag(afg.locked[_user(one(a))])),
        f"{ROOT}:DELete[:NAME]": Command(set=lambda c, a: afg.erase(_user(one(a)))),
    }


def _edit_memory(name: Argument) -> None:
    if not isinstance(name, str) or not (is_word(name.upper(), "EMEMory") or is_word(name.upper(), "EMEMory1")):
        raise ScpiError(-224, str(name)[:40])


def _user(name: Argument) -> int:
    return int(read_choice("USER1" if str(name).upper() == "USER" else name, MEMORIES)[4:])
