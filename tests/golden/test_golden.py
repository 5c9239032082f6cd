"""What must not change while the package is rearranged, frozen as it was (`write.py` freezes it again).

Nothing here knows how the package is built: command lines, its public functions, and `inside` for the rest.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import cases
import pytest
from freezing import differences, load
from outside import ROOT, workplace
from sayings import MISPLACED, OUTPUTS, REFUSALS, Output, Refusal

pytestmark = pytest.mark.usefixtures("undrawn")

NEED_A_WINDOW_OR_A_SCAN = {"modaltouch demo", "modaltouch compare", "modaltouch validate", "modaltouch fingers probe"}


@pytest.fixture(scope="module")
def cohort(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the analysis of the simulated cohort."""
    with workplace(tmp_path_factory.mktemp("cohort") / "place"):
        return cases.cohort()


def test_codes_and_amplitudes_stay(tmp_path: Path) -> None:
    """Each channel's codes to the bit, by both laws: a record names them by their hash, and is verified by it."""
    assert differences(cases.codes(tmp_path / "place"), load("codes"), rel=0) == []


def test_orders_stay(tmp_path: Path) -> None:
    """Every place of every order: a record is resumed and verified by drawing it again."""
    assert differences(cases.orders(tmp_path / "place"), load("orders"), rel=0) == []


def test_commands_and_their_options_keep_their_names(tmp_path: Path) -> None:
    """Scripts of laboratories name them."""
    assert differences(cases.commands(tmp_path), load("commands")) == []


def test_every_command_that_takes_json_is_frozen() -> None:
    """But for those that need a window, or a scan of half a minute."""
    taking = {words for words, page in load("commands").items() if "--json" in page["options"]}
    given = {
        words for words in taking for case in OUTPUTS.values() if f"modaltouch {case.line} ".startswith(f"{words} ")
    }
    assert taking - given == NEED_A_WINDOW_OR_A_SCAN


@pytest.mark.parametrize(("name", "case"), OUTPUTS.items(), ids=OUTPUTS)
def test_json_keeps_its_keys_types_and_values(tmp_path: Path, name: str, case: Output) -> None:
    """One object with the same keys, in it the same values; the exit status that goes with it."""
    found, frozen = cases.output(case, tmp_path / "place"), load(f"outputs/{name}")
    assert differences(found, frozen, rel=case.rel, absolute=case.absolute) == []


@pytest.mark.parametrize("case", REFUSALS, ids=[case.name for case in REFUSALS])
def test_a_refusal_keeps_its_status_and_its_words(tmp_path: Path, case: Refusal) -> None:
    """2 bad input, 3 rig failed, 4 record at risk, 130 interrupted; each fault of a file with its place."""
    found = cases.refusal(case, tmp_path / "place")
    assert found["status"] in (2, 3, 4, 130)
    assert not any("Traceback" in line for line in found["stderr"])
    if case.prepare in MISPLACED:
        assert all(re.match(r"[\w./]+:\d+:\d+: ", line) for line in found["stderr"]), found["stderr"]
    assert differences(found, load("refusals")[case.name]) == []


def test_records_of_format_2_are_read_and_resumed(tmp_path: Path) -> None:
    """A whole session and an interrupted one, recorded by version 0.2.0."""
    found = cases.records(tmp_path / "place")
    assert differences(found, load("records")) == []
    answered = found["unfinished"]["answers"]
    assert found["resumed"]["answers"][: len(answered)] == answered


def test_the_numbers_of_the_analysis_stay(cohort: Path) -> None:
    """Counts, estimates, intervals and p values of ten simulated participants, and the heads of all tables."""
    assert differences(cases.analysed(cohort), load("statistics"), absolute=1e-12) == []


@pytest.mark.parametrize("name", ["fig_10.csv", "fig_11.csv"])
def test_tables_of_the_reference_are_those_of_the_cohort(cohort: Path, name: str) -> None:
    """What `make results` wrote into results/reference, byte by byte."""
    assert (cohort / name).read_bytes() == (ROOT / "results" / "reference" / name).read_bytes()


@pytest.mark.parametrize(
    ("found", "frozen", "said"),
    [
        ({"a": 1}, {"a": 1, "b": 2}, [".b: missing"]),
        ({"a": 1, "b": 2}, {"a": 1}, [".b: new"]),
        ({"a": [1.0, 2.0]}, {"a": [1.0]}, [".a: 2 items, frozen 1"]),
        ({"a": 1.0}, {"a": 1}, [".a: 1.0 is a float, frozen 1"]),
        ({"a": 1.0 + 1e-8}, {"a": 1.0}, [".a: 1.00000001, frozen 1.0"]),
        ({"a": 1.0 + 1e-10}, {"a": 1.0}, []),
        ({"a": [{"b": "x"}]}, {"a": [{"b": "y"}]}, [".a[0].b: 'x', frozen 'y'"]),
    ],
)
def test_a_difference_is_told_with_its_place(found: Any, frozen: Any, said: list[str]) -> None:
    """Keys, types and texts exactly, numbers within bounds: what the tests above rest on."""
    assert differences(found, frozen) == said
