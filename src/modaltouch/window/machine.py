"""Checks of this machine for sessions, and measurement of its timing of pictures and keys."""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from modaltouch.system import sync_file, versions
from modaltouch.window.display_loop import POLL_INTERVAL
from modaltouch.window.environment import LIBRARIES, is_loadable, missing_libraries, some_display
from modaltouch.window.interface import WindowError
from modaltouch.window.masking import DeviceError, default_device
from modaltouch.window.screen import Screen
from modaltouch.window.shapes import Box, Picture, Words, rectangle
from modaltouch.window.typesetting import Typesetter

_TIMEOUT = 0.5
"""Time after which an unseen key counts as lost [s]."""


class MachineCheck(NamedTuple):
    """Result of one check of a machine."""

    subject: str  # subject of the check
    # ``ok``, ``warning`` (something optional is missing) or ``fault`` (a session cannot run)
    state: Literal["ok", "warning", "fault"]
    found: str  # what was found
    remedy: str = ""  # what to do; empty if nothing
    packages: Sequence[str] = ()  # missing Debian packages


def examine_machine(results: Path = Path("results"), *, quick: bool = False) -> tuple[MachineCheck, ...]:
    """Check what a session needs on this machine, including a test drawing; no instrument is opened.

    Parameters
    ----------
    results : Path
        Folder where sessions will be recorded.
    quick : bool
        Whether to check only installed software, without window, sound device and disk.
    """
    return (
        _python(),
        _packages(),
        _display(),
        _libraries(),
        _virtual_display(),
        _fonts(),
        *(() if quick else (_window(),)),
        _sound(quick=quick),
        _usb(),
        _precedence(),
        *(() if quick else (_disk(results),)),
    )


def _display() -> MachineCheck:
    own, display = sys.platform in ("win32", "darwin"), os.environ.get("DISPLAY", "")
    if own or display:
        return MachineCheck("display", "ok", "the system's own" if own else f"DISPLAY={display}")
    return MachineCheck(
        "display", "warning", "DISPLAY is not set", "log in at the screen; the demo brings its own virtual display"
    )


def _libraries() -> MachineCheck:
    packages = list((missing := missing_libraries()).values())
    if missing:
        names = ", ".join(f"{name} ({package})" for name, package in missing.items())
        return MachineCheck("libraries", "fault", f"missing: {names}", f"apt install {' '.join(packages)}", packages)
    return MachineCheck("libraries", "ok", ", ".join(LIBRARIES) if sys.platform == "linux" else "the system's own")


def _virtual_display() -> MachineCheck:
    if sys.platform != "linux":
        return MachineCheck("virtual display", "ok", "not needed")
    if path := shutil.which("Xvfb"):
        return MachineCheck("virtual display", "ok", path)
    return MachineCheck(
        "virtual display", "warning", "Xvfb is absent", "install xvfb to run the demo without a screen", ["xvfb"]
    )


def _fonts() -> MachineCheck:
    """Check for fonts of scripts beyond the bundled Latin, Greek, Cyrillic, Arabic and Hebrew."""
    # A letter of Devanagari and an ideograph, with the Debian package of a font for each script.
    fonts = {"\u0915": "fonts-noto-core", "\u4e2d": "fonts-wqy-microhei"}
    packages = [package for letter, package in fonts.items() if Typesetter().lacking(letter)]
    if not packages:
        return MachineCheck("fonts", "ok", "Latin, Greek, Cyrillic, Arabic, Hebrew, Devanagari, Chinese, Japanese")
    remedy = f"where texts are in other scripts, apt install {' '.join(packages)}, or name a font in the texts"
    return MachineCheck("fonts", "warning", "no letters for some scripts", remedy, packages)


