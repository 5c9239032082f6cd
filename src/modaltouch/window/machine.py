"""The machine: libraries, variables and displays for the window, and checks of what a session needs."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, NamedTuple

from modaltouch.system import sync_file, versions
from modaltouch.window.interface import WindowError

LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libGLX_mesa.so.0": "libglx-mesa0",  # brings Mesa's drivers
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
    if isinstance(error, ImportError):
        return (
            f"PsychoPy cannot be imported ({error}); install the project's environment again (`make install`), "
            "or answer without a window (`--answers simulated`)"
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
    # In a process group of its own, so that Ctrl-C reaches the session but not its display.
    server = subprocess.Popen(
        [program, "-displayfd", str(writing), *screen, *options],
        pass_fds=(writing,),
        stderr=subprocess.DEVNULL,
        process_group=0,
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


class MachineCheck(NamedTuple):
    """Result of one check of a machine."""

    subject: str  # subject of the check
    # ``ok``, ``warning`` (something optional is missing) or ``fault`` (a session cannot run)
    state: Literal["ok", "warning", "fault"]
    found: str  # what was found
    remedy: str = ""  # what to do; empty if nothing
    packages: Sequence[str] = ()  # missing Debian packages


def examine_installation() -> tuple[MachineCheck, ...]:
    """Check what the window needs to be installed."""
    return _software(), _display(), _libraries(), _fonts()


def examine_devices(results: Path, *, quick: bool) -> tuple[MachineCheck, ...]:
    """Check sound, USB, priority and, unless `quick`, the disk with the folder of the results."""
    return _sound(quick=quick), _usb(), _precedence(), *(() if quick else (_disk(results),))


def _software() -> MachineCheck:
    found = versions()
    listed = ", ".join(f"{name} {version}" for name, version in found.items() if name != "modaltouch")
    if missing := [name for name, version in found.items() if version == "absent"]:
        return MachineCheck("software", "fault", f"missing: {', '.join(missing)}", "reinstall modaltouch")
    return MachineCheck("software", "ok", listed)


def _display() -> MachineCheck:
    display, virtual = os.environ.get("DISPLAY", ""), shutil.which("Xvfb")
    if sys.platform != "linux" or display:
        return MachineCheck("display", "ok", f"DISPLAY={display}" if display else "the system's own")
    remedy = "log in at the screen, or install xvfb to run the demo without one"
    found = f"DISPLAY is not set; the demo uses {virtual}" if virtual else "DISPLAY is not set, and Xvfb is absent"
    return MachineCheck("display", "warning", found, remedy, [] if virtual else ["xvfb"])


def _libraries() -> MachineCheck:
    packages = list((missing := missing_libraries()).values())
    if missing:
        names = ", ".join(f"{name} ({package})" for name, package in missing.items())
        return MachineCheck("libraries", "fault", f"missing: {names}", f"apt install {' '.join(packages)}", packages)
    return MachineCheck("libraries", "ok", ", ".join(LIBRARIES) if sys.platform == "linux" else "the system's own")


def _fonts() -> MachineCheck:
    """Check for fonts of scripts beyond the bundled Latin, Greek, Cyrillic, Arabic and Hebrew."""
    from modaltouch.window.typesetting import Typesetter

    # A letter of Devanagari and an ideograph, with the Debian package of a font for each script.
    fonts = {"\u0915": "fonts-noto-core", "\u4e2d": "fonts-wqy-microhei"}
    packages = [package for letter, package in fonts.items() if Typesetter().lacking(letter)]
    if not packages:
        return MachineCheck("fonts", "ok", "Latin, Greek, Cyrillic, Arabic, Hebrew, Devanagari, Chinese, Japanese")
    remedy = f"where texts are in other scripts, apt install {' '.join(packages)}, or name a font in the texts"
    return MachineCheck("fonts", "warning", "no letters for some scripts", remedy, packages)


def _sound(*, quick: bool) -> MachineCheck:
    lacks = sys.platform == "linux" and not is_loadable("libportaudio.so.2")
    if quick:
        return MachineCheck("sound", "warning" if lacks else "ok", "PortAudio", packages=["libportaudio2"] * lacks)
    from modaltouch.window.masking import default_device

    try:
        device = default_device()
    except WindowError as error:
        remedy = "connect one, or install libportaudio2, where a protocol wants masking noise"
        return MachineCheck("sound", "warning", str(error).partition(";")[0], remedy)
    found = f"{device['name']}, {device['default_samplerate']:g} Hz, {device['max_output_channels']} channels"
    return MachineCheck("sound", "ok", found)


def _usb() -> MachineCheck:
    if importlib.util.find_spec("usb") is not None:
        from importlib.metadata import version

        return MachineCheck("USB", "ok", f"pyusb {version('pyusb')}")
    return MachineCheck(
        "USB", "warning", "pyusb is absent: a generator on USB is not found", "connect it by LAN, or install pyusb"
    )


def _precedence() -> MachineCheck:
    """Check whether `modaltouch.rig.watchdog_process`, which triggers bursts, may run at real-time priority."""
    if sys.platform != "linux":
        return MachineCheck("real time", "ok", "left to the system's scheduler")
    import resource

    if os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_RTPRIO)[0] > 0:
        return MachineCheck("real time", "ok", "bursts are triggered before all other work")
    line = f"{os.environ.get('USER', 'NAME')} - rtprio 10"
    return MachineCheck(
        "real time",
        "warning",
        "not allowed: on a busy machine bursts may be late or left out, and their trials are repeated",
        f"put `{line}` into /etc/security/limits.d/modaltouch.conf and log in again",
    )


def _disk(results: Path) -> MachineCheck:
    folder = next(path for path in (results, *results.resolve().parents) if path.exists())
    try:
        with tempfile.NamedTemporaryFile(dir=folder, buffering=0) as file:
            start = time.perf_counter()
            file.write(b"x" * 512)
            sync_file(file.fileno())
            elapsed = time.perf_counter() - start
    except OSError as error:
        found = f"{folder}: {error.strerror}"
        return MachineCheck("disk", "fault", found, "give a folder you may write to with --results")
    free = shutil.disk_usage(folder).free / 1e9
    found = f"{folder}: {free:.1f} GB free, a durable write takes {elapsed * 1e3:.1f} ms"
    if free < 0.1:
        return MachineCheck("disk", "fault", found, "free some space: a session needs a few megabytes")
    return MachineCheck("disk", "ok", found)
