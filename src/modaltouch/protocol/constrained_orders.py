"""Orders under several limits at once, each order that keeps them all being as likely as any other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

from modaltouch.protocol.cells import Cell
from modaltouch.protocol.order_limits import LIMITS, NoOrderError
from modaltouch.protocol.orders import draw_order, least_limit
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.streams import Stream

WORK_LIMIT = 300_000
"""Most trials placed in rejected orders before a design is given up: a few seconds."""

DRAWN_LIMIT = 6_000_000
"""Most words of chance drawn for them: where the hardest limit itself is kept by rejection, some ten seconds."""


@dataclass(frozen=True)
class Limit:
    """A limit on what may follow what.

    Attributes
    ----------
    key : str
        Key of the section schedule that sets it.
    kind_of : callable
        What of a cell it is about; None for a cell that it is not about.
    running : int
        Most times running; 1 for a distance.
    distance : int
        Least number of trials from one of a kind to the next; 1 for none.
    """

    key: str
    kind_of: Callable[[Cell], object]
    running: int
    distance: int = 1

    def holds(self, order: Sequence[Cell]) -> bool:
        """Return whether an order keeps it."""
        last: dict[object, int] = {}
        for place, cell in enumerate(order):
            if self.distance > 1 and place - last.get(cell, -self.distance) < self.distance:
                return False
            last[cell] = place
        if self.distance > 1:
            return True
        runs = ((kind, len(list(run))) for kind, run in groupby(order, self.kind_of))
        return all(kind is None or n <= self.running for kind, n in runs)

    def refuse_impossible(self, cells: Sequence[Cell]) -> None:
        """Raise NoOrderError where no order of these cells keeps it."""
        counts = Counter(self.kind_of(cell) for cell in cells)
        n_free = counts.pop(None, 0)
        most = max(counts.values(), default=0)
        if self.distance > 1 and most > 1:
            farthest = (len(cells) - list(counts.values()).count(most)) // (most - 1)
            if self.distance > farthest:
                said = f"{most} of {len(cells)} trials are of one cell; the largest that works is {farthest}"
                raise NoOrderError(f"schedule.{self.key} is {self.distance}, but {said}", self.key)
        elif self.distance == 1 and most:
            least = least_limit([*counts.values(), *[1] * n_free])
            if self.running < least:
                said = f"{most} of {len(cells)} trials are alike in this; the least that works is {least}"
                raise NoOrderError(f"schedule.{self.key} is {self.running}, but {said}", self.key)

    def frequency(self, cells: Sequence[Cell]) -> float:
        """Return about how often it is broken in an order drawn without it; 0 where it cannot be kept by drawing."""
        counts = Counter(self.kind_of(cell) for cell in cells)
        if None in counts:
            return 0.0
        # Runs that are too long, each counted where it begins.
        return sum(n * (n / len(cells)) ** self.running * (1 - n / len(cells)) for n in counts.values())


def limits_of(protocol: Protocol) -> list[Limit]:
    """Return the limits of a protocol on its shuffled orders."""

    def side(cell: Cell) -> int | None:
        focus = protocol.stimulus_of(cell[2]).focus
        return cell[0].index(focus) if focus in cell[0] else None

    kinds: dict[str, Callable[[Cell], object]] = {
        "max_same_pair_running": lambda cell: cell[0],
        "max_same_level_running": lambda cell: cell[1],
        "max_same_stimulus_running": lambda cell: cell[2],
        "max_same_side_running": side,
    }
    given = {key: getattr(protocol.schedule, key) for key in LIMITS}
    limits = [Limit(key, kind_of, given[key]) for key, kind_of in kinds.items() if given[key] is not None]
    distance = given["min_same_cell_distance"]
    return [*limits, *([Limit("min_same_cell_distance", lambda cell: cell, 1, distance)] if distance else [])]


def draw_constrained(cells: Sequence[Cell], limits: Sequence[Limit], stream: Stream, effort: float = 1.0) -> list[Cell]:
    """Return the first order that keeps all limits, of many drawn uniformly among those that keep the hardest one.

    Parameters
    ----------
    cells, limits, stream
        What is ordered, what is to be kept, and where chance comes from.
    effort : float
        Share of the usual work after which a design is given up [1].

    Raises
    ------
    NoOrderError
        If no order keeps one of them, or those that keep all are too rare to be found.
    """
    for limit in limits:
        limit.refuse_impossible(cells)
    hardest = max(limits, key=lambda limit: limit.frequency(cells))
    exact = hardest.frequency(cells) > 0
    kinds: dict[object, list[Cell]] = {}
    for cell in cells:
        kinds.setdefault(hardest.kind_of(cell) if exact else None, []).append(cell)
    own, broken, begun = list(kinds.values()), Counter[str](), stream.n_drawn
    while broken.total() * len(cells) < WORK_LIMIT * effort and stream.n_drawn - begun < DRAWN_LIMIT * effort:
        order = draw_order(list(map(len, own)), hardest.running if exact else None, stream, hardest.key)
        waiting = [stream.shuffled(each) for each in own]
        drawn = [waiting[kind].pop() for kind in order]
        unkept = next((limit.key for limit in limits if not limit.holds(drawn)), None)
        if unkept is None:
            return drawn
        broken[unkept] += 1
    worst = broken.most_common(1)[0][0]
    raise NoOrderError(
        f"none of {broken.total()} orders drawn kept {' and '.join(f'schedule.{limit.key}' for limit in limits)} "
        f"together; most broke schedule.{worst}: ease it, or leave one of them out",
        worst,
    )
