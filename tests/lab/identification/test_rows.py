"""Rows over the width: torsion is distinguished from bending, and shapes are maps, as in the paper's Fig. 4."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification.conftest import BANDWIDTH, DELAY, LENGTH, PERIOD

from modaltouch.lab.identification.command import IdentifyOptions
from modaltouch.lab.identification.command import identify as identify_files
from modaltouch.lab.identification.figures import draw_shape_maps
from modaltouch.lab.identification.files import ResponseFormat, read_responses
from modaltouch.lab.identification.joint_fit import identify
from modaltouch.lab.identification.modal_parameters import Identification
from modaltouch.lab.identification.report import as_dict, export, map_rows, shape_rows, table_rows
from modaltouch.lab.identification.responses import FrequencyResponses, Place, along
from modaltouch.lab.identification.shapes import label_torsion, mac, torsion_shapes
from modaltouch.lab.scan import kept_rows, row_name, rows_over
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.simulator.true_beam import TrueBeam

ROWS = (-2.5e-3, 0.0, 2.5e-3)
POSITIONS = np.linspace(-LENGTH / 2, LENGTH / 2, 13)


def row_of(
    beam: TrueBeam, across: float, scatter: float = 0.0, positions: np.ndarray = POSITIONS
) -> FrequencyResponses:
    """Return the closed-form responses of a row from 6 to 14 kHz, with noise of a thousandth of their median.

    Points may scatter uniformly by a distance along the beam, and by a tenth of it across [m].
    """
    rng = np.random.default_rng(round(across * 1e6) + 9999)
    x = np.clip(positions + rng.uniform(-scatter, scatter, positions.size), -LENGTH / 2, LENGTH / 2)
    y = across + rng.uniform(-scatter, scatter, positions.size) / 10
    frequency = np.arange(int(6e3 * PERIOD / 2) + 1, int(14e3 * PERIOD / 2)) * 2 / PERIOD
    omega, own = 2 * np.pi * frequency, 2 * np.pi * beam.natural_frequency[:, None]
    dynamic = 1j * omega / (own**2 - omega**2 + 2j * beam.damping_ratio[:, None] * own * omega)
    dynamic = dynamic * np.exp(-1j * omega * DELAY) / (1 + 1j * frequency / BANDWIDTH)
    response = np.einsum("ks,kp,kf->spf", beam.modal_gain, beam.shapes(x, y), dynamic, optimize=True)
    noise = rng.standard_normal(response.shape) + 1j * rng.standard_normal(response.shape)
    response = response + 1e-3 * np.median(np.abs(response)) * noise
    return FrequencyResponses(frequency, response, x, ("centre", "side"), bandwidth=BANDWIDTH, across=y)


@pytest.fixture(scope="module")
def found(beam: TrueBeam) -> Identification:
    """Return the identification of three rows."""
    return identify(FrequencyResponses.of_rows([row_of(beam, across) for across in ROWS]), LENGTH)


def test_torsion_is_labelled_between_the_bending_modes(found: Identification, beam: TrueBeam) -> None:
    """The twin's torsion at 8.7 kHz; all natural frequencies within 20 ppm, and all other labels unchanged."""
    assert [mode.name for mode in found.modes] == ["5", "T1", "6", "7"]
    for mode in found.modes:
        own = beam.natural_frequency[np.abs(beam.natural_frequency - mode.natural_frequency.value).argmin()]
        assert mode.natural_frequency.value == pytest.approx(own, rel=2e-5)
    assert [row["mode"] for row in table_rows(found)] == [mode.name for mode in found.modes]
    assert [mode["torsion"] for mode in as_dict(found)["modes"] if mode["torsion"]] == [1]


@pytest.mark.parametrize("scatter", [20e-6, 0.5e-3])
def test_points_of_a_scanned_grid_may_scatter(beam: TrueBeam, scatter: float) -> None:
    """By 20 um or 0.5 mm along the beam: still 11 positions along it, and the same modes."""
    positions = np.linspace(-LENGTH / 2, LENGTH / 2, 11)
    scattered = FrequencyResponses.of_rows([row_of(beam, across, scatter, positions) for across in ROWS])
    found = identify(scattered, LENGTH)
    assert [mode.name for mode in found.modes] == ["5", "T1", "6", "7"]
    np.testing.assert_allclose([float(row["position_mm"]) for row in shape_rows(found)], positions * 1e3, atol=0.5)


def test_close_points_of_one_row_are_separate_positions() -> None:
    """However unevenly they are spaced, and if they scatter across."""
    near = [Place(x, y) for x, y in zip([-50e-3, -49.9e-3, 0.0, 50e-3], [0.0, 4e-5, -2e-5, 0.0], strict=True)]
    assert along(near)[0] == pytest.approx([-50e-3, -49.9e-3, 0.0, 50e-3])


