"""A copy of the shipped protocols that a test may spoil; how the tests are shared out among processes."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

SHIPPED = Path(__file__).parents[1] / "protocols"

Edit = Callable[..., Path]

LONGEST = (
    "tests/test_readme.py",
    "tests/sessions/test_durability.py",
    "tests/sessions/test_in_the_window.py",
    "tests/window/test_session_from_outside.py",
    "tests/sessions/test_kill_and_resume.py",
    "tests/test_resumption.py",
    "tests/test_sensation.py",
    "tests/console/test_terminal.py",
    "tests/rig/test_watchdog.py",
    "tests/identification/test_identify.py",
)
"""Files that take longest, begun first, so that no process is left with one of them when the others are done."""

SPLIT = ("tests/sessions/test_durability.py",)
"""Files of which each test may run in another process: one takes longer than most files."""

# How long an example takes says more of what else the machine does than of the test. The suite tries the same examples
# every time, so that a change is judged by itself; `make fuzz` looks for new ones.
_ANY_MACHINE: dict[str, Any] = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("modaltouch", derandomize=True, **_ANY_MACHINE)
settings.register_profile("search", derandomize=False, max_examples=500, **_ANY_MACHINE)
settings.load_profile("modaltouch")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first."""
    order = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.nodeid.partition("::")[0], len(LONGEST)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep the tests of a file together under ``--dist loadfile``, but for the files to be split."""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return nodeid if nodeid.startswith(SPLIT) else str(super()._split_scope(nodeid))

    return Scheduling(config, log)


@pytest.fixture
def shipped() -> Path:
    """Folder of the shipped protocols."""
    return SHIPPED


@pytest.fixture
def edit(tmp_path: Path) -> Edit:
    """Return a function that replaces texts in a copy of a shipped file and returns the copy's path.

    ``edit("differentiated_stimulation.yaml", ("150, 200", "400"))``; the copy's folder holds all shipped files.
    """
    folder = tmp_path / "protocols"
    shutil.copytree(SHIPPED, folder)

    def change(name: str, *changes: tuple[str, str]) -> Path:
        file = folder / name
        text = file.read_text(encoding="utf-8")
        for old, new in changes:
            assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in {name}"
            text = text.replace(old, new)
        file.write_text(text, encoding="utf-8")
        return file

    return change
