"""Trials that time out: recorded, verified, and described in the BIDS view."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from modaltouch.record import audit_session
from modaltouch.session import simulate_session


@pytest.mark.parametrize("until", ["answer", "question"])
def test_a_session_with_time_outs_is_complete(edit: Callable[..., Path], tmp_path: Path, until: str) -> None:
    """Simulated answers take about a second: with 1.2 s some are in time and some are not."""
    delay = 0.3 if until == "answer" else 0.0
    changes = ("stimulus_until: answer", f"stimulus_until: {until}\n  time_out_s: {1.2 - delay}")
    session = simulate_session(edit("demo.yaml", changes), "p01", tmp_path)
    assert session.complete
    assert audit_session(session).problems == ()
    times: dict[str, list[float]] = {"time_out": [], "answer": []}
    for row in session.table():
        times["time_out" if row["response"] == "time_out" else "answer"].append(row["response_time"])
    assert times["time_out"] == pytest.approx([1.2] * len(times["time_out"]))
    assert max(times["answer"]) <= 1.2
    assert len(times["time_out"]) + len(times["answer"]) == 13
    (side,) = session.path.parent.glob("*_beh.json")
    assert json.loads(side.read_text())["response"]["Levels"]["time_out"] == "no answer in time"
