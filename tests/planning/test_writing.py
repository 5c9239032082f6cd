"""The files of a plan, and folders that it must not overwrite."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from modaltouch.planning.design import Design
from modaltouch.planning.experiments import Study
from modaltouch.planning.observer import Observer
from modaltouch.planning.power import Power, plan, write_power
from modaltouch.record.chain import RecordError
from modaltouch.report.page import write_files


@pytest.fixture
def power(design: Design) -> Power:
    """A small plan."""
    return plan(Study(design, Observer(), ("a2", "b"), null=False, seed=1), [(8, 1), (12, 1)], 20)


def test_tables_and_json_have_the_same_figures(power: Power, tmp_path: Path) -> None:
    """The rows are those of the plan, and a second writing gives the same bytes."""
    files = write_power(tmp_path / "plan", power)
    assert {"power.csv", "power_tests.csv", "power_needed.csv", "power.json", "power.svg", "power.png"} == set(files)
    values = json.loads(files["power.json"].read_text())
    rows = list(csv.DictReader(files["power.csv"].read_text().splitlines()))
    assert [float(row["power"]) for row in rows] == [row["power"] for row in values["power"]]
    before = files["power.svg"].read_bytes()
    assert write_power(tmp_path / "plan", power)["power.svg"].read_bytes() == before


def test_an_analysis_is_never_replaced_by_a_plan(power: Power, tmp_path: Path) -> None:
    """The folder is refused and the analysis left unchanged."""
    write_files(tmp_path / "analysis", {"tests.csv": b"p\n1\n"}, {"version": "0"})
    with pytest.raises(
        RecordError, match="contains output of `modaltouch analyse`, which would be replaced; give another folder"
    ):
        write_power(tmp_path / "analysis", power)
    assert (tmp_path / "analysis" / "tests.csv").read_bytes() == b"p\n1\n"
