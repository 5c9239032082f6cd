"""Whole sessions under Windows' file rules, interrupted and resumed (tests/record/windows_rules.py)."""

import runpy
from pathlib import Path

import pytest

from modaltouch.record.audit import audit_session
from modaltouch.record.chain import read_chain
from modaltouch.record.session import Session, read_session

CUT_SHORT = Path(__file__).with_name("cut_short.py")
RUN = ("--rig", "simulated", "--answers", "simulated", "--yes")
PROTOCOL = "demo"


@pytest.fixture(scope="module")
def by_rules(context, protocol_path, tmp_path_factory):
    """Return a function that starts ``modaltouch`` in a separate process under Windows' file rules."""
    started = []

    def begin(*words, cut=None, witness=None):
        witness = witness or tmp_path_factory.mktemp("witness") / "witness"
        plan = {"words": [str(word) for word in words], "windows": True, "cut": cut or {}, "witness": str(witness)}
        process = context.Process(
            target=runpy.run_path, args=(str(CUT_SHORT),), kwargs={"init_globals": {"PLAN": plan}}
        )
        process.start()
        started.append(process)
        return process

    yield begin
    for process in started:
        process.kill()
        process.join()


@pytest.fixture(scope="module")
def protocol(protocol_path):
    """A session of few trials."""
    return protocol_path.with_name(f"{PROTOCOL}.yaml")


def log_in(results):
    """Return the log of the participant's session."""
    return results / "simulated" / PROTOCOL / "sub-p07" / "ses-1" / "beh" / "session.jsonl"


def status(process):
    """Return the exit status of a process after its end."""
    process.join(60)
    assert process.exitcode is not None, "did not end within 60 s"
    return process.exitcode


@pytest.fixture(scope="module")
def whole(by_rules, protocol, tmp_path_factory):
    """The log of an uninterrupted session."""
    results = tmp_path_factory.mktemp("whole")
    assert status(by_rules("run", protocol, "-p", "p07", *RUN, "--results", results)) == 0
    return log_in(results)


def test_a_session_is_recorded_and_verified(whole, by_rules):
    """Complete, valid, byte for byte as on Unix, with its view, and without temporary files."""
    assert read_session(whole).complete
    assert audit_session(Session.find(whole)).problems == ()
    for path in whole.parents[3].rglob("*"):
        assert not path.name.endswith(".tmp")
        assert path.is_dir() or b"\r" not in path.read_bytes()
    assert status(by_rules("verify", whole.parent)) == 0
    assert status(by_rules("resume", whole.parent)) == 0


CUTS = {
    "first line torn": {"call": 9, "torn": 0.5},
    "before the log has its name": {"call": 11, "torn": 0.0},
    "as soon as it has": {"call": 12, "torn": 0.0},
    "line torn": {"call": 28, "torn": 0.5},
    "before the table is replaced": {"call": 45, "torn": 0.0},
    "stimulus": {"stimulus": 4, "signal": 9},
}


@pytest.mark.parametrize("cut", CUTS.values(), ids=list(CUTS))
def test_an_interrupted_session_continues(tmp_path, whole, by_rules, protocol, answers_of, cut):
    """No confirmed answer is lost, and the order is that of an uninterrupted session."""
    log, witness = log_in(tmp_path), tmp_path / "witness"
    words = "run", protocol, "-p", "p07", *RUN, "--results", tmp_path
    assert status(by_rules(*words, cut=cut, witness=witness)) != 0
    confirmed = witness.stat().st_size if witness.exists() else 0
    before = answers_of(log) if log.exists() else []
    assert len(before) >= confirmed - 1
    assert status(by_rules(*(("resume", log.parent) if log.exists() else words))) == 0
    assert answers_of(log)[: len(before)] == before
    assert answers_of(log) == answers_of(whole)
    assert read_chain(log).problems == ()
    assert audit_session(Session.find(log)).problems == ()


def test_one_of_two_simultaneous_runs_is_refused(tmp_path, by_rules, protocol):
    """The record is that of one session."""
    runs = [by_rules("run", protocol, "-p", "p07", *RUN, "--results", tmp_path) for _ in range(2)]
    assert sorted(status(process) for process in runs) == [0, 4]
    assert read_session(log_in(tmp_path)).complete
    assert audit_session(Session.find(log_in(tmp_path))).problems == ()
