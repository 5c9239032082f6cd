"""IEEE 488.2 program messages, and the errors of SCPI-99: from the bytes on the wire to units."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

Argument = str | bytes
"""A text argument as it was sent, or the content of a definite block."""

TEXTS = {
    -100: "Command error",
    -101: "Invalid character",
    -102: "Syntax error",
    -104: "Data type error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -112: "Program mnemonic too long",
    -113: "Undefined header",
    -114: "Header suffix out of range",
    -120: "Numeric data error",
    -124: "Too many digits",
    -131: "Invalid suffix",
    -151: "Invalid string data",
    -161: "Invalid block data",
    -200: "Execution error",
    -211: "Trigger ignored",
    -220: "Parameter error",
    -221: "Settings conflict",
    -222: "Data out of range",
    -223: "Too much data",
    -224: "Illegal parameter value",
    -241: "Hardware missing",
    -310: "System error",
    -350: "Queue overflow",
    -363: "Input buffer overrun",
    -410: "Query INTERRUPTED",
    -420: "Query UNTERMINATED",
    -430: "Query DEADLOCKED",
}
"""Standard texts of SCPI-99, volume 2, chapter 21.8."""

_HEADER = re.compile(rb"[ \t\r]*([*:]?[A-Za-z][A-Za-z0-9_]*(?::[A-Za-z][A-Za-z0-9_]*)*)(\??)")
_PLAIN = re.compile(rb"[^;,\n\"'#]*")
_BLANKS = b" \t\r"


LONGEST_TEXT = 255
"""Characters of an error's text (SCPI-99, 21.8.1), and of what else has to be looked at as a whole."""


class ScpiError(Exception):
    """What an instrument puts in its error queue: a number of SCPI-99 and its text, printable whatever was sent."""

    def __init__(self, code: int, detail: str = "") -> None:
        self.code = code
        said = detail[:LONGEST_TEXT].encode("ascii", "backslashreplace").decode().replace('"', "'")
        said = "".join(letter if letter.isprintable() else " " for letter in said)
        text = TEXTS.get(code, "Device error")
        self.text = f"{text}; {said}"[:LONGEST_TEXT] if detail else text
        super().__init__(f'{code},"{self.text}"')


@dataclass(frozen=True)
class MessageUnit:
    """One command or query of a message: header without question mark, arguments as sent."""

    header: str
    query: bool
    arguments: tuple[Argument, ...]


def read_message(message: bytes) -> Iterator[MessageUnit]:
    """Yield the units of a complete message, semicolons, strings and definite blocks understood.

    Raises
    ------
    ScpiError
        At the first unit that is not IEEE 488.2; the units before it have been yielded.
    """
    at = 0
    while at < len(message):
        if message[at] in b" \t\r\n;":
            at += 1
            continue
        found = _HEADER.match(message, at)
        if found is None:
            raise ScpiError(-102 if 0x20 <= message[at] <= 0x7E else -101, _show(message[at : at + 20]))
        if len(found[1]) > LONGEST_TEXT:
            raise ScpiError(-112, _show(found[1][:20]))
        header, query = found[1].decode("ascii"), bool(found[2])
        arguments, at = _read_arguments(message, found.end())
        yield MessageUnit(header, query, arguments)


def _read_arguments(message: bytes, at: int) -> tuple[tuple[Argument, ...], int]:
    """Return the arguments that start at a place, and the place after their unit's end."""
    arguments: list[Argument] = []
    if at < len(message) and message[at] not in b" \t\r\n;":
        raise ScpiError(-102, _show(message[at : at + 20]))
    while True:
        while at < len(message) and message[at] in _BLANKS:
            at += 1
        if at >= len(message) or message[at] in b";\n":
            if arguments:
                raise ScpiError(-109, "nothing after the comma")
            return (), at + 1
        argument, at = _read_argument(message, at)
        arguments.append(argument)
        while at < len(message) and message[at] in _BLANKS:
            at += 1
        if at >= len(message) or message[at] in b";\n":
            return tuple(arguments), at + 1
        if message[at] != ord(","):
            raise ScpiError(-102, _show(message[at : at + 20]))
        at += 1


def _read_argument(message: bytes, at: int) -> tuple[Argument, int]:
    first = message[at : at + 1]
    if first == b"#" and message[at + 1 : at + 2] in (b"1", b"2", b"3", b"4", b"5", b"6", b"7", b"8", b"9"):
        start = at + 2 + int(message[at + 1 : at + 2])
        announced = message[at + 2 : start]
        if not announced.isdigit() or start + int(announced) > len(message):
            raise ScpiError(-161, f"announced {_show(announced)} bytes, {max(len(message) - start, 0)} came")
        end = start + int(announced)
        return message[start:end], end
    if first in (b'"', b"'"):
        end = message.find(first, at + 1)
        if end < 0:
            raise ScpiError(-151, "no closing quote")
        return message[at + 1 : end].decode("latin1"), end + 1
    found = _PLAIN.match(message, at)
    text = found[0] if found else b""
    if not text:
        raise ScpiError(-102, _show(message[at : at + 20]))
    return text.decode("latin1").strip(), at + len(text)


def _show(text: bytes) -> str:
    return text.decode("latin1").encode("ascii", "backslashreplace").decode()
