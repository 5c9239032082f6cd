"""A log whose lines are whole but do not say what a session says: another version's, or somebody's own."""

import json

import pytest

from modaltouch.document import InputError
from modaltouch.record.chain import GENESIS, RecordError, encode_line, read_chain
from modaltouch.record.log import read_session
from modaltouch.simulation import simulate_session
from modaltouch.verification import verify_session
from modaltouch.wiring import wire_resume


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A whole session's log."""
    return simulate_session("protocols/demo.yaml", "p01", tmp_path_factory.mktemp("shape")).path


@pytest.fixture
def rewritten(log):
    """Write the log anew with one event changed, every check right."""
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


def test_a_session_of_today_says_all_it_must(log):
    """No problem with what this version writes."""
    assert read_session(log).problems == ()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda events: events[0].update(schema=2), "session.jsonl:1: was written in format 2, this program knows 1"),
        (
            lambda events: events[0].pop("participant"),
            "session.jsonl:1: the event `start` does not say its participant",
        ),
        (lambda events: events[1].pop("event"), "session.jsonl:2: is no event of a session"),
    ],
)
def test_another_format_is_told_by_every_reader(rewritten, change, said):
    """Verify names the line, resume refuses, the analysis leaves the session out with the reason."""
    path = rewritten(change)
    assert said in verify_session(path).problems[0]
    with pytest.raises(RecordError, match="format 2|does not say|is no event"):
        wire_resume(path)
    from modaltouch.analysis.reading import read_responses

    with pytest.raises(InputError, match=r"damaged: .*(format 2|does not say|is no event)"):
        read_responses(path.parent)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda events: events[0].pop("seed"), "session.jsonl:1: the event `start` does not say its seed"),
        (lambda events: events[0].update(seed=True), "does not say its seed"),
        (lambda events: events[0]["sources"]["texts"].pop("text"), "does not say its sources.texts.text"),
    ],
)
def test_what_cannot_be_repeated_is_told_where_it_would_be(rewritten, change, said):
    """Verify and resume compute order and drive again; the answers can still be analysed."""
    path = rewritten(change)
    assert said in verify_session(path).problems[0]
    with pytest.raises(RecordError, match="does not say"):
        wire_resume(path)
    assert read_session(path).problems == ()


def test_an_answer_without_its_words_is_named(rewritten):
    """The first of the missing members, with its line."""

    def change(events):
        next(event for event in events if event["event"] == "trial")["response"].pop("answer")

    assert "the event `trial` does not say its response.answer" in read_session(rewritten(change)).problems[0]
