from __future__ import annotations

import base64
import csv
import html
import json
import re
import subprocess
import sys
from html.parser import HTMLParser

import pytest

from modaltouch.analysis.pipeline import analyse, default_folder
from modaltouch.analysis.report import design_limits
from modaltouch.protocol import InputError


class Page(HTMLParser):
    """Collects what a browser would load and show."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.open: list[str] = []
        self.shown = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs) -> None:
        self.addresses += [value for name, value in attrs if name in ("src", "href", "action", "data") and value]
        if tag not in ("meta", "img", "br", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        self.shown += data


@pytest.fixture(scope="module")
def analysis(paper_csv, tmp_path_factory):
    """The analysis of the synthetic set modelled on the paper's text."""
    return analyse(paper_csv, tmp_path_factory.mktemp("analysis") / "out")


def test_every_documented_file_is_written(analysis) -> None:
    """Tables, bar charts as SVG and PNG, statistics and report; optional figures only on request."""
    assert set(analysis.files) == {
        "counts.csv", "fig_10.csv", "fig_11.csv", "fig_10.svg", "fig_11.svg", "fig_10.png", "fig_11.png", "tests.csv",
        "tests.json", "report.html", "answers.csv", "models.R",
    }  # fmt: skip
    assert all(path.stat().st_size > 0 for path in analysis.files.values())


def test_a_table_has_no_velocity_fields_to_draw(paper_csv, tmp_path) -> None:
    """The figure needs the record of a session."""
    with pytest.raises(InputError, match="--fields: given answers without the field of their stimulus"):
        analyse(paper_csv, tmp_path / "out", fields=True)


@pytest.mark.parametrize("zones", [["A", "", ""], ["A", "B", "C"]])
def test_without_two_fingers_no_answer_counts_as_a_zone(zones, tmp_path) -> None:
    """A table without a protocol has the paper's answers, which do not cover one finger or a middle one."""
    rows = [["p1", "hand", *zones, level, "left", n] for n, level in enumerate((80, 150), start=1)]
    header = [
        "participant",
        "finger_condition",
        "zone_left",
        "zone_between",
        "zone_right",
        "velocity_mm_s",
        "response",
        "trial",
    ]
    with (tmp_path / "answers.csv").open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    analysis = analyse(tmp_path / "answers.csv")
    assert not analysis.answers.compares
    with analysis.files["answers.csv"].open(newline="") as file:
        assert [row["response"] for row in csv.DictReader(file)] == ["left", "left"]
    with pytest.raises(InputError, match="--model: given answers that do not name each of two fingers alone"):
        analyse(tmp_path / "answers.csv", model=True)


def test_the_json_is_plain_and_without_nan(analysis) -> None:
    """Every test has the same keys."""
    values = json.loads(json.dumps(analysis.as_dict(), allow_nan=False))
    assert {"counts", "tests", "files", "n_participants", "n_responses", "left_out"} <= set(values)
    assert (values["n_participants"], values["n_responses"]) == (10, 240)
    assert set(values["counts"][0]) == {
        "finger_condition", "pair", "zone_left", "zone_right", "velocity_mm_s", "left", "both", "right", "n",
    }  # fmt: skip
    keys = ("question", "name", "scope", "statistic", "p", "p_min", "p_holm", "estimate", "low", "high", "n")
    assert all(key in row for row in values["tests"] for key in keys)


def test_the_table_of_fig_10_has_the_counts(analysis) -> None:
    """In the synthetic set (A, C) has C 10, 10, 9 and 10 times."""
    with analysis.files["fig_10.csv"].open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["pair", "answer", "80", "100", "150", "200"]
    assert rows[1] == ["A-C", "C", "10", "10", "9", "10"]


def test_the_same_data_give_the_same_bytes_in_an_older_folder(
    analysis, paper_csv, write_csv, paper_rows, tmp_path
) -> None:
    """There is no date and no random identifier (commit excepted), and files of an earlier run are replaced."""
    analyse(write_csv(paper_rows[:1]), tmp_path / "out")
    again = analyse(paper_csv, tmp_path / "out")
    for name, path in analysis.files.items():
        one, other = (re.sub(rb"commit <code>\S+</code>", b"", p.read_bytes()) for p in (path, again.files[name]))
        assert one == other, name


def test_the_report_needs_no_network_and_contains_every_figure(analysis) -> None:
    """Every URL is a data URI or an anchor in the page; each SVG of the folder is embedded."""
    text = analysis.files["report.html"].read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert all(address.startswith(("data:image/svg+xml;base64,", "#")) for address in page.addresses)
    inside = [base64.b64decode(a.split(",", 1)[1]) for a in page.addresses if a.startswith("data:")]
    assert {path.read_bytes() for name, path in analysis.files.items() if name.endswith(".svg")} == set(inside)
    assert not re.search(r"https?://|@import|url\(|<script", text)