def _window() -> MachineCheck:
    """Draw a letter in the window, which requires a display, OpenGL, fonts and PsychoPy."""
    try:
        with (
            some_display() as where,
            tempfile.TemporaryDirectory() as folder,
            closing(Screen(size=(320, 200), title="modaltouch doctor")) as screen,
        ):
            screen.draw(Picture("letter", (Words("A", Box(0.0, 0.0, 0.8, 0.8), 0.5, "#ffffff"),)))
            screen.flip(Path(folder) / "letter.png")
            from matplotlib.image import imread  # loaded after PsychoPy, which it would slow down

            is_lit = (imread(Path(folder) / "letter.png")[..., :3] > 0.5).any()
            renderer = screen.describe()["renderer"]
    except WindowError as error:
        return MachineCheck("window", "fault", *str(error).split("; ", 1))
    if not is_lit:
        found = f"no letter can be seen on {where}"
        return MachineCheck("window", "fault", found, "install fonts and a driver for OpenGL")
    return MachineCheck("window", "ok", f"a letter is drawn on {where} ({renderer})")


def _sound(*, quick: bool) -> MachineCheck:
    lacks = sys.platform == "linux" and not is_loadable("libportaudio.so.2")
    if quick:
        return MachineCheck("sound", "warning" if lacks else "ok", "PortAudio", packages=["libportaudio2"] * lacks)
    try:
        device = default_device()
    except DeviceError as error:
        remedy = "connect one, or install libportaudio2, where a protocol wants masking noise"
        return MachineCheck("sound", "warning", str(error).partition(";")[0], remedy)
    found = f"{device['name']}, {device['default_samplerate']:g} Hz, {device['max_output_channels']} channels"
    return MachineCheck("sound", "ok", found)


def _python() -> MachineCheck:
    found = f"Python {versions()['python']} on {versions()['system']}"
    if (3, 11) <= sys.version_info[:2] <= (3, 12):
        return MachineCheck("python", "ok", found)
    return MachineCheck("python", "fault", found, "use Python 3.11 or 3.12: PsychoPy does not support 3.13 or later")


def _packages() -> MachineCheck:
    found = {name: version for name, version in versions().items() if name not in ("modaltouch", "python", "system")}
    if missing := [name for name, version in found.items() if version == "absent"]:
        return MachineCheck("packages", "fault", f"missing: {', '.join(missing)}", "reinstall modaltouch")
    return MachineCheck("packages", "ok", ", ".join(f"{name} {version}" for name, version in found.items()))


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
    folder = next(path for path in (results, *results.resolve().parents) if path.is_dir())
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


def time_window(
    screen: Screen, *, n_frames: int = 120, n_keys: int = 60, display: str = "the screen"
) -> tuple[dict[str, Any], str]:
    """Measure the timing of pictures and keys in an open window with keyboard focus, and assess it.

    Returns
    -------
    figures : dict
        ``display``, a description of the display; ``n_frames``, and ``n_dropped`` of at least 1.5 times the usual
        duration; ``waits_for_monitor``, whether frames follow a monitor's refresh; ``n_keys`` injected, ``n_lost``
        never seen, and ``key_path``: ``display server`` (as from a keyboard) or ``event queue`` (of the window, if
        nothing else is available); time between frames (``frame_median_ms``, ``frame_p95_ms``), and from the injection
        of a key to its time stamp (``key_delay_median_ms``, ``key_delay_p95_ms``, ``key_delay_max_ms``), None if no key
        was seen.
    verdict : str
        Consequences for an experiment, and what to do.
    """
    frames = _measure_frames(screen, n_frames) * 1e3
    with _injector(screen) as (press, path):
        delays = [_measure_key(screen, press, number) for number in range(n_keys)]
    seen = [delay * 1e3 for delay in delays if delay is not None]
    usual = float(np.median(frames))
    figures = {
        "display": display,
        "n_frames": n_frames,
        "n_dropped": int(np.sum(frames > 1.5 * usual)),
        # No monitor refreshes in less than 4 ms.
        "waits_for_monitor": usual > 4.0 and float(np.quantile(frames, 0.1)) > 0.8 * usual,
        "n_keys": n_keys,
        "n_lost": n_keys - len(seen),
        "key_path": path,
        "frame_median_ms": round(usual, 3),
        "frame_p95_ms": round(float(np.quantile(frames, 0.95)), 3),
        "key_delay_median_ms": round(float(np.median(seen)), 3) if seen else None,
        "key_delay_p95_ms": round(float(np.quantile(seen, 0.95)), 3) if seen else None,
        "key_delay_max_ms": round(max(seen), 3) if seen else None,
    }
    return figures, judge_window(figures)


