"""The demonstration beside another one: a number that is taken meanwhile is left to it."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from modaltouch import analysis
from modaltouch import session as sessions
from modaltouch.cli.run import demonstrate
from modaltouch.record.chain import RecordExistsError
from modaltouch.window import WindowOptions


def test_a_number_that_another_demonstration_takes_meanwhile_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Session 1 was there; 2 and 3 are begun by others while this one opens its window; 4 is its own, in all places."""
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
    monkeypatch.setattr("modaltouch.window.environment.some_display", lambda: nullcontext("the screen"))
    outcome = demonstrate(
        tmp_path, seed=1, window_options=WindowOptions(), tell=said.append, on_progress=lambda done, total: None
    )
    assert tried == [2, 3, 4]
    assert [line.split()[1] for line in said[:-1]] == ["2", "3", "4"]
    traces = root / "derivatives" / "sub-demo_ses-4"
    assert outcome["session"] == root / "sub-demo" / "ses-4" / "beh"
    assert (outcome["screenshots"], outcome["report"]) == (traces / "screenshots", traces / "analysis" / "report.html")
