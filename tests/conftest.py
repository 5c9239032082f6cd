"""A copy of the shipped protocols that a test may spoil."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

SHIPPED = Path(__file__).parents[1] / "protocols"

Edit = Callable[..., Path]


@pytest.fixture
def shipped() -> Path:
    """Folder of the shipped protocols."""
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
            assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in {name}"
            text = text.replace(old, new)
        file.write_text(text, encoding="utf-8")
        return file

    return change
