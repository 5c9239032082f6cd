"""IEEE 488.2 messages and SCPI headers: from the bytes on the wire to calls of a table of commands."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

Argument = str | bytes
"""A text argument as it was sent, or the content of a definite block."""

Handler = Callable[[int, tuple[Argument, ...]], "str | bytes | None"]
"""Called with the channel (header suffix, 1 without one) and the arguments; a query returns its reply."""

TEXTS = {
    -100: "Command error",
    -101: "Invalid character",
    -102: "Syntax error",
    -104: "Data type error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -113: "Undefined header",
    -114: "Header suffix out of range",
    -120: "Numeric data error",
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
    -410: "Query INTERRUPTED",
    -420: "Query UNTERMINATED",
}
"""Standard texts of SCPI-99, volume 2, chapter 21.8."""

_HEADER = re.compile(rb"[ \t\r]*([*:]?[A-Za-z][A-Za-z0-9_]*(?::[A-Za-z][A-Za-z0-9_]*)*)(\??)")
_PLAIN = re.compile(rb"[^;,\n\"'#]*")
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:\s*[eE]\s*[+-]?\d+)?)\s*([A-Za-z]*)$")
_MULTIPLIERS = {"G": 1e9, "MA": 1e6, "K": 1e3, "": 1.0, "M": 1e-3, "U": 1e-6, "N": 1e-9, "P": 1e-12}
_BLANKS = b" \t\r"


class ScpiError(Exception):
    """What an instrument puts in its error queue: a number of SCPI-99 and its text."""

    def __init__(self, code: int, detail: str = "") -> None:
        self.code = code
        self.text = f"{TEXTS.get(code, 'Device error')}; {detail}" if detail else TEXTS.get(code, "Device error")
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
            raise ScpiError(-101 if message[at] > 0x7E else -102, _show(message[at : at + 20]))
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
    try:
        return round(float(word)) != 0
    except ValueError:
        raise ScpiError(-104, _show(argument) if isinstance(argument, bytes) else argument) from None


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


@dataclass(frozen=True)
class Command:
    """What one header does: `set` for the command, `get` for the query; None where the form does not exist."""

    set: Handler | None = None
    get: Handler | None = None


@dataclass
class CommandTable:
    """SCPI headers and what they do.

    Headers are written as in manuals: ``[SOURce#]:VOLTage[:LEVel]``, brackets around what may be left out,
    ``#`` for a channel suffix, ``|`` between synonyms of one node.
    """

    commands: Mapping[str, Command]
    n_channels: int
    _patterns: list[tuple[re.Pattern[str], Command]] = field(init=False)
    _known: dict[str, tuple[Command, int] | None] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self._patterns = [(re.compile(_pattern(header)), command) for header, command in self.commands.items()]

    def find(self, header: str) -> tuple[Command, int]:
        """Return the command and channel that a complete header names.

        Raises
        ------
        ScpiError
            -113 where there is no such header, -114 where there is no such channel.
        """
        name = header.upper().lstrip(":")
        if name not in self._known:
            self._known[name] = self._search(name)
        found = self._known[name]
        if found is None:
            raise ScpiError(-113, header)
        if not 1 <= found[1] <= self.n_channels:
            raise ScpiError(-114, header)
        return found

    def _search(self, name: str) -> tuple[Command, int] | None:
        for pattern, command in self._patterns:
            match = pattern.fullmatch(name)
            if match:
                suffix = next((group for group in match.groups() if group), "1")
                return command, int(suffix)
        return None

    def run(self, message: bytes, *, fail: Callable[[ScpiError], None]) -> list[bytes]:
        """Carry out a message and return the replies of its queries.

        After a command error the rest of the message is dropped, after an execution error it goes on.

        Parameters
        ----------
        message : bytes
            One complete program message.
        fail : callable
            Takes each error, for the queue and the status registers.
        """
        replies: list[bytes] = []
        path = ""
        try:
            for unit in read_message(message):
                command, channel, path = self._resolve(unit.header, path)
                try:
                    reply = _call(command, channel, unit)
                except ScpiError as error:
                    fail(error)
                    if -200 < error.code <= -100:
                        return replies
                    continue
                if reply is not None:
                    replies.append(reply if isinstance(reply, bytes) else reply.encode("ascii"))
        except ScpiError as error:
            fail(error)
        return replies

    def _resolve(self, header: str, path: str) -> tuple[Command, int, str]:
        """Return command, channel and the path that the next unit starts from."""
        if header.startswith("*"):
            return (*self.find(header), path)
        full = header if header.startswith(":") or not path else f"{path}:{header}"
        full = full.lstrip(":")
        return (*self.find(full), full.rpartition(":")[0])


def _call(command: Command, channel: int, unit: MessageUnit) -> str | bytes | None:
    handler = command.get if unit.query else command.set
    if handler is None:
        raise ScpiError(-113, unit.header + ("?" if unit.query else ""))
    return handler(channel, unit.arguments)


def _pattern(header: str) -> str:
    """Return the regular expression of a header as manuals write it, for upper-case names."""
    # A first node that may be left out takes its colon with it.
    header = re.sub(r"^\[([^\]]*)\]:", r"[\1:]", header)
    pattern = ""
    for token in re.findall(r"\[|\]|:|#|\||\*?[A-Za-z]+\d*", header):
        if token == "[":
            pattern += "(?:"
        elif token == "]":
            pattern += ")?"
        elif token == "#":
            pattern += r"(\d*)"
        elif token in (":", "|"):
            pattern += token
        else:
            pattern += f"(?:{re.escape(short_form(token))}|{re.escape(token.upper())})"
    return _group_synonyms(pattern)


def _group_synonyms(pattern: str) -> str:
    """Put brackets around ``A|B`` so that each stands for one node."""
    node = r"\(\?:[^()]*\)"
    return re.sub(rf"{node}(?:\|{node})+", lambda found: f"(?:{found[0]})", pattern)
