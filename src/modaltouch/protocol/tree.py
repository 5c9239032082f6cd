"""YAML 1.2 -> tree of nodes that know their line and column.

The tree is built from the parser's events, so that nesting, aliases and tags are bounded before anything is
made of them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.reader import ReaderError

from modaltouch.protocol.problems import Problem, format_path
from modaltouch.protocol.source import Source

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
    """Return the value of an unquoted word under the core schema of YAML 1.2.

    >>> [resolve(word) for word in ("80", "8e1", "0x50", "no", "80 mm/s", "")]
    [80, 80.0, 80, 'no', '80 mm/s', None]
    """
    if text in _SPECIAL:
        return _SPECIAL[text]
    if _INTEGER.fullmatch(text):
        return int(text)
    if _BASED.fullmatch(text):
        return int(text, 0)
    if _FLOAT.fullmatch(text):
        return float(text)
    return text


DEPTH_LIMIT = 16
"""Deepest nesting that is read; the shipped files need four."""

VALUE_LIMIT = 20_000
"""Most values in a file, every alias counted as what it stands for."""


@dataclass(frozen=True, eq=False)
class Node:
    """A value of a YAML file and its place.

    Attributes
    ----------
    content : scalar, list of Node, or dict of str to Node
        The value.
    line, column : int
        Where it begins, both from 1.
    keys : dict of str to (int, int)
        Line and column of each key, where the value is a mapping.
    text : str
        A scalar as it was written.
    size : int
        Number of values in it, itself included, every alias counted as what it stands for.
    depth : int
        Number of lists and mappings nested in it, itself included.
    """

    content: Scalar | list[Node] | dict[str, Node]
    line: int
    column: int
    keys: dict[str, tuple[int, int]] = field(default_factory=dict)
    text: str = ""
    size: int = 1
    depth: int = 0

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


def parse_tree(source: Source) -> tuple[Node | None, list[Problem]]:
    """Return the tree of a YAML text and the faults that building it met.

    Parameters
    ----------
    source : Source
        The file's text.

    Returns
    -------
    root : Node or None
        The mapping at the top; None where the text holds none.
    problems : list of Problem
        Syntax, doubled keys, tags, aliases without an anchor, excess.
    """
    builder = _Builder(str(source.path))
    try:
        for event in _events(source.text):
            builder.take(event)
    except _Stop:
        return None, builder.problems
    except (YAMLError, ValueError, AttributeError) as error:  # the parser itself fails so on some directives
        builder.problems.append(_syntax_problem(str(source.path), source.text, error))
        return None, builder.problems
    root = builder.root
    if root is None or root.content is None:
        builder.report(1, 1, "an empty file", "keys and values in YAML", "compare with the shipped files")
        return None, builder.problems
    if not isinstance(root.content, dict):
        given = f"a {'list' if isinstance(root.content, list) else 'single value'} at the top"
        builder.report(root.line, root.column, given, "`key: value` lines", "compare with the shipped files")
        return None, builder.problems
    return root, builder.problems


class _Stop(Exception):  # noqa: N818
    """The text is not worth reading further."""


def _events(text: str) -> Iterator[Any]:
    yield from YAML(typ="safe", pure=True).parse(text)


def _syntax_problem(file: str, text: str, error: Exception) -> Problem:
    """Return what the parser could not read."""
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    if isinstance(error, ReaderError):
        line, column = _line_and_column(text, error.position)
        given = f"the character U+{ord(text[error.position]):04X}, which YAML does not allow"
        return Problem(file, line, column, "", given, "printable text", "remove it")
    line, column = (mark.line + 1, mark.column + 1) if mark is not None else (1, 1)
    written = text.split("\n")[line - 1] if line <= text.count("\n") + 1 else ""
    if "\t" in written[: max(column, len(written) - len(written.lstrip()))]:
        given = "a tab where YAML wants spaces"
        return Problem(file, line, column, "", given, "spaces", "indent with spaces alone")
    detail = " ".join(str(getattr(error, "problem", None) or error).split())
    context = getattr(error, "context", None)
    given = f"text that is not YAML ({detail}{f' {context}' if context else ''})"
    remedy = "check indentation, brackets, quotes and colons here and in the line above"
    return Problem(file, line, column, "", given, "YAML 1.2", remedy)


def _line_and_column(text: str, position: int) -> tuple[int, int]:
    before = text[:position]
    return before.count("\n") + 1, position - (before.rfind("\n") + 1) + 1


@dataclass
class _Open:
    """A list or mapping whose end has not been read."""

    node: Node
    anchor: str | None
    key: str | None = None
    key_place: tuple[int, int] = (1, 1)
    awaits_key: bool = True
    sound_key: bool = True
    size: int = 1
    depth: int = 1


class _Builder:
    """Takes the parser's events one by one; iterative, so that no nesting exhausts the stack."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.root: Node | None = None
        self.problems: list[Problem] = []
        self._stack: list[_Open] = []
        self._anchors: dict[str, Node] = {}
        self._n_documents = 0
        self._size = 0

    def report(self, line: int, column: int, given: str, allowed: str, remedy: str = "", path: str = "") -> None:
        self.problems.append(Problem(self.file, line, column, path, given, allowed, remedy))

    def take(self, event: Any) -> None:
        kind = type(event).__name__
        if kind == "DocumentStartEvent":
            self._n_documents += 1
            if self._n_documents > 1:
                line, column = _place(event)
                self.report(line, column, "a second document after `---`", "one document in a file", "remove it")
                raise _Stop
        elif kind in ("MappingStartEvent", "SequenceStartEvent"):
            self._begin(event, {} if kind == "MappingStartEvent" else [])
        elif kind in ("MappingEndEvent", "SequenceEndEvent"):
            self._end()
        elif kind == "ScalarEvent":
            self._refuse_tag(event)
            plain = event.implicit[0] and event.tag is None
            content = resolve(event.value) if plain else event.value
            node = Node(content, *_place(event), text=event.value)
            self._count(node, event)
            if event.anchor:
                self._anchors[event.anchor] = node
            self._add(node)
        elif kind == "AliasEvent":
            self._alias(event)

    def _alias(self, event: Any) -> None:
        line, column = _place(event)
        node = self._anchors.get(event.anchor)
        if node is None:
            given = f"`*{event.anchor}`, which stands for nothing"
            self.report(line, column, given, f"an anchor `&{event.anchor}` completed before it")
            node = Node(None, line, column)
        self._bound_depth(node.depth, line, column)
        self._count(node, event)
        self._add(node)

    def _begin(self, event: Any, content: list[Node] | dict[str, Node]) -> None:
        self._refuse_tag(event)
        line, column = _place(event)
        self._bound_depth(1, line, column)
        self._size += 1
        self._stack.append(_Open(Node(content, line, column), event.anchor))

    def _bound_depth(self, depth: int, line: int, column: int) -> None:
        if len(self._stack) + depth > DEPTH_LIMIT:
            given = f"lists and mappings nested deeper than {DEPTH_LIMIT}"
            self.report(line, column, given, f"at most {DEPTH_LIMIT} levels")
            raise _Stop

    def _end(self) -> None:
        closed = self._stack.pop()
        node = replace(closed.node, size=closed.size, depth=closed.depth)
        if closed.anchor:
            self._anchors[closed.anchor] = node
        self._add(node)

    def _count(self, node: Node, event: Any) -> None:
        self._size += node.size
        if self._size > VALUE_LIMIT:
            line, column = _place(event)
            self.report(line, column, f"more than {VALUE_LIMIT} values", f"at most {VALUE_LIMIT}, aliases counted out")
            raise _Stop

    def _add(self, node: Node) -> None:
        if not self._stack:
            self.root = node
            return
        parent = self._stack[-1]
        parent.depth = max(parent.depth, node.depth + 1)
        if isinstance(parent.node.content, list):
            parent.node.content.append(node)
            parent.size += node.size
        elif parent.awaits_key:
            self._take_key(parent, node)
        elif isinstance(parent.node.content, dict):
            parent.awaits_key = True
            parent.size += node.size
            if parent.sound_key and parent.key is not None:
                parent.node.content[parent.key] = node
                parent.node.keys[parent.key] = parent.key_place

    def _take_key(self, parent: _Open, node: Node) -> None:
        parent.awaits_key = False
        parent.sound_key = False
        if not isinstance(node.content, str):
            word = node.text or "a list, a mapping or nothing"
            remedy = f'write "{node.text}" in quotes' if node.text else "write a word before the colon"
            self.report(node.line, node.column, f"{word} as a key", "a word as a key", remedy)
        elif node.content in parent.node.keys:
            first = parent.node.keys[node.content][0]
            given = f"`{node.content}` a second time (first in line {first})"
            self.report(
                node.line, node.column, given, "each key once", "remove one of them", path=self._path_to(node.content)
            )
            # What stands under it is read on and told by this name, but not kept.
            parent.key = node.content
        else:
            parent.sound_key = True
            parent.key, parent.key_place = node.content, (node.line, node.column)

    def _path_to(self, key: str) -> str:
        """Return the full path of a key of the mapping that is being read."""
        steps = [
            len(each.node.content) if isinstance(each.node.content, list) else each.key for each in self._stack[:-1]
        ]
        return format_path([*(step for step in steps if step is not None), key])

    def _refuse_tag(self, event: Any) -> None:
        if event.tag is not None:
            line, column = _place(event)
            tag = str(event.tag).replace("tag:yaml.org,2002:", "!!")
            self.report(line, column, f"the tag `{tag}`", "plain values without tags", "remove the tag")


def _place(event: Any) -> tuple[int, int]:
    return event.start_mark.line + 1, event.start_mark.column + 1
