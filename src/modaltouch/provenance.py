"""Which program made a record: versions of what took part, the commit, and since when the machine runs."""

from __future__ import annotations

import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from modaltouch import __version__

PACKAGES = ("numpy", "scipy", "pandas", "statsmodels", "PyVISA", "PyVISA-py", "psychopy", "pyglet", "pydantic")


def versions() -> dict[str, str]:
    """Return the versions of the program, of Python, of the system and of the packages that take part."""
    found = {"modaltouch": __version__, "python": platform.python_version(), "system": platform.platform()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "absent"
    return found


def commit() -> str:
    """Return the commit of the checkout that the code runs from, marked ``+`` if changed; empty elsewhere."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    try:
        head = _git(root, "rev-parse", "HEAD")
        changed = _git(root, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return ""
    return head + ("+" if changed else "")


def boot() -> str:
    """Return what tells one start of this machine from another; empty where the system does not say.

    The monotonic clock of a record counts from there.
    """
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""


def _git(root: Path, *words: str) -> str:
    done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, timeout=5, check=True)
    return done.stdout.strip()
