"""Adaptive sessions and several stimuli on the simulated rig: killed, resumed, checked, forged."""

import json
import random
import shutil
import signal

import pytest

from modaltouch.record.audit import audit_session
from modaltouch.record.chain import GENESIS, encode_line, read_chain
from modaltouch.record.session import Session

RUN = ("--rig", "simulated", "--answers", "simulated", "--yes")


@pytest.fixture
def short(tmp_path, protocol_path):
    """Return the shipped adaptive protocol with short runs and a given rule."""

    def write(method):
        return _shorten(tmp_path, protocol_path, method)

    return write


def _shorten(tmp_path, protocol_path, method):
    folder = tmp_path / "protocols"
    shutil.copytree(protocol_path.parent, folder)
    file = folder / "threshold.yaml"
    text = file.read_text(encoding="utf-8").replace("method: quest_plus", f"method: {method}")
    text = text.replace("trials: 40", "trials: 9").replace("catch_trials: 10", "catch_trials: 3")
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize(("method", "n_trials"), [("staircase", 6), ("staircase", 17), ("quest_plus", 12)])
def test_a_killed_run_continues_at_the_same_level(
    tmp_path, short, start, finish, kill, wait_for_trials, answers_of, method, n_trials
):
    """SIGKILL and resume: levels and answers are those of an uninterrupted session; verify recomputes them."""
    protocol = short(method)
    logs = [tmp_path / name / "simulated/threshold/sub-p07/ses-1/beh/session.jsonl" for name in ("a", "b")]
    assert finish("run", protocol, "-p", "p07", *RUN, "--results", tmp_path / "a", timeout=120) == 0
    session = start("run", protocol, "-p", "p07", *RUN, "--results", tmp_path / "b")
    wait_for_trials(logs[1], n_trials, timeout=90)
    session.join(random.Random(n_trials).uniform(0, 0.04))
    kill(session, signal.SIGKILL)
    assert finish("resume", logs[1].parent, timeout=120) == 0
    assert answers_of(logs[1]) == answers_of(logs[0])
    levels = {condition["velocity_mm_s"] for practice, _, condition, _ in answers_of(logs[1]) if not practice}
    assert len(levels) > 4
    verdict = audit_session(Session.find(logs[1].parent))
    assert verdict.problems == ()
    assert "levels follow from the answers before them" in verdict.lines
    start_record = json.loads(logs[1].read_text(encoding="utf-8").splitlines()[0])
    assert start_record["schedule"]["levels"] == "adaptive"


def test_a_forged_level_is_detected(tmp_path, short, finish):
    """A level is changed in the record, with all checksums recomputed."""
    assert finish("run", short("staircase"), "-p", "p07", *RUN, "--results", tmp_path) == 0
    log = tmp_path / "simulated/threshold/sub-p07/ses-1/beh/session.jsonl"
    check, lines = GENESIS, []
    for event in read_chain(log).events:
        if event["event"] == "trial" and event["trial"]["index"] == 9 and not event["trial"]["practice"]:
            event["trial"]["condition"]["velocity_mm_s"] = 77.0
        line, check = encode_line(event, check)
        lines.append(line)
    log.write_bytes(b"".join(lines))
    problems = audit_session(Session.find(log.parent)).problems
    assert any("velocity_mm_s 77.0, but the answers before it lead to" in problem for problem in problems)


def test_a_killed_session_continues_with_its_stimuli(
    tmp_path, protocol_path, start, finish, kill, wait_for_trials, answers_of
):
    """SIGKILL and resume with two stimuli in memory: trials and answers of an uninterrupted session."""
    protocol = protocol_path.with_name("two_fields.yaml")
    logs = [tmp_path / name / "simulated/two_fields/sub-p07/ses-1/beh/session.jsonl" for name in ("a", "b")]
    assert finish("run", protocol, "-p", "p07", *RUN, "--results", tmp_path / "a", timeout=120) == 0
    session = start("run", protocol, "-p", "p07", *RUN, "--results", tmp_path / "b")
    wait_for_trials(logs[1], 11, timeout=90)
    kill(session, signal.SIGKILL)
    assert finish("resume", logs[1].parent, timeout=120) == 0
    assert answers_of(logs[1]) == answers_of(logs[0])
    assert {condition["stimulus"] for _, _, condition, _ in answers_of(logs[1])} == {"sharp", "blunt"}
    assert audit_session(Session.find(logs[1].parent)).problems == ()
