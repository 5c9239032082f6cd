"""The validation page: self-contained, made from the numbers, identical for identical recordings."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from modaltouch.cli import app
from modaltouch.lab.validation import write_validation
from modaltouch.lab.validation.key_figures import findings, key_figures
from modaltouch.record.chain import RecordError
from modaltouch.report.page import write_files

pytestmark = pytest.mark.usefixtures("svg_alone")

OCCASION = {
    "title": "A <title>",
    "protocol": "p.yaml",
    "apparatus": "beam",
    "mode": "simulated",
    "generator": "generator",
    "scope": "scope",
    "calibration": None,
    "commit": "abc",
}
SHIPPED = Path(__file__).parents[3] / "protocols"
PAIRS = [("A", "C"), ("B", "D"), ("C", "E")]


@pytest.fixture(scope="module")
def written(evidences, tmp_path_factory):
    """Return the files and the figures in them."""
    folder = tmp_path_factory.mktemp("page") / "out"
    files = write_validation(evidences, PAIRS, OCCASION, folder)["files"]
    return {name: Path(path) for name, path in files.items()}, [key_figures(each, PAIRS) for each in evidences]


def test_the_page_needs_no_network(written):
    """Every picture is embedded."""
    page = written[0]["validation.html"].read_text()
    assert len(re.findall(r'<img src="data:image/svg\+xml;base64,', page)) == page.count("<img") == 5
    assert not re.search(r'(src|href)="(https?:)?//', page)
    assert "default-src 'none'" in page


def test_the_page_escapes_the_title_and_marks_simulated_data(written):
    """A title is text, not HTML."""
    page = written[0]["validation.html"].read_text()
    assert "A &lt;title&gt;" in page
    assert "SIMULATED DATA" in page


def test_tables_agree_with_the_json(written):
    """Fig. 6 as CSV and as JSON."""
    files, _ = written
    values = json.loads(files["validation.json"].read_text())
    lines = files["fig_6.csv"].read_text().splitlines()
    assert len(lines) == 1 + sum(len(law["coefficients"]) for law in values["laws"])
    first = dict(zip(lines[0].split(","), lines[1].split(","), strict=True))
    assert float(first["achieved_mm_s"]) == pytest.approx(
        values["laws"][0]["coefficients"][0]["achieved_mm_s"], abs=1e-3
    )


def test_sentences_follow_the_numbers(written):
    """One for each law while nothing is implausible, with its worst modal error."""
    told = findings(written[1])
    assert [re.search("Law “(.*?)”", each)[1] for each in told] == ["exact", "paper"]
    for each, figures in zip(told, written[1], strict=True):
        assert f"modal error is {figures['worst_modal_error_mm_s']:.2f} mm/s, of mode {figures['worst_mode']}" in each


def test_a_drive_unlike_the_prediction_is_reported(written):
    """Exchanged or wrongly attenuated probes leave the field unchanged: one sentence each."""
    figures = [dict(each) for each in written[1]]
    assert "probe" not in " ".join(findings(figures))
    peaks = figures[0]["peak_drive_V"]
    figures[0]["peak_drive_V"] = {
        output: {**peak, "measured": peaks["2" if output == "1" else "1"]["measured"]} for output, peak in peaks.items()
    }
    told = findings(figures)[-2:]
    said = (
        "output 1 with law “exact” was measured as .* V were predicted: check that the amplifier does not saturate, wh"
    )
    assert re.search(said, told[0])
    assert "output 2 with law “exact”" in told[1]
    figures[0]["peak_drive_V"] = peaks | {"1": peaks["1"] | {"measured": 0.85 * peaks["1"]["measured"]}}
    assert len(findings(figures)) == len(findings(written[1])) + 1


@pytest.mark.parametrize("factor", [0.5, 1.25])
def test_a_common_factor_of_the_speeds_is_reported(written, factor):
    """A wrong sensitivity shows a field of the right form and the wrong size."""
    assert "times as fast" not in " ".join(findings(written[1]))
    figures = [dict(each) for each in written[1]]
    zones = figures[0]["zone_peak_mm_s"].items()
    figures[0]["zone_peak_mm_s"] = {zone: {**peak, "measured": factor * peak["measured"]} for zone, peak in zones}
    (told,) = (each for each in findings(figures) if "times as fast" in each)
    said = float(re.search(r"law “exact” the zones moved (\S+) times as fast as predicted: check", told)[1])
    assert said == pytest.approx(factor, rel=0.05)


def test_an_analysis_is_not_replaced(evidences, tmp_path):
    """A folder belongs to the command that made it."""
    write_files(tmp_path / "out", {"tests.csv": b"1"}, {})
    with pytest.raises(RecordError, match="contains output of `modaltouch analyse`"):
        write_validation(evidences, PAIRS, OCCASION, tmp_path / "out")


def test_the_command_reads_kept_scans_without_a_rig(written, kept, tmp_path):
    """With an unreachable address: the same bytes, and one JSON object on standard output."""
    protocol = str(SHIPPED / "differentiated_stimulation.yaml")
    words = [
        "validate",
        protocol,
        "--rig",
        "TCPIP::192.0.2.1::INSTR",
        "--scan",
        str(kept),
        "--out",
        str(tmp_path / "o"),
    ]
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exit_code == 0, done.output
    values = json.loads(done.stdout)
    assert [law["law"] for law in values["laws"]] == ["exact", "paper"]
    for name in ("fig_5.svg", "fig_6.svg", "fig_7.svg", "fig_8.svg", "fig_5_exact.csv"):
        assert (tmp_path / "o" / name).read_bytes() == written[0][name].read_bytes(), name


def test_the_command_refuses_too_few_points(tmp_path):
    """With exit status 2 and the least allowed number; nothing is written."""
    words = [
        "validate",
        str(SHIPPED / "differentiated_stimulation.yaml"),
        "--points",
        "21",
        "--out",
        str(tmp_path / "o"),
    ]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 2
    assert "at least 26" in done.output
    assert not (tmp_path / "o").exists()
