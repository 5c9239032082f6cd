"""Validation of a YAML tree by a pydantic model: valid values, and problems with their positions."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError

from modaltouch.protocol.section import Step, adapter, annotation_at
from modaltouch.protocol.source import YAML_FILE, InputError, Problem, Source, format_path, suggest
from modaltouch.protocol.tree import Node, parse_tree

Model = TypeVar("Model", bound=BaseModel)
Entry = TypeVar("Entry")


@dataclass(frozen=True, eq=False)
class Reading(Generic[Model]):
    """The valid parts of a file, and its problems."""

    source: Source
    model: type[Model]
    root: Node | None  # tree of the text; None if the text is not a YAML mapping
    value: Model | None  # content; None if there is any problem
    problems: tuple[Problem, ...] = field(default=())

    def sound(self, *path: Step) -> Any:
        """Return the value at a path, or its default; None if it is missing or itself invalid.

        Problems elsewhere in the file are ignored, so that one problem does not hide another.
        """
        if self.value is not None:
            return _descend(self.value, path)
        node = self.root
        for depth, step in enumerate(path):
            if node is None:
                return None
            child = node.child(step)
            if child is None:
                return _default(self.model, path, depth) if isinstance(node.content, dict) else None
            node = child
        known = adapter(self.model, path)
        if node is None or known is None:
            return None
        try:
            return known.validate_python(node.plain())
        except ValidationError:
            return None

    def items(self, *path: Step) -> list[tuple[Any, Any]]:
        """Return index (or key) and value of every valid entry of the list (or mapping) at a path."""
        node = self.find(path)
        if node is None or not isinstance(node.content, dict | list):
            value = self.sound(*path)
            return list(
                value.items() if isinstance(value, dict) else enumerate(value if isinstance(value, tuple) else ())
            )
        steps = list(node.content) if isinstance(node.content, dict) else list(range(len(node.content)))
        return [(step, value) for step in steps if (value := self.sound(*path, step)) is not None]

    def require(self) -> Model:
        """Return the content of the text; raise `InputError` if there are problems."""
        if self.value is None:
            raise InputError(self.problems)
        return self.value

    def find(self, path: Iterable[Step]) -> Node | None:
        """Return the node at a path, or None."""
        return None if self.root is None else self.root.find(*path)

    def keys(self, *path: Step) -> list[str] | None:
        """Return the keys of the mapping at a path; None if there is no mapping."""
        node = self.find(path)
        return list(node.content) if node is not None and isinstance(node.content, dict) else None

    def has_unknown_key(self, *section: Step) -> bool:
        """Test whether a section has an unknown key, which may be a missing one misspelt."""
        from modaltouch.protocol.wording import keys_of

        return not {*(self.keys(*section) or ())} <= {*keys_of(self.model, section)}

    def length(self, *path: Step) -> int | None:
        """Return the number of entries of the list at a path; None if there is no list."""
        node = self.find(path)
        return len(node.content) if node is not None and isinstance(node.content, list) else None

    def unknown(
        self, path: Iterable[Step], kind: str, known: Iterable[str], remedy: str = "", *, at_key: bool = False
    ) -> Problem:
        """Return the problem of an unknown name: the value at a path, or the last key of the path."""
        *_, last = steps = tuple(path)
        # For one of several stimuli the value is that of the stimulus, the text that of the shared section.
        name, names = str(last if at_key else self.sound(*steps)), list(known)
        remedy = f"did you mean '{meant}'?" if (meant := suggest(name, names)) else remedy
        return self.problem(steps, f"'{name}', which is not {kind}", ", ".join(names) or "none", remedy, at_key=at_key)

    def unlisted(
        self, path: tuple[Step, ...], kind: str, known: Sequence[str], remedy: str = "", *, at_key: bool = False
    ) -> Iterator[Problem]:
        """Yield a problem for each unknown entry of a list, or key of a mapping."""
        for step, value in [(key, key) for key in self.keys(*path) or ()] if at_key else self.items(*path):
            if value not in known:
                yield self.unknown((*path, step), kind, known, remedy, at_key=at_key)

    def problem(
        self, path: Iterable[Step], given: str, allowed: str, remedy: str = "", *, at_key: bool = False
    ) -> Problem:
        """Return a problem at the value (or key) at a path, or at its nearest existing parent."""
        from modaltouch.protocol.wording import place_of

        steps = tuple(path)
        (file, line, column), written = place_of(self.root, steps, at_key=at_key)
        return Problem(
            file or str(self.source.path), line, column, format_path(steps),
            given, allowed, remedy, format_path(written),
        )  # fmt: skip

    def faults(self, *known: tuple[object, Iterable[Step], str, str, str]) -> Iterator[Problem]:
        """Yield a problem for each tuple (condition, path, given, allowed, remedy) with a true condition."""
        yield from (self.problem(at, given, allowed, remedy) for holds, at, given, allowed, remedy in known if holds)

    def load_named(self, key: tuple[str, ...], problems: list[Problem]) -> Source | None:
        """Return the file that a key names relative to this one, if any; add its problems to `problems`."""
        name = self.sound(*key)
        if name is None:
            return None
        path = self.source.path.parent / name
        try:
            return Source.load(path)
        except InputError as error:
            found = error.problems[0]
        if found.line > 1 or found.column > 1 or "UTF-8" in found.allowed:
            problems.append(found)
        else:
            wanted = YAML_FILE.replace("YAML", "CSV") if key[0] in ("stimulus", "conditions") else YAML_FILE
            allowed = f"{wanted}, as a path relative to this file" if found.allowed == YAML_FILE else found.allowed
            problems.append(self.problem(key, f"{name!r}, {found.given} ({path})", allowed, found.remedy))
        return None


def repeats(entries: Iterable[tuple[Entry, Hashable]]) -> Iterator[tuple[Entry, Any, Entry]]:
    """Yield each entry that repeats an earlier value: its place, the value, and the place of the earlier entry."""
    seen: dict[Hashable, Entry] = {}
    for place, value in entries:
        if value in seen:
            yield place, value, seen[value]
        seen.setdefault(value, place)


def read(source: Source, model: type[Model]) -> Reading[Model]:
    """Parse and validate a text."""
    return read_tree(source, model, *parse_tree(source))


def read_tree(source: Source, model: type[Model], root: Node | None, problems: Iterable[Problem]) -> Reading[Model]:
    """Validate a tree, which may contain more than the text; see `read`."""
    problems = list(problems)
    if root is None:
        return Reading(source, model, None, None, tuple(problems))
    bare: Reading[Model] = Reading(source, model, root, None)
    value: Model | None = None
    try:
        value = model.model_validate(root.plain())
    except ValidationError as error:
        # Only here, since valid files need no words.
        from modaltouch.protocol.wording import problems_of

        # A value that is no plain YAML is not reported again as one of the wrong kind.
        placed = {(problem.line, problem.column) for problem in problems}
        problems += [each for each in problems_of(bare, error) if (each.line, each.column) not in placed]
    return Reading(source, model, root, None if problems else value, tuple(problems))


def _descend(value: Any, path: Iterable[Step]) -> Any:
    for step in path:
        if isinstance(value, BaseModel):
            value = getattr(value, str(step), None)
        elif isinstance(value, dict):
            value = value.get(step)
        elif isinstance(value, tuple) and isinstance(step, int) and step < len(value):
            value = value[step]
        else:
            return None
    return value


def _default(model: type[BaseModel], path: tuple[Step, ...], depth: int) -> Any:
    """Return the default of a path of which `path[depth]` is missing; None if there is none."""
    parent: Any = annotation_at(model, path[:depth])
    step = path[depth]
    if not (isinstance(parent, type) and issubclass(parent, BaseModel)) or step not in parent.model_fields:
        return None
    info = parent.model_fields[str(step)]
    return None if info.is_required() else _descend(info.get_default(call_default_factory=True), path[depth + 1 :])
