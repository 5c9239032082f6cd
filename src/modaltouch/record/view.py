"""The BIDS view: tables and side files derived from the session log, valid at every moment.

Every file is written beside its place and renamed into it, so a reader never meets half a file. The log is the
only truth; the view may be rebuilt from it at any time.

References
----------
Brain Imaging Data Structure 1.10, "Behavioral experiments (with no neural recordings)".
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from modaltouch.record.chain import RecordError
from modaltouch.record.files import OWNER_ALONE, replace_file
from modaltouch.record.folders import LOG_NAME, SessionFolder, make_folder
from modaltouch.record.session import Session
from modaltouch.system import LOCK_NAME, hold, version

BIDS_VERSION = "1.10.0"

COLUMNS: dict[str, dict[str, Any]] = {
    "trial": {"Description": "Place in the session, from 1; practice trials count on their own"},
    "block": {"Description": "Block (one finger condition), from 1; 0 for practice"},
    "practice": {
        "Description": "Practice trial, to be left out of the analysis",
        "Levels": {"0": "no", "1": "yes"},
    },
    "finger_condition": {
        "Description": "Fingers on the two zones",
        "Levels": {
            "one_hand": "index and middle finger of one hand (test 1 of the paper)",
            "two_hands": "both index fingers (test 2 of the paper)",
        },
    },
    "zone_left": {"Description": "Zone under the left finger, as the participant sees the beam"},
    "zone_right": {"Description": "Zone under the right finger"},
    "finger_left": {"Description": "Finger on the left zone"},
    "finger_right": {"Description": "Finger on the right zone"},
    "placement": {
        "Description": "How the fingers lie on the beam",
        "Levels": {
            "normal": "as the protocol has it",
            "mirrored": "the beam turned end to end",
            "swapped": "the other hand in one_hand, crossed hands in two_hands",
            "mirrored_swapped": "both",
        },
    },
    "velocity_mm_s": {"Description": "Peak velocity asked at the focus", "Units": "mm/s"},
    "repetition": {"Description": "Which presentation of this condition it is, from 1"},
    "response": {
        "Description": "Where the participant felt the stimulation",
        "Levels": {"left": "left finger", "right": "right finger", "both": "both fingers"},
    },
    "response_time": {"Description": "From the onset named beside it to the answer", "Units": "s"},
    "response_onset": {
        "Description": "What the response time counts from",
        "Levels": {"first_burst": "the first burst", "question": "the question, the stimulus having ended"},
    },
    "answered_by": {"Description": "Who gave the answer to the program: participant, experimenter or simulated"},
    "way": {"Description": "How the answer was given: free_hand, lifting, foot_switch or experimenter"},
    "confirmed": {
        "Description": "The instrument confirmed amplitude and state before the trial and still at its end",
        "Levels": {"0": "no", "1": "yes"},
    },
    "log_line": {"Description": f"Number of the line in {LOG_NAME}"},
}

COUNTED: dict[str, dict[str, Any]] = {
    "onset": {
        "Description": "When the first sample of the first burst left the generator, by the clock of the session log; "
        "the focus comes at the protocol's focusing_instant_ms after it",
        "Units": "s",
    },
    "onset_uncertainty": {
        "Description": "How far from the onset it can have been, either way: half the time from the command that "
        "triggered the burst to the instrument's having taken it, and the bounds of the trigger latency; where that "
        "latency has not been measured, nothing is claimed to less than a millisecond",
        "Units": "s",
    },
    "n_bursts": {"Description": "Whole bursts that were played; n/a where they cannot be counted"},
    "n_bursts_dropped": {"Description": "Bursts left out because they would have come too late"},
    "repetition_by": {
        "Description": "What repeats the bursts",
        "Levels": {
            "single": "each burst has a command of its own",
            "timer": "the free timer of the generator: bursts are not counted, the first is known to a period",
            "continuous": "one record plays on: bursts are not counted",
            "wired": "a pulse source at the trigger input: bursts are counted there",
        },
    },
    "presentation": {"Description": "How often this trial had been presented by then, from 1"},
    "device": {"Description": "What the answer came from: key, mouse, console, model, or none at a time-out"},
    "speed_left_mm_s": {"Description": "Predicted peak speed of the beam under the left finger", "Units": "mm/s"},
    "speed_right_mm_s": {"Description": "Predicted peak speed of the beam under the right finger", "Units": "mm/s"},
}
"""Columns of sessions whose bursts are counted, since format 2 of the log."""

CATCH: dict[str, Any] = {
    "Description": "Catch trial: nothing was driven, the velocity is 0",
    "Levels": {"0": "no", "1": "yes"},
}

MASKED: dict[str, Any] = {
    "Description": "Masking noise was on and at its level during the whole trial",
    "Levels": {"0": "no", "1": "yes"},
}

MULTIPLE: dict[str, Any] = {
    "Description": "Velocity as a multiple of the participant's own threshold; n/a in a catch trial",
    "Units": "1",
}

STIMULUS: dict[str, Any] = {"Description": "Which of the protocol's stimuli; n/a in a catch trial"}


def write_view(place: SessionFolder, session: Session, head: dict[str, Any]) -> None:
    """Write the session's table and its side file from the log.

    Parameters
    ----------
    place : SessionFolder
        Where the session lives.
    session : Session
        What its log holds.
    head : dict
        How far the log has come (`SessionLog.head`); the side file carries it, so that a log that lost its last
        lines is noticed.

    Raises
    ------
    RecordError
        If a file cannot be written; the files before it stay valid.
    """
    side = {
        "TaskName": place.protocol,
        **_columns(session),
        "Mode": session.mode,
        "SessionLog": {"File": LOG_NAME, **head},
    }
    _replace(place.table, table_text(session))
    _replace(place.table.with_suffix(".json"), json.dumps(side, indent=2, ensure_ascii=False) + "\n")


def table_text(session: Session) -> str:
    """Return the BIDS table of a session: one row for each answer that counts."""
    columns = _columns(session)
    rows = [_row(event, columns, session.multiples) for event in session.trials]
    return "\n".join(["\t".join(columns), *("\t".join(row) for row in rows)]) + "\n"


def _columns(session: Session) -> dict[str, dict[str, Any]]:
    """Return the columns of a session's table: those for catch trials and the answer none only where it has them."""
    design = session.start.get("design", {})
    columns = dict(COLUMNS)
    if session.start.get("schema", 1) > 1:
        line = columns.pop("log_line")
        columns |= {**COUNTED, "log_line": line}
    if design.get("schedule", {}).get("catch_trials"):
        columns["catch"] = CATCH
    if session.multiples:
        columns["multiple_of_threshold"] = MULTIPLE
    if design.get("masking"):
        columns["masked"] = MASKED
    if design.get("stimuli"):
        columns["stimulus"] = STIMULUS
    if "none" in design.get("answers", {}).get("keys", {}):
        response = columns["response"]
        columns["response"] = {**response, "Levels": {**response["Levels"], "none": "neither finger"}}
    if design.get("answers", {}).get("after_longest") == "time_out":
        response = columns["response"]
        columns["response"] = {**response, "Levels": {**response["Levels"], "time_out": "no answer in time"}}
    return columns


