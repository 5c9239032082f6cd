"""Which program made a record: its version and commit, and what took part.

The build executes this file for the version, so it imports the standard library alone.
"""

from __future__ import annotations

import os
import platform
import re
import subprocess
from functools import lru_cache
from pathlib import Path

RELEASE = "0.2.0"
"""The latest release, or the one in the making; tagged as ``v0.2.0``."""

PACKAGES = ("numpy", "scipy", "pandas", "statsmodels", "PyVISA", "PyVISA-py", "psychopy", "pyglet", "pydantic")

_PACKAGE = Path(__file__).resolve().parents[1]


def version() -> str:
    """Return the version, as ``0.2.0+g1bbd8eefd71e.dirty``; the release alone at its tag, or if no commit is known."""
    return _origin()[0]


def commit() -> str:
    """Return the commit that the code is of, marked ``+`` if changed; empty where neither build nor git tells."""
    return _origin()[1]


def versions() -> dict[str, str]:
    """Return the versions of the program, of Python, of the system and of the packages that take part."""
    from importlib import metadata  # which loads half of what reads mail

    found = {"modaltouch": version(), "python": platform.python_version(), "system": platform.platform()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "absent"
    return found


@lru_cache(maxsize=1)
def _origin() -> tuple[str, str]:
    """Return version and commit, as the build wrote them down beside the code, or as git tells them of a checkout."""
    built = _PACKAGE / "build.txt"
    if built.is_file():
        found, _, commit = built.read_text(encoding="ascii").strip().partition(" ")
        return found, commit
    told = re.fullmatch(r"(?:v.+-(\d+)-g)?([0-9a-f]{40,64})(-dirty)?", _describe(_PACKAGE.parents[1]))
    if told is None:
        return RELEASE, ""
    since_release, commit, dirty = told.groups()
    if dirty:
        return f"{RELEASE}+g{commit[:12]}.dirty", f"{commit}+"
    return RELEASE if since_release == "0" else f"{RELEASE}+g{commit[:12]}", commit


def _describe(root: Path) -> str:
    """Return what git says of a checkout of modaltouch; empty for any other folder, and where git fails."""
    words = ("describe", "--tags", "--long", "--always", "--dirty", "--abbrev=64", "--match", f"v{RELEASE}")
    # What runs in a hook of git is told of the repository of that hook.
    env = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        # An installed package may lie in a repository of somebody else.
        if 'name = "modaltouch"' not in (root / "pyproject.toml").read_text(encoding="utf-8"):
            return ""
        git = ["git", f"--git-dir={root / '.git'}", f"--work-tree={root}", *words]
        return subprocess.run(git, env=env, capture_output=True, text=True, timeout=5, check=True).stdout.strip()
    except (OSError, ValueError, subprocess.SubprocessError):
        return ""
