"""Target fields: two foci, points or a CSV file, with faults and their positions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modaltouch.preflight import examine
from modaltouch.protocol import Findings, Source, Sources
from modaltouch.protocol.cell_table import read_points
from modaltouch.record.audit import audit_session
from modaltouch.record.session import Session
from modaltouch.session.wiring import simulate_session

Edit = Callable[..., Path]
FILE = "differentiated_stimulation.yaml"
FIELD = "field: {shape: triangle, base_mm: 56}"
FOCUS = "focus: C  "
TRIANGLE = "[[-28, 0], [0, 7], [28, 0]]"


def faults(file: Path) -> list[str]:
    """Return all problems of a protocol."""
    return [str(problem).replace(f"{file.parent}/", "") for problem in examine(file).problems]


def sampled(edit: Edit, what: str) -> Path:
    """Return the paper's protocol with a sampled field."""
    return edit(FILE, (FIELD, f"field: {{shape: sampled, {what}}}"))


@pytest.mark.parametrize("way", ["points", "file"])
def test_sampled_corners_of_a_triangle_give_the_triangle(edit: Edit, way: str) -> None:
    """In any unit of velocity, by points or by file."""
    shipped = examine(edit(FILE)).stimulus
    file = sampled(edit, f"points: {TRIANGLE}" if way == "points" else "file: field.csv")
    (file.parent / "field.csv").write_text("velocity,position_mm\n0,-28\n3,0\n0,28\n", encoding="utf-8")
    assert examine(file).stimulus.target == pytest.approx(shipped.target, rel=1e-9, abs=1e-12)


def test_two_foci_reach_the_level_together(edit: Edit) -> None:
    """Symmetric wiring drives B and D alike; both centres reach the level at the focusing instant."""
    file = edit(FILE, (FOCUS, "focus: B\n  further_foci: [D]  "), ("[80, 100, 150, 200]", "[80, 100]"))
    stimulus = examine(file).stimulus
    reached = stimulus.velocity_at_focus(np.array([-0.02, 0.02]), 0.1)
    assert reached == pytest.approx([0.1, 0.1], rel=1e-6)


def test_an_asymmetric_target_causes_a_warning(edit: Edit) -> None:
    """For a field at B alone the even modes have no gain, so it is mirrored; the warning has the residual."""
    file = edit(FILE, (FOCUS, "focus: B  "), ("[80, 100, 150, 200]", "[80]"))
    warned = " ".join(examine(file).as_dict()["warnings"])
    assert "mode" in warned
    assert "%" in warned


@pytest.mark.parametrize("base", ["", "stimulus:\n  field: {shape: sampled, points: [[-28, 0], [0, 7], [28, 0]]}"])
def test_each_stimulus_may_have_its_own_points(edit: Edit, base: str) -> None:
    """Or another shape, if the common section has points."""
    blunt = "blunt: {field: {shape: raised_cosine, base_mm: 100}}"
    own = f"blunt: {{field: {{shape: sampled, points: {TRIANGLE}}}}}"
    changes = [("stimulus:", base)] if base else [(blunt, own)]
    assert faults(edit("two_fields.yaml", *changes)) == []


