"""A session checked against its own start record: what was presented, in which order, at which level, and when.

``restored``   the experiment made again from the record's own texts
``beginning``  order, codes and levels of the start record
``course``     each line against those before it
``presented``  level, amplitudes, speeds, bursts and instants of one trial
``view``       the BIDS view against the log
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from modaltouch.protocol import InputError, Sources
from modaltouch.record.audit.experiment import UNTOLD, restore
from modaltouch.record.audit.presentation import TrialExpectation
from modaltouch.record.audit.sequence import EventSequence
from modaltouch.record.audit.start import check_beginning, draw_again, levels_of
from modaltouch.record.audit.view import check_view
from modaltouch.record.chain import Chain, RecordError, read_chain
from modaltouch.record.session import Session
from modaltouch.record.shape import check_shape


@dataclass(frozen=True)
class Audit:
    """What came of the check of a session against itself.

    Attributes
    ----------
    lines : tuple of str
        What holds, in words.
    problems : tuple of str
        What does not, each with its file and line; empty for a sound session.
    to_mend : tuple of str
        Those of the problems that an interruption leaves behind and `resume` mends: a last line that was cut, a BIDS
        view that was not written.
    """

    lines: tuple[str, ...]
    problems: tuple[str, ...]
    to_mend: tuple[str, ...] = ()


def audit_session(session: Session, chain: Chain) -> Audit:
    """Return whether a session is what its own start record makes of it.

    Parameters
    ----------
    session : Session
        As its log tells it, with what is wrong with the file.
    chain : Chain
        The lines of that log.
    """
    shape = check_shape(session.events, str(session.path), to_repeat=True)
    problems = list(dict.fromkeys((*session.problems, *shape)))
    place = f"{session.path}:1:"
    if shape or not session.start:
        return Audit((), (*problems, *(() if session.start else (f"{place} is no start record",))))
    lines = [] if problems else [f"{len(session.events)} lines, each continuing the one before"]
    try:
        restored = restore(Sources.from_dict(session.start["sources"]))
        protocol = levels_of(restored.protocol, session.start)
        schedule = draw_again(session, protocol)
        checked = [each for each in check_beginning(session, restored, protocol, schedule) if each[1]]
        lines += [said for holds, said in checked if holds]
        problems += [said for holds, said in checked if not holds]
        course = EventSequence(session, TrialExpectation(restored, protocol, session.start.get("schema", 1)), schedule)
        course.walk()
        problems += course.problems
        lines += course.lines
        seen = check_view(session, chain.checks, is_cut=bool(chain.torn))
    except InputError as error:
        return Audit((), (*problems, f"{place} its files do not hold: {error}"))
    except RecordError as error:
        return Audit((), (*problems, str(error)))
    except UNTOLD as error:
        said = f"does not say what its order and drive follow from ({type(error).__name__}: {error})"
        return Audit((), (*problems, f"{place} {said}"))
    cut = () if chain.damage else chain.problems
    mendable = (seen.problem,) if seen.is_mendable else ()
    lines += [seen.line] if seen.line else []
    problems += [seen.problem] if seen.problem else []
    return Audit(tuple(lines), tuple(problems), (*cut, *mendable))


def require_sound(log: Path) -> Session:
    """Return a session that may go on: nothing is wrong with it but what going on mends.

    Parameters
    ----------
    log : Path
        Its log.

    Raises
    ------
    RecordError
        With what `modaltouch verify` says against it.
    """
    chain = read_chain(log)
    session = Session(log, chain.events, chain.problems)
    found = audit_session(session, chain)
    if faults := [each for each in found.problems if each not in found.to_mend]:
        raise RecordError("\n".join(faults))
    return session
