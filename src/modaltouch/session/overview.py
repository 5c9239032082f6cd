"""Overview of a study: the sessions of a results tree, the balance of orders, and the next sessions.

Records are checked as by `modaltouch verify`, so that the reasons for exclusion are those of the analysis.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from itertools import count, pairwise
from pathlib import Path
from typing import Any

from modaltouch.protocol import Findings, InputError, Protocol, Sources, Turn
from modaltouch.record import RecordError, Session, SessionFolder, audit_session, read_session
from modaltouch.session.assignment import assign_group, assign_turn, first_turn, propose_participant


def survey_results(place: Path, on_progress: Callable[[int, int], None] | None = None) -> list[dict[str, Any]]:
    """Survey a results tree, and return plain values for each dataset (one protocol in one mode).

    Parameters
    ----------
    place : Path
        A results folder, or a folder in it.
    on_progress : callable, optional
        Called with the numbers of sessions read and to be read, since checking measured fingers takes seconds each.

    Raises
    ------
    InputError
        If it contains no session.
    """
    logs = SessionFolder.logs_under(place)
    datasets: dict[Path, list[Path]] = defaultdict(list)
    for log in (log if len(log.parts) > 4 else log.absolute() for log in logs):
        datasets[Path(*log.parts[:-4])].append(log)
    n_read = count(1)

    def survey_session(log: Path) -> tuple[dict[str, Any], Session]:
        found = _survey_session(log)
        if on_progress is not None:
            on_progress(next(n_read), len(logs))
        return found

    return [_survey_dataset(dataset, each, survey_session) for dataset, each in datasets.items()]


def _survey_dataset(
    dataset: Path, logs: list[Path], survey_session: Callable[[Path], tuple[dict[str, Any], Session]]
) -> dict[str, Any]:
    rows: list[dict[str, Any]] = []
    begun: dict[str, Session] = {}  # the start of each participant's first session
    for log in sorted(logs, key=lambda log: (log.parts[:-3], SessionFolder.number_of(log))):
        row, session = survey_session(log)
        rows.append(row)
        if session.start:
            begun.setdefault(row["participant"], Session(log, session.events[:1]))  # lets go of the rest
    latest = max(begun.values(), key=lambda each: str(each.start.get("time", "")), default=Session(logs[0], ()))
    survey: dict[str, Any] = {
        "folder": str(dataset),
        "protocol": latest.protocol,
        "title": "",
        "mode": latest.mode,
        "n_participants": len({row["participant"] for row in rows}),
        "sessions_each": None,
        "sessions": rows,
        "orders": [],
        "next": [],
        "notes": [],
    }
    try:
        survey["title"] = str(latest.start.get("design", {}).get("title", ""))
        return survey | _plan(dataset, rows, begun, latest) | {"notes": _notes(begun, rows)}
    except (InputError, RecordError, LookupError, AttributeError, TypeError, ValueError) as error:
        is_told = isinstance(error, (InputError, RecordError))
        why = error if is_told else "the start record of the latest session is missing or incomplete"
        return survey | {"notes": [f"orders and next sessions are not known: {why}"]}


def _plan(dataset: Path, rows: list[dict[str, Any]], begun: dict[str, Session], latest: Session) -> dict[str, Any]:
    """Return the sessions for each participant, the balance of orders, and the next sessions."""
    ends = {row["participant"]: row["ended"] for row in rows}
    protocol = _protocol_of(latest, *latest.occasion)
    schedule, seed = protocol.schedule, int(latest.start["seed"])
    new = SessionFolder(dataset.parent, "real", dataset.name, propose_participant(dataset))  # in any mode
    group, _ = assign_group(new, protocol, seed)
    due = [each for name in ends if (each := _next_of(name, rows, schedule.n_sessions))]
    due.append({"participant": new.participant, "session": 1, "do": "run", "nth": 1})
    own = {name: session.occasion[0] for name, session in begun.items()} | {new.participant: group}
    named = list(dict.fromkeys(kind.name for kind in schedule.session_kinds)) or [""]
    # A record contains only the table of its group.
    of_group = {session.occasion[0]: session for session in begun.values()}
    protocols = {
        (name, kind): _protocol_of(of_group.get(name, latest), name, kind)
        for name in sorted(set(own.values()) | set(protocol.groups)) or [""]
        for kind in named
    }
    turns = {name: first_turn(each, protocols[own[name], named[0]]) for name, each in begun.items()}
    if schedule.balance == "least_filled":
        turns[new.participant] = assign_turn(new, protocols[group, named[0]], 1, group)[0].number
    else:
        turns[new.participant] = Turn.of(new.participant, seed, 1, protocol.groups).number
    for each in due:
        who, nth = each["participant"], each.pop("nth")
        if who not in turns:
            continue
        kind = schedule.kind_of(nth)
        name, gap = ("", None) if kind is None else (kind.name, kind.min_gap_days)
        each |= _named(own[who], name) | _order(Turn(turns[who] + nth - 1, ""), protocols[own[who], name])
        if gap and nth > 1 and each["do"] == "run" and (ended := ends.get(who)):
            each["from"] = (datetime.fromisoformat(ended) + timedelta(days=gap)).isoformat(timespec="minutes")
    once = {who: [("", turns[who], row["state"])] for row in rows if (who := row["participant"]) in turns}
    had = _turns_had(turns, rows) if schedule.session_kinds else once
    orders = [
        _named(name, kind) | row
        for name in dict.fromkeys([*protocol.groups, *own.values()])
        for kind in named
        for row in _balance(
            protocols[name, kind],
            [each[1:] for who in begun if own[who] == name for each in had[who] if each[0] == kind],
        )
    ]
    return {"sessions_each": schedule.n_sessions, "orders": orders, "next": due}


def _protocol_of(session: Session, group: str, kind: str) -> Protocol:
    """Return the protocol in the record of a session, for a group and a kind of session."""
    return Findings.restored(Sources.recorded(session.start), (group, kind)).experiment().protocol


def _named(group: str, kind: str = "") -> dict[str, str]:
    """Return group and kind of session by name, if any."""
    return {name: own for name, own in (("group", group), ("session_kind", kind)) if own}


def _survey_session(log: Path) -> tuple[dict[str, Any], Session]:
    """Return the row of a session and the session, without events if its log cannot be read."""
    try:
        session = read_session(log)
        audit = audit_session(session)
        problems, damage = audit.problems, [each for each in audit.problems if each not in audit.to_mend]
    except RecordError as error:
        session, problems, damage = Session(log, ()), (str(error),), [str(error)]
    state, why = ("damaged", damage[0]) if damage else _state(session)
    schedule = {} if damage else session.start["schedule"]
    sittings = _sittings(session)
    row = {
        "participant": log.parts[-4:][0].removeprefix("sub-"),
        "session": SessionFolder.number_of(log),
        **(_named(*session.occasion) if isinstance(session.start.get("schedule"), dict) else {}),
        "begun": session.start.get("time"),
        "ended": session.ended,
        "duration_min": round(sum(sittings) / 60, 1),
        "n_sittings": len(sittings),
        "n_answered": None if damage else session.n_answered,
        "n_trials": schedule.get("n_trials"),
        "state": state,
        "why": why,
        "excluded": f"damaged: {problems[0]}" if problems else session.unfit,
        "finger_conditions": schedule.get("finger_conditions", []),
        "log": str(log),
    }
    return row, session


def _state(session: Session) -> tuple[str, str]:
    last, anew = session.events[-1], session.started_over_as
    known = (
        (session.complete, "complete", ""),
        (session.is_running, "running", ""),
        (anew is not None, "closed", f"started over as session {anew}"),
        (True, "interrupted", str(last.get("reason", "")) if last["event"] == "stop" else "killed"),
    )
    return next((state, why) for holds, state, why in known if holds)


def _sittings(session: Session) -> list[float]:
    """Return the duration of each sitting of a session [s]; a reboot resets the clock."""
    begins = [place for place, event in enumerate(session.events) if event.get("event") in ("start", "resume")]
    parts = (session.events[begin:end] for begin, end in pairwise([*begins, None]))
    read = ([e.get("clock") for e in part if e.get("event") not in Session.REPAIRS] for part in parts)
    clocks = ([clock for clock in each if isinstance(clock, (int, float))] for each in read)
    return [each[-1] - each[0] if each else 0.0 for each in clocks]


def _next_of(participant: str, rows: list[dict[str, Any]], n_each: int) -> dict[str, Any] | None:
    """Return a participant's next step; None after the last session or during a session."""
    own = [row for row in rows if row["participant"] == participant]
    held, last = sum(row["state"] != "closed" for row in own), own[-1]
    to_mend = last["state"] == "complete" and last["excluded"].startswith("damaged")
    if to_mend or last["state"] in ("damaged", "interrupted", "closed"):
        do = "verify" if last["state"] == "damaged" else "resume"
        nth = held + (last["state"] == "closed")
        return {"participant": participant, "session": last["session"], "do": do, "nth": nth, "log": last["log"]}
    if last["state"] == "running" or held >= n_each:
        return None
    return {"participant": participant, "session": last["session"] + 1, "do": "run", "nth": held + 1}


