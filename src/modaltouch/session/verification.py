"""Says in words whether a session is what its own record makes of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from modaltouch.record import Session, audit_session, find_log, read_chain


@dataclass(frozen=True)
class Verdict:
    """What a verification found.

    Attributes
    ----------
    path : Path
        The session log.
    lines : tuple of str
        What was checked and holds, in words.
    problems : tuple of str
        What does not hold; empty for a sound session.
    """

    path: Path
    lines: tuple[str, ...]
    problems: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict as plain values."""
        return {
            "session": str(self.path),
            "sound": not self.problems,
            "checked": list(self.lines),
            "problems": list(self.problems),
        }


def verify_session(path: Path) -> Verdict:
    """Check a session's record against itself.

    Parameters
    ----------
    path : Path
        A session's folder or its ``session.jsonl``.

    Raises
    ------
    RecordError
        If there is no such session.
    """
    log = find_log(path)
    chain = read_chain(log)
    session = Session(log, chain.events, chain.problems)
    found = audit_session(session, chain)
    if not found.lines:  # nothing is known of such a session
        return Verdict(log, (), found.problems)
    return Verdict(log, (*found.lines, _completeness(session)), found.problems)


def _completeness(session: Session) -> str:
    if session.complete:
        return "complete"
    if session.begun_anew_as is not None:
        return f"closed and not complete: begun anew as session {session.begun_anew_as}"
    return "not complete: `modaltouch resume` goes on with it; until then the analysis leaves it out"
