"""A tree of recorded sessions -> answers, with every session that stays out named with its reason.

Modes and protocols are never mixed: real, pilot and simulated sessions answer different questions, and so do
two designs.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from modaltouch.analysis.balance import answers_per_cell, describe_cell
from modaltouch.analysis.mirroring import unmirror
from modaltouch.analysis.responses import LeftOut, Responses, Source
from modaltouch.document import InputError, Problem
from modaltouch.record.chain import RecordError
from modaltouch.record.folders import LOG_NAME
from modaltouch.record.log import Session, read_session
from modaltouch.trial import ANSWERS

MODES = ("real", "pilot", "simulated")


@dataclass(frozen=True)
class Found:
    """A session of the tree.

    Attributes
    ----------
    path : Path
        Its log.
    session : Session or None
        What the log tells; none where it cannot be read.
    reason : str
        Why it stays out; empty if it is analysed.
    """

    path: Path
    session: Session | None
    reason: str = ""


def read_tree(place: Path, mode: str | None = None) -> Responses:
    """Return the answers of the complete, sound sessions in a folder.

    Parameters
    ----------
    place : Path
        A results folder, a folder in it, or one session log.
    mode : {"real", "pilot", "simulated"}, optional
        Which sessions to take; by default the real ones, and where there are none the only kind there is.

    Raises
    ------
    InputError
        If there is no session to analyse, or the folder mixes modes or protocols without a choice.
    """
    if mode is not None and mode not in MODES:
        _refuse(place, f"mode {mode!r}", ", ".join(MODES), "choose one of them")
    found = [_open(path) for path in find_logs(place)]
    if not found:
        remedy = f"give the folder that `modaltouch run` wrote to; it holds files named {LOG_NAME}"
        _refuse(place, "a folder without a recorded session", "a results folder", remedy)
    chosen = mode or _choose_mode(place, found)
    found = [_mark(item, _other_mode(item, chosen)) for item in found]
    _refuse_protocols(place, [item.session for item in found if item.session and not item.reason])
    found = [_mark(item, _unfit(item)) for item in found]
    found = _even_out(found)
    left_out = tuple(LeftOut(str(item.path.parent), item.reason) for item in found if item.reason)
    sessions = tuple(item.session for item in found if item.session and not item.reason)
    if not sessions:
        counted = Counter(item.reason for item in left_out)
        listed = "; ".join(f"{n} {reason}" for reason, n in counted.most_common(5))
        remedy = "finish one with `modaltouch resume`, or choose another mode or folder"
        _refuse(place, f"no session that can be analysed ({listed})", "at least one complete session", remedy)
    frame = unmirror(pd.DataFrame([row for session in sessions for row in session_rows(session)]))
    _refuse_designs(place, frame)
    frame["response"] = pd.Categorical(frame["response"], categories=list(ANSWERS))
    digest = hashlib.sha256("".join(_digest(session.path) for session in sessions).encode()).hexdigest()
    focus = str(sessions[0].start.get("design", {}).get("stimulus", {}).get("focus", ""))
    return Responses(frame, sessions, left_out, Source(str(place), "results", digest, chosen), focus)


def find_logs(place: Path) -> list[Path]:
    """Return the session logs under a folder, in order of their names.

    Parameters
    ----------
    place : Path
        A folder, or one log.
    """
    return [place] if place.is_file() else sorted(place.rglob(LOG_NAME))


def session_rows(session: Session) -> list[dict[str, Any]]:
    """Return the answers of a session that count, practice left out, as tidy rows.

    Parameters
    ----------
    session : Session
        A sound session.
    """
    return [_row(session, event) for event in session.trials if not event["trial"]["practice"]]


def _row(session: Session, event: dict[str, Any]) -> dict[str, Any]:
    trial, response, planned = event["trial"], event["response"], event.get("planned", {})
    condition = trial["condition"]
    return {
        "participant": session.participant,
        "finger_condition": condition["finger_condition"],
        "zone_left": condition["zone_left"],
        "zone_right": condition["zone_right"],
        "velocity_mm_s": float(condition["velocity_mm_s"]),
        "placement": condition.get("placement", "normal"),
        "response": response["answer"],
        "n": 1,
        "repetition": trial["repetition"],
        "session": session.start.get("session", 1),
        "trial": float(trial["index"]),
        "block": float(trial["block"]),
        "response_time": float(response["reaction_time"]),
        "response_onset": response.get("onset", ""),
        "answered_by": response.get("answered_by", ""),
        "double": bool(response.get("double", False)),
        "speed_left_mm_s": float(planned.get("speed_left_mm_s", float("nan"))),
        "speed_right_mm_s": float(planned.get("speed_right_mm_s", float("nan"))),
        "confirmed": bool(event.get("confirmed", {}).get("confirmed", False)),
    }


def _open(path: Path) -> Found:
    try:
        session = read_session(path)
    except RecordError as error:
        return Found(path, None, f"unreadable: {error}")
    if not session.start:
        return Found(path, None, f"damaged: {session.problems[0]}" if session.problems else "cut before it began")
    return Found(path, session)


def _mark(item: Found, reason: str) -> Found:
    return item if item.reason or not reason else Found(item.path, item.session, reason)


def _choose_mode(place: Path, found: Sequence[Found]) -> str:
    counted = Counter(item.session.mode for item in found if item.session)
    if "real" in counted or not counted:
        return "real"
    if len(counted) > 1:
        listed = ", ".join(f"{n} {mode}" for mode, n in counted.most_common())
        remedy = "choose with --mode, or give the folder of one of them"
        _refuse(place, f"sessions of several modes ({listed})", "sessions of one mode", remedy)
    return next(iter(counted))


def _other_mode(item: Found, chosen: str) -> str:
    if item.session is None or item.session.mode == chosen:
        return ""
    return f"{item.session.mode}, not {chosen} (choose with --mode {item.session.mode})"


def _refuse_protocols(place: Path, sessions: Sequence[Session]) -> None:
    names = Counter(session.protocol for session in sessions)
    if len(names) > 1:
        listed = ", ".join(f"{n} of {name!r}" for name, n in names.most_common())
        _refuse(place, f"sessions of several protocols ({listed})", "one protocol", "give the folder of one of them")


def _refuse_designs(place: Path, frame: pd.DataFrame) -> None:
    """Refuse participants who met different conditions, as under two versions of a protocol."""
    answers = answers_per_cell(frame)
    usual = int(answers.to_numpy().max())
    odd = answers.index[(answers != usual).any(axis=1)]
    if not len(odd):
        return
    cells = answers.columns[(answers.loc[odd[0]] != usual).to_numpy()]
    shown = f"{odd[0]} has {answers.loc[odd[0], cells[0]]} in {describe_cell(cells[0])}, others up to {usual}"
    given = f"participants who answered different conditions ({len(odd)} of {len(answers)}; {shown})"
    remedy = "give a folder with the sessions of one version of the protocol; adaptive runs have no table of counts"
    _refuse(place, given, "the same conditions, equally often, for every participant", remedy)


def _unfit(item: Found) -> str:
    session = item.session
    if session is None:
        return ""
    if session.problems:
        return f"damaged: {session.problems[0]}"
    if not session.complete:
        total = session.start.get("schedule", {}).get("n_trials", 0)
        return f"incomplete: {session.n_answered} of {total} trials answered (go on with `modaltouch resume`)"
    return ""


def _even_out(found: Sequence[Found]) -> list[Found]:
    """Keep as many sessions of every participant as the one with fewest has."""
    usable = Counter(item.session.participant for item in found if item.session and not item.reason)
    fewest = min(usable.values(), default=0)
    taken: Counter[str] = Counter()
    evened = []
    for item in found:
        if item.session and not item.reason:
            taken[item.session.participant] += 1
            if taken[item.session.participant] > fewest:
                item = _mark(item, f"session beyond the first {fewest}: not every participant has as many")
        evened.append(item)
    return evened


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _refuse(place: Path, given: str, allowed: str, remedy: str) -> None:
    raise InputError([Problem(str(place), 1, 1, "", given, allowed, remedy)])