def test_a_record_keeps_the_points_of_its_field(edit: Edit, tmp_path: Path) -> None:
    """The drive is recomputed from the record without the file."""
    file = sampled(edit, "file: field.csv")
    points = file.parent / "field.csv"
    points.write_text("position_mm,velocity\n-28,0\n0,3\n28,0\n", encoding="utf-8")
    session = simulate_session(file, "p01", tmp_path / "results")
    points.unlink()
    assert Findings.restored(Sources.from_dict(session.start["sources"])).problems == ()
    assert audit_session(Session.find(session.path)).problems == ()


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("base_mm: 30", "stimulus.field.shape: given a sampled field with neither points nor a file"),
        (f"points: {TRIANGLE}, file: f.csv", "given a sampled field with points and a file"),
        ("points: [[0, 1]]", "stimulus.field.points: given a list of 1"),
        ("points: [[0, 1], [0, 2]]", "stimulus.field.points[1]: given 0 mm after 0 mm"),
        (
            "points: [[-9, 0], [0, -1], [9, 0]]",
            "stimulus.field: given a stimulus that cannot be made, the sampled field",
        ),
        ("file: nowhere.csv", "stimulus.field.file: given 'nowhere.csv', a file that does not exist"),
        ("file: nowhere.csv", "allowed: a CSV file that exists and can be read, as a path relative to this file"),
    ],
)
def test_invalid_points_are_refused_with_their_position(edit: Edit, what: str, said: str) -> None:
    """Missing, repeated, too few, unordered, of the wrong sign, or off the beam."""
    told = faults(sampled(edit, what))
    assert any(said in each for each in told), told
    assert all(each.startswith(FILE) for each in told)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "field.csv:1:1: given the columns of an empty file"),
        (
            "place,speed\n0,1\n",
            "field.csv:1:1: given the columns place,speed; allowed: position_mm, velocity, once each",
        ),
        ("position_mm,velocity,velocity\n0,1,2\n", "field.csv:1:1: given the columns position_mm,velocity,velocity"),
        ("position_mm,velocity\n0,1\nx,2\n", "field.csv:3:1: given 'x,2'; allowed: two finite numbers"),
        ("position_mm,velocity\n0,1\n1,nan\n", "field.csv:3:1: given '1,nan'"),
        ("position_mm,velocity\n0,1\n", "field.csv:1:1: given 1 points; allowed: at least 2"),
        ("position_mm,velocity\n0,1\n\n-1,2\n", "field.csv:4:1: given -1 mm after 0 mm"),
        ("position_mm,velocity\n0,true\n1,1\n", "field.csv:2:1: given '0,true'; allowed: two finite numbers"),
        ("position_mm,velocity\n0,0x1\n1,1\n", "field.csv:2:1: given '0,0x1'; allowed: two finite numbers"),
        (
            "position_mm,velocity,note\n0,0,5,near\n",
            "field.csv:2:1: given '0,0,5,near'; allowed: two finite numbers; a decimal comma splits a number into two",
        ),
        (
            "position_mm,velocity,\n0,0,5\n",
            "field.csv:2:1: given '0,0,5'; allowed: two finite numbers; a decimal comma",
        ),
        (
            "position_mm;velocity\n1;-20;0.5\n",
            "field.csv:2:1: given '1;-20;0.5'; allowed: two finite numbers; name every",
        ),
        (
            "position_mm;velocity\n-20;0,5\n",
            "field.csv:2:1: given '-20;0,5'; allowed: two finite numbers; write 0.5, with a decimal point",
        ),
        ('position_mm,velocity,note\n0,1,"two\nlines"\n1,x,\n', "field.csv:4:1: given '1,x,'"),
        ('position_mm,velocity,note\n0,1,\n1,2,"left\n2,3,\n', "field.csv:3:1: given an unpaired quotation mark"),
    ],
)
def test_faults_in_a_csv_have_their_line(edit: Edit, text: str, said: str) -> None:
    """Every line that is not a point."""
    file = sampled(edit, "file: field.csv")
    (file.parent / "field.csv").write_text(text, encoding="utf-8")
    assert any(each.startswith(said) for each in faults(file)), faults(file)


@pytest.mark.parametrize(
    "text",
    [
        "position_mm,velocity\n-20,0.5,\n0,1,\n20,.5,\n",
        "position_mm,velocity,,,\n-20,0.5,,,\n0,1,,,\n20,.5,,,\n,,,,\n",
        "note,position_mm,velocity,note\na,-20,0.5,b\na,0,1,b\na,20,.5,b\n",
        "position_mm,velocity,note\n-20,0.5\n0,1,peak\n20,.5,left, near\n",
        'position_mm,velocity,note\n-20,0.5,"two\nlines"\n0,1,5" off\n20,.5,\n',
        "position_mm;velocity\n-20;0.5\n0;1\n20;.5\n",
        "position_mm\tvelocity\n-20\t0.5\n0\t1\n20\t.5\n",
    ],
)
def test_only_the_two_columns_of_a_csv_matter(text: str) -> None:
    """As spreadsheets save it: empty columns, notes of any kind, semicolons or tabs."""
    assert read_points(Source(Path("field.csv"), text)) == (((-20, 0.5), (0, 1), (20, 0.5)), [])


def test_foci_must_be_different_zones(edit: Edit) -> None:
    """An unknown zone and a repeated one are refused."""
    told = faults(edit(FILE, (FOCUS, "focus: B\n  further_foci: [F, B]  ")))
    assert any("further_foci[0]: given 'F', which is not a zone of this beam" in each for each in told)
    assert any("further_foci[1]: given B, which is already a focus" in each for each in told)
