"""Provenance of a record: version and commit of the program, and versions of its packages.

The build executes this file to get the version, so it imports only the standard library.
"""

from __future__ import annotations

import os
import platform
import re
import subprocess
from functools import lru_cache
from pathlib import Path

RELEASE = "0.2.0"
"""The latest or upcoming release; tagged as ``v0.2.0``."""

PACKAGES = ("numpy", "scipy", "pandas", "statsmodels", "PyVISA", "PyVISA-py", "psychopy", "pyglet", "pydantic")

_PACKAGE = Path(__file__).resolve().parents[1]


def version() -> str:
    """Return the version, such as ``0.2.0+g1bbd8eefd71e.dirty``; just the release if at its tag or commit unknown."""
    return _origin()[0]


def commit() -> str:
    """Return the commit of the code, with ``+`` if modified since; empty if unknown to both build and git."""
    return _origin()[1]


def versions() -> dict[str, str]:
    """Return the versions of the program, Python, the system and `PACKAGES`; ``absent`` if not installed."""
    from importlib import metadata  # imported late: it loads much of the email package

    found = {"modaltouch": version(), "python": platform.python_version(), "system": platform.platform()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "absent"
    return found


@lru_cache(maxsize=1)
def _origin() -> tuple[str, str]:
    """Return version and commit, from the file written by the build or from git in a checkout."""
    built = _PACKAGE / "build.txt"
    if built.is_file():
        found, _, commit = built.read_text(encoding="ascii").strip().partition(" ")
        return found, commit
    described = re.fullmatch(r"(?:v.+-(\d+)-g)?([0-9a-f]{40,64})(-dirty)?", _describe(_PACKAGE.parents[1]))
    if described is None:
        return RELEASE, ""
    since_release, commit, dirty = described.groups()
    if dirty:
        return f"{RELEASE}+g{commit[:12]}.dirty", f"{commit}+"
    return RELEASE if since_release == "0" else f"{RELEASE}+g{commit[:12]}", commit


def _describe(root: Path) -> str:
    """Return the output of ``git describe`` in a checkout of modaltouch; empty for other folders or if git fails."""
    words = ("describe", "--tags", "--long", "--always", "--dirty", "--abbrev=64", "--match", f"v{RELEASE}")
    # In a git hook, variables named GIT_* point to the hook's repository.
    env = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        # An installed package may be inside another project's repository.
        if 'name = "modaltouch"' not in (root / "pyproject.toml").read_text(encoding="utf-8"):
            return ""
        git = ["git", f"--git-dir={root / '.git'}", f"--work-tree={root}", *words]
        return subprocess.run(git, env=env, capture_output=True, text=True, timeout=5, check=True).stdout.strip()
    except (OSError, ValueError, subprocess.SubprocessError):
        return ""