def judge_window(figures: Mapping[str, Any]) -> str:
    """Return what the timing figures of a window mean for an experiment, with advice."""
    lines, delay = [f"On {figures['display']}:"], figures["key_delay_p95_ms"]
    if figures["n_lost"]:
        lines.append(
            f"{figures['n_lost']} of {figures['n_keys']} keys were lost: give the window the keyboard focus, and do "
            "not run participants here until none is."
        )
    if delay is None:
        return " ".join(lines)
    if delay > 5:
        lines.append(
            f"Keys are stamped up to {delay:.0f} ms late (95 %): close other programs, and state this with every "
            "reaction time."
        )
    else:
        lines.append(f"Keys are stamped within {delay:.1f} ms (95 %): good.")
    if not figures["waits_for_monitor"]:
        lines.append(
            "Frames do not wait for a monitor, so the time at which one shows them is unknown: measure on the "
            "participants' own screen, and switch on vertical synchronisation (vsync) there."
        )
    elif figures["n_dropped"] > 0.01 * figures["n_frames"]:
        lines.append(
            f"{figures['n_dropped']} of {figures['n_frames']} frames came late: run full screen, without a compositor, "
            "and close other programs."
        )
    else:
        lines.append(f"Frames follow the monitor at {1e3 / figures['frame_median_ms']:.0f} Hz: good.")
    return " ".join(lines)


def _measure_frames(screen: Screen, n_frames: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the times between frames of two alternating pictures [s]."""
    pictures = [Picture(f"timing_{x}", (rectangle(Box(x, 0, 0.1, 0.1), "#808080"),)) for x in (-0.2, 0.2)]
    shown = []
    for number in range(n_frames + 3):
        screen.draw(pictures[number % 2])
        shown.append(screen.flip())
    # The first two frames also prepare the marks.
    return np.diff(shown[2:])


def _measure_key(screen: Screen, press: Callable[[], float], number: int) -> float | None:
    """Return the time from a key's injection to its time stamp, polled as in a session [s]; None if lost."""
    screen.poll()
    # Vary the phase of presses relative to the poll.
    until = time.perf_counter() + 0.02 + (number * 0.618 % 1) * POLL_INTERVAL
    while time.perf_counter() < until:
        time.sleep(1e-4)
    injected = press()
    while time.perf_counter() < injected + _TIMEOUT:
        for event in screen.poll():
            if event.kind == "key":
                return event.time - injected
        time.sleep(POLL_INTERVAL)
    return None


@contextmanager
def _injector(screen: Screen) -> Iterator[tuple[Callable[[], float], str]]:
    """Yield a function that presses and releases F12 and returns the time, and the path of the key."""
    if not sys.platform.startswith("linux"):

        def type_key() -> float:
            now = time.perf_counter()
            screen.type_key("f12", down=True)
            screen.type_key("f12", down=False)
            return now

        yield type_key, "event queue"
        return
    # A dependency of PsychoPy.
    from Xlib import X, display
    from Xlib.ext import xtest

    with closing(display.Display()) as server:
        code = server.keysym_to_keycode(0xFFC9)  # F12, to which no program reacts

        def press() -> float:
            xtest.fake_input(server, X.KeyPress, code)
            now = time.perf_counter()
            server.sync()
            xtest.fake_input(server, X.KeyRelease, code)
            server.sync()
            return now

        yield press, "display server"
