"""`make demo`: simulated rig, real window, simulated participant typing, analysis, report."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from modaltouch.record.session import read_session


@pytest.mark.window
def test_the_demonstration_runs_without_a_screen(tmp_path):
    """A short session with record, screenshots and report, whose paths are printed."""
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    command = [sys.executable, "-m", "modaltouch", "demo", "--results", str(tmp_path / "results")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=170)
    assert done.returncode == 0, done.stderr
    places = dict(line.split(maxsplit=1) for line in done.stdout.splitlines() if str(tmp_path) in line)
    session = read_session(tmp_path / "results/simulated/demo/sub-demo/ses-1/beh/session.jsonl")
    assert session.complete
    assert session.mode == "simulated"
    assert {event["response"]["answered_by"] for event in session.trials} == {"simulated"}
    assert {event["response"]["device"] for event in session.trials} == {"key"}
    assert all(event["confirmed"]["confirmed"] for event in session.trials)
    shots = {path.name for path in Path(places["Screenshots"]).iterdir()}
    assert {"welcome.png", "question_one_hand_AC.png", "rest.png", "goodbye.png"} <= shots
    text = Path(places["Report"]).read_text(encoding="utf-8")
    assert "data:image" in text
    assert "http://" not in text.replace("http://www.w3.org", "")
