"""BIDS view: tables and sidecar files derived from the session log.

Files are replaced atomically, so that they are valid at all times. The log is the only original; the view can be
rebuilt from it.

References
----------
Brain Imaging Data Structure 1.10, "Behavioral experiments (with no neural recordings)".
"""

from __future__ import annotations

from typing import Any

from modaltouch.protocol import TIME_OUT, AnswerList
from modaltouch.record.folders import LOG_NAME, SessionFolder, replace_json, replace_text
from modaltouch.record.session import Session

COLUMNS: dict[str, dict[str, Any]] = {
    "trial": {"Description": "Place in the session, from 1; practice trials are counted separately"},
    "block": {"Description": "Block (one finger condition), from 1; 0 for practice"},
    "practice": {"Description": "Practice trial, to be left out of the analysis", "Levels": {"0": "no", "1": "yes"}},
    "finger_condition": {
        "Description": "Which fingers are on the zones, by their name in the protocol",
        "Levels": {
            "one_hand": "index and middle finger of one hand (test 1 of the paper)",
            "two_hands": "both index fingers (test 2 of the paper)",
        },
    },
    "zone_left": {
        "Description": "Zone under the left finger, as the participant sees the beam, or under the only finger"
    },
    "zone_right": {"Description": "Zone under the right finger; n/a for one finger alone"},
    "finger_left": {"Description": "Finger on the left zone"},
    "finger_right": {"Description": "Finger on the right zone"},
    "placement": {
        "Description": "How the fingers lie on the beam",
        "Levels": {
            "normal": "as in the protocol",
            "mirrored": "the beam turned end to end",
            "swapped": "the other hand, or crossed hands where both are on the beam",
            "mirrored_swapped": "both",
        },
    },
    "velocity_mm_s": {"Description": "Peak velocity requested at the focus", "Units": "mm/s"},
    "repetition": {"Description": "Number of this presentation of the condition, from 1"},
    "response": {"Description": "Where the participant felt the stimulation"},
    "response_time": {"Description": "Time from the onset in response_onset to the answer", "Units": "s"},
    "response_onset": {
        "Description": "What the response time is counted from",
        "Levels": {"first_burst": "the first burst", "question": "the question, after the end of the stimulus"},
    },
    "answered_by": {"Description": "Who gave the answer to the program: participant, experimenter or simulated"},
    "way": {"Description": "How the answer was given: free_hand, lifting, foot_switch or experimenter"},
    "confirmed": {
        "Description": "The instrument confirmed amplitude and state before the trial and at its end",
        "Levels": {"0": "no", "1": "yes"},
    },
}

_YES = {"0": "no", "1": "yes"}
FURTHER: dict[str, dict[str, dict[str, Any]]] = {
    "counted": {
        "onset": {
            "Description": "When the first sample of the first burst left the generator, by the clock of the session "
            "log; the focus comes at the protocol's focusing_instant_ms after it",
            "Units": "s",
        },
        "onset_uncertainty": {
            "Description": "How far the true onset can be from it, either way: half the time from sending the trigger "
            "command until the instrument had accepted it, plus the bounds of the trigger latency; at least a "
            "millisecond if that latency has not been measured",
            "Units": "s",
        },
        "n_bursts": {"Description": "Complete bursts that were played; n/a if they cannot be counted"},
        "n_bursts_dropped": {"Description": "Bursts left out because they would have come too late"},
        "repetition_by": {
            "Description": "What repeats the bursts",
            "Levels": {
                "single": "a command for each burst",
                "timer": "the generator's free timer: bursts are not counted, and the first is known to within a "
                "period",
                "continuous": "one record, repeated continuously: bursts are not counted",
                "wired": "a pulse source at the trigger input: bursts are counted there",
            },
        },
        "presentation": {"Description": "Number of this presentation of the trial, from 1"},
        "device": {"Description": "Source of the answer: key, mouse, console, model, or none at a time-out"},
        "speed_left_mm_s": {"Description": "Predicted peak speed of the beam under the left finger", "Units": "mm/s"},
        "speed_right_mm_s": {"Description": "Predicted peak speed of the beam under the right finger", "Units": "mm/s"},
    },
    "line": {"log_line": {"Description": f"Line number in {LOG_NAME}"}},
    "catch": {"catch": {"Description": "Catch trial: nothing was driven, and the velocity is 0", "Levels": _YES}},
    "multiples": {
        "multiple_of_threshold": {
            "Description": "Velocity as a multiple of the participant's own threshold; n/a in a catch trial",
            "Units": "1",
        }
    },
    "masking": {
        "masked": {
            "Description": "Masking noise was on and at its level during the whole trial",
            "Levels": _YES,
        }
    },
    "stimuli": {"stimulus": {"Description": "Which of the protocol's stimuli; n/a in a catch trial"}},
    "three_fingers": {
        "zone_between": {"Description": "Zone under the finger between the outer two"},
        "finger_between": {"Description": "Finger on that zone"},
        "speed_between_mm_s": {"Description": "Predicted peak speed of the beam under that finger", "Units": "mm/s"},
    },
    "intervals": {
        "interval": {"Description": "Interval of the trial in which this condition was presented, from 1"},
        "standard_mm_s": {"Description": "Level at the focus in the other intervals, 0 for silence", "Units": "mm/s"},
        "correct": {
            "Description": "Whether the answer is right; n/a if any answer may be right, and at a time-out",
            "Levels": _YES,
        },
    },
    "delivered": {
        "delivered_mm_s": {
            "Description": "Peak speed of the beam under the faster finger, from a record of the first burst",
            "Units": "mm/s",
        }
    },
}
"""Additional columns by the feature of a session that requires them; bursts are counted since log format 2."""
QUESTION_TIME: dict[str, Any] = {"Description": "Time from the question to its answer", "Units": "s"}
_FORMATS = {
    **dict.fromkeys(("velocity_mm_s", "multiple_of_threshold", "standard_mm_s"), "g"),
    **dict.fromkeys(("speed_left_mm_s", "speed_between_mm_s", "speed_right_mm_s", "delivered_mm_s"), "g"),
    **dict.fromkeys(("response_time", "onset", "onset_uncertainty"), ".4f"),
}
_FINGERS: dict[tuple[str, ...] | None, str] = {
    ("left",): "left finger",
    ("right",): "right finger",
    ("left", "right"): "both fingers",
    ("between",): "finger between them",
    (): "neither finger",
}


