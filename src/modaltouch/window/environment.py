"""Environment of PsychoPy: libraries, variables, error messages, and virtual displays."""

from __future__ import annotations

import ctypes
import importlib
import os
import select
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from modaltouch.window.interface import WindowError

LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libGLX_mesa.so.0": "libglx-mesa0",
    "libGLU.so.1": "libglu1-mesa",
    "libX11.so.6": "libx11-6",
    "libXext.so.6": "libxext6",
    "libfontconfig.so.1": "libfontconfig1",
    "libfreetype.so.6": "libfreetype6",
    "libfribidi.so.0": "libfribidi0",
}
"""Shared libraries required by the window on Linux, with the Debian package of each."""


class _PutOff(ModuleType):
    """Placeholder of a module until one of its names is used; Python's lazy loader would load it at a second import."""

    def __getattr__(self, name: str) -> Any:
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)


def missing_libraries() -> dict[str, str]:
    """Return the missing libraries of the window, with their Debian packages."""
    if not sys.platform.startswith("linux"):
        return {}
    missing = {name: package for name, package in LIBRARIES.items() if not is_loadable(name)}
    if is_loadable("libGLX_nvidia.so.0"):
        # A graphics card with its own drivers needs no Mesa drivers.
        return {name: package for name, package in missing.items() if "mesa" not in name}
    # The location of Mesa's drivers depends on its version and the system.
    patterns = ("dri/*_dri.so", "*/dri/*_dri.so", "libgallium*.so", "*/libgallium*.so")
    if not any(any(Path("/usr").glob(f"lib*/{pattern}")) for pattern in patterns):
        missing["the Mesa drivers"] = "libgl1-mesa-dri"
    return missing


