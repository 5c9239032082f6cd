"""An editable copy of the shipped protocols, and the distribution of the tests over processes."""

from __future__ import annotations

import gc
import shutil
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from _pytest.doctest import DoctestModule
from hypothesis import HealthCheck, settings

SHIPPED = Path(__file__).parents[1] / "protocols"
SOURCE = Path(__file__).parents[1] / "src"

Edit = Callable[..., Path]

LONGEST = (
    "tests/test_readme.py",
    "tests/session/test_durability.py",
    "tests/session/test_demo.py",
    "tests/session/test_in_the_window.py",
    "tests/session/test_stalls.py",
    "tests/lab/identification/test_verdict.py",
    "tests/lab/identification/test_identify.py",
    "tests/window/test_session_from_outside.py",
    "tests/session/test_kill_and_resume.py",
    "tests/session/test_resumption.py",
    "tests/session/test_sensation_level.py",
    "tests/session/console/test_terminal.py",
    "tests/rig/test_watchdog.py",
    "tests/golden/test_golden.py",
    "tests/cli/test_new.py",
    "tests/session/console/test_beside_the_window.py",
    "tests/session/test_disk_and_company.py",
    "tests/session/test_measured_fingers.py",
    "tests/session/test_by_windows_rules.py",
    "tests/window/test_screen.py",
    "tests/stimulus/test_fingers.py",
    "tests/test_wheel.py",
)
"""Files that take longest, begun first, so that no process is left with one of them when the others are done."""

TOGETHER = (
    tuple(
        f"tests/lab/identification/test_{name}.py"
        for name in ("identify", "apparatus_file", "export", "figures", "rows")
    ),
    ("tests/lab/validation/",),
)
"""Files that share what takes seconds to make: one process makes it for all of them."""

SPLIT = (
    "tests/session/test_durability.py",
    "tests/test_readme.py",
    "tests/session/test_resumption.py",
    "tests/session/test_in_the_window.py",
)
"""Files of which each test may run in another process: one takes longer than most files."""

# The time of an example depends more on the load of the machine than on the test. The suite tries the same examples
# every time, so that a change is judged by itself; `make fuzz` searches for new ones.
_ANY_MACHINE: dict[str, Any] = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("modaltouch", derandomize=True, **_ANY_MACHINE)
settings.register_profile("search", derandomize=False, max_examples=500, **_ANY_MACHINE)
settings.load_profile("modaltouch")


# What is collected stays in memory: searching it again and again for garbage is a fifth of the time of the collection.
gc.disable()


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Collect doctests only from files of the source that have one: searching the others takes time in each process."""
    found = yield
    if file_path.is_relative_to(SOURCE) and ">>> " in file_path.read_text(encoding="utf-8"):
        return found
    return [each for each in found if not isinstance(each, DoctestModule)]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the longest files first."""
    order = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.nodeid.partition("::")[0], len(LONGEST)))


def pytest_collection_finish() -> None:
    """Exempt the collected tests, which stay in memory, from further garbage collection."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep the tests of a file together under ``--dist loadfile``, except for the files to be split."""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            if nodeid.startswith(SPLIT):
                return nodeid
            together = (files[0] for files in TOGETHER if nodeid.startswith(files))
            return next(together, str(super()._split_scope(nodeid)))

    return Scheduling(config, log)


@contextmanager
def _blank(*kinds: str) -> Iterator[None]:
    """Compute every figure, but write blank files of some kinds: drawing takes longer than most analyses."""
    from modaltouch.report import page

    render = page.render
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "render", lambda figure, kind: b"<svg/>" if kind in kinds else render(figure, kind))
        yield


@pytest.fixture(scope="module")
def svg_alone() -> Iterator[None]:
    """Draw every figure as SVG only and leave its PNG blank, for files whose claims need one format."""
    with _blank("png"):
        yield


@pytest.fixture(scope="module")
def undrawn() -> Iterator[None]:
    """Leave the files of every figure blank, for files whose claims do not concern pictures."""
    with _blank("png", "svg"):
        yield


@pytest.fixture
def shipped() -> Path:
    """The folder of the shipped protocols."""
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
            assert text.count(old) == 1, f"{old!r} occurs {text.count(old)} times in {name}"
            text = text.replace(old, new)
        file.write_text(text, encoding="utf-8")
        return file

    return change


@pytest.fixture(scope="session")
def scribe() -> Callable[..., Path]:
    """Return a function that records a session in format 1, as a session does, without a rig."""
    return _record_session


def _record_session(
    preflight: Any,
    results: Path,
    participant: str = "p01",
    *,
    mode: Any = "real",
    session: int = 1,
    n_answered: int | None = None,
    answer: Callable[[Any], str] = lambda trial: "both",
    also: tuple[dict[str, Any], ...] = (),
) -> Path:
    """Record the answers that a function of the trial gives, and the further events in `also`; return the log."""
    from modaltouch.protocol.schedule import Schedule
    from modaltouch.record.folders import SessionFolder
    from modaltouch.record.log import SessionLog
    from modaltouch.record.session import Session
    from modaltouch.record.view import write_view
    from modaltouch.session.events import describe_start

    protocol, burst = preflight.experiment.protocol, preflight.stimulus.burst
    place = SessionFolder(results, mode, protocol.protocol, participant, session)
    schedule = Schedule.draw(protocol, participant, 1, session)
    facts = {
        **describe_start(preflight, schedule, place), "schema": 1, "seed": 1, "rig_choice": "TCPIP::10.0.0.1::INSTR",
        "answers_choice": "window", "rig": {"identity": "TEKTRONIX,AFG3022B,C010101,SCPI:99.0 FV:3.2.2"},
        "versions": {}, "boot": "",
    }  # fmt: skip
    silent = min(protocol.conditions.peak_velocities_mm_s)
    with SessionLog.create(place.log, "start", **facts) as log:
        for trial in (*schedule.practice, *schedule.trials[:n_answered]):
            amplitudes = list(burst.amplitude_for((trial.condition.velocity_mm_s or silent) * 1e-3))
            left, right = (round(speed * 1e3, 3) for speed in preflight.speeds(trial))
            speeds = {"speed_left_mm_s": left, "speed_right_mm_s": right}
            confirmed = {"commanded_amplitude": amplitudes, "confirmed_amplitude": amplitudes, "confirmed": True}
            log.append("fired", trial=trial.as_dict(), confirmed=confirmed)
            log.append(
                "trial",
                trial=trial.as_dict(),
                presentation=1,
                fingers=list(trial.condition.fingers(protocol.conditions.hand)),
                **({"catch": True} if trial.condition.is_catch else {}),
                planned={"velocity_mm_s": trial.condition.velocity_mm_s, **speeds},
                commanded={"amplitude_Vpp": amplitudes},
                confirmed=confirmed,
                response={"answer": answer(trial), "reaction_time": 0.8, "onset": "first_burst", "way": "free_hand",
                          "answered_by": "participant", "device": "key", "double": False},
                supersedes=None,
            )  # fmt: skip
        for event in also:
            log.append(**event)
        write_view(place, Session(log.path, tuple(log.events)), log.head)
    return place.log