def test_the_report_gives_the_numbers(analysis) -> None:
    """Counts and p of dominance in (A, C), no information in (B, D), and confounding among the limits."""
    page = Page(analysis.files["report.html"].read_text(encoding="utf-8"))
    shown = re.sub(r"\s+", " ", page.shown)
    assert "39 C, 0 A, 1 both of 40 answers; 10 of 10 participants lean to C" in shown
    assert "p = 0.002, Holm p = 0.012" in shown
    assert "none of 6 tests could reach p ≤ 0.05" in shown
    assert "10, 10, 9, 10" in shown
    assert "In (B, D) zone, side and finger are confounded" in shown


def test_names_from_the_table_are_text_in_the_report(write_csv, paper_rows, tmp_path) -> None:
    """Autoescape: a finger condition named like a script is shown as text."""
    name = "<script>alert(1)</script>"
    rows = [{**row, "finger_condition": name} for row in paper_rows if row["finger_condition"] == "one_hand"]
    report = analyse(write_csv(rows), tmp_path / "out").files["report.html"].read_text(encoding="utf-8")
    assert "<script" not in report
    assert html.escape(name) in report


def test_constant_answers_give_a_complete_report(build, write_csv, tmp_path) -> None:
    """Identical answers of all participants cause no error and no warning."""
    analysis = analyse(write_csv(build["constant"](3)), tmp_path / "out")
    assert Page(analysis.files["report.html"].read_text(encoding="utf-8")).open == []


@pytest.mark.parametrize(("zones", "size", "fewest"), [("ABC", 6, 8), ("A", 2, 7)])
def test_the_report_gives_the_participants_a_sign_flip_test_needs(
    build, write_csv, tmp_path, zones, size, fewest
) -> None:
    """2/2^N times the tests of the smallest family must be at most 0.05; the paper's six need eight."""
    rows = [row for row in build["constant"](3) if row["zone_left"] in zones]
    limits = design_limits(analyse(write_csv(rows), tmp_path / "out"))
    (told,) = [limit for limit in limits if "no sign-flip test" in limit]
    assert f"a family of {size}: its smallest p is 2/2^3 = 0.25. At least {fewest} participants are needed." in told


def test_bars_of_repeated_answers_state_their_intervals(build, write_csv, tmp_path) -> None:
    """With three answers per participant, shares are not binomial counts and the intervals not exact."""
    files = analyse(write_csv(build["random"](3, 1, repetitions=3)), tmp_path / "out").files
    page = files["report.html"].read_text(encoding="utf-8")
    assert (
        "3 answers each. Error bars: Clopper and Pearson&#39;s 95 % intervals, as if each participant had given one"
        in page
    )
    assert "exact 95 % intervals" not in page


def test_a_single_answer_can_be_analysed(write_csv, paper_rows, tmp_path) -> None:
    """One participant, condition, pair and level."""
    analysis = analyse(write_csv(paper_rows[:1]), tmp_path / "out")
    assert analysis.as_dict()["n_responses"] == 1
    assert "Only one participant" in analysis.files["report.html"].read_text(encoding="utf-8")


def test_results_are_written_beside_the_data_by_default(tmp_path) -> None:
    """A CSV gets a folder with its name, a tree its own analysis folder."""
    assert default_folder(tmp_path / "a.csv") == tmp_path / "a_analysis"
    assert default_folder(tmp_path) == tmp_path / "analysis"


def test_the_analysis_loads_neither_instrument_nor_screen() -> None:
    """A new interpreter loads it without PyVISA, PsychoPy, pyglet, pyplot and statsmodels."""
    code = (
        "import sys, modaltouch.analysis.pipeline, modaltouch.analysis.figures, modaltouch.analysis.report\n"
        "import modaltouch.analysis.statistics\n"
        "print([m for m in ('pyvisa', 'psychopy', 'pyglet', 'matplotlib.pyplot', 'statsmodels') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_an_analysis_of_a_dataset_is_written_to_its_derivatives(tmp_path) -> None:
    """BIDS: derived files must be under ``derivatives``, or the raw dataset becomes invalid."""
    session = tmp_path / "sub-p01" / "ses-1" / "beh"
    session.mkdir(parents=True)
    (tmp_path / "dataset_description.json").write_text("{}")
    assert default_folder(tmp_path) == tmp_path / "derivatives" / "analysis"
    assert default_folder(session) == tmp_path / "derivatives" / "analysis_sub-p01_ses-1"
    assert default_folder(session / "session.jsonl") == tmp_path / "derivatives" / "analysis_sub-p01_ses-1"