def describe_dataset(place: SessionFolder, title: str) -> None:
    """Write the dataset's description and ignore file where they are missing.

    Raises
    ------
    RecordError
        If a file cannot be written.
    """
    description = {
        "Name": title or place.protocol,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "GeneratedBy": [{"Name": "modaltouch", "Version": version()}],
    }
    try:
        make_folder(place.dataset)
    except OSError as error:
        raise RecordError(
            f"{place.dataset}: cannot be created ({error.strerror}); give a folder you may write to with --results"
        ) from error
    if not (place.dataset / "dataset_description.json").exists():
        text = json.dumps(description, indent=2, ensure_ascii=False) + "\n"
        _replace(place.dataset / "dataset_description.json", text)
        _replace(place.dataset / "README", f"{description['Name']}: sessions recorded by modaltouch {version()}.\n")
        _replace(place.dataset / ".bidsignore", f"*.jsonl\n*.log\n{LOCK_NAME}\n")


def list_participants(place: SessionFolder) -> None:
    """Add the participants whose folders are not listed yet; what a lab wrote into the list stays as it is.

    Raises
    ------
    RecordError
        If the list cannot be read or written.
    """
    with hold_dataset(place):  # two sessions may begin at once: none may write a list that lacks the other
        _list_participants(place.dataset)


