"""What this machine has of what a session needs, and what to do about the rest."""

from __future__ import annotations

import ctypes.util
import importlib.util
import os
import shutil
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from modaltouch.provenance import versions


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    subject : str
        What was looked at.
    state : str
        ``ok``, ``warning`` (something optional is absent) or ``fault`` (a session cannot run).
    found : str
        What is there.
    remedy : str
        What to do; empty where all is well.
    """

    subject: str
    state: Literal["ok", "warning", "fault"]
    found: str
    remedy: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the finding as plain values."""
        return asdict(self)


def examine_machine(results: Path) -> tuple[Finding, ...]:
    """Look at everything a session needs, without opening a window or an instrument.

    Parameters
    ----------
    results : Path
        Where sessions would be recorded.
    """
    return (
        _python(),
        *_packages(),
        _display(),
        _opengl(),
        _virtual_display(),
        _sound(),
        _visa(),
        _usb(),
        _disk(results),
    )


def _python() -> Finding:
    found = f"Python {versions()['python']} on {versions()['system']}"
    if (3, 11) <= sys.version_info[:2] <= (3, 12):
        return Finding("python", "ok", found)
    return Finding("python", "fault", found, "use Python 3.11 or 3.12: PsychoPy ends below 3.13")


def _packages() -> list[Finding]:
    required = ("numpy", "scipy", "pandas", "statsmodels", "PyVISA", "PyVISA-py", "psychopy")
    found, missing = [], []
    for package in required:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            missing.append(package)
    if missing:
        return [Finding("packages", "fault", f"missing: {', '.join(missing)}", "run `make install`")]
    return [Finding("packages", "ok", ", ".join(found))]


def _display() -> Finding:
    if sys.platform in ("win32", "darwin"):
        return Finding("display", "ok", "the system's own")
    display = os.environ.get("DISPLAY", "")
    if display:
        return Finding("display", "ok", f"DISPLAY={display}")
    return Finding(
        "display",
        "warning",
        "DISPLAY is not set",
        "log in at the screen; the demo brings a virtual display of its own",
    )


def _opengl() -> Finding:
    if sys.platform in ("win32", "darwin"):
        return Finding("OpenGL", "ok", "the system's own")
    missing = [name for name in ("GL", "GLU") if ctypes.util.find_library(name) is None]
    if missing:
        names = ", ".join(f"lib{name}" for name in missing)
        return Finding("OpenGL", "fault", f"missing: {names}", "install libgl1, libgl1-mesa-dri and libglu1-mesa")
    return Finding("OpenGL", "ok", "libGL, libGLU")


def _virtual_display() -> Finding:
    if sys.platform != "linux":
        return Finding("virtual display", "ok", "not needed")
    path = shutil.which("Xvfb")
    if path:
        return Finding("virtual display", "ok", path)
    return Finding("virtual display", "warning", "Xvfb is absent", "install xvfb to run the demo without a screen")


def _sound() -> Finding:
    from modaltouch.masking.device import DeviceError, default_device

    try:
        device = default_device()
    except DeviceError as error:
        remedy = "connect one, or install libportaudio2, where a protocol wants masking noise"
        return Finding("sound", "warning", str(error).partition(";")[0], remedy)
    found = f"{device['name']}, {device['default_samplerate']:g} Hz, {device['max_output_channels']} channels"
    return Finding("sound", "ok", found)


def _visa() -> Finding:
    try:
        return Finding("VISA", "ok", f"PyVISA {version('PyVISA')} with PyVISA-py {version('PyVISA-py')}: LAN (VXI-11)")
    except PackageNotFoundError:
        return Finding("VISA", "fault", "PyVISA or PyVISA-py is absent", "run `make install`")


def _usb() -> Finding:
    if importlib.util.find_spec("usb") is not None:
        return Finding("USB", "ok", f"pyusb {version('pyusb')}")
    return Finding(
        "USB",
        "warning",
        "pyusb is absent: a generator on USB is not found",
        "connect it by LAN, or install pyusb",
    )


def _disk(results: Path) -> Finding:
    folder = next(path for path in (results, *results.resolve().parents) if path.is_dir())
    try:
        with tempfile.NamedTemporaryFile(dir=folder) as file:
            start = time.perf_counter()
            file.write(b"x" * 512)
            file.flush()
            os.fsync(file.fileno())
            elapsed = time.perf_counter() - start
    except OSError as error:
        remedy = "give a folder you may write to with --results"
        return Finding("disk", "fault", f"{folder}: {error.strerror}", remedy)
    free = shutil.disk_usage(folder).free / 1e9
    found = f"{folder}: {free:.1f} GB free, a durable write takes {elapsed * 1e3:.1f} ms"
    if free < 0.1:
        return Finding("disk", "fault", found, "free some space: a session needs a few megabytes")
    return Finding("disk", "ok", found)
