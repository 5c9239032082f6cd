"""The mutants that ``mutation.toml`` argues away are mutants of the code as it stands."""

from __future__ import annotations

import ast
import runpy
import tomllib
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
ARGUED = {
    module: part["argued"]
    for module, part in tomllib.loads((TESTS / "mutation.toml").read_text(encoding="utf-8")).items()
    if "argued" in part
}


@pytest.fixture(scope="module")
def mutants():
    """Return the function that lists all mutants of a module."""
    return runpy.run_path(str(TESTS / "mutation.py"))["mutants"]


@pytest.mark.parametrize("module", ARGUED)
def test_what_is_argued_away_can_still_be_made(module: str, mutants) -> None:
    """A renamed class or a joined module takes its arguments along."""
    source = (TESTS.parent / "src" / "modaltouch" / module).read_text(encoding="utf-8")
    assert set(ARGUED[module]) <= set(mutants(ast.parse(source)))
