"""The comparison of methods: one generator, one judge, and sentences that follow the numbers."""

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from modaltouch.cli import app
from modaltouch.lab.common import title_of
from modaltouch.lab.comparison import comparison_table, draw_robustness, rows_of, write_comparison
from modaltouch.lab.contest import contest, true_delay, without_mismatch
from modaltouch.preflight import examine
from modaltouch.rig import Simulator

pytestmark = pytest.mark.usefixtures("svg_alone")

SHIPPED = Path(__file__).parents[3] / "protocols" / "differentiated_stimulation.yaml"
ABOUT = {"title": "A <title>", "protocol": "p.yaml", "apparatus": "beam", "seed": 1, "n_records": 2, "commit": ""}


@pytest.fixture(scope="module")
def found(preflight, known):
    """Return the comparison with the table's beam, played through the driver, and on two other beams."""
    return contest(preflight, known, n_beams=2)


@pytest.fixture(scope="module")
def rows(found):
    """Return the rows of all methods."""
    return rows_of(found)


def by_method(rows):
    """Return the rows by method."""
    return {row["method"]: row for row in rows}


def test_every_method_has_the_same_limit_and_length(found):
    """And the same clock; the generator's codes begin and end at rest."""
    for each in found.designed:
        assert each.peak_voltage <= found.known.amplifier.limit * (1 + 1e-9), each.method.key
        assert each.burst.codes.shape == (2, found.known.timing.n_samples), each.method.key
        assert (each.burst.codes[:, [0, -1]] == 8191).all(), each.method.key


def test_the_judge_reads_the_true_state(found, preflight):
    """The exact law on the table's beam reaches the field of the selected modes despite the twin's other modes."""
    verdict = found.verdicts[0]
    assert found.designed[0].method.key == "exact"
    assert verdict.row["at_focus_mm_s"] == pytest.approx(200, abs=2)
    assert verdict.row["rms_from_selected_mm_s"] < 2
    rig = Simulator(without_mismatch(preflight.experiment.apparatus), 1)
    assert true_delay(rig) == pytest.approx(1e-6 + 1 / (2 * np.pi * 300e3))


def test_only_the_other_beams_depend_on_the_seed(found, preflight):
    """Without mismatch two seeds give the same beam."""
    centre = without_mismatch(preflight.experiment.apparatus)
    one, other = Simulator(centre, 1).twin.beam.table, Simulator(centre, 2).twin.beam.table
    assert (one.natural_frequency == other.natural_frequency).all()
    assert (one.modal_gain == other.modal_gain).all()
    first, second = found.changed[0]
    assert np.abs(first.field - second.field).max() > 1e-4


def test_each_method_wins_where_theory_says(rows):
    """Reversal is the matched filter, and the exact law meets the selected modes."""
    row = by_method(rows)
    assert min(rows, key=lambda each: each["energy_V2_s"])["method"] == "time_reversal"
    assert min(rows, key=lambda each: each["rms_from_selected_mm_s"])["method"] == "exact"
    assert row["time_reversal"]["width_80_mm"] < row["exact"]["width_80_mm"]
    assert row["inverse_filter"]["contrast_A_C"] > row["exact"]["contrast_A_C"]
    assert row["time_reversal"]["recordings"] == 2 < row["exact"]["recordings"] == 82


def test_zone_names_may_contain_underscores(rows):
    """As `Word` in `protocol.section` allows."""
    peaks = {"left_end": 10.0, "mid": 200.0, "far_right": 20.0}
    keys = {"contrast_left_end_mid": 20.0, "contrast_left_end_far_right": 2.0}
    row = {name: value for name, value in rows[0].items() if "contrast_" not in name}
    found = {line["quantity"]: line["cells"] for line in comparison_table([row | keys | {"zone_peak_mm_s": peaks}])}
    assert found["contrast of (left_end, mid)"] == ["20.00"]
    assert found["contrast of (left_end, far_right)"] == ["2.00"]


def test_page_json_and_table_agree(found, rows, tmp_path):
    """A page without network access, a JSON and a CSV, each with every criterion and method."""
    written = write_comparison(found, ABOUT, tmp_path / "out")
    files = {name: Path(path) for name, path in written["files"].items()}
    page = files["comparison.html"].read_text()
    assert "A &lt;title&gt;" in page
    assert len(re.findall(r'<img src="data:image/svg\+xml;base64,', page)) == page.count("<img") == 2
    assert not re.search(r'(src|href)="(https?:)?//', page)
    for line in comparison_table(rows):
        assert line["quantity"] in page, line["quantity"]
    values = json.loads(files["comparison.json"].read_text())
    table = list(csv.DictReader(files["comparison.csv"].read_text().splitlines()))
    assert [line["method"] for line in table] == [method["method"] for method in values["methods"]]
    for line, method in zip(table, values["methods"], strict=True):
        assert float(line["rms_error_mm_s"]) == pytest.approx(method["rms_error_mm_s"], abs=1e-4)


def test_an_infinite_contrast_is_not_drawn(found):
    """For a zone at rest the contrast is None in JSON; the other beams are drawn."""
    pair = "contrast_{}_{}".format(*found.preflight.experiment.protocol.conditions.pairs[0])
    rest = replace(found.changed[0][0], row=found.changed[0][0].row | {pair: None})
    draw_robustness(replace(found, changed=((rest, *found.changed[0][1:]), *found.changed[1:]))).canvas.draw()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--points", "20"], "at least 26"),
        (["--averages", "1"], "--averages"),
        (["--beams", "0"], "--beams"),
    ],
)
def test_the_command_refuses_bad_options(tmp_path, words, message):
    """With exit status 2 and the allowed values; nothing is written."""
    done = CliRunner().invoke(app, ["compare", str(SHIPPED), *words, "--out", str(tmp_path / "o")])
    assert done.exit_code == 2
    assert message in done.output
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("name", "title"),
    [("two_fields", "Sharp and blunt fields, stimulus sharp"), ("threshold", "Threshold of differentiation")],
)
def test_the_title_has_the_stimulus(name, title):
    """`validate` and `compare` use the first of several."""
    assert title_of(examine(SHIPPED.with_name(f"{name}.yaml"))) == title
