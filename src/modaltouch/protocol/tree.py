"""Parser of YAML 1.2 into a tree of nodes with line and column.

The tree is built from parser events, so that nesting, aliases and tags are checked before expansion.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, NoReturn

import yaml

from modaltouch.protocol.source import Problem, Source, format_path

Scalar = str | int | float | bool | None

_INTEGER = re.compile(r"[-+]?[0-9]{1,30}")
_BASED = re.compile(r"0o[0-7]{1,40}|0x[0-9a-fA-F]{1,30}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL: dict[str, Scalar] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}


def resolve(text: str) -> Scalar:
    """Return the value of an unquoted word in the core schema of YAML 1.2.

    >>> [resolve(word) for word in ("80", "8e1", "0x50", "no", "80 mm/s", "")]
    [80, 80.0, 80, 'no', '80 mm/s', None]
    """
    if text in _SPECIAL:
        return _SPECIAL[text]
    if _INTEGER.fullmatch(text):
        return int(text)
    if _BASED.fullmatch(text):
        return int(text, 0)
    return float(text) if _FLOAT.fullmatch(text) else text


DEPTH_LIMIT = 16
"""Deepest nesting allowed; the shipped files need four."""

VALUE_LIMIT = 20_000
"""Largest number of values in a file, with aliases expanded."""


@dataclass(frozen=True, eq=False)
class Node:
    """A value of a YAML file, with its position and those of its keys, from 1.

    `text` is a scalar as written; `file` is given if it differs from that of the tree.
    """

    content: Scalar | list[Node] | dict[str, Node]
    line: int
    column: int
    keys: dict[str, tuple[int, int]] = field(default_factory=dict)
    text: str = ""
    file: str = ""

    @property
    def children(self) -> list[Node]:
        """The values of a list or mapping; empty for a scalar."""
        if isinstance(self.content, dict):
            return list(self.content.values())
        return self.content if isinstance(self.content, list) else []

    @cached_property
    def size(self) -> int:
        """Number of values, including this one, with aliases expanded."""
        return 1 + sum(child.size for child in self.children)

    @cached_property
    def depth(self) -> int:
        """Levels of nested lists and mappings, including this one."""
        return (
            1 + max((child.depth for child in self.children), default=0) if isinstance(self.content, list | dict) else 0
        )

    def plain(self) -> Any:
        """Return the value as plain lists, dicts and scalars."""
        if isinstance(self.content, dict):
            return {key: node.plain() for key, node in self.content.items()}
        if isinstance(self.content, list):
            return [node.plain() for node in self.content]
        return self.content

    def child(self, key: str | int) -> Node | None:
        """Return the value under a key or index, or None."""
        if isinstance(self.content, dict) and isinstance(key, str):
            return self.content.get(key)
        if isinstance(self.content, list) and isinstance(key, int) and 0 <= key < len(self.content):
            return self.content[key]
        return None

    def find(self, *path: str | int) -> Node | None:
        """Return the value at a path, or None."""
        node: Node | None = self
        for step in path:
            node = None if node is None else node.child(step)
        return node

    def paths_of(self, wanted: Node) -> list[tuple[str | int, ...]]:
        """Return every path to a node, which may be below several keys; an empty path for the node itself."""
        found: list[tuple[str | int, ...]] = [()] if self is wanted else []
        for step, child in self.content.items() if isinstance(self.content, dict) else enumerate(self.children):
            found += [(step, *rest) for rest in child.paths_of(wanted)]
        return found

    def with_child(self, key: str, child: Node) -> Node:
        """Return the mapping with a value under a key; a new key has the position of its value."""
        held = self.content if isinstance(self.content, dict) else {}
        keys = {key: (child.line, child.column)} | self.keys
        return Node(held | {key: child}, self.line, self.column, keys, self.text, self.file)


def parse_tree(source: Source) -> tuple[Node | None, list[Problem]]:
    """Parse a YAML text into a tree; return tree and problems."""
    root, problems = _parsed(source.text)
    return root, [replace(problem, file=str(source.path)) for problem in problems]


@lru_cache(maxsize=16)
def _parsed(text: str) -> tuple[Node | None, list[Problem]]:
    """Return the tree of a text and its problems, without the file name."""
    reader = _Reader(yaml.parse(text, Loader=yaml.CSafeLoader))
    try:
        return _built(reader), reader.problems
    except yaml.YAMLError as fault:
        return None, [*reader.problems, _syntax_problem(text, fault)]


def _syntax_problem(text: str, error: Any) -> Problem:
    """Return an error of the parser as a problem."""
    mark = getattr(error, "problem_mark", None)
    if mark is None:  # the position of a character is in bytes
        before = text.encode()[: error.position].decode()
        line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
        given = f"the character U+{error.character:04X}, which YAML does not allow"
        return Problem("", line, column, "", given, "printable text", "remove it")
    line, column = mark.line + 1, mark.column + 1
    written = [*text.split("\n"), ""][line - 1]
    if "\t" in written[: max(column, len(written) - len(written.lstrip()))]:
        return Problem("", line, column, "", "a tab, but YAML needs spaces", "spaces", "indent only with spaces")
    return Problem(
        "",
        line,
        column,
        "",
        f"text that is not YAML ({' '.join(filter(None, (error.problem, error.context)))})",
        "YAML 1.2",
        "check indentation, brackets, quotes and colons here and in the line above",
    )


def _built(reader: _Reader) -> Node | None:
    """Return the top-level mapping of a text, if any."""
    try:
        root = reader.document()
    except _Stop:
        return None
    if root is None or root.content is None:
        reader.report(1, 1, "an empty file", "keys and values in YAML", "compare with the shipped files")
        return None
    if not isinstance(root.content, dict):
        reader.report(
            root.line,
            root.column,
            f"a {'list' if isinstance(root.content, list) else 'single value'} at the top",
            "`key: value` lines",
            "compare with the shipped files",
        )
        return None
    return root


class _Stop(Exception):  # noqa: N818
    """Raised to stop reading at a problem."""


class _Reader:
    """Builds nodes from parser events, recursively; its depth limit is far below that of Python."""

    def __init__(self, events: Iterator[Any]) -> None:
        self.problems: list[Problem] = []
        self._events = events
        self._anchors: dict[str, Node] = {}
        self._size = 0

    def report(self, line: int, column: int, given: str, allowed: str, remedy: str = "", path: str = "") -> None:
        self.problems.append(Problem("", line, column, path, given, allowed, remedy))

    def document(self) -> Node | None:
        """Return the value of the only document; None if there is none."""
        root = None
        for event in self._events:
            if type(event).__name__ == "DocumentStartEvent":
                if root is not None:
                    self._stop(event, "a second document after `---`", "one document in a file", "remove it")
                root = self._value(next(self._events), ())
        return root

    def _stop(self, event: Any, given: str, allowed: str, remedy: str = "") -> NoReturn:
        self.report(*_place(event), given, allowed, remedy)
        raise _Stop

    def _value(self, event: Any, path: tuple[str | int, ...]) -> Node:
        """Build the value that begins with an event, at a path."""
        kind = type(event).__name__
        if kind == "AliasEvent":
            return self._alias(event, len(path))
        if event.tag is not None:
            tag = str(event.tag).replace("tag:yaml.org,2002:", "!!")
            self.report(*_place(event), f"the tag `{tag}`", "plain values without tags", "remove the tag")
        self._bound(event, 1, len(path) + (kind != "ScalarEvent"))
        if kind == "ScalarEvent":
            is_plain = event.implicit[0] and event.tag is None
            node = Node(resolve(event.value) if is_plain else event.value, *_place(event), text=event.value)
        else:
            node = self._list(event, path) if kind == "SequenceStartEvent" else self._mapping(event, path)
        if event.anchor:
            self._anchors[event.anchor] = node
        return node

    def _alias(self, event: Any, depth: int) -> Node:
        node = self._anchors.get(event.anchor)
        if node is None:
            self.report(
                *_place(event),
                f"`*{event.anchor}`, which has no anchor",
                f"an anchor `&{event.anchor}` completed before it",
            )
            node = Node(None, *_place(event))
        self._bound(event, node.size, depth + node.depth)
        return node

    def _bound(self, event: Any, size: int, depth: int) -> None:
        """Stop if a value makes the file too large or is nested too deeply."""
        self._size += size
        if depth > DEPTH_LIMIT:
            self._stop(event, f"lists and mappings nested deeper than {DEPTH_LIMIT}", f"at most {DEPTH_LIMIT} levels")
        if self._size > VALUE_LIMIT:
            self._stop(event, f"more than {VALUE_LIMIT} values", f"at most {VALUE_LIMIT}, aliases expanded")

    def _list(self, start: Any, path: tuple[str | int, ...]) -> Node:
        content: list[Node] = []
        while type(event := next(self._events)).__name__ != "SequenceEndEvent":
            content.append(self._value(event, (*path, len(content))))
        return Node(content, *_place(start))

    def _mapping(self, start: Any, path: tuple[str | int, ...]) -> Node:
        content: dict[str, Node] = {}
        keys: dict[str, tuple[int, int]] = {}
        while type(event := next(self._events)).__name__ != "MappingEndEvent":
            key = self._value(event, (*path, ""))
            is_new = self._check_key(key, keys, path)
            value = self._value(next(self._events), (*path, key.text))
            if is_new:
                content[key.text], keys[key.text] = value, (key.line, key.column)
        return Node(content, *_place(start), keys)

    def _check_key(self, key: Node, keys: dict[str, tuple[int, int]], path: tuple[str | int, ...]) -> bool:
        """Test whether a key is a word new to the mapping; values under other keys are dropped."""
        if not isinstance(key.content, str):
            word = key.text or "a list, a mapping or nothing"
            self.report(
                key.line,
                key.column,
                f"{word} as a key",
                "a word as a key",
                f'write "{key.text}" in quotes' if key.text else "write a word before the colon",
            )
        elif key.content in keys:
            given = f"`{key.content}` a second time (first on line {keys[key.content][0]})"
            place = format_path([*path, key.content])
            self.report(key.line, key.column, given, "each key once", "remove one of them", place)
        return isinstance(key.content, str) and key.content not in keys


def _place(event: Any) -> tuple[int, int]:
    return event.start_mark.line + 1, event.start_mark.column + 1
