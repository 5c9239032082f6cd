"""Doctor reports what a machine is missing, and what installs it, before a participant arrives."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from modaltouch.system import versions
from modaltouch.window import machine, opening
from modaltouch.window.interface import WindowError


def hide_libraries(monkeypatch: pytest.MonkeyPatch, *missing: str) -> None:
    """Make the loader miss some libraries, as on a bare Debian."""
    monkeypatch.setattr(machine, "is_loadable", lambda name: name not in missing)


def test_each_missing_library_is_reported_with_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a bare Debian without them pyglet ended in `Library "fontconfig" not found`."""
    hide_libraries(monkeypatch, "libfontconfig.so.1", "libGLU.so.1", "libportaudio.so.2")
    found = machine._libraries()
    assert found.state == "fault"
    assert found.found == "missing: libGLU.so.1 (libglu1-mesa), libfontconfig.so.1 (libfontconfig1)"
    assert found.remedy == "apt install libglu1-mesa libfontconfig1"
    packages = [package for check in opening.examine_machine(quick=True) for package in check.packages]
    assert packages[:3] == ["libglu1-mesa", "libfontconfig1", "libportaudio2"]


def test_a_missing_python_package_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each package whose version a record states is required, including pyglet, which draws the window."""
    monkeypatch.setattr(machine, "versions", lambda: versions() | {"pyglet": "absent"})
    found = machine._software()
    assert (found.state, found.found, found.remedy) == ("fault", "missing: pyglet", "reinstall modaltouch")


def test_a_graphics_card_with_its_own_drivers_does_not_need_mesa(monkeypatch: pytest.MonkeyPatch) -> None:
    """There Mesa's libraries are not reported missing; those that every machine needs are."""
    hide_libraries(monkeypatch, "libGLX_mesa.so.0", "libGLU.so.1")
    assert machine.missing_libraries() == {"libGLU.so.1": "libglu1-mesa"}


def test_a_window_error_identifies_the_missing_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """The message gives the missing library and the package to install."""
    hide_libraries(monkeypatch, "libfontconfig.so.1")
    assert machine.explain(ImportError('Library "fontconfig" not found.')) == (
        "the answer window cannot be drawn: this machine lacks libfontconfig.so.1; install the Debian packages "
        "libfontconfig1, or their equivalents on this system"
    )


@pytest.mark.window
def test_a_letter_is_drawn() -> None:
    """In a separate process, since a window has one display."""
    program = "from modaltouch.window import opening; print(opening._draw_letter().state)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == "ok"


def test_a_window_that_does_not_open_is_a_fault_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reason and the remedy are separate values."""

    def fail() -> None:
        raise WindowError("there is no display; log in at a screen")

    monkeypatch.setattr("modaltouch.window.opening.some_display", fail)
    found = opening._draw_letter()
    assert (found.state, found.found, found.remedy) == ("fault", "there is no display", "log in at a screen")


@pytest.mark.parametrize(("limit", "state"), [(0, "warning"), (10, "ok")])
def test_a_user_without_realtime_priority_is_warned(monkeypatch: pytest.MonkeyPatch, limit: int, state: str) -> None:
    """The limit `rtprio` of an ordinary user decides; root has none."""
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    monkeypatch.setattr(resource, "getrlimit", lambda which: (limit, limit))
    assert machine._precedence().state == state


def test_a_file_in_place_of_the_results_folder_is_a_fault(tmp_path: Path) -> None:
    """It was passed over for the folder above it, and `run` then failed."""
    (tmp_path / "results").write_text("")
    found = machine._disk(tmp_path / "results")
    assert (found.state, found.remedy) == ("fault", "give a folder you may write to with --results")
    assert machine._disk(tmp_path / "new" / "results").state == "ok"


def test_the_makefile_takes_its_packages_from_doctor() -> None:
    """There is one list of packages; the Makefile does not repeat any."""
    makefile = (Path(__file__).parents[2] / "Makefile").read_text(encoding="utf-8")
    assert "doctor --packages" in makefile
    assert not [package for package in machine.LIBRARIES.values() if package in makefile]
