"""Every test of the record runs by the rules of Unix and by those of Windows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from windows_rules import windows_rules


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run each test under both, unless it says which."""
    says = any(mark.args[0] == "rules" for mark in metafunc.definition.iter_markers("parametrize"))
    writes = metafunc.module.__name__.rpartition(".")[2] not in ("test_audit", "test_expectation")
    if "rules" in metafunc.fixturenames and not says and writes:
        metafunc.parametrize("rules", ["unix", "windows"], indirect=True)


@pytest.fixture(autouse=True)
def rules(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """Impose the rules, once pytest has made its folders by its own."""
    if getattr(request, "param", "unix") == "windows":
        with windows_rules():
            yield "windows"
    else:
        yield "unix"
