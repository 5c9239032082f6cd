"""Measurement of frames and keys on the virtual display, and the wording of the verdict."""

from __future__ import annotations

from typing import Any

import pytest

from modaltouch.window.opening import judge_window, time_window

GOOD: dict[str, Any] = {
    "display": "the screen",
    "n_frames": 120,
    "n_dropped": 0,
    "frame_median_ms": 1e3 / 60,
    "waits_for_monitor": True,
    "n_keys": 60,
    "n_lost": 0,
    "key_delay_p95_ms": 1.1,
}


@pytest.mark.window
def test_keys_injected_at_the_display_are_all_seen_in_time(screen: Any) -> None:
    """None is lost, each is stamped about one poll (1 ms) after injection; frames do not wait on a virtual display."""
    measured, verdict = time_window(screen, n_frames=30, n_keys=20)
    assert measured["n_lost"] == 0
    assert measured["key_path"] == "display server"
    assert 0 < measured["key_delay_median_ms"] < 10
    assert 0 < measured["frame_median_ms"] <= measured["frame_p95_ms"]
    assert measured["n_frames"] == 30
    assert verdict == judge_window(measured)


@pytest.mark.window
def test_without_an_x_server_no_key_is_timed(screen: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The window's own queue would leave out the path from the keyboard; frames are measured all the same."""
    monkeypatch.setattr("sys.platform", "darwin")
    measured, verdict = time_window(screen, n_frames=10, n_keys=10)
    assert (measured["key_path"], measured["n_keys"], measured["n_lost"]) == ("none", 0, 0)
    assert "No key was timed. Frames" in verdict


def test_the_verdict_on_a_good_machine() -> None:
    """Both parts are good, with the monitor's rate."""
    assert (
        judge_window(GOOD)
        == "On the screen: Keys are stamped within 1.1 ms (95 %): good. Frames follow the monitor at 60 Hz: good."
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"n_lost": 3}, "3 of 60 keys were lost: give the window the keyboard focus"),
        ({"key_delay_p95_ms": 17.0}, "Keys are stamped up to 17 ms late (95 %): close other programs"),
        ({"n_dropped": 5}, "5 of 120 frames came late: run full screen"),
        ({"waits_for_monitor": False}, "and switch on vertical synchronisation (vsync) there"),
        (
            {"display": "a virtual display (:1), as there is no screen"},
            "On a virtual display (:1), as there is no screen:",
        ),
    ],
)
def test_faults_are_reported_with_figure_and_remedy(change: dict[str, Any], words: str) -> None:
    """For each kind of fault."""
    assert words in judge_window(GOOD | change)


def test_a_window_that_lost_all_keys_is_reported() -> None:
    """With the sentence on frames, which need no key."""
    verdict = judge_window(GOOD | {"n_lost": 60, "key_delay_p95_ms": None})
    assert "until none is. No key was timed. Frames follow the monitor at 60 Hz" in verdict