def is_loadable(library: str) -> bool:
    """Return whether the dynamic loader finds a shared library."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


@contextmanager
def few_imports() -> Iterator[None]:
    """Import PsychoPy within this context without modules that no window needs, which halves the time to open one.

    Rarely used modules are imported at first use; optional ones cannot be imported meanwhile.
    """
    # These serve monitor files, spreadsheets and web fonts only.
    for name in ("json_tricks", "pandas", "requests", "scipy.interpolate"):
        if name not in sys.modules:
            sys.modules[name] = _PutOff(name)
    # PsychoPy does without these, which serve points in polygons and Excel files.
    hidden = [name for name in ("matplotlib", "openpyxl") if name not in sys.modules]
    # Python refuses to import a module whose entry in sys.modules is None.
    sys.modules.update(dict.fromkeys(hidden))  # type: ignore[arg-type]
    try:
        yield
    finally:
        for name in hidden:
            sys.modules.pop(name, None)


def prepare_environment() -> None:
    """Set the environment variables that PsychoPy reads on import.

    Raises
    ------
    WindowError
        If there is no display; importing PsychoPy would fail, now and later in this process.
    """
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise WindowError(
            "the answer window needs a display, but DISPLAY is not set; run it on the desktop, "
            "on a virtual display (`xvfb-run -s '-screen 0 1920x1080x24' modaltouch ...`), or answer without a "
            "window (`--answers simulated`)"
        )
    # Without these, PsychoPy puts its plug-in folders on sys.path and its clock follows the wall clock.
    os.environ.setdefault("PSYCHOPYNOPACKAGES", "1")
    os.environ.setdefault("PSYCH_GETSECS_CLOCK", "1")
    # Without a graphics card, drawing a frame would occupy all cores and delay bursts.
    os.environ.setdefault("LP_NUM_THREADS", str(max(1, (os.cpu_count() or 2) - 1)))
    # PsychoPy writes its settings into the home folder.
    name = "APPDATA" if sys.platform == "win32" else "HOME"
    if not os.access(os.environ.get(name, ""), os.W_OK | os.X_OK):
        os.environ[name] = tempfile.mkdtemp(prefix="modaltouch-home-")


def explain(error: Exception) -> str:
    """Return the explanation and remedy for a failure to open the display."""
    display = os.environ.get("DISPLAY", "")
    kind = type(error).__name__
    if missing := missing_libraries():
        return (
            f"the answer window cannot be drawn: this machine lacks {', '.join(missing)}; install the Debian packages "
            f"{' '.join(missing.values())}, or their equivalents on this system"
        )
    if "NoSuchDisplay" in kind:
        return (
            f"the answer window cannot reach the display {display!r}; check that DISPLAY is right and that the X "
            "server runs and accepts this user (`xdpyinfo`), then start again"
        )
    if "GLX" in str(error) or "GLX" in kind:
        return (
            f"the display {display!r} cannot draw with OpenGL ({error}); use one with GLX and 24-bit colour (a "
            "virtual one: `Xvfb -screen 0 1920x1080x24 +extension GLX`) and install libgl1 and libgl1-mesa-dri"
        )
    return f"the answer window cannot be opened on display {display!r}: {kind}: {error}; run `modaltouch doctor`"


def fit(size: tuple[int, int], monitor: int) -> tuple[int, int]:
    """Return the size, limited to that of the monitor [pixels].

    Raises
    ------
    WindowError
        If there is no such monitor, or the colour depth is too low, where pyglet would wait for its window forever.
    """
    import pyglet.canvas

    display = pyglet.canvas.get_display()
    monitors = display.get_screens()
    if sys.platform.startswith("linux"):
        from pyglet.libs.x11.xlib import XDefaultDepth

        if (depth := XDefaultDepth(display._display, display.x_screen)) < 24:
            raise WindowError(
                f"the display {os.environ.get('DISPLAY', '')!r} has colours of {depth} bits, but 24 are needed; set "
                "its X server to 24 bits"
            )
    if not 0 <= monitor < len(monitors):
        raise WindowError(
            f"given screen {monitor}, but this display has {len(monitors)}; allowed: 0 to {len(monitors) - 1}; "
            "choose one with --screen"
        )
    return min(size[0], monitors[monitor].width), min(size[1], monitors[monitor].height)


_PATIENCE = 60.0
"""Maximum time for Xvfb to report its display, and ten times the maximum time for it to end [s]."""


@contextmanager
def some_display() -> Iterator[str]:
    """Use the existing display, or a virtual one within the context.

    Yields
    ------
    str
        Description of the display.

    Raises
    ------
    WindowError
        If there is neither a display nor Xvfb.
    """
    if sys.platform != "linux" or os.environ.get("DISPLAY"):
        yield "the screen"
        return
    with virtual_display() as name:
        os.environ["DISPLAY"] = name
        try:
            yield f"a virtual display ({name}), as there is no screen"
        finally:
            os.environ.pop("DISPLAY")


@contextmanager
def virtual_display(size: tuple[int, int] = (1920, 1080), *options: str) -> Iterator[str]:
    """Run Xvfb on a free display number and yield the name of the display, such as ``:1``."""
    program = shutil.which("Xvfb")
    if program is None:
        raise WindowError("there is no display, and no Xvfb to make one: install xvfb, or log in at a screen")
    reading, writing = os.pipe()
    # -noreset keeps it alive between clients.
    screen = ("-screen", "0", f"{size[0]}x{size[1]}x24", "-nolisten", "tcp", "-noreset")
    server = subprocess.Popen(
        [program, "-displayfd", str(writing), *screen, *options], pass_fds=(writing,), stderr=subprocess.DEVNULL
    )
    os.close(writing)
    try:
        ready, _, _ = select.select([reading], [], [], _PATIENCE)
        number = os.read(reading, 16).decode().strip() if ready else ""
        if not number:
            how = "ended at once" if ready else f"did not start within {_PATIENCE:g} s"
            raise WindowError(f"{program} {how}; run `{program} -displayfd 1` by hand to see why")
        yield f":{number}"
    finally:
        os.close(reading)
        server.terminate()
        try:
            server.wait(_PATIENCE / 10)
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()
