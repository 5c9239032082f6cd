"""Schedule of a session, drawn from protocol, participant and seed, and results of its rounds of practice."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from modaltouch.protocol.conditions import Cell, Placement
from modaltouch.protocol.orders import are_certain, order_cells
from modaltouch.protocol.schedule_section import NoOrderError
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.source import InputError, Problem
from modaltouch.protocol.streams import ALGORITHM, FORMER_ALGORITHM, Stream, key_of, seed_sequence
from modaltouch.protocol.trial import SIDES, Condition, Trial

if TYPE_CHECKING:
    from modaltouch.protocol.findings import Findings


@dataclass(frozen=True)
class Turn:
    """Number of a participant's balanced order.

    Attributes
    ----------
    number : int
        Taken modulo the numbers of orders, placements and rows.
    reason : str
        Origin of the number.
    group : str
        The participant's group; empty if the protocol has none.
    group_by : str
        Origin of the group.
    """

    number: int
    reason: str
    group: str = ""
    group_by: str = ""

    @staticmethod
    def of(participant: str, seed: int, session: int, groups: Iterable[str] = ()) -> Turn:
        """Return the turn and group of a participant, from the number at the end of the identifier or from a hash.

        Each further session of a participant takes the next turn. Groups alternate between participants; the turn
        advances after each cycle of groups.

        Parameters
        ----------
        participant, seed, session
            As in `Schedule.draw`.
        groups : iterable of str
            Groups of the protocol.
        """
        names = list(groups) or [""]
        ending = re.search(r"[0-9]+$", participant)
        if ending is not None:
            number, reason = int(ending.group()[-18:]) - 1, "number of the participant"
        else:
            number, reason = Stream(seed, participant, 1, "order of finger conditions").below(2**64), _BY_HASH
        turn, place = divmod(number, len(names))
        return Turn(turn + session - 1, reason, names[place], reason if names[place] else "")

    @staticmethod
    def recorded(start: dict[str, Any]) -> Turn | None:
        """Return the turn in a start record; None if it followed from the participant's number or hash."""
        schedule = start.get("schedule", {})
        own = [str(schedule.get(key, "")) for key in ("group", "group_by")]
        return Turn(int(schedule["turn"]), str(schedule["turn_by"]), *own) if "turn" in schedule else None

    def order(self, protocol: Protocol) -> tuple[tuple[str, ...], Placement]:
        """Return the order of the finger conditions and the placement for this turn."""
        orders, placements = _orders_of_finger_conditions(protocol), protocol.conditions.placements
        # Orders alternate with every turn; the placement advances after each cycle of orders.
        return orders[self.number % len(orders)], placements[self.number // len(orders) % len(placements)]

    def balanced(self, protocol: Protocol) -> tuple[object, ...]:
        """Return all that this turn decides: order of finger conditions, placement and rows of a Latin square."""
        from modaltouch.protocol.latin_squares import numbers_of_rows, row_of_turn

        return *self.order(protocol), *(row_of_turn(self.number, n_rows) for n_rows in numbers_of_rows(protocol))

    def as_now(self, start: dict[str, Any], protocol: Protocol) -> Turn:
        """Return the turn that now has the order, placement and first rows that this one has in a start record."""
        schedule = start.get("schedule", {})
        if schedule.get("seeds", {}).get("algorithm") != FORMER_ALGORITHM or protocol.schedule.order != "latin_square":
            return self
        rows = Turn(self.number * protocol.scheduled_repetitions, "").balanced(protocol)[2:]
        turns = (replace(self, number=number) for number in range(Turn.period(protocol)))
        return next((turn for turn in turns if turn.balanced(protocol) == (*self.order(protocol), *rows)), self)

    @staticmethod
    def period(protocol: Protocol) -> int:
        """Return the number of turns after which orders of finger conditions, placements and rows all repeat."""
        from modaltouch.protocol.latin_squares import numbers_of_rows

        n_orders = len(_orders_of_finger_conditions(protocol)) * len(protocol.conditions.placements)
        # Each round of a square begins one row later than the last, so its period is as many rounds as rows.
        return math.lcm(n_orders, *(n_rows**2 for n_rows in numbers_of_rows(protocol)))


@dataclass(frozen=True)
class Block:
    """The trials of one finger condition in order, and the position of the block in the session, from 1."""

    number: int
    finger_condition: str
    trials: tuple[Trial, ...]


@dataclass(frozen=True)
class Schedule:
    """All trials of a participant's session, in order.

    Attributes
    ----------
    participant : str
        Identifier of the participant.
    session : int
        Number of the session, from 1.
    seed : int
        Seed of the study.
    practice : tuple of Trial
        Practice trials, before those that count.
    blocks : tuple of Block
        One for each finger condition, in this participant's order.
    finger_conditions_by : str
        Origin of the order of finger conditions: ``number of the participant``, ``hash of the participant``, the
        reason of a given turn, or ``protocol``.
    is_adaptive : bool
        Whether the levels depend on the answers; all trials are then scheduled at the level of a run's first trial.
    turn : Turn or None
        The turn, if given; None if it follows from participant, seed and session.
    group, group_by : str
        The participant's group and its origin; empty if the protocol has none.
    session_kind : str
        Kind of the session; empty if the protocol has only one.
    algorithm : str
        Name and version of the algorithm that drew the order.
    """

    participant: str
    session: int
    seed: int
    practice: tuple[Trial, ...]
    blocks: tuple[Block, ...]
    finger_conditions_by: str
    is_adaptive: bool = False
    turn: Turn | None = None
    group: str = ""
    group_by: str = ""
    session_kind: str = ""
    algorithm: str = ALGORITHM

    @property
    def trials(self) -> tuple[Trial, ...]:
        """Trials that count, in order."""
        return tuple(trial for block in self.blocks for trial in block.trials)

    @property
    def order_hash(self) -> str:
        """SHA-256 of all trials in order, practice first."""
        values = [
            [trial.practice, trial.index, trial.repetition, *_brief(trial)] for trial in (*self.practice, *self.trials)
        ]
        return hashlib.sha256(json.dumps(values).encode()).hexdigest()

    @property
    def seeds(self) -> dict[str, Any]:
        """Seeds and algorithm of the order, for the record."""
        return {
            "algorithm": self.algorithm,
            "study_seed": self.seed,
            "participant": self.participant,
            "participant_key": f"{key_of(self.participant):064x}",
            "session": self.session,
            "purposes": {purpose: f"{key_of(purpose):064x}" for purpose in self._purposes()},
        }

    def _purposes(self) -> list[str]:
        orders = [_ORDER + block.finger_condition for block in self.blocks]
        with_catches = (block for block in self.blocks if any(trial.condition.is_catch for trial in block.trials))
        catches = [_CATCHES + block.finger_condition for block in with_catches]
        intervals = [_INTERVALS + block.finger_condition for block in self.blocks if block.trials[0].interval]
        intervals += [_INTERVALS + "practice"] if intervals and self.practice else []
        return ["order of finger conditions", "practice", *orders, *catches, *intervals]

    def as_dict(self) -> dict[str, Any]:
        """Return the schedule as a JSON-serialisable dict for the record."""
        return {
            "order_hash": self.order_hash,
            "seeds": self.seeds,
            "finger_conditions": [block.finger_condition for block in self.blocks],
            "finger_conditions_by": self.finger_conditions_by,
            **({"levels": "adaptive"} if self.is_adaptive else {}),
            **({"turn": self.turn.number, "turn_by": self.turn.reason} if self.turn is not None else {}),
            **{name: own for name in ("group", "group_by", "session_kind") if (own := getattr(self, name))},
            "n_trials": len(self.trials),
            "n_practice_trials": len(self.practice),
            "practice": [_brief(trial) for trial in self.practice],
            "order": [_brief(trial) for trial in self.trials],
        }

    @classmethod
    def draw(
        cls,
        protocol: Protocol,
        participant: str,
        seed: int,
        session: int = 1,
        *,
        given: Turn | None = None,
        effort: float = 1.0,
        algorithm: str = ALGORITHM,
    ) -> Schedule:
        """Draw a participant's schedule; the same arguments give the same schedule.

        Parameters
        ----------
        protocol : Protocol
            The design.
        participant : str
            Identifier of the participant.
        seed : int
            Seed of the study, 0 or above.
        session : int
            Number of the session, from 1; every session has a separate order.
        given : Turn, optional
            The participant's turn, if set by the record rather than by the participant's number.
        effort : float
            Fraction of the usual work after which the search for an order is abandoned [1].
        algorithm : str
            Name and version of the algorithm.

        Raises
        ------
        ValueError
            If no order keeps the protocol's limits, or if such orders are too rare to find.
        """
        decided = given or Turn.of(participant, seed, session, protocol.groups)
        finger_conditions, placement = decided.order(protocol)
        chance = partial(Stream, seed, participant, session)
        practised = _place(
            finger_conditions[0], _draw_practice(protocol, finger_conditions[0], chance("practice")), placement
        )
        return cls(
            participant=participant,
            session=session,
            seed=seed,
            practice=_number(protocol, practised, chance(_INTERVALS + "practice"), block=0, first=1),
            blocks=_draw_blocks(protocol, decided, chance, effort, algorithm),
            is_adaptive=protocol.adaptive is not None,
            finger_conditions_by=decided.reason if len(_orders_of_finger_conditions(protocol)) > 1 else "protocol",
            turn=given,
            group=decided.group,
            group_by=decided.group_by,
            session_kind=getattr(protocol.schedule.kind_of(session), "name", ""),
            algorithm=algorithm,
        )

    @classmethod
    def draw_again(cls, protocol: Protocol, start: dict[str, Any], session: int) -> Schedule:
        """Draw the schedule of a start record again, by the algorithm that it names.

        Parameters
        ----------
        protocol : Protocol
            The design.
        start : dict
            The start record.
        session : int
            Number of the session when the order was drawn.
        """
        is_former = start["schedule"]["seeds"]["algorithm"] == FORMER_ALGORITHM
        return cls.draw(
            protocol,
            start["participant"],
            start["seed"],
            session,
            given=Turn.recorded(start),
            algorithm=FORMER_ALGORITHM if is_former else ALGORITHM,
        )

    @classmethod
    def draw_from(
        cls,
        findings: Findings,
        participant: str,
        seed: int,
        session: int = 1,
        *,
        given: Turn | None = None,
        effort: float = 1.0,
    ) -> Schedule:
        """Draw a participant's schedule from a protocol file without problems; arguments and `effort` as in `draw`.

        Raises
        ------
        InputError
            If no order keeps a limit, or if such orders are too rare to find; with the position of the limit.
        """
        try:
            return cls.draw(findings.experiment().protocol, participant, seed, session, given=given, effort=effort)
        except NoOrderError as error:
            raise InputError([findings.problem(("schedule", error.key), *error.parts)]) from error

    @classmethod
    def check(cls, findings: Findings) -> tuple[Problem, ...]:
        """Return a problem if no order can be drawn; draws one only if the outcome is not certain beforehand."""
        try:
            if not are_certain(findings.experiment().protocol):
                # A quarter of the effort, so that with full effort an order is found for nearly every participant.
                cls.draw_from(findings, "p01", 0, effort=0.25)
        except InputError as error:
            return error.problems
        return ()

    @staticmethod
    def random_generator(seed: int, participant: str, session: int, purpose: str) -> np.random.Generator:
        """Return a generator for random numbers that do not affect the order, such as an observer's answers.

        Streams of different purposes are independent.
        """
        return np.random.Generator(np.random.PCG64(seed_sequence(seed, participant, session, purpose)))


_BY_HASH = "hash of the participant"
_ORDER, _CATCHES, _INTERVALS = "order within ", "catch trials within ", "intervals within "
"""Purposes of random streams, each followed by the name of the finger condition."""


def _orders_of_finger_conditions(protocol: Protocol) -> list[tuple[str, ...]]:
    given = protocol.conditions.finger_conditions
    return list(itertools.permutations(given)) if protocol.schedule.counterbalance_finger_conditions else [given]


def _place(finger_condition: str, cells: Iterable[Cell], placement: Placement) -> list[Condition]:
    """Return the conditions of cells in a placement; left and right are exchanged on a beam turned end to end."""
    way = -1 if placement.startswith("mirrored") else 1
    return [Condition.on(zones[::way], finger_condition, level, placement, name) for zones, level, name in cells]


def _draw_blocks(
    protocol: Protocol, turn: Turn, chance: Callable[[str], Stream], effort: float, algorithm: str
) -> tuple[Block, ...]:
    """Draw the blocks of a session, in the order of finger conditions of the turn."""
    finger_conditions, placement = turn.order(protocol)
    blocks: list[Block] = []
    for number, name in enumerate(finger_conditions, start=1):
        cells = order_cells(protocol, name, turn.number, chance(_ORDER + name), effort, algorithm)
        if protocol.schedule.catch_trials:
            from modaltouch.protocol.catch_trials import insert_catches

            cells = insert_catches(protocol, cells, chance(_CATCHES + name))
        conditions = _place(name, cells, placement)
        first = sum(len(block.trials) for block in blocks) + 1
        trials = _number(protocol, conditions, chance(_INTERVALS + name), block=number, first=first)
        blocks.append(Block(number, name, trials))
    return tuple(blocks)


def _draw_practice(protocol: Protocol, finger_condition: str, stream: Stream) -> list[Cell]:
    """Draw the practice cells; none is repeated before all others have been used."""
    cells, schedule, drawn = dict.fromkeys(protocol.cells(finger_condition)), protocol.schedule, list[Cell]()
    n_trials = schedule.practice_trials * (1 if schedule.practice_criterion is None else schedule.practice_rounds)
    while len(drawn) < n_trials:
        drawn += stream.shuffled(cells)
    return drawn[:n_trials]


def _number(
    protocol: Protocol, conditions: Sequence[Condition], stream: Stream, *, block: int, first: int
) -> tuple[Trial, ...]:
    """Number the conditions as trials and count repetitions in order; block 0 is practice."""
    seen: Counter[Condition] = Counter()
    intervals = [0] * len(conditions)
    if protocol.intervals is not None:
        from modaltouch.protocol.intervals import draw_intervals

        intervals = draw_intervals(protocol.intervals, conditions, stream)
    trials = []
    for index, (condition, interval) in enumerate(zip(conditions, intervals, strict=True), start=first):
        seen[condition] += 1
        trials.append(Trial(index, block, condition, seen[condition], practice=block == 0, interval=interval))
    return tuple(trials)


def _brief(trial: Trial) -> list[Any]:
    condition = trial.condition
    values = [trial.block, condition.finger_condition, *condition.zones, condition.velocity_mm_s, condition.placement]
    values += [condition.stimulus] if condition.stimulus else []
    return [*values, trial.interval] if trial.interval else values


@dataclass(frozen=True)
class Round:
    """Result of a round of practice: number of trials with an expected answer, and of those answered so."""

    n_judged: int
    n_agreed: int

    def passes(self, criterion: float | None) -> bool:
        """Test whether the round meets a criterion."""
        return criterion is None or self.n_agreed >= criterion * self.n_judged - 1e-9


def judge_round(events: Iterable[Mapping[str, Any]], number: int, n_trials: int, protocol: Protocol) -> Round:
    """Return the result of a round of practice, from 1, of `n_trials` each, from the events of the session log."""
    first, last = (number - 1) * n_trials + 1, number * n_trials
    judged: dict[int, bool] = {}
    for event in events:
        if event.get("event") != "trial" or not event["trial"]["practice"]:
            continue
        index, planned = event["trial"]["index"], event["planned"]
        speeds = [planned[name] for name in map("speed_{}_mm_s".format, SIDES[3]) if name in planned]
        expected = protocol.expected(Trial.from_dict(event["trial"]), speeds)
        if first <= index <= last and expected is not None:
            judged[index] = event["response"]["answer"] == expected
    return Round(len(judged), sum(judged.values()))
