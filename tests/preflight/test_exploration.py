"""Options of `check` that explore the stimulus: sensitivity, sample count and contrast."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from modaltouch.cli import app

PROTOCOL = Path(__file__).parents[2] / "protocols" / "differentiated_stimulation.yaml"


def check(*options: str) -> Result:
    """Run ``modaltouch check`` on the paper's protocol, in this process."""
    return CliRunner().invoke(app, ["check", str(PROTOCOL), *options])


@pytest.fixture(scope="module")
def explored() -> dict[str, Any]:
    """The output of all options together."""
    done = check("--sensitivity", "--tolerance", "0.01", "--json")
    assert done.exit_code == 0, done.stderr
    values: dict[str, Any] = json.loads(done.stdout)
    return values


def test_open_loop_accuracy_is_limited_by_identification(explored: dict[str, Any]) -> None:
    """5 % of a modal gain moves the field by about 3 mm/s, 5 % of a damping ratio by 1.4 or more."""
    table = explored["sensitivity"]["table"]
    of_mode_1 = {row["parameter"]: row["field_mm_s"] for row in table if row["mode"] == 1}
    assert of_mode_1["modal_gain"] == pytest.approx(2.96, abs=0.02)
    assert of_mode_1["damping_ratio"] == pytest.approx(1.4, rel=0.1)
    assert [row["field_mm_s"] for row in table] == sorted((row["field_mm_s"] for row in table), reverse=True)


def test_the_fewest_samples_stay_within_the_tolerance(explored: dict[str, Any]) -> None:
    """There are at least 2.5 samples per period of the highest mode, 87,855 Hz over 50 ms."""
    found = explored["samples"]
    assert found["error"] <= 0.01
    assert 2.5 * 87855 * 0.05 <= found["n_samples"] < 125_000


def test_the_contrast_of_the_focus_is_above_1_khz_only(edit: Callable[..., Path]) -> None:
    """Nine times the contrast of the exact law at less than 250 V; below 1 kHz both zones move equally."""
    short = ("focusing_instant_ms: 25", "focusing_instant_ms: 10"), ("duration_ms: 50", "duration_ms: 20")
    file = edit("differentiated_stimulation.yaml", *short, ("n_samples: 125000", "n_samples: 50000"))
    done = CliRunner().invoke(app, ["check", str(file), "--contrast", "--json"])
    rows = {(row["placement"], row["design"]): row for row in json.loads(done.stdout)["contrast"]}
    assert [place for place, _ in rows] == ["A-C", "A-C", "C-E", "C-E"]
    designed, best = rows["A-C", "designed"], rows["A-C", "contrast"]
    assert 9 * designed["contrast"] < best["contrast"] < best["bound"]
    assert best["peak_drive_V"] <= 250 * (1 + 1e-9)
    assert best["contrast_below_1_kHz"] == pytest.approx(1, abs=0.01)
    assert best["focus_below_1_kHz_mm_s"] < 0.2 * designed["focus_below_1_kHz_mm_s"]
    assert rows["C-E", "contrast"] == {**best, "placement": "C-E"}


def test_errors_under_fingers_are_those_of_the_first_placement() -> None:
    """At 100 mm/s, 5 % of the gain of mode 3 moves the field by 3 mm/s, and other modes with it."""
    done = CliRunner().invoke(app, ["check", "under_the_finger", "--sensitivity", "--json"])
    found = json.loads(done.stdout)["sensitivity"]
    (row,) = (each for each in found["table"] if (each["parameter"], each["mode"]) == ("modal_gain", 3))
    assert found["placement"] == "A-C"
    assert row["field_mm_s"] == pytest.approx(2.98, abs=0.02)
    # On the untouched beam a gain error displaces nothing at the focus.
    assert row["displacement_mm_s"] == pytest.approx(0.013, abs=0.01)
    assert row["displacement_mm_s"] > 1e-3


def test_nothing_is_computed_without_its_option(explored: dict[str, Any]) -> None:
    """Without an option its key is absent."""
    plain = json.loads(check("--json").stdout)
    assert set(explored) - set(plain) == {"sensitivity", "samples"}


def test_the_tables_are_printed_as_text() -> None:
    """Parameters are written out, and a senseless tolerance is refused with the allowed range."""
    said = check("--sensitivity").stdout
    assert "modal gain" in said
    refused = check("--tolerance", "2")
    assert refused.exit_code == 2
    assert "given 2; allowed: a number from 1e-06 to 0.999" in refused.stderr
