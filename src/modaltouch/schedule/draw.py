"""Protocol + participant + seed -> Schedule."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from modaltouch.protocol import Protocol
from modaltouch.schedule.designs import order_cells
from modaltouch.schedule.streams import ALGORITHM, Stream, key_of
from modaltouch.trial import Condition, Trial


@dataclass(frozen=True)
class Block:
    """The trials of one finger condition.

    Attributes
    ----------
    number : int
        Place in the session, from 1.
    finger_condition : str
        ``one_hand`` or ``two_hands``.
    trials : tuple of Trial
        In order.
    """

    number: int
    finger_condition: str
    trials: tuple[Trial, ...]


@dataclass(frozen=True)
class Schedule:
    """Everything a participant will be presented with, in order.

    Attributes
    ----------
    participant : str
        Identifier of the participant.
    session : int
        Number of the session, from 1.
    seed : int
        Seed of the study.
    practice : tuple of Trial
        Trials before the ones that count.
    blocks : tuple of Block
        One to each finger condition, in this participant's order.
    finger_conditions_by : str
        What decided the order of the finger conditions: ``number of the participant``, ``hash of the
        participant``, or ``protocol``.
    """

    participant: str
    session: int
    seed: int
    practice: tuple[Trial, ...]
    blocks: tuple[Block, ...]
    finger_conditions_by: str

    @property
    def trials(self) -> tuple[Trial, ...]:
        """Trials that count, in order."""
        return tuple(trial for block in self.blocks for trial in block.trials)

    @property
    def order_hash(self) -> str:
        """SHA-256 of all trials in order, practice first."""
        values = [trial.as_dict() for trial in (*self.practice, *self.trials)]
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()

    @property
    def seeds(self) -> dict[str, Any]:
        """What the order was drawn from, and how, for the record."""
        return {
            "algorithm": ALGORITHM,
            "study_seed": self.seed,
            "participant": self.participant,
            "participant_key": f"{key_of(self.participant):064x}",
            "session": self.session,
            "purposes": {purpose: f"{key_of(purpose):064x}" for purpose in self._purposes()},
        }

    def _purposes(self) -> list[str]:
        orders = [_purpose_of_order(block.finger_condition) for block in self.blocks]
        return ["order of finger conditions", "practice", *orders]

    def as_dict(self) -> dict[str, Any]:
        """Return the schedule as plain values for the record."""
        return {
            "order_hash": self.order_hash,
            "seeds": self.seeds,
            "finger_conditions": [block.finger_condition for block in self.blocks],
            "finger_conditions_by": self.finger_conditions_by,
            "n_trials": len(self.trials),
            "n_practice_trials": len(self.practice),
            "practice": [_brief(trial) for trial in self.practice],
            "order": [_brief(trial) for trial in self.trials],
        }


def draw_schedule(protocol: Protocol, participant: str, seed: int, session: int = 1) -> Schedule:
    """Return a participant's schedule; the same arguments give the same schedule.

    Parameters
    ----------
    protocol : Protocol
        The design.
    participant : str
        Identifier of the participant.
    seed : int
        Seed of the study, 0 or above.
    session : int
        Number of the session, from 1; every session has an order of its own.

    Raises
    ------
    ValueError
        If an argument is out of bounds or no order keeps the protocol's limit on runs.
    """
    _check_arguments(participant, seed, session)
    finger_conditions, decided_by = order_finger_conditions(protocol, participant, seed, session)
    blocks: list[Block] = []
    for number, finger_condition in enumerate(finger_conditions, start=1):
        conditions = _draw_block(protocol, finger_condition, participant, seed, session)
        first = sum(len(block.trials) for block in blocks) + 1
        trials = _number(conditions, block=number, first=first, practice=False)
        blocks.append(Block(number, finger_condition, trials))
    stream = Stream(seed, participant, session, "practice")
    practice = _draw_practice(protocol, finger_conditions[0], stream)
    return Schedule(participant, session, seed, practice, tuple(blocks), decided_by)


def order_finger_conditions(
    protocol: Protocol, participant: str, seed: int, session: int
) -> tuple[tuple[str, ...], str]:
    """Return a participant's order of the finger conditions, and what decided it.

    Where the identifier ends in a number, participants take turns: p01 has the protocol's order, p02 the next.
    Other identifiers draw an order. A further session has the next order.
    """
    given: tuple[str, ...] = protocol.conditions.finger_conditions
    if not protocol.schedule.counterbalance_finger_conditions or len(given) == 1:
        return given, "protocol"
    turn, decided_by = turn_of(participant, seed, session)
    orders = list(itertools.permutations(given))
    return orders[turn % len(orders)], decided_by


def turn_of(participant: str, seed: int, session: int) -> tuple[int, str]:
    """Return which of several balanced orders is a participant's, to be taken modulo their number, and why.

    Sessions of one participant take turns too, so nothing is drawn anew for them.
    """
    ending = re.search(r"[0-9]+$", participant)
    if ending is not None:
        return int(ending.group()[-18:]) - 1 + session - 1, "number of the participant"
    stream = Stream(seed, participant, 1, "order of finger conditions")
    return stream.below(2**64) + session - 1, "hash of the participant"


def _check_arguments(participant: str, seed: int, session: int) -> None:
    if not participant:
        raise ValueError("participant is empty; give an identifier such as p01")
    if seed < 0:
        raise ValueError(f"the seed is {seed}; it must be 0 or above")
    if session < 1:
        raise ValueError(f"the session is {session}; sessions count from 1")


def _purpose_of_order(finger_condition: str) -> str:
    return f"order within {finger_condition}"


def _draw_block(
    protocol: Protocol, finger_condition: str, participant: str, seed: int, session: int
) -> list[Condition]:
    stream = Stream(seed, participant, session, _purpose_of_order(finger_condition))
    turn = turn_of(participant, seed, session)[0]
    return [Condition(finger_condition, *pair, level) for pair, level in order_cells(protocol, turn, stream)]


def _draw_practice(protocol: Protocol, finger_condition: str, stream: Stream) -> tuple[Trial, ...]:
    """Return the practice trials: conditions of the first block, none again before all others have come."""
    conditions, n_trials = protocol.conditions, protocol.schedule.practice_trials
    cells = [
        Condition(finger_condition, *pair, level)
        for pair in conditions.zone_pairs
        for level in conditions.peak_velocities_mm_s
    ]
    drawn: list[Condition] = []
    while len(drawn) < n_trials:
        drawn += stream.shuffled(cells)
    return _number(drawn[:n_trials], block=0, first=1, practice=True)


def _number(conditions: Iterable[Condition], *, block: int, first: int, practice: bool) -> tuple[Trial, ...]:
    """Return the conditions as trials; repetitions count in the order of presentation."""
    seen: Counter[Condition] = Counter()
    trials = []
    for index, condition in enumerate(conditions, start=first):
        seen[condition] += 1
        trials.append(Trial(index, block, condition, seen[condition], practice))
    return tuple(trials)


def _brief(trial: Trial) -> list[Any]:
    condition = trial.condition
    return [trial.block, condition.finger_condition, *condition.pair, condition.velocity_mm_s]