def test_gains_are_those_of_the_mid_line(found: Identification, beam: TrueBeam) -> None:
    """Further rows change no gain: within two thousandths of the twin's."""
    for label in (5, 7):
        k, gain = beam.table.label.index(label), [each.value for each in found.by_label[label].gain]
        np.testing.assert_allclose(gain, beam.table.modal_gain[k], rtol=2e-3)


def test_shapes_over_the_width_are_those_of_the_twin(found: Identification, beam: TrueBeam) -> None:
    """MAC of T1 above 0.99; unit mean square, positive at the corner of largest x and y."""
    x, y = np.array(found.responses.places).T
    true = beam.shapes(x, y)[[-3]]
    twisted = np.array([shape for mode, shape in found.shaped if mode.torsion])
    assert mac(twisted, true) > 0.99
    assert (twisted**2).mean(axis=1) == pytest.approx([1.0])
    assert (twisted[:, -1] > 1).all()


def test_tables_have_the_map_and_the_mid_line(found: Identification) -> None:
    """A line for each of 39 points with torsion, and one for each of 13 positions for the stimulus."""
    rows, line = map_rows(found), shape_rows(found)
    assert (len(rows), rows[0]["across_mm"], rows[-1]["across_mm"]) == (39, "-2.5", "2.5")
    assert "mode_T1" in rows[0]
    np.testing.assert_allclose([float(row["position_mm"]) for row in line], POSITIONS * 1e3, rtol=1e-5)
    assert "mode_T1" not in line[0]
    panels = [axes.get_title() for axes in draw_shape_maps(found).axes]
    assert "mode T1, 8.7 kHz" in panels


@pytest.mark.parametrize("name", ["beam.csv", "beam.uff"])
def test_rows_are_read_back_from_an_export(tmp_path: Path, found: Identification, name: str) -> None:
    """Adjacent points are not repeats of one point."""
    few = found.responses.between(8e3, 8.5e3)
    export(replace(found, modes=(), responses=few), tmp_path / name)
    read = read_responses([tmp_path / name], ResponseFormat("velocity" if name.endswith("csv") else None))
    assert not read.repeats
    order = sorted(range(few.n_points), key=lambda point: few.places[point])
    np.testing.assert_allclose(read.places, np.array(few.places)[order], atol=1e-9)
    np.testing.assert_allclose(read.response, few.response[:, order], rtol=1e-8)


def test_one_row_alone_shows_no_torsion(beam: TrueBeam) -> None:
    """A row 0.2 mm off sees the motion at 8.7 kHz but cannot distinguish it from bending."""
    places = [Place(place, 0.2e-3) for place in POSITIONS]
    assert label_torsion(beam.shapes(POSITIONS, 0.2e-3)[[-3]], [None], places, LENGTH)[0] == [None]
    assert torsion_shapes([1], [Place(0.05)], LENGTH) == pytest.approx(0.0)


def test_an_even_number_of_rows_is_refused(apparatus: Apparatus) -> None:
    """No row would be the mid-line, on which gains are based."""
    assert rows_over(apparatus, 5) == pytest.approx((-2.5e-3, -1.25e-3, 0.0, 1.25e-3, 2.5e-3))
    with pytest.raises(ValueError, match="given --rows 2; allowed: odd numbers"):
        rows_over(apparatus, 2)


def test_rows_of_one_set_are_not_those_of_another(tmp_path: Path) -> None:
    """The folders of the sets `outer` and `outer_2` each have two rows beside the mid-line."""
    for name in ("scan_outer", "scan_outer_2"):
        for across in (-2.5e-3, 0.0, 2.5e-3):
            (tmp_path / row_name(name, across)).mkdir()
    assert kept_rows(tmp_path, "scan_outer") == ["", "_+2.5_mm", "_-2.5_mm"]
    assert kept_rows(tmp_path, "scan_outer_2") == ["", "_+2.5_mm", "_-2.5_mm"]


def test_points_beside_the_beam_are_refused(tmp_path: Path) -> None:
    """Coordinates across in millimetres, or exchanged with those along it."""
    response = np.random.default_rng(0).standard_normal((2, 8, 40)) + 1j
    arrays = {"frequency": 100.0 + np.arange(40), "response": response, "positions": np.linspace(-0.05, 0.05, 8)}
    path = tmp_path / "a.npz"
    np.savez(path, **arrays, across=np.full(8, 2.5), sets=["centre", "side"], quantity="velocity")
    with pytest.raises(ValueError, match=r"a point lies 2500 mm from the mid-line, but the beam is 6 mm wide: check"):
        identify_files(IdentifyOptions(Path("beam_100x6x2"), (path,), out=tmp_path / "out"))
