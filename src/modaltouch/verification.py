"""Recomputes a session's order and drive from its own record, and checks its chain and its BIDS view."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from modaltouch.adaptive import Levels
from modaltouch.allotment import recorded_turn
from modaltouch.preflight import examine_findings
from modaltouch.protocol import Sources, examine_sources, restore_experiment
from modaltouch.record.chain import read_chain
from modaltouch.record.folders import find_log, locate
from modaltouch.record.session import Session
from modaltouch.record.shape import check_shape
from modaltouch.record.view import table_text
from modaltouch.schedule import draw_schedule
from modaltouch.trial import Trial


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
    lines: list[str] = []
    problems = list(chain.problems)
    shape = check_shape(chain.events, str(log), to_repeat=True)
    if shape:
        return Verdict(log, (), (*problems, *shape))
    if not problems:
        lines.append(f"{len(chain.events)} lines, each continuing the one before")
    if not session.start:
        return Verdict(log, tuple(lines), (*problems, f"{log}: has no start record"))
    checks = [_check_order, _check_drive]
    if session.start.get("adaptive"):
        checks.append(_check_levels)
    if session.start.get("sensation_levels"):
        checks.append(_check_own_levels)
    for check in checks:
        holds, line = check(session)
        (lines if holds else problems).append(line)
    line, faults = _check_view(session, chain.checks)
    lines += [line] if line else []
    problems += faults
    lines.append(_completeness(session))
    return Verdict(log, tuple(lines), tuple(problems))


def _check_order(session: Session) -> tuple[bool, str]:
    start = session.start
    protocol = restore_experiment(Sources.from_dict(start["sources"])).protocol
    if own := start.get("sensation_levels"):
        protocol = protocol.with_levels(tuple(own["levels_mm_s"]))
    schedule = draw_schedule(
        protocol, start["participant"], start["seed"], session.drawn_as, given=recorded_turn(start)
    )
    if schedule.as_dict() == start["schedule"]:
        return True, f"order of {len(schedule.trials)} trials drawn again from seed {start['seed']}: the same"
    return False, f"{session.path}: seed {start['seed']} draws another order than the recorded one"


def _check_drive(session: Session) -> tuple[bool, str]:
    preflight = examine_findings(examine_sources(Sources.from_dict(session.start["sources"]))).require()
    found, recorded = preflight.stimulus.burst.content_hash, session.start["stimulus"]["content_hash"]
    hashes = session.start["stimulus"].get("content_hashes")
    if found == recorded and (hashes is None or hashes == preflight.content_hashes):
        words = f"drives of {len(hashes)} stimuli" if hashes else "drive"
        return True, f"{words} computed again: the same codes ({found[:12]})"
    return (
        False,
        f"{session.path}: the drive computed again has the hash {found[:12]}, the record says {recorded[:12]}",
    )


def _check_levels(session: Session) -> tuple[bool, str]:
    """Return whether the answers lead to the levels that were presented."""
    levels = Levels(restore_experiment(Sources.from_dict(session.start["sources"])).protocol)
    lines, n_driven = [event["n"] for event in session.trials], 0
    for place, event in enumerate(session.events):
        if event["n"] not in lines:
            continue
        trial = Trial.from_dict(event["trial"])
        # What counted by then: an answer may have been replaced since, at the experimenter's wish.
        before = Session(session.path, session.events[:place], ()).trials
        found = levels.settle(trial, before).condition.velocity_mm_s
        if found != trial.condition.velocity_mm_s:
            return False, (
                f"{session.path}: the answers before trial {trial.index} lead to {found:g} mm/s, the record says "
                f"{trial.condition.velocity_mm_s:g} mm/s"
            )
        n_driven += not (trial.practice or trial.condition.is_catch)
    return True, f"levels of {n_driven} trials follow from the answers before them"


def _check_own_levels(session: Session) -> tuple[bool, str]:
    """Return whether the levels follow from the participant's threshold, and that from the session that found it."""
    own = session.start["sensation_levels"]
    section = restore_experiment(Sources.from_dict(session.start["sources"])).protocol.conditions.sensation_levels
    threshold = f"threshold of {own['threshold_mm_s']:g} mm/s"
    if section is None or list(section.levels(own["threshold_mm_s"])) != own["levels_mm_s"]:
        return False, f"{session.path}: its levels do not follow from the {threshold}"
    if own["found"] != "session":
        return True, f"levels follow from the {threshold}, as it was given"
    place = locate(session.path, session.mode, session.protocol)
    log = place.results / own["session"]
    if not log.exists():
        return True, f"levels follow from the {threshold}; {log}, which found it, is not here"
    if read_chain(log).last_check != own["last_check"]:
        return False, f"{log}: has changed since the {threshold} was taken from it"
    return True, f"levels follow from the {threshold}, found in {own['session']}"


def _completeness(session: Session) -> str:
    if session.complete:
        return "complete"
    if session.begun_anew_as is not None:
        return f"closed and not complete: begun anew as session {session.begun_anew_as}"
    return "not complete: `modaltouch resume` goes on with it; until then the analysis leaves it out"


def _check_view(session: Session, checks: tuple[str, ...]) -> tuple[str, list[str]]:
    """Return what holds of the view, in words, and what does not."""
    tables = sorted(session.path.parent.glob("*_beh.tsv"))
    if len(tables) != 1:
        return "", [f"{session.path.parent}: holds {len(tables)} BIDS tables (*_beh.tsv), exactly one is needed"]
    table, side = tables[0], tables[0].with_suffix(".json")
    try:
        head = json.loads(side.read_text(encoding="utf-8"))["SessionLog"]
        text = table.read_text(encoding="utf-8")
    except (OSError, ValueError, KeyError, TypeError) as error:
        return "", [f"{table}: the BIDS view cannot be read ({error})"]
    if head["lines"] > len(checks):
        return "", [
            f"{session.path}: the BIDS view was made from {head['lines']} lines, the log has {len(checks)}: "
            "lines were removed from its end"
        ]
    if head["lines"] and checks[head["lines"] - 1] != head["check"]:
        return "", [f"{side}: was made from another log"]
    # The table is replaced before its side file: after a kill between the two it is of a later line.
    made_from = (Session(session.path, session.events[:n], ()) for n in range(head["lines"], len(checks) + 1))
    shown, n_shown = next(
        ((each, n) for n, each in enumerate(made_from, head["lines"]) if text == table_text(each)), (None, 0)
    )
    if shown is None:
        return "", [f"{table}: differs from what the log says; the log is the truth"]
    if session.trials != shown.trials:
        behind = len(checks) - n_shown
        return f"BIDS view agrees, {behind} lines behind the log: `modaltouch resume` brings it up", []
    return f"BIDS view agrees: {len(session.trials)} answers, practice included", []
