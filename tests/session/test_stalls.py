"""A session whose processes are repeatedly stopped ends normally; `make stalls` tries twenty demos."""

import pytest
from stalls import run_stopped

from modaltouch.window.machine import virtual_display


@pytest.mark.window
def test_a_repeatedly_stopped_session_is_completed(tmp_path, edit):
    """SIGSTOP for 0.8 s every 2 to 4 s, for the session, its watchdog or both: four answers, exit status 0."""
    protocol = edit(
        "demo.yaml",
        ("[one_hand, two_hands]", "[one_hand]"),
        ("[[A, C], [B, D], [C, E]]", "[[A, C], [B, D]]"),
        ("practice_trials: 1", "practice_trials: 0"),
        ("break_after_trials: 6", "break_after_trials: 2"),
    )
    words = ["run", str(protocol), "-p", "p01", "--rig", "simulated", "--answers", "robot", "--yes"]
    log = tmp_path / "results/simulated/demo/sub-p01/ses-1/beh/session.jsonl"
    with virtual_display((1280, 800)) as name:
        outcome = run_stopped([*words, "--results", str(tmp_path / "results")], 5, log, display=name, longest=150)
    assert outcome.status == 0, outcome
    assert outcome.verified
    assert outcome.n_answered >= 4
    assert outcome.n_stops >= 3
