"""Audit of a session against its start record (stimuli, order, levels and timing), and of its BIDS view."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from modaltouch.protocol import InputError, Schedule, Sources
from modaltouch.record.chain import RecordError, read_chain
from modaltouch.record.expectation import MALFORMED, SPEED, Expectation, restore
from modaltouch.record.folders import SessionFolder
from modaltouch.record.sequence import EventSequence
from modaltouch.record.session import Session
from modaltouch.record.view import columns_of, form_text, table_text


@dataclass(frozen=True)
class Audit:
    """Result of the audit of a session.

    Attributes
    ----------
    path : Path
        The session log.
    lines : tuple of str
        Sentences on the checks that passed.
    problems : tuple of str
        Problems, each with file and line; empty for a valid session.
    to_mend : tuple of str
        Problems left by an interruption that `resume` repairs: an incomplete last line, an unwritten BIDS view.
    """

    path: Path
    lines: tuple[str, ...]
    problems: tuple[str, ...]
    to_mend: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain values."""
        return {
            "session": str(self.path),
            "sound": not self.problems,
            "checked": list(self.lines),
            "problems": list(self.problems),
        }

    def require(self) -> None:
        """Raise if the session has problems that `resume` does not repair.

        Raises
        ------
        RecordError
            With these problems, as `modaltouch verify` reports them.
        """
        if faults := [each for each in self.problems if each not in self.to_mend]:
            raise RecordError(
                "\n".join([*faults, f"`modaltouch doctor {self.path.parent}` says what can be recovered"])
            )


def audit_session(session: Session) -> Audit:
    """Check a session against its start record.

    Drives for measured fingers are designed again, which takes some tenths of a second for each placement.

    Parameters
    ----------
    session : Session
        The session, as read from its log.
    """
    path, chain, start = session.path, session.chain, session.start
    if session.faults:
        return Audit(path, (), session.problems)
    problems, place = list(chain.problems), f"{path}:1:"
    lines = [] if problems else [f"{len(session.events)} lines, each continuing the one before"]
    try:
        restored = restore(Sources.recorded(start), session.occasion)
        own = start.get("sensation_levels")
        given = Expectation(restored.preflight.with_levels(tuple(own["levels_mm_s"]))) if own else restored
        schedule = Schedule.draw_again(given.protocol, start, session.drawn_as)
        for holds, sentence in check_beginning(session, restored, given, schedule):
            if sentence:
                (lines if holds else problems).append(sentence)
        sequence = EventSequence(session, given, schedule)
        sequence.walk()
        problems += sequence.problems
        lines += sequence.lines
        agrees, differs, is_mendable = check_view(session)
    except RecordError as error:
        return Audit(path, (), (*problems, str(error)))
    except (InputError, *MALFORMED) as error:
        based = f"does not say what its order and drive are based on ({type(error).__name__}: {error})"
        said = f"its files are not valid: {error}" if isinstance(error, InputError) else based
        return Audit(path, (), (*problems, f"{place} {said}"))
    lines += [agrees] if agrees else []
    problems += [differs] if differs else []
    to_mend = (*(() if chain.damage else chain.problems), *([differs] if is_mendable else []))
    audit = Audit(path, tuple(lines), tuple(problems), to_mend)
    return replace(audit, lines=(*lines, _completeness(session, audit))) if lines else audit


def _completeness(session: Session, audit: Audit) -> str:
    if session.complete:
        return "complete"
    if session.is_running:
        return "not complete: another program is running this session now"
    if session.started_over_as is not None:
        return f"closed and not complete: started over as session {session.started_over_as}"
    if not set(audit.problems) <= set(audit.to_mend):
        return "not complete; the analysis leaves it out"  # `modaltouch resume` refuses it, too
    return "not complete: `modaltouch resume` continues it; until then the analysis leaves it out"


def check_beginning(
    session: Session, restored: Expectation, given: Expectation, schedule: Schedule
) -> Iterator[tuple[bool, str]]:
    """Yield whether each check of the start record passed, and a sentence; empty if there is nothing to report.

    `given` is the `restored` experiment at the participant's own levels.
    """
    place = f"{session.path}:1:"
    yield _check_texts(session.start, given, place)
    yield _check_mode(session.start, given, place)
    seed = session.start["seed"]
    if schedule.as_dict() == session.start["schedule"]:
        yield True, f"order of {len(schedule.trials)} trials drawn again from seed {seed}: identical"
    else:
        yield False, f"{place} seed {seed} draws a different order from the recorded one"
    yield _check_drive(session.start, given, place)
    yield _check_shown(session.start, given, place)
    if session.start.get("sensation_levels"):
        yield _check_own_levels(session, restored, place)
    if schedule.session_kind:
        yield _check_gap(session, given, place)


def _check_texts(start: dict[str, Any], given: Expectation, place: str) -> tuple[bool, str]:
    if start["protocol"] != (name := given.protocol.protocol):
        return False, f"{place} is a session of {start['protocol']!r}, but its protocol file is of {name!r}"
    if differing := _first_difference(start["design"], given.protocol.model_dump(mode="json"), start.get("schema", 1)):
        return False, f"{place} its design differs from its protocol file in {differing}"
    return True, ""


