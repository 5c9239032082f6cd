"""Exports for other programs: responses are read back, and shapes are read by pyuff."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyuff

from modaltouch.lab.identification.files import ResponseFormat, read_responses
from modaltouch.lab.identification.modal_parameters import Estimate, Identification, IdentifiedMode, Rest
from modaltouch.lab.identification.peaks import HalfPower
from modaltouch.lab.identification.report import check_export, export
from modaltouch.lab.identification.responses import FrequencyResponses
from modaltouch.protocol import InputError
from modaltouch.record import RecordError

POSITIONS = np.array([-0.04, -0.01, 0.02, 0.04])
REST = Rest(0.01, 0.0)


@pytest.fixture
def found() -> Identification:
    """Return an identification of two sets and four points, with one mode that has a shape and one without."""
    rng = np.random.default_rng(3)
    response = rng.standard_normal((2, 4, 40)) + 1j * rng.standard_normal((2, 4, 40))
    coherence = rng.uniform(0.5, 1.0, (2, 4, 40))
    frequency = 100 + 0.25 * np.arange(40)
    half = HalfPower(104.0, 1.0, 0.01, 6.0)
    modes = tuple(
        IdentifiedMode(
            label,
            Estimate.of(104.0, 0.1),
            Estimate.of(0.01, 1e-4),
            (),
            shape,
            np.nan,
            half,
            np.nan,
            np.nan,
            REST,
            np.ones(4),
        )
        for label, shape in ((1, np.array([1.0, -0.5, 0.25, 1.5])), (None, None))
    )
    responses = FrequencyResponses(frequency, response, POSITIONS, ("centre", "side"), coherence, 4)
    return Identification(modes, Estimate.of(0.0, 1.0), 1.0, responses, 0.1, response)


@pytest.mark.parametrize("name", ["beam.uff", "beam.unv", "beam.csv"])
def test_exported_responses_are_read_back(tmp_path: Path, found: Identification, name: str) -> None:
    """Frequencies, positions and responses within 1e-8; a universal file states that they are velocities."""
    path = tmp_path / "new" / name
    export(found, path)
    quantity = "velocity" if name.endswith("csv") else None
    read = read_responses([path], ResponseFormat(quantity, n_averages=4))
    given = found.responses
    np.testing.assert_allclose(read.frequency, given.frequency, rtol=1e-12)
    np.testing.assert_allclose(read.response, given.response, rtol=1e-8)
    assert read.positions == pytest.approx(POSITIONS)
    if name.endswith("csv"):
        assert read.sets == ("centre", "side")
        np.testing.assert_allclose(read.coherence, given.coherence, rtol=1e-5)
    assert [each.name for each in path.parent.iterdir()] == [name]


def test_shapes_are_data_set_55(tmp_path: Path, found: Identification) -> None:
    """One normal mode: number, natural frequency, damping ratio and the displacement of every node."""
    export(found, tmp_path / "beam.uff")
    sets = pyuff.UFF(str(tmp_path / "beam.uff")).read_sets()
    assert [each["type"] for each in sets] == [164, 2411, *[58] * 8, 55]
    mode = sets[-1]
    assert (mode["mode_n"], mode["freq"], mode["modal_damp_vis"]) == pytest.approx((1, 104.0, 0.01))
    assert mode["r3"] == pytest.approx([1.0, -0.5, 0.25, 1.5])
    assert sets[1]["x"] == pytest.approx(POSITIONS)


@pytest.mark.parametrize("n_points", [3, 4])
def test_responses_to_a_hammer_are_read_back_without_nodes(
    tmp_path: Path, found: Identification, n_points: int
) -> None:
    """No position is invented; the excitation is a force; an odd number of binary data sets is not called cut off."""
    path, given = tmp_path / "beam.uff", found.responses
    hammered = FrequencyResponses(given.frequency, given.response[:1, :n_points], None, ("hammer",), per="N")
    export(Identification((), found.delay, 1.0, hammered, None, found.fitted), path)
    assert {each["type"] for each in pyuff.UFF(str(path)).read_sets()} == {164, 58}
    read = read_responses([path])
    assert (read.response.shape, read.per) == ((n_points, 1, 40), "N")


def test_unknown_formats_are_refused_first(tmp_path: Path, found: Identification) -> None:
    """Before a long scan; a failed export leaves no file."""
    with pytest.raises(InputError, match=r"--export with the ending '.mat'; allowed: .uff, .unv, .csv"):
        check_export(tmp_path / "beam.mat")
    (tmp_path / "file").touch()
    with pytest.raises(RecordError, match="name another file with --export"):
        export(found, tmp_path / "file" / "beam.csv")
    assert [each.name for each in tmp_path.iterdir()] == ["file"]