def _order(turn: Turn, protocol: Protocol) -> dict[str, Any]:
    finger_conditions, placement = turn.order(protocol)
    return {"finger_conditions": list(finger_conditions), "placement": placement}


def _balance(protocol: Protocol, turns: list[tuple[int, str]]) -> list[dict[str, Any]]:
    """Return the number of participants with each order and placement, and the number missing for balance.

    `turns` contains pairs of a turn and the state of its session, counted as in `assignment.assign_turn`.
    """
    n_turns = Turn.period(protocol)
    # The rows of a Latin square repeat before the turns do.
    first_like = dict[object, int]()
    alike = [first_like.setdefault(Turn(number, "").balanced(protocol), number) for number in range(n_turns)]
    filled = Counter(alike[turn % n_turns] for turn, state in turns if state in ("complete", "running"))
    left = Counter(alike[turn % n_turns] for turn, state in turns if state not in ("complete", "running"))
    most = max(filled.values(), default=1)
    by_order: dict[str, list[int]] = defaultdict(list)
    for number in first_like.values():
        by_order[str(Turn(number, "").order(protocol))].append(number)
    return [
        _order(Turn(own[0], ""), protocol)
        | {
            "n_turns": len(own),
            "filled": sum(filled[number] for number in own),
            "left_incomplete": sum(left[number] for number in own),
            "open": sum(most - filled[number] for number in own),
        }
        for own in by_order.values()
    ]


