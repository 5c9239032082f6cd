"""IEEE 488.2 program messages and SCPI-99 errors: parsing of messages, command tables, and replies."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

Argument = str | bytes
"""A text argument as sent, or the content of a definite-length block."""


class Quoted(str):
    """A quoted string: a name or a text, never a number or a keyword."""

    __slots__ = ()


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
}
"""Standard error texts (SCPI-99, volume 2, chapter 21.8)."""

_HEADER = re.compile(rb"[ \t\r]*([*:]?[A-Za-z][A-Za-z0-9_]*(?::[A-Za-z][A-Za-z0-9_]*)*)(\??)")
_PLAIN = re.compile(rb"[^;,\n\"'#]*")
_BLANKS = b" \t\r"


LONGEST_TEXT = 255
"""Longest text of an error (SCPI-99, 21.8.1), and longest header or number that is parsed [characters]."""


class ScpiError(Exception):
    """An entry of an instrument's error queue: SCPI-99 number and text, which is always printable."""

    def __init__(self, code: int, detail: str = "") -> None:
        self.code = code
        plain = detail[:LONGEST_TEXT].encode("ascii", "backslashreplace").decode().replace('"', "'")
        plain = "".join(letter if letter.isprintable() else " " for letter in plain)
        text = TEXTS.get(code, "Device error")
        text = f"{text}; {plain}"[:LONGEST_TEXT] if detail else text
        super().__init__(f'{code},"{text}"')


MessageUnit = tuple[str, bool, tuple[Argument, ...]]
"""One command or query of a message: header, without the question mark of a query; whether it is one; arguments."""


def read_message(message: bytes) -> Iterator[MessageUnit]:
    """Split a complete message into units, with regard to semicolons, strings and definite-length blocks."""
    at = 0
    while at < len(message):
        if message[at] in b" \t\r\n;":
            at += 1
            continue
        found = _HEADER.match(message, at)
        if found is None:
            raise ScpiError(-102 if 0x20 <= message[at] <= 0x7E else -101, message[at : at + 20].decode("latin1"))
        if len(found[1]) > LONGEST_TEXT:
            raise ScpiError(-112, found[1][:20].decode("latin1"))
        header, query = found[1].decode("ascii"), bool(found[2])
        arguments, at = _read_arguments(message, found.end())
        yield header, query, arguments


def _read_arguments(message: bytes, at: int) -> tuple[tuple[Argument, ...], int]:
    """Return the arguments that start at an index of a message, and the index after the end of their unit."""
    arguments: list[Argument] = []
    if at < len(message) and message[at] not in b" \t\r\n;":
        raise ScpiError(-102, message[at : at + 20].decode("latin1"))
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
            raise ScpiError(-102, message[at : at + 20].decode("latin1"))
        at += 1


def _read_argument(message: bytes, at: int) -> tuple[Argument, int]:
    first = message[at : at + 1]
    if first == b"#" and message[at + 1 : at + 2] in (b"1", b"2", b"3", b"4", b"5", b"6", b"7", b"8", b"9"):
        start = at + 2 + int(message[at + 1 : at + 2])
        announced = message[at + 2 : start]
        if not announced.isdigit() or start + int(announced) > len(message):
            raise ScpiError(-161, f"announced {announced.decode('latin1')} bytes, {max(len(message) - start, 0)} came")
        end = start + int(announced)
        return message[start:end], end
    if first in (b'"', b"'"):
        end = message.find(first, at + 1)
        if end < 0:
            raise ScpiError(-151, "no closing quote")
        return Quoted(message[at + 1 : end].decode("latin1")), end + 1
    found = _PLAIN.match(message, at)
    text = found[0] if found else b""
    if not text:
        raise ScpiError(-102, message[at : at + 20].decode("latin1"))
    return text.decode("latin1").strip(), at + len(text)


Arguments = tuple[Argument, ...]

PERCENT, SECONDS, HERTZ = {"PCT": 1.0}, {"S": 1.0}, {"HZ": 1.0}
"""Units of settings."""

_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:\s*[eE]\s*[+-]?\d+)?)\s*([A-Za-z]*)$")
_MULTIPLIERS = {"G": 1e9, "MA": 1e6, "K": 1e3, "": 1.0, "M": 1e-3, "U": 1e-6, "N": 1e-9, "P": 1e-12}


def read_number(
    argument: Argument, units: Mapping[str, float], minimum: float, maximum: float, default: float | None = None
) -> float:
    """Convert an argument such as ``15E-1``, ``1500 mVPP`` or ``MIN`` to the unit with factor 1 in `units`.

    ``M`` is milli, except before HZ and OHM, where it is mega; `default` is the value of ``DEF``. Raises ScpiError:
    -104 if it is not a number, -124 for too many digits, -131 for another unit, -222 for a value out of range.
    """
    argument = _plain(argument)
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


def _plain(argument: Argument) -> str:
    """Return a number or keyword as sent; reject blocks and strings."""
    if isinstance(argument, bytes | Quoted):
        raise ScpiError(-104, "a block or string where a number or keyword belongs")
    return argument


def read_boolean(argument: Argument) -> bool:
    """Convert ON, OFF or a number to a bool."""
    word = _plain(argument).upper()
    if word in ("ON", "OFF"):
        return word == "ON"
    return round(read_number(argument, units={}, minimum=-9.9e37, maximum=9.9e37)) != 0


