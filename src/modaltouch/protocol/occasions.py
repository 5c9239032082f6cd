"""Groups of participants and kinds of session: overrides of protocol keys for each."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from pydantic import Field, Tag

from modaltouch.protocol.problems import Problem
from modaltouch.protocol.section import NUMBER_OR_LIST, Count, NotNegative, Section, Word, described
from modaltouch.protocol.source import Source
from modaltouch.protocol.tree import Node

_OWN: dict[str, Any] = {"default": {}, "exclude_if": lambda given: not given}


class Overrides(Section):
    """Keys of the protocol overridden for a group or a kind of session."""

    conditions: dict[str, object] = described(
        "Keys of the section conditions that differ, such as {peak_velocities_mm_s: [80, 100]}.", **_OWN
    )
    stimulus: dict[str, object] = described("Keys of the section stimulus that differ, such as {focus: B}.", **_OWN)
    schedule: dict[str, object] = described(
        "Keys of the section schedule that differ, such as {repetitions: 1, practice_trials: 10}.", **_OWN
    )
    answers: dict[str, object] = described(
        "Keys of the section answers that differ, such as {presentation_bursts: 7}.", **_OWN
    )
    masking: dict[str, object] = described(
        "Keys of the section masking that differ, such as {level_dB_FS: -30}.", **_OWN
    )


class SessionKind(Overrides):
    """A kind of session; every participant has the kinds in this order."""

    name: Word = described("Name of the kind, such as training; used in the record, tables and report.")
    times: Annotated[Count, Field(le=1000)] = described(
        "Number of sessions of this kind, one after the other.", default=1
    )
    min_gap_days: NotNegative = described(
        "Minimum time since the participant's previous session of any kind [days]; `run` refuses to begin earlier.",
        default=0.0,
    )
    analysed: bool = Field(
        strict=True, default=True, description="Whether `analyse` uses sessions of this kind; false for training."
    )


Sessions = Annotated[
    Annotated[Annotated[Count, Field(le=1000)], Tag("number")]
    | Annotated[Annotated[tuple[SessionKind, ...], Field(min_length=1, max_length=100)], Tag("list")],
    NUMBER_OR_LIST,
]


class Occasion(NamedTuple):
    """A group of participants and a kind of session; each empty if the protocol has none."""

    group: str = ""
    kind: str = ""


def occasions_of(root: Node | None) -> list[Occasion]:
    """Return every combination of group and kind of session in the tree of a protocol; missing names are empty."""
    groups = list(_overrides(root, "groups")) or [""]
    kinds = list(_overrides(root, "schedule", "sessions")) or [""]
    return [Occasion(group, kind) for group in groups for kind in kinds]


def at_occasion(root: Node, occasion: Occasion) -> Node:
    """Return the tree of a protocol with the overrides of an occasion; every value keeps its position."""
    own = [_overrides(root, "groups").get(occasion.group), _overrides(root, "schedule", "sessions").get(occasion.kind)]
    for each in filter(None, own):
        for section in Overrides.model_fields:
            over = each.child(section)
            if over is not None:
                root = root.with_child(section, _merged(root.child(section), over))
    return root


def check_groups(source: Source, root: Node) -> list[Problem]:
    """Return the problems of groups and kinds: a key `sessions`, repeated names, a field `group` under people."""
    problems = []
    people = root.child("people")
    if people is not None and "group" in people.keys and _overrides(root, "groups"):
        given = "a column group beside that of the protocol's groups"
        where = people.keys["group"]
        problems.append(Problem(str(source.path), *where, "people.group", given, "another name", "choose another"))

    def refuse_sessions(node: Node, path: str, *said: str) -> None:
        schedule = node.child("schedule")
        if schedule is not None and "sessions" in schedule.keys:
            problems.append(Problem(str(source.path), *schedule.keys["sessions"], f"{path}.schedule.sessions", *said))

    for name, group in _overrides(root, "groups").items():
        refuse_sessions(
            group,
            f"groups.{name}",
            "sessions of one group",
            "the same sessions for all groups",
            "write them under schedule.sessions",
        )
    section = root.child("schedule")
    listed, seen = None if section is None else section.child("sessions"), list[str]()
    for index, kind in enumerate(() if listed is None else listed.children):
        called, path = kind.child("name"), f"schedule.sessions[{index}]"
        if called is not None and called.text in seen:
            given, place, remedy = f"{called.text!r} again", (called.line, called.column), "choose another, or `times`"
            problems.append(Problem(str(source.path), *place, f"{path}.name", given, "each name once", remedy))
        seen += [] if called is None else [called.text]
        refuse_sessions(kind, path, "sessions of one kind", "none", "write `times`, or another kind")
    return problems


def _overrides(root: Node | None, *path: str) -> dict[str, Node]:
    """Return the groups or kinds of session at a path of the tree, by name."""
    node = root
    for step in path:
        node = None if node is None else node.child(step)
    content = None if node is None else node.content
    if isinstance(content, dict):
        return content
    named = [(each.child("name"), each) for each in content] if isinstance(content, list) else []
    return {name.text: each for name, each in named if name is not None}


def _merged(base: Node | None, over: Node) -> Node:
    """Return a mapping recursively updated with the values of another; values of other types are replaced."""
    if base is None or not (isinstance(base.content, dict) and isinstance(over.content, dict)):
        return over
    for key, each in over.content.items():
        base = base.with_child(key, _merged(base.content.get(key), each))
        base.keys[key] = over.keys[key]
    return base
