from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from modaltouch.analysis.provenance import (
    describe_record,
    form_files,
    summarise_form,
    take_facts,
    version_notes,
)
from modaltouch.record.session import Session


def session(participant: str, *events: dict) -> Session:
    """Return a session of one trial at 80 mm/s and further events."""
    start = {"event": "start", "n": 1, "time": "2026-01-02T10:00:00+00:00", "participant": participant, "session": 1,
             "rig": {"identity": f"AFG of {participant}"}, "protocol": "touch"}  # fmt: skip
    condition = {"finger_condition": "one_hand", "zone_left": "A", "zone_right": "C", "velocity_mm_s": 80.0}
    trial = {
        "event": "trial", "n": 2, "trial": {"index": 1, "practice": False, "condition": condition},
        "commanded": {"amplitude_Vpp": [1.5, 2.0]},
        "confirmed": {"confirmed": True, "confirmed_amplitude": [1.5, 2.01]},
    }  # fmt: skip
    return Session(Path("session.jsonl"), (start, trial, *events))


def facts(*sessions: Session):
    """Return the record section of the report on these sessions."""
    return describe_record([take_facts(each) for each in sessions])


def test_a_table_has_no_record_section() -> None:
    """A CSV has no information on what was presented."""
    assert facts() is None


def test_planned_and_confirmed_amplitudes_are_listed_together() -> None:
    """Two sessions at one level: sent 1.5 and 2 Vpp, read back 1.5 and 2.01."""
    (row,) = facts(session("p01"), session("p02"))["presented"]
    assert (row["level"], row["n_trials"], row["n_confirmed"]) == ("80", 2, 2)
    assert (row["commanded"], row["confirmed"]) == ("1.5, 2", "1.5, 2.01")


def test_faults_are_counted_with_their_sessions() -> None:
    """The second participant had an interrupted trial and resumed the session."""
    found = facts(session("p01"), session("p02", {"event": "trial_cut", "n": 3}, {"event": "resume", "n": 4}))
    assert ("trials interrupted and presented again", 1, "p02 (session 1)") in found["faults"]
    assert [row.faults.total() for row in found["sessions"]] == [0, 2]


def test_settings_that_differ_are_listed() -> None:
    """The sessions have two generators and one protocol."""
    settings = facts(session("p01"), session("p02"))["settings"]
    assert settings["protocol"] == "touch"
    assert settings["rig"] == "AFG of p01 (sessions: 1); AFG of p02 (sessions: 1)"


@pytest.mark.parametrize(
    ("key", "given", "said"),
    [
        (
            "schedule",
            {"order": "random", "repetitions": 2, "catch_trials": 2},
            ["schedule.catch_trials", "schedule.order"],
        ),
        ("schedule", {"repetitions": 2, "catch_trials": 0}, []),
        ("groups", {"low": {}}, ["groups.low"]),
        ("intervals", {"number": 2}, ["intervals"]),
        ("masking", None, []),
        ("later", {"key": 1}, ["later.key"]),
    ],
)
def test_a_key_of_one_version_alone_differs_unless_it_is_at_its_default(key: str, given, said: list[str]) -> None:
    """Older programs recorded fewer keys, and keys that a protocol leaves out are not recorded."""
    facts = [take_facts(session(who)) for who in ("p01", "p02")]
    usual = {"schedule": {"repetitions": 2}, "later": {}}  # a section that only a later program knows
    designs = [usual, usual | {key: given}]
    both = [replace(each, design=("", "", json.dumps(own))) for each, own in zip(facts, designs, strict=True)]
    expected = f"Versions of the protocol that differ in {', '.join(said)} are analysed together (1 and 1 sessions)"
    assert [*version_notes(both)] == [*version_notes(both[::-1])] == [expected] * bool(said)


def test_settings_of_some_sessions_are_not_attributed_to_all() -> None:
    """One of six sessions had masking noise, and each its own generator: four are listed, the others counted."""
    sessions = [session(f"p0{number}") for number in range(6)]
    sessions[0].start["masking"] = {"state": "masked", "noise": "pink", "level_dB_FS": -30, "level_dB_SPL": None,
                                    "device": "phones"}  # fmt: skip
    settings = facts(*sessions)["settings"]
    assert settings["masking noise"] == "pink, -30 dB FS, on phones (sessions: 1)"
    assert settings["rig"].count("AFG of") == 4 and settings["rig"].endswith("; 2 others")


def test_the_end_of_a_complete_session_is_not_a_fault() -> None:
    """Every session writes a stop event; only an early one counts."""
    ends = [session(f"p{i}", {"event": "stop", "n": 3, "complete": whole}) for i, whole in enumerate((True, False))]
    assert facts(*ends)["faults"] == [("sittings ended early", 1, "p1 (session 1)")]


def test_rig_faults_are_found_among_its_exchanges() -> None:
    """A lost connection is a fault, an ordinary command is not."""
    lost = {"event": "rig", "n": 3, "exchanges": [{"what": "scpi"}, {"what": "connection_lost"}]}
    calm = {"event": "rig", "n": 3, "exchanges": [{"what": "scpi"}]}
    assert [row.faults.total() for row in facts(session("p1", lost), session("p2", calm))["sessions"]] == [1, 0]


def with_form(participant: str, **said: float | str):
    """Return the facts of a session whose form has the given numbers and answers."""
    own = session(participant, *(
        {"event": "form", "n": 3 + place, "name": name,
         "response": {"answer": value} if isinstance(value, str) else {"answer": "rated", "value": value}}
        for place, (name, value) in enumerate(said.items())
    ))  # fmt: skip
    own.start["design"] = {"form": dict.fromkeys(said, {})}
    return take_facts(own)


def test_the_form_is_summarised_over_participants() -> None:
    """Numpy's quartiles of 1, 2, 5 and the mean of 6 and 10; answers in words count by session, a time-out does not."""
    sessions = [with_form("p1", tired=1, again="yes"), with_form("p2", tired=2, again="no"),
                with_form("p3", tired=5, again="time_out"), with_form("p4", tired=6, again="yes"),
                with_form("p4", tired=10, again="yes")]  # fmt: skip
    tired, again = summarise_form(sessions)
    assert (tired["question"], tired["n"], tired["answers"]) == ("tired", 4, {})
    told = [tired[name] for name in ("quartile_low", "median", "quartile_high")]
    assert told == np.quantile([1, 2, 5, 8], [0.25, 0.5, 0.75]).tolist()
    assert (again["n"], again["median"], again["answers"]) == (3, None, {"yes": 3, "no": 1})
    assert [row["again"] for row in form_files(sessions)["form.csv"]] == ["yes", "no", None, "yes", "yes"]
    assert form_files([take_facts(session("p1"))]) == {}


def test_forms_are_summarised_by_group_and_kind_of_session() -> None:
    """With one participant per group, two rows have that number as all three quartiles."""
    low, high = with_form("p1", tired=1), with_form("p2", tired=5)
    told = list(summarise_form([replace(low, occasion=("low", "test")), replace(high, occasion=("high", "test"))]))
    assert [(row["group"], row["session_kind"], row["quartile_low"], row["n"]) for row in told] == [
        ("low", "test", 1.0, 1), ("high", "test", 5.0, 1)]  # fmt: skip
