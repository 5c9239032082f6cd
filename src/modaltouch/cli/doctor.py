"""What this machine has of what a session needs, and what to do about the rest."""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal

from modaltouch.system import sync_file, versions


@dataclass(frozen=True)
class MachineCheck:
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


def examine_machine(results: Path) -> tuple[MachineCheck, ...]:
    """Look at everything a session needs, and draw a letter in the window; no instrument is opened."""
    from modaltouch.window import examine_surroundings

    return (
        _python(),
        *_packages(),
        *(MachineCheck(*check[:4]) for check in examine_surroundings()),
        _visa(),
        _usb(),
        _precedence(),
        _disk(results),
    )


def missing_packages() -> list[str]:
    """Return the Debian packages that hold what this machine lacks for a session, a test or the demonstration."""
    from modaltouch.window import examine_surroundings

    return [package for check in examine_surroundings(quick=True) for package in check.packages]


def _python() -> MachineCheck:
    found = f"Python {versions()['python']} on {versions()['system']}"
    if (3, 11) <= sys.version_info[:2] <= (3, 12):
        return MachineCheck("python", "ok", found)
    return MachineCheck("python", "fault", found, "use Python 3.11 or 3.12: PsychoPy ends below 3.13")


def _packages() -> list[MachineCheck]:
    required = ("numpy", "scipy", "pandas", "statsmodels", "PyVISA", "PyVISA-py", "psychopy")
    found, missing = [], []
    for package in required:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            missing.append(package)
    if missing:
        return [MachineCheck("packages", "fault", f"missing: {', '.join(missing)}", "install modaltouch anew")]
    return [MachineCheck("packages", "ok", ", ".join(found))]


def _visa() -> MachineCheck:
    try:
        return MachineCheck(
            "VISA", "ok", f"PyVISA {version('PyVISA')} with PyVISA-py {version('PyVISA-py')}: LAN (VXI-11)"
        )
    except PackageNotFoundError:
        return MachineCheck("VISA", "fault", "PyVISA or PyVISA-py is absent", "install modaltouch anew")


def _usb() -> MachineCheck:
    if importlib.util.find_spec("usb") is not None:
        return MachineCheck("USB", "ok", f"pyusb {version('pyusb')}")
    found = "pyusb is absent: a generator on USB is not found"
    return MachineCheck("USB", "warning", found, "connect it by LAN, or install pyusb")


def _precedence() -> MachineCheck:
    """Find out whether the process that triggers bursts may go before others (`modaltouch.rig.watchdog_process`)."""
    if sys.platform != "linux":
        return MachineCheck("real time", "ok", "as the system shares out its processors")
    import resource

    if os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_RTPRIO)[0] > 0:
        return MachineCheck("real time", "ok", "bursts are triggered before all other work")
    user = os.environ.get("USER", "NAME")
    remedy = f"put `{user} - rtprio 10` into /etc/security/limits.d/modaltouch.conf and log in again"
    found = "not allowed: on a busy machine bursts come late, are left out, and trials are repeated"
    return MachineCheck("real time", "warning", found, remedy)


def _disk(results: Path) -> MachineCheck:
    folder = next(path for path in (results, *results.resolve().parents) if path.is_dir())
    try:
        with tempfile.NamedTemporaryFile(dir=folder) as file:
            start = time.perf_counter()
            file.write(b"x" * 512)
            file.flush()
            sync_file(file.fileno())
            elapsed = time.perf_counter() - start
    except OSError as error:
        remedy = "give a folder you may write to with --results"
        return MachineCheck("disk", "fault", f"{folder}: {error.strerror}", remedy)
    free = shutil.disk_usage(folder).free / 1e9
    found = f"{folder}: {free:.1f} GB free, a durable write takes {elapsed * 1e3:.1f} ms"
    if free < 0.1:
        return MachineCheck("disk", "fault", found, "free some space: a session needs a few megabytes")
    return MachineCheck("disk", "ok", found)