def _first_difference(recorded: dict[str, Any], given: dict[str, Any], schema: int) -> str:
    """Return the name of the first section whose values differ, comparing only keys that both have."""
    for name in recorded.keys() & given.keys():
        known, values = recorded[name], given[name]
        if isinstance(known, dict) and isinstance(values, dict):
            # Format 1 recorded the default length of the stimulus if none was given.
            shared = (known.keys() & values.keys()) - ({"presentation_s"} if schema == 1 else set())
            known, values = ({key: each[key] for key in shared} for each in (known, values))
        if known != values:
            return name
    return ""


def _check_mode(start: dict[str, Any], given: Expectation, place: str) -> tuple[bool, str]:
    real = start["rig_choice"] != "simulated" and start["answers_choice"] == "window"
    if start["mode"] == "simulated" or (real and not given.instrument.is_simulated(str(start["rig"]["identity"]))):
        return True, ""
    return False, f"{place} is called a {start['mode']} session, but its rig or its answers were simulated"


def _check_drive(start: dict[str, Any], given: Expectation, place: str) -> tuple[bool, str]:
    burst, recorded = given.preflight.stimulus.burst, start["stimulus"]
    found, stated, hashes = burst.content_hash, recorded["content_hash"], recorded.get("content_hashes")
    if found != stated or (hashes is not None and hashes != given.preflight.content_hashes):
        return False, f"{place} the recomputed drive has the hash {found[:12]}, but the record says {stated[:12]}"
    if recorded.get("amplitude_Vpp", list(burst.amplitude)) != list(burst.amplitude):
        return (
            False,
            f"{place} the recomputed drive has the amplitudes {burst.amplitude} Vpp, but the record has others",
        )
    return (
        True,
        f"{f'drives of {len(hashes)} stimuli' if hashes else 'drive'} recomputed: identical codes ({found[:12]})",
    )


def _check_shown(start: dict[str, Any], given: Expectation, place: str) -> tuple[bool, str]:
    """Check that the recorded fields and speeds at the zones, shown in reports, agree with recomputed ones."""
    for row in start["stimulus"].get("stimuli", ()):
        design = " ".join(filter(None, (row.get("stimulus", ""), row.get("placement", ""))))
        peaks = given.preflight.zone_peaks(design, row["velocity_mm_s"])
        if not _agree(row["zone_peak_mm_s"], {zone: peak * 1e3 for zone, peak in peaks.items()}):
            return (False, f"{place} its speeds at the zones at {row['velocity_mm_s']:g} mm/s are not those recomputed")
    recorded = start["stimulus"].get("fields")  # not recorded by earlier versions
    if recorded is not None and not _agree(recorded, given.fields):
        return False, f"{place} its field is not the one recomputed"
    return True, ""


def _agree(recorded: Any, found: Any) -> bool:
    """Return whether recorded and computed values agree, speeds to 0.002 mm/s."""
    if isinstance(found, dict):
        return (
            isinstance(recorded, dict)
            and recorded.keys() >= found.keys()
            and all(_agree(recorded[k], found[k]) for k in found)
        )
    if isinstance(found, list):
        return isinstance(recorded, list) and len(recorded) == len(found) and all(map(_agree, recorded, found))
    if isinstance(found, float):
        return isinstance(recorded, (int, float)) and abs(recorded - found) <= SPEED
    return bool(recorded == found)


def _check_gap(session: Session, given: Expectation, place: str) -> tuple[bool, str]:
    """Check the minimum time since the previous session, if its kind requires one and that session is present."""
    kind, begun = given.protocol.schedule.kind_of(session.drawn_as), session.start["time"]
    logs = SessionFolder.logs_of(session.path.absolute().parents[2])
    before = [log for log in logs if SessionFolder.number_of(log) < int(session.start["session"])]
    events = tuple(each for each in Session.find(before[-1]).events if each["time"] <= begun) if before else ()
    ended = Session(session.path, events).ended
    # A restarted session replaces the previous one, to which the minimum time applied.
    if kind is None or not kind.min_gap_days or ended is None or "begins_anew" in session.start:
        return True, ""
    days = (datetime.fromisoformat(begun) - datetime.fromisoformat(ended)) / timedelta(days=1)
    sentence = f"begun {days:.2f} days after the previous session"
    if days >= kind.min_gap_days:
        return True, sentence
    sentence += f", where '{kind.name}' has min_gap_days: {kind.min_gap_days:g}"
    return (
        (True, f"{sentence}, waived by --any-gap") if session.start.get("any_gap") else (False, f"{place} {sentence}")
    )


