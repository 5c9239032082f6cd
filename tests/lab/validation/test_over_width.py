"""Rows over the width: added torsion is found, with the value for noise alone (the paper's Fig. 7)."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from modaltouch.lab.validation import complete, read_laws
from modaltouch.lab.validation.evidence import Evidence
from modaltouch.lab.validation.figures import draw_over_width
from modaltouch.lab.validation.key_figures import key_figures, validation_table
from modaltouch.preflight import Preflight
from modaltouch.record import RecordInputError

TORSION = 0.004


@pytest.fixture(scope="module")
def twisted(evidences: list[Evidence]) -> Evidence:
    """Return the evidence of a beam with a torsion of a cosine along it, 4 mm/s on rows 2.5 mm off the mid-line."""
    evidence = evidences[0]
    field = evidence.field
    course = TORSION * np.cos(np.pi * (field.positions / 0.1 + 0.5))
    rows = []
    for sign in (1, -1):
        arrays = [
            {**each, "velocity": each["velocity"] + sign * turn}
            for each, turn in zip(field.arrays, course, strict=True)
        ]
        facts = {**field.facts, "settings": {**field.facts["settings"], "across_mm": sign * 2.5}}
        rows.append(replace(field, facts=facts, arrays=tuple(arrays)))
    return replace(evidence, further_rows=tuple(rows))


def test_torsion_is_the_part_that_grows_across_the_beam(twisted: Evidence) -> None:
    """With equal noise on every row only the cosine remains: its rms over 41 points from end to end."""
    place = twisted.field.positions
    expected = TORSION * np.cos(np.pi * (place / 0.1 + 0.5))
    np.testing.assert_allclose(twisted.torsion.mean(axis=0), expected, atol=1e-6)
    assert [scan.across for scan in twisted.rows] == [-2.5e-3, 0.0, 2.5e-3]
    figures = key_figures(twisted, ())
    assert figures["torsion_on_outer_rows_mm_s"]["rms"] == pytest.approx(4 * np.sqrt(21 / 41), rel=1e-3)
    assert figures["torsion_on_outer_rows_mm_s"]["noise"] < 1e-3
    cells = [row["cells"] for row in validation_table([figures]) if row["quantity"].startswith("torsion")]
    assert cells == [["2.86, 0.00"]]


def test_the_map_shows_field_speed_and_torsion(twisted: Evidence) -> None:
    """Three panels per law; the mid-line has the values of the field."""
    figure = draw_over_width([twisted])
    names = [axes.get_ylabel().split(":")[0] for axes in figure.axes]
    assert names[:3] == ["at the focus", "highest speed", "torsion at the focus"]
    np.testing.assert_allclose(twisted.field_over_width[1].mean(axis=0), twisted.measured_points)


def test_the_mid_line_alone_gives_no_torsion(evidences: list[Evidence]) -> None:
    """None instead of an unmeasured zero."""
    assert key_figures(evidences[0], ())["torsion_on_outer_rows_mm_s"] is None


def test_kept_rows_are_read_without_an_option(
    preflight: Preflight, kept: Path, evidences: list[Evidence], tmp_path: Path
) -> None:
    """As `identify` does: --rows only says what is measured. An interrupted row is refused."""
    folder = shutil.copytree(kept, tmp_path / "scans")
    for each in evidences:
        for across in (-2.5, 2.5):
            row = shutil.copytree(
                folder / f"{each.stimulus.law}_field", folder / f"{each.stimulus.law}_field_{across:+g}_mm"
            )
            facts = json.loads((row / "scan.json").read_text(encoding="utf-8"))
            facts["settings"]["across_mm"] = across
            (row / "scan.json").write_text(json.dumps(facts), encoding="utf-8")
    assert complete(folder, ())
    for observed in read_laws(preflight.inputs, folder):
        assert sorted(scan.across for scan in observed.further_rows) == [-2.5e-3, 2.5e-3]
    (row / "position_040.npz").unlink()
    with pytest.raises(RecordInputError, match="interrupted after 40 of 41 positions"):
        read_laws(preflight.inputs, folder)
