"""The sections ``schedule`` and ``groups``: order of trials, practice, breaks, sessions, groups of people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, Tag

from modaltouch.protocol.reading import Reading, repeats
from modaltouch.protocol.section import NUMBER_OR_LIST, Count, NotNegative, Positive, Section, Word, described
from modaltouch.protocol.source import Problem, Source
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


def check_groups(source: Source, root: Node) -> Iterator[Problem]:
    """Yield the problems of groups and kinds: a key `sessions`, repeated names, a field `group` under people."""
    file, people, groups = str(source.path), root.child("people"), _overrides(root, "groups")
    if people is not None and "group" in people.keys and groups:
        given = "a column group beside that of the protocol's groups"
        yield Problem(file, *people.keys["group"], "people.group", given, "another name", "choose another")
    kinds = () if (listed := root.find("schedule", "sessions")) is None else listed.children
    of_group = "sessions of one group", "the same sessions for all groups", "write them under schedule.sessions"
    of_kind = "sessions of one kind", "none", "write `times`, or another kind"
    parts = [(f"groups.{name}", group, of_group) for name, group in groups.items()]
    parts += [(f"schedule.sessions[{index}]", kind, of_kind) for index, kind in enumerate(kinds)]
    for path, node, what in parts:
        schedule = node.child("schedule")
        if schedule is not None and "sessions" in schedule.keys:
            yield Problem(file, *schedule.keys["sessions"], f"{path}.schedule.sessions", *what)
    named = [((index, name), name.text) for index, kind in enumerate(kinds) if (name := kind.child("name")) is not None]
    for (index, name), word, _ in repeats(named):
        path = f"schedule.sessions[{index}].name"
        yield Problem(
            file, name.line, name.column, path, f"{word!r} again", "each name once", "choose another, or `times`"
        )


def _overrides(root: Node | None, *path: str) -> dict[str, Node]:
    """Return the groups or kinds of session at a path of the tree, by name."""
    node = None if root is None else root.find(*path)
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


LIMITS = (
    "max_same_pair_running",
    "max_same_level_running",
    "max_same_stimulus_running",
    "max_same_side_running",
    "min_same_cell_distance",
)
"""Keys of the section schedule that limit the sequence of trials in shuffled orders."""

_ABSENT: dict[str, Any] = {"default": None, "exclude_if": lambda given: given is None}


class NoOrderError(ValueError):
    """Raised if no order keeps the limit under a `key`, or if such orders are too rare to find."""

    def __init__(self, key: str, given: str, allowed: str, remedy: str) -> None:
        super().__init__(f"schedule.{key}: given {given}; {allowed or remedy}")
        self.key, self.parts = key, (given, allowed, remedy)


def least_limit(counts: Sequence[int]) -> int:
    """Return the smallest limit on runs that the counts allow.

    The trials of the most frequent kind must fit into the gaps before, between and after all others.

    >>> least_limit([4, 4, 4]), least_limit([12]), least_limit([9, 2])
    (1, 12, 3)
    """
    most = max(counts)
    return -(-most // (sum(counts) - most + 1))


class ResumeSection(Section):
    """Resumption of an interrupted session."""

    at: Literal["trial", "block", "restart"] = described(
        "trial: from the next trial; block: from the first trial of the interrupted block, whose answers are kept but "
        "not counted; restart: as a new session in the same order, with the old one closed.",
        default="trial",
    )
    within_hours: Positive | None = described(
        "Longest interruption after which a session may be resumed [h]; null for no limit.", default=None
    )


class ScheduleSection(Section):
    """Order of the trials, practice, breaks and sessions."""

    repetitions: Annotated[Count, Field(le=10_000)] = described("Number of trials of each condition.", default=1)
    order: Literal["shuffled", "by_pair", "by_velocity", "latin_square", "as_listed"] = described(
        "Order within a finger condition: shuffled, pairs or velocities one after the other, a different row of a "
        "balanced Latin square for each participant, or for all participants as the cells are listed (conditions.cells "
        "or table).",
        default="shuffled",
    )
    max_same_pair_running: Count | None = described(
        "Most consecutive trials with the same pair of zones, in shuffled orders; null for no limit.", default=None
    )
    max_same_level_running: Count | None = described(
        "Most consecutive trials with the same peak velocity, in shuffled orders; null for no limit.", **_ABSENT
    )
    max_same_stimulus_running: Count | None = described(
        "Most consecutive trials with the same stimulus, if there are several, in shuffled orders; null for no limit.",
        **_ABSENT,
    )
    max_same_side_running: Count | None = described(
        "Most consecutive trials with the focus under the finger of the same side, in shuffled orders, so that the "
        "same answer is not expected too often in a row; pairs without the focus restart the count. Null for no limit.",
        **_ABSENT,
    )
    min_same_cell_distance: Annotated[Count, Field(ge=2)] | None = described(
        "Minimum number of trials from one trial of a cell (pair, peak velocity and stimulus) to the next of the same "
        "cell, in shuffled orders: 2 for never twice in a row, 3 for at least two other cells in between. Null for no "
        "limit.",
        **_ABSENT,
    )
    counterbalance_finger_conditions: bool = Field(
        strict=True,
        default=True,
        description="Whether the finger condition that comes first alternates between participants.",
    )
    catch_trials: Annotated[int, Field(strict=True, ge=0, le=100)] = described(
        "Number of trials without a stimulus in each finger condition; none comes first, and no two are adjacent. The "
        "pair of each is drawn at random (with the order by_pair, that of the trial before it), so pairs may get "
        "unequal numbers. An adaptive run fits its guess rate to those of its own pair; give several per pair.",
        default=0,
    )
    balance: Literal["by_number", "least_filled"] = described(
        "How orders, placements and rows of a Latin square are assigned to participants: in turn by participant "
        "number, or each new participant gets those that the fewest on record have completed, so that dropouts are "
        "replaced.",
        default="by_number",
    )
    sessions: Sessions = described(
        "Sessions of each participant, each of which takes the turn after the previous one: their number, or the kinds "
        "of session in order, such as [{name: training, analysed: false, schedule: {repetitions: 1}}, {name: test, "
        "min_gap_days: 1}].",
        default=1,
    )
    practice_trials: Annotated[int, Field(strict=True, ge=0, le=1000)] = described(
        "Number of practice trials before the trials that count.", default=0
    )
    practice_feedback: bool = Field(
        strict=True,
        default=False,
        description="Whether the participant is told, after a practice trial, where the vibration was stronger, or the "
        "right answer.",
    )
    practice_criterion: Annotated[float, Field(strict=True, gt=0, le=1)] | None = described(
        "Share of practice trials that must be answered correctly; null if practice cannot fail.", default=None
    )
    practice_rounds: Annotated[Count, Field(le=10)] = described(
        "Maximum number of practice rounds, if the criterion is not met at first.", default=1
    )
    after_failed_practice: Literal["continue", "stop"] = described(
        "What to do if no round met the criterion.", default="continue"
    )
    break_after_trials: Count | None = described("Trials between two breaks; null for no breaks.", default=None)
    break_after_min: Positive | None = described(
        "Minutes between two breaks, taken at the next trial; null for no timed breaks.", default=None
    )
    resume: ResumeSection = described("How an interrupted session is resumed.", default=ResumeSection())

    @property
    def session_kinds(self) -> tuple[SessionKind, ...]:
        """Kinds of a participant's sessions, in order; empty if all are alike."""
        kinds = () if isinstance(self.sessions, int) else self.sessions
        return tuple(kind for kind in kinds for _ in range(kind.times))

    @property
    def n_sessions(self) -> int:
        """Number of sessions of each participant."""
        return self.sessions if isinstance(self.sessions, int) else len(self.session_kinds)

    @property
    def all_repetitions(self) -> int:
        """Repetitions of a cell over all analysed sessions of a participant, if these are alike."""
        return self.repetitions * (self.n_sessions - sum(not kind.analysed for kind in self.session_kinds))

    def kind_of(self, session: int) -> SessionKind | None:
        """Return the kind of a participant's session, from 1; the kind of the last session for higher numbers."""
        return self.session_kinds[: max(session, 1)][-1] if self.session_kinds else None


def check_alike(readings: Sequence[tuple[Occasion, Reading[Any] | None]]) -> Iterator[Problem]:
    """Yield a problem for each group and analysed kind of session that is asked something else than the first one."""
    found = [(occasion, reading, reading.value) for occasion, reading in readings if reading and reading.value]
    asked: dict[Occasion, tuple[object, ...]] = {}
    for occasion, reading, protocol in found if len(found) == len(readings) else ():
        if occasion.kind in [kind.name for kind in protocol.schedule.session_kinds if not kind.analysed]:
            continue
        answers = protocol.answers
        asked[occasion] = (
            answers.asks,
            {each.name: (each.fingers, each.interval) for each in answers.offered},
            {name: question.asks for name, question in answers.then.items()},
        )
        first = next(iter(asked))
        if asked[occasion] != asked[first]:
            # If the first group is asked the same in this kind of session, the kind makes the difference.
            place = int(asked[occasion] == asked[occasion._replace(group=first.group)])
            yield reading.problem(
                ("schedule", "sessions") if place else ("groups", occasion.group),
                f"other answers or questions for {occasion[place]} than for {first[place]}",
                "the same ones for all that is analysed together; wording, keys and time limits may differ",
                "give the other a protocol of its own",
            )
