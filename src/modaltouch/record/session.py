"""A session as its log tells it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from modaltouch.record.chain import read_chain
from modaltouch.record.shape import check_shape


@dataclass(frozen=True)
class Session:
    """A session as its log tells it.

    Attributes
    ----------
    path : Path
        The log.
    events : tuple of dict
        Its sound lines.
    problems : tuple of str
        What is wrong with the file; empty for an intact one.
    """

    path: Path
    events: tuple[dict[str, Any], ...]
    problems: tuple[str, ...]

    @cached_property
    def start(self) -> dict[str, Any]:
        """The start record; empty if the session was cut before it."""
        return self.events[0] if self.events and self.events[0].get("event") == "start" else {}

    @property
    def mode(self) -> str:
        """``real``, ``pilot`` or ``simulated``."""
        return str(self.start.get("mode", "unknown"))

    @property
    def participant(self) -> str:
        """Participant id."""
        return str(self.start.get("participant", ""))

    @property
    def protocol(self) -> str:
        """Name of the protocol."""
        return str(self.start.get("protocol", ""))

    @property
    def drawn_as(self) -> int:
        """Number of the session whose order this one has: its own, or that of the session it began anew."""
        own = self.start.get("session", 1)
        return int(self.start.get("schedule", {}).get("seeds", {}).get("session", own))

    @property
    def begun_anew_as(self) -> int | None:
        """Number of the session that began this one anew; None if this one may go on."""
        closed = [event["begun_anew_as"] for event in self.events if event.get("event") == "closed"]
        return int(closed[-1]) if closed else None

    @property
    def multiples(self) -> dict[float, float]:
        """What multiple of the participant's own threshold each level [mm/s] is; empty where levels are not so."""
        own = self.start.get("sensation_levels") or {"levels_mm_s": (), "multiples": ()}
        return dict(zip(own["levels_mm_s"], own["multiples"], strict=True))

    @cached_property
    def trials(self) -> tuple[dict[str, Any], ...]:
        """The trial events that count: answered, not superseded by a later one, and not to be asked again."""
        superseded = {event["supersedes"] for event in self.events if event.get("supersedes")}
        withdrawn = {line for event in self.events if event.get("event") == "withdrawn" for line in event["lines"]}
        # An answer is written down at once, and again once the end of its stimulus is confirmed.
        confirmed = {event.get("answered") for event in self.events if event.get("event") == "trial"}
        gone = superseded | withdrawn | confirmed
        return tuple(
            event for event in self.events if event.get("event") in ("trial", "answered") and event["n"] not in gone
        )

    @cached_property
    def answered(self) -> frozenset[tuple[bool, int]]:
        """Which trials are done, as (practice, index): answered, and the stimulus confirmed by the instrument."""
        return frozenset(
            (event["trial"]["practice"], event["trial"]["index"])
            for event in self.trials
            if event["confirmed"]["confirmed"]
        )

    @property
    def n_answered(self) -> int:
        """Number of trials answered, practice not counted."""
        return sum(not practice for practice, _ in self.answered)

    @property
    def complete(self) -> bool:
        """Whether every scheduled trial is answered, practice not counted."""
        return bool(self.start) and self.n_answered >= self.start["schedule"]["n_trials"]


def read_session(path: Path) -> Session:
    """Return a session from its log.

    Parameters
    ----------
    path : Path
        A ``session.jsonl``.

    Raises
    ------
    RecordError
        If the file cannot be read.
    """
    chain = read_chain(path)
    return Session(path, chain.events, (*chain.problems, *check_shape(chain.events, str(path))))
