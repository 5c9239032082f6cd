"""A demonstration beside another one leaves it the session numbers that it takes meanwhile."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from modaltouch import analysis
from modaltouch import session as sessions
from modaltouch.cli.run import demonstrate
from modaltouch.record.chain import RecordExistsError
from modaltouch.window import WindowOptions


def test_a_session_number_taken_by_another_demonstration_is_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Session 1 exists, others start 2 and 3 while this one opens its window, so it uses 4 everywhere."""
    tried, said = [], []
    root = tmp_path / "simulated" / "demo"
    first = root / "sub-demo" / "ses-1" / "beh" / "session.jsonl"
    first.parent.mkdir(parents=True)
    first.touch()

    def begin(setup):
        tried.append(setup.place.session)
        if setup.place.session < 4:
            raise RecordExistsError("another program is running this session now")
        return SimpleNamespace(path=setup.place.log, n_answered=12)

    def analyse(session, out, mode):
        return SimpleNamespace(files={"report.html": out / "report.html"})

    monkeypatch.setattr(sessions, "begin", begin)
    monkeypatch.setattr(analysis, "analyse", analyse)
    monkeypatch.setattr("modaltouch.window.machine.some_display", lambda: nullcontext("the screen"))
    outcome = demonstrate(
        tmp_path, seed=1, window_options=WindowOptions(), tell=said.append, on_progress=lambda done, total: None
    )
    assert tried == [2, 3, 4]
    assert [line.split()[1] for line in said[:-1]] == ["2", "3", "4"]
    traces = root / "derivatives" / "sub-demo_ses-4"
    assert outcome["session"] == root / "sub-demo" / "ses-4" / "beh"
    assert (outcome["screenshots"], outcome["report"]) == (traces / "screenshots", traces / "analysis" / "report.html")
