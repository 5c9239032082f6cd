"""The modules, tests and mutants that ``mutation.toml`` lists exist."""

from __future__ import annotations

import ast
import runpy
import tomllib
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
PLAN = tomllib.loads((TESTS / "mutation.toml").read_text(encoding="utf-8"))
ARGUED = {module: part["argued"] for module, part in PLAN.items() if "argued" in part}


@pytest.fixture(scope="module")
def mutants():
    """Return the function that lists all mutants of a module."""
    return runpy.run_path(str(TESTS / "mutation.py"))["mutants"]


@pytest.mark.parametrize("module", PLAN)
def test_the_tests_listed_for_a_module_exist(module: str) -> None:
    """After a module is removed or a test renamed, its mutants would no longer be examined."""
    assert (TESTS.parent / "src" / "modaltouch" / module).is_file()
    for test in PLAN[module]["tests"]:
        file, *names = test.split("::")
        source = (TESTS / file).read_text(encoding="utf-8")
        assert all(f"def {name.partition('[')[0]}(" in source for name in names if not name.startswith("Test")), test


@pytest.mark.parametrize("module", ARGUED)
def test_every_argued_mutant_still_exists(module: str, mutants) -> None:
    """A renamed class or a merged module needs its entries updated."""
    source = (TESTS.parent / "src" / "modaltouch" / module).read_text(encoding="utf-8")
    assert set(ARGUED[module]) <= set(mutants(ast.parse(source)))