def _check_own_levels(session: Session, restored: Expectation, place: str) -> tuple[bool, str]:
    """Check that the levels follow from the participant's threshold, and the threshold from its session."""
    own, section = session.start["sensation_levels"], restored.protocol.conditions.sensation_levels
    threshold = f"threshold of {own['threshold_mm_s']:g} mm/s"
    follow = section is not None and list(section.levels(own["threshold_mm_s"])) == own["levels_mm_s"]
    if section is None or not follow or list(section.multiples) != own["multiples"]:
        return False, f"{place} its levels do not follow from the {threshold}"
    if own["found"] != "session":
        return True, f"levels follow from the {threshold}, as it was given"
    log = SessionFolder.of(session.path, session.mode, session.protocol).results / own["session"]
    if not log.exists():
        return True, f"levels follow from the {threshold}; {log}, which found it, is not here"
    if read_chain(log).last_check != own["last_check"]:
        return False, f"{log}: has changed since the {threshold} was taken from it"
    return True, f"levels follow from the {threshold}, found in {own['session']}"


def check_view(session: Session) -> tuple[str, str, bool]:
    """Return a sentence if the BIDS view agrees with the log, else its problem, and whether `resume` repairs that.

    It does if a table or sidecar file is missing, or if the view includes the line that is incomplete in the log.
    """
    checks = session.chain.checks
    found = {path.name: path for path in session.path.parent.glob("*_beh.tsv")}
    forms = {name: found[name] for name in found if name.replace("form_beh.tsv", "_beh.tsv") in found.keys() - {name}}
    tables = [found[name] for name in found.keys() - forms.keys()]
    if len(tables) != 1:
        remedy = "move the others away" if tables else "`modaltouch resume` writes it"
        problem = f"holds {len(tables)} BIDS tables (*_beh.tsv), but exactly one is needed; {remedy}"
        return "", f"{session.path.parent}: {problem}", not tables
    table, side = tables[0], tables[0].with_suffix(".json")
    # The table is written before its sidecar: a session killed between the two the first time has no sidecar.
    is_described = side.exists()
    about: dict[str, Any] = {"SessionLog": {"lines": 0, "check": ""}}
    try:
        about = json.loads(side.read_text(encoding="utf-8")) if is_described else about
        n_lines, check = int(about["SessionLog"]["lines"]), about["SessionLog"]["check"]
        text = table.read_text(encoding="utf-8")
        form = "".join(path.read_text(encoding="utf-8") for path in forms.values())
    except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
        return "", f"{table}: the BIDS view cannot be read ({error}); move it away, and {_REMAKE}", False
    if n_lines > len(checks):
        # Lines after a damage are not read, and a running session may have been written to since.
        if session.chain.damage or session.is_running:
            return "", "", False
        problem = f"the BIDS view was made from {n_lines} lines, but the log has {len(checks)}"
        is_mendable = bool(session.chain.torn) and n_lines == len(checks) + 1
        copy = "" if is_mendable else "; look for a copy"
        return "", f"{session.path}: {problem}: lines were removed from its end{copy}", is_mendable
    if n_lines > 0 and checks[n_lines - 1] != check:
        return "", f"{side}: was made from another log", False
    # After a kill between the two, the table includes more lines than its sidecar states.
    made_from = (Session(session.path, session.events[:n]) for n in range(max(n_lines, 0), len(checks) + 1))
    # The form's table is written first.
    shown = next((each for each in made_from if text == table_text(each)), None)
    if shown is not None and form not in {form_text(shown), form_text(session)}:
        if not forms:
            return "", f"{session.path.parent}: the table of the form is missing; `modaltouch resume` writes it", True
        named = next(iter(forms.values()), session.path.parent)
        return "", f"{named}: the table of the form differs from the log; move it away, and {_REMAKE}", False
    if shown is None:
        return "", f"{table}: differs from the log, which is the original: move the table away, and {_REMAKE}", False
    if not is_described:
        return "", f"{side}: is missing; `modaltouch resume` writes it", True
    if about.get("Mode") != session.mode:
        unlike = f"says Mode: {about.get('Mode')}, but its log says {session.mode}"
        return "", f"{side}: {unlike}; move it away, and {_REMAKE}", False
    if unlike := _misdescribed(session, about, text):
        # The table is whole, and labs rename tasks and units for others.
        return f"BIDS view agrees, but {side} {unlike}", "", False
    if session.trials != shown.trials:
        behind = len(checks) - len(shown.events)
        return f"BIDS view agrees, {behind} lines behind the log: `modaltouch resume` brings it up to date", "", False
    return f"BIDS view agrees: {len(session.trials)} answers, practice included", "", False


def _misdescribed(session: Session, about: dict[str, Any], table: str) -> str:
    """Say how a sidecar file differs from its log; descriptions may be changed, such as translated."""
    if about.get("TaskName") != session.protocol:
        return f"says TaskName: {about.get('TaskName')}, where its log says {session.protocol}"
    columns = columns_of(session)
    for name in table.partition("\n")[0].split("\t"):
        described, units = about.get(name), columns[name].get("Units")
        if not isinstance(described, dict):
            return f"does not describe the column {name}"
        if described.get("Units") != units:
            return f"gives the unit {described.get('Units')} for {name}, where its log has {units}"
    return ""


_REMAKE = "`modaltouch resume` writes it again"