def read_choice(argument: Argument, choices: tuple[str, ...]) -> str:
    """Return the short form of a keyword given in short or long form."""
    word = _plain(argument)
    for choice in choices:
        if is_word(word.upper(), choice):
            return short_form(choice)
    raise ScpiError(-224, word[:40])


def short_form(mnemonic: str) -> str:
    """Return the capitals and digits of a mnemonic: ``EXT`` of ``EXTernal``."""
    return "".join(letter for letter in mnemonic if not letter.islower())


def is_word(word: str, mnemonic: str) -> bool:
    """Test whether an upper-case word is the short or the long form of a mnemonic."""
    return word in (short_form(mnemonic), mnemonic.upper())


def exactly(arguments: Arguments, n: int) -> Arguments:
    """Return the arguments; raise ScpiError unless there are `n` of them."""
    if len(arguments) < n:
        raise ScpiError(-109)
    if len(arguments) > n:
        raise ScpiError(-108)
    return arguments


def one(arguments: Arguments) -> Argument:
    """Return the only argument."""
    return exactly(arguments, 1)[0]


def whole(arguments: Arguments, low: int, high: int) -> int:
    """Return the only argument as an integer."""
    return round(read_number(one(arguments), units={}, minimum=low, maximum=high))


def asked(arguments: Arguments, value: float, low: float, high: float) -> float:
    """Return the value for a query, or the limit requested by ``MIN`` or ``MAX``."""
    if not arguments:
        return value
    return low if read_choice(one(arguments), ("MINimum", "MAXimum")) == short_form("MINimum") else high


def flag(state: bool) -> str:
    """Format a bool as a reply."""
    return "1" if state else "0"


Handler = Callable[[int, tuple[Argument, ...]], "str | bytes | None"]
"""Handler of a command: takes channel (header suffix, default 1) and arguments; for a query it returns the reply."""


@dataclass(frozen=True)
class Command:
    """Handlers of one header: `set` for the command, `get` for the query; None if that form does not exist."""

    set: Handler | None = None
    get: Handler | None = None


@dataclass
class CommandTable:
    """SCPI headers and their commands.

    Headers are written as in manuals, such as ``[SOURce#]:VOLTage[:LEVel]``: brackets enclose optional nodes, ``#`` is
    a channel suffix, and ``|`` separates synonyms of one node. `further` returns additional commands; it is called for
    the first header that is not in `commands`. Every command, not a query, is executed in a context of `changing`.
    """

    commands: Mapping[str, Command]
    n_channels: int
    further: Callable[[], Mapping[str, Command]] | None = None
    changing: Callable[[], contextlib.AbstractContextManager[None]] = contextlib.nullcontext
    _patterns: list[tuple[re.Pattern[str], Command]] = field(init=False)
    _known: dict[str, tuple[Command, int]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self._patterns = _patterns(self.commands)

    def find(self, header: str) -> tuple[Command, int]:
        """Return the command and channel of a complete header."""
        name = header.upper().lstrip(":")
        found = self._known.get(name) or self._search(name)
        if found is None and self.further is not None:
            self._patterns += _patterns(self.further())
            self.further = None
            found = self._search(name)
        if found is None:
            raise ScpiError(-113, header)
        # Unknown headers are not cached, since their number is unlimited.
        self._known[name] = found
        if not 1 <= found[1] <= self.n_channels:
            raise ScpiError(-114, header)
        return found

    def _search(self, name: str) -> tuple[Command, int] | None:
        for pattern, command in self._patterns:
            match = pattern.fullmatch(name)
            if match:
                suffix = next((group for group in match.groups() if group), "1").lstrip("0")
                return command, int(suffix) if len(suffix) == 1 else 0
        return None

    def run(self, message: bytes, *, fail: Callable[[ScpiError], None]) -> list[bytes]:
        """Execute a complete program message and return the replies of its queries.

        A command error ends the message; after an execution error the next unit is executed. `fail` gets each error.
        """
        replies: list[bytes] = []
        path = ""
        try:
            for header, query, arguments in read_message(message):
                command, channel, path = self._resolve(header, path)
                try:
                    handler = command.get if query else command.set
                    if handler is None:
                        raise ScpiError(-113, header + ("?" if query else ""))
                    with contextlib.nullcontext() if query else self.changing():
                        reply = handler(channel, arguments)
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
        """Return command, channel and the header path from which the next unit starts."""
        if header.startswith("*"):
            return (*self.find(header), path)
        full = header if header.startswith(":") or not path else f"{path}:{header}"
        full = full.lstrip(":")
        return (*self.find(full), full.rpartition(":")[0])


def _patterns(commands: Mapping[str, Command]) -> list[tuple[re.Pattern[str], Command]]:
    return [(re.compile(_pattern(header)), command) for header, command in commands.items()]


def _pattern(header: str) -> str:
    """Return the regular expression, for upper-case names, of a header written as in manuals."""
    # An optional first node includes its colon.
    header = re.sub(r"^\[([^\]]*)\]:", r"[\1:]", header)
    signs = {"[": "(?:", "]": ")?", "#": r"(\d*)", ":": ":", "|": "|"}

    def written(token: re.Match[str]) -> str:
        return signs.get(token[0]) or f"(?:{re.escape(short_form(token[0]))}|{re.escape(token[0].upper())})"

    pattern = re.sub(r"[][:#|]|\*?[A-Za-z]+\d*", written, header)
    # Put brackets around `A|B`, so that it stands for one node.
    node = r"\(\?:[^()]*\)"
    return re.sub(rf"{node}(?:\|{node})+", lambda found: f"(?:{found[0]})", pattern)
