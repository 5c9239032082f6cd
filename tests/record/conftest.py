"""Every test of the record runs under the file rules of Unix and under those of Windows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from windows_rules import windows_rules


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run each test under both sets of rules, unless the test selects one itself."""
    says = any(mark.args[0] == "rules" for mark in metafunc.definition.iter_markers("parametrize"))
    writes = metafunc.module.__name__.rpartition(".")[2] not in ("test_audit", "test_expectation")
    if "rules" in metafunc.fixturenames and not says and writes:
        metafunc.parametrize("rules", ["unix", "windows"], indirect=True)


@pytest.fixture(autouse=True)
def rules(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """Impose the rules after pytest has created its folders under the real ones."""
    if getattr(request, "param", "unix") == "windows":
        with windows_rules():
            yield "windows"
    else:
        yield "unix"