def write_view(
    place: SessionFolder, session: Session, head: dict[str, Any], before: tuple[tuple[Any, ...], str] = ((), "")
) -> str:
    """Write the session's table and sidecar file from the log, and return the table.

    `head` is the length of the log (`SessionLog.head`), stated in the sidecar file to detect the loss of its last
    lines; `before` is as for `table_text`. Raises RecordError if a file cannot be written; existing files remain valid.
    """
    about = {
        "TaskDescription": session.start.get("design", {}).get("title", ""),
        "Instructions": session.start.get("instructions", "").replace("\n", " "),
    }
    side = {
        "TaskName": place.protocol,
        **{key: words for key, words in about.items() if words},
        **columns_of(session),
        "Mode": session.mode,
        "SessionLog": {"File": LOG_NAME, **head},
    }
    if form := form_text(session):
        replace_text(place.form_table, form)
        described = {name: describe_question(asked) for name, asked in session.start["design"]["form"].items()}
        task = {"TaskName": f"{place.protocol} form", "TaskDescription": "Questions at the end of the session"}
        replace_json(place.form_table.with_suffix(".json"), task | described)
    text = table_text(session, before)
    replace_text(place.table, text)
    replace_json(place.table.with_suffix(".json"), side)
    return text


def table_text(session: Session, before: tuple[tuple[Any, ...], str] = ((), "")) -> str:
    """Return the BIDS table of a session, one row per answer that counts.

    If the answers of an earlier table, `before`, are unchanged, rows are only appended, so that the time per answer
    does not grow.
    """
    columns, (done, text) = columns_of(session), before
    if not text or session.trials[: len(done)] != done:
        done, text = (), "\t".join(columns) + "\n"
    rows = map(session.row, session.trials[len(done) :])
    return text + "".join("\t".join(_text(name, row[name]) for name in columns) + "\n" for row in rows)


def form_text(session: Session) -> str:
    """Return the table of the closing form, one row with a column per question; empty before any answer."""
    if not session.form:
        return ""
    given = {name: session.form.get(name, {"answer": None}) for name in session.start["design"]["form"]}
    row = [_text(name, each.get("value", each["answer"])) for name, each in given.items()]
    return "\t".join(given) + "\n" + "\t".join(row) + "\n"


def columns_of(session: Session) -> dict[str, dict[str, Any]]:
    """Return the columns of a session's table with their descriptions, according to its protocol."""
    design = session.start.get("design", {})
    finger_conditions = COLUMNS["finger_condition"]
    for name, fingers in design.get("conditions", {}).get("fingers", {}).items():
        finger_conditions = finger_conditions | {"Levels": finger_conditions["Levels"] | {name: ", ".join(fingers)}}
    has = {
        "counted": session.start.get("schema", 1) > 1,
        "line": True,
        "catch": design.get("schedule", {}).get("catch_trials"),
        "multiples": session.multiples,
        "masking": design.get("masking"),
        "stimuli": design.get("stimuli"),
        "three_fingers": any(len(zones) > 2 for zones in design.get("conditions", {}).get("zones", ())),
        "intervals": design.get("intervals"),
        "delivered": design.get("stimulus", {}).get("fingers") == "measured",
    }
    columns = COLUMNS | {
        "response": _describe_answers(design.get("answers", {})),
        "finger_condition": finger_conditions,
    }
    for name, further in FURTHER.items():
        columns |= further if has[name] else {}
    for name, asked in session.questions.items():
        columns[name] = describe_question(asked)
        columns |= {f"{name}_time": QUESTION_TIME} if name != "value" else {}
    return columns


def describe_question(asked: dict[str, Any]) -> dict[str, Any]:
    """Return the description of a question's column from its section of the protocol."""
    scale, words = asked.get("scale"), asked.get("question") or ""
    if not scale:
        levels = {name: f"the answer {name}" for name in asked["keys"]} | {TIME_OUT: "no answer in time"}
        return {"Description": words or "The answer", "Levels": levels}
    ends = f" ({' - '.join(scale['words'])})" if scale["words"] else ""
    return {"Description": f"{words or 'Number on the scale'}; {scale['kind']} scale{ends}, n/a without an answer"}


def _describe_answers(section: dict[str, Any]) -> dict[str, Any]:
    answers = AnswerList.of(section).ranked
    levels = {answer.name: _FINGERS.get(answer.fingers, f"the answer {answer.name}") for answer in answers}
    if section.get("after_longest") == "time_out" or section.get("time_out_s"):
        levels[TIME_OUT] = "no answer in time"
    asked = COLUMNS["response"] if any(answer.fingers for answer in answers) else {"Description": "The answer"}
    return {**asked, "Levels": levels}


def _text(name: str, value: Any) -> str:
    if value is None or value == "":
        return "n/a"
    usual = ".4f" if name.endswith("_time") else ".10g" if isinstance(value, float) else ""
    text = str(int(value)) if isinstance(value, bool) else format(value, _FORMATS.get(name, usual))
    return text.replace("\t", " ").replace("\n", " ")