def _turns_had(turns: dict[str, int], rows: list[dict[str, Any]]) -> dict[str, list[tuple[str, int, str]]]:
    """Return kind, turn and state of each participant's sessions, without restarted ones."""
    had: dict[str, list[tuple[str, int, str]]] = defaultdict(list)
    for row in rows:
        if row["state"] != "closed" and (who := row["participant"]) in turns:
            had[who].append((row.get("session_kind", ""), turns[who] + len(had[who]), row["state"]))
    return had


def _notes(begun: dict[str, Session], rows: list[dict[str, Any]]) -> list[str]:
    """Return notes on limitations of an analysis of the current tree."""
    texts = {str(session.start.get("sources", {}).get("protocol", {}).get("sha256")) for session in begun.values()}
    several = f"sessions were begun with {len(texts)} versions of the protocol"
    now = datetime.now(UTC).isoformat()
    ahead = [f"{row['participant']} session {row['session']}" for row in rows if str(row["begun"] or "") > now]
    who = ", ".join(ahead) if len(ahead) < 4 else f"{len(ahead)} sessions"
    wrong = f"{who}: begun later than now, so this computer's clock is wrong, or was then"
    kinds = sorted({f"{session.mode} sessions of {session.protocol}" for session in begun.values()})
    mixed = f"holds {' and '.join(kinds)}, which are counted together here: move them to folders of their own"
    found = (mixed, len(kinds) > 1), (several, len(texts) > 1), (wrong, ahead)
    return [note for note, holds in found if holds]
