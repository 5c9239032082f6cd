"""A log with valid checksums whose lines lack members of a session: of another version, or written by hand."""

import json
from pathlib import Path

import pytest

from modaltouch.protocol import InputError
from modaltouch.record.audit import audit_session
from modaltouch.record.chain import GENESIS, RecordError, encode_line, read_chain
from modaltouch.record.session import Session, read_session
from modaltouch.session.resumption import wire_resume
from modaltouch.session.wiring import simulate_session


def faults_of(events):
    """Return the problems of the members of the lines of a log."""
    return Session(Path("log"), tuple(events)).faults


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """The log of a complete session."""
    return simulate_session("protocols/demo.yaml", "p01", tmp_path_factory.mktemp("shape")).path


@pytest.fixture
def rewritten(log):
    """Rewrite the log with changed events and valid checksums."""
    kept = log.read_bytes()

    def rewrite(change):
        events = json.loads(json.dumps(read_chain(log).events))
        change(events)
        data, check = b"", GENESIS
        for event in events:
            line, check = encode_line(event, check)
            data += line
        log.write_bytes(data)
        return log

    yield rewrite
    log.write_bytes(kept)


def test_a_session_of_this_version_has_every_member(log):
    """What this version writes has no problem."""
    assert read_session(log).problems == ()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda events: events[0].update(schema=3),
            "session.jsonl:1: was written in format 3, but this program reads 1 and 2",
        ),
        (
            lambda events: events[0].pop("participant"),
            "session.jsonl:1: the event `start` does not say its participant",
        ),
        (lambda events: events[1].pop("event"), "session.jsonl:2: is not an event of a session"),
    ],
)
def test_another_format_is_refused_by_every_reader(rewritten, change, said):
    """Verify gives the line, resume refuses, and the analysis leaves the session out with the reason."""
    path = rewritten(change)
    assert said in audit_session(Session.find(path)).problems[0]
    with pytest.raises(RecordError, match="format 3|does not say|is not an event"):
        wire_resume(path)
    from modaltouch.analysis.pipeline import read_responses

    with pytest.raises(InputError, match=r"damaged: .*(format 3|does not say|is not an event)"):
        read_responses(path.parent)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda events: events[0].pop("seed"), "session.jsonl:1: the event `start` does not say its seed"),
        (lambda events: events[0].update(seed=True), "does not say its seed"),
        (lambda events: events[0]["sources"]["texts"].pop("text"), "does not say its sources.texts.text"),
    ],
)
def test_members_needed_for_recomputation_are_checked_by_every_reader(rewritten, change, said):
    """Order and drive could not be recomputed without them."""
    path = rewritten(change)
    assert said in audit_session(Session.find(path)).problems[0]
    with pytest.raises(RecordError, match="does not say"):
        wire_resume(path)
    assert said in read_session(path).problems[0]


def test_a_trial_without_its_answer_is_reported(rewritten):
    """The problem gives the first missing member of the `trial` event."""

    def change(events):
        next(event for event in events if event["event"] == "trial")["response"].pop("answer")

    assert "the event `trial` does not say its response.answer" in read_session(rewritten(change)).problems[0]


@pytest.mark.parametrize(
    "line", [{"n": 1}, {"n": 1, "event": ["trial"]}, {"event": "trial"}, {"n": "1", "event": "start"}]
)
def test_a_line_without_a_number_or_a_name_is_one_problem(line):
    """The members of an invalid line are not checked; the lines after it are."""
    no_event = "is not an event of a session"
    after = {"n": 2, "event": "trial"}
    assert faults_of([line, after])[-2:] == (
        f"log:1: {no_event}",
        "log:2: the event `trial` does not say its trial.index",
    )


def test_an_event_of_another_kind_needs_no_members():
    """An event kind added by a later version is not a fault."""
    assert faults_of([{"n": 1, "event": "note"}]) == ("log:1: is not a start record",)


STARTS = (
    "mode", "participant", "protocol", "schedule.n_trials", "session", "seed", "rig_choice", "answers_choice",
    "design", "sources.protocol.text", "sources.protocol.path", "sources.apparatus.text", "sources.apparatus.path",
    "sources.texts.text", "sources.texts.path",
    "schedule.order_hash", "stimulus.content_hash", "versions",
)  # fmt: skip
TRIALS = (
    "trial.index", "trial.block", "trial.practice", "trial.repetition", "trial.condition.finger_condition",
    "trial.condition.zone_left", "trial.condition.zone_right", "trial.condition.velocity_mm_s", "confirmed.confirmed",
    "response.answer", "response.reaction_time",
)  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "member"),
    [*(("start", member) for member in STARTS), *(("trial", member) for member in TRIALS)],
)
@pytest.mark.parametrize("spoilt", [None, [], b""])
def test_every_required_member_is_checked(log, kind, member, spoilt):
    """A required member is reported when absent or of a wrong type."""
    events = json.loads(json.dumps(read_chain(log).events))
    assert faults_of(events) == ()
    number, event = next((n, event) for n, event in enumerate(events, 1) if event["event"] == kind)
    *path, last = member.split(".")
    for step in path:
        event = event[step]
    if spoilt is None:
        del event[last]
    else:
        event[last] = spoilt
    assert faults_of(events) == (f"log:{number}: the event `{kind}` does not say its {member}",)


@pytest.mark.parametrize(
    ("members", "wrong"),
    [
        (("trial.index", "trial.block", "trial.repetition"), "1"),
        (("trial.index", "trial.block", "trial.repetition"), True),
        (("trial.practice", "confirmed.confirmed"), 1),
        (("trial.condition.finger_condition", "trial.condition.zone_left", "trial.condition.zone_right"), 3),
        (("trial.condition.velocity_mm_s", "response.reaction_time"), "3"),
        (("trial.condition.velocity_mm_s", "response.reaction_time"), True),
    ],
)
def test_members_of_one_wrong_type_are_reported(log, members, wrong):
    """Another version may write all members with another type; the first is reported."""
    events = json.loads(json.dumps(read_chain(log).events))
    number, event = next((n, event) for n, event in enumerate(events, 1) if event["event"] == "trial")
    for member in members:
        *path, last = member.split(".")
        place = event
        for step in path:
            place = place[step]
        place[last] = wrong
    assert faults_of(events) == (f"log:{number}: the event `trial` does not say its {members[0]}",)


def test_a_boolean_is_not_a_number(log):
    """JSON's true is an int in Python, but not a valid number of trials."""
    events = json.loads(json.dumps(read_chain(log).events))
    events[0]["schedule"]["n_trials"] = True
    assert faults_of(events) == ("log:1: the event `start` does not say its schedule.n_trials",)
