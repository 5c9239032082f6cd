"""SCPI headers written as in manuals, and what they do."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from modaltouch.rig.simulator.arguments import short_form
from modaltouch.rig.simulator.scpi import Argument, MessageUnit, ScpiError, read_message

LARGEST_REPLY = 1 << 20
"""Bytes that the output queue holds: four records."""

QUERY_DEADLOCKED = -430

Handler = Callable[[int, tuple[Argument, ...]], "str | bytes | None"]
"""Called with the channel (header suffix, 1 without one) and the arguments; a query returns its reply."""


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
    _known: dict[str, tuple[Command, int]] = field(default_factory=dict, init=False)

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
        found = self._known.get(name) or self._search(name)
        if found is None:
            raise ScpiError(-113, header)
        # What does not exist is not remembered: there is no end to it.
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
        path, size = "", 0
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
                    size += len(replies[-1])
                    if size > LARGEST_REPLY:
                        raise ScpiError(QUERY_DEADLOCKED, f"more than {LARGEST_REPLY} bytes were asked for")
        except ScpiError as error:
            fail(error)
            if error.code == QUERY_DEADLOCKED:
                return []
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