@contextmanager
def hold_dataset(place: SessionFolder) -> Iterator[None]:
    """Keep other sessions from beginning in a dataset, for milliseconds.

    Raises
    ------
    RecordError
        If it cannot be locked.
    """
    with ExitStack() as stack:
        try:
            stack.enter_context(hold(place.dataset))
        except OSError as error:
            raise RecordError(
                f"{place.dataset}: cannot be locked ({error.strerror}); see what else writes there"
            ) from error
        yield


def _list_participants(dataset: Path) -> None:
    path = dataset / "participants.tsv"
    try:
        text = path.read_text(encoding="utf-8") if path.exists() else "participant_id\n"
    except (OSError, UnicodeDecodeError) as error:
        raise RecordError(f"{path}: cannot be read ({error}); mend it or move it away") from error
    header, *rows = [line.split("\t") for line in text.splitlines()] or [["participant_id"]]
    listed = {row[0] for row in rows}
    folders = sorted(folder.name for folder in dataset.glob("sub-*") if folder.is_dir())
    new = ["\t".join([name, *["n/a"] * (len(header) - 1)]) for name in folders if name not in listed]
    if new or not path.exists():
        _replace(path, "\n".join([text.rstrip("\n"), *new]) + "\n")


def _replace(path: Path, text: str) -> None:
    replace_file(path, text.encode(), "the session log is intact", OWNER_ALONE)


def _row(event: dict[str, Any], columns: dict[str, dict[str, Any]], multiples: dict[float, float]) -> list[str]:
    trial, response = event["trial"], event["response"]
    condition = trial["condition"]
    multiple = multiples.get(condition["velocity_mm_s"])
    bursts, planned = event.get("bursts") or {}, event.get("planned") or {}
    values = {
        "trial": trial["index"],
        "block": trial["block"],
        "practice": int(trial["practice"]),
        "finger_condition": condition["finger_condition"],
        "zone_left": condition["zone_left"],
        "zone_right": condition["zone_right"],
        "finger_left": event["fingers"][0],
        "finger_right": event["fingers"][1],
        "placement": condition["placement"],
        "velocity_mm_s": f"{condition['velocity_mm_s']:g}",
        "multiple_of_threshold": f"{multiple:g}" if multiple else "n/a",
        "masked": int(bool(event.get("masked"))),
        "catch": int(condition["velocity_mm_s"] == 0),
        "stimulus": condition.get("stimulus") or "n/a",
        "repetition": trial["repetition"],
        "response": response["answer"],
        "response_time": f"{response['reaction_time']:.4f}",
        "response_onset": response["onset"],
        "answered_by": response["answered_by"],
        "way": response["way"] or "n/a",
        "confirmed": int(event["confirmed"]["confirmed"]),
        "onset": _number(bursts.get("first_s"), ".4f"),
        "onset_uncertainty": _number(bursts.get("uncertainty_s"), ".4f"),
        "n_bursts": _number(bursts.get("whole"), "d"),
        "n_bursts_dropped": _number(bursts.get("dropped"), "d"),
        "repetition_by": event["confirmed"].get("repetition", "n/a"),
        "presentation": event.get("presentation", "n/a"),
        "device": response.get("device", "n/a"),
        "speed_left_mm_s": _number(planned.get("speed_left_mm_s"), "g"),
        "speed_right_mm_s": _number(planned.get("speed_right_mm_s"), "g"),
        "log_line": event["n"],
    }
    return [str(values[column]).replace("\t", " ").replace("\n", " ") for column in columns]


def _number(value: float | None, form: str) -> str:
    return "n/a" if value is None else format(value, form)
