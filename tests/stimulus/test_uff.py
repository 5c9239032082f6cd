"""Measured shapes from universal files, written by pyuff."""

import numpy as np
import pytest
import pyuff

from modaltouch.stimulus.modes import mode_shapes
from modaltouch.stimulus.uff import read_uff

LABELS = tuple(range(1, 18, 2))
PLACE = np.linspace(-0.05, 0.05, 41)


def write(path, shapes, *, labels=LABELS, place=PLACE, unit=1.0, nodes=None, analysis=2):
    """Write shapes (n_modes, n_points) that move along z on a beam along y, its nodes in no order."""
    order = np.random.default_rng(0).permutation(place.size)
    number = np.arange(101, 101 + place.size)
    file = pyuff.UFF(str(path))
    flat, zero = [0.003 * unit] * place.size, np.zeros(place.size)
    if unit != 1.0:
        file.write_sets(
            pyuff.prepare_164(
                units_code=5,
                units_description="mm",
                temp_mode=1,
                length=unit,
                force=1.0,
                temp=1.0,
                temp_offset=0.0,
                return_full_dict=True,
            ),
            "add",
        )
    one = [1] * place.size
    if nodes != "left out":
        file.write_sets(
            pyuff.prepare_15(
                node_nums=number[order].tolist(),
                def_cs=one,
                disp_cs=one,
                color=one,
                x=flat,
                y=(place[order] * unit).tolist(),
                z=flat,
            ),
            "add",
        )
    for label, shape in zip(labels, shapes, strict=True):
        kind = 5 if np.iscomplexobj(shape) else 2
        extra = {"eig": 1j, "modal_a": 1 + 0j, "modal_b": 1 + 0j} if analysis == 3 else {"freq": 1.0, "modal_m": 1.0}
        if analysis == 2:
            extra |= {"modal_damp_vis": 0.0, "modal_damp_his": 0.0}
        file.write_sets(
            pyuff.prepare_55(
                model_type=1,
                id1="NONE",
                id2="NONE",
                id3="NONE",
                id4="NONE",
                id5="NONE",
                analysis_type=analysis,
                data_ch=2,
                spec_data_type=8,
                data_type=kind,
                n_data_per_node=3,
                r1=zero.astype(shape.dtype),
                r2=0.1 * shape,
                r3=shape,
                node_nums=number,
                load_case=1,
                mode_n=label,
                **extra,
            ),
            "add",
        )
    return path


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_shapes_come_back_from_a_file(tmp_path, unit):
    """Theoretical shapes, written in metres or (data set 164) millimetres, nodes out of order, five printed digits."""
    shapes = mode_shapes(LABELS, PLACE, 0.1)
    measured = read_uff(write(tmp_path / "a.uff", -2.5e-3 * shapes, unit=unit), 0.1)
    assert measured.label == LABELS
    assert measured.position == pytest.approx(PLACE, abs=1e-9)
    assert measured.shape == pytest.approx(shapes, abs=1e-4)


def test_complex_shapes_are_turned_to_real_ones(tmp_path):
    """A common phase of each mode drops out (up to the sign that the right end decides)."""
    shapes = mode_shapes(LABELS, PLACE, 0.1)
    phase = np.exp(1j * np.arange(9))[:, None]
    measured = read_uff(write(tmp_path / "a.uff", shapes * phase, analysis=3), 0.1)
    assert measured.shape == pytest.approx(shapes, abs=1e-4)


def test_origin_and_labels_can_be_told(tmp_path):
    """A file that counts nodes from the left end and modes from 1."""
    shapes = mode_shapes(LABELS, PLACE, 0.1)
    path = write(tmp_path / "a.uff", shapes, labels=range(1, 10), place=PLACE + 0.05)
    measured = read_uff(path, 0.1, label=LABELS, origin=-0.05)
    assert measured.label == LABELS
    assert measured.shape == pytest.approx(shapes, abs=1e-4)
    with pytest.raises(ValueError, match=r"a\.uff: the scan grid runs from 0 to 100 mm; it must .* measure from mid"):
        read_uff(path, 0.1, label=LABELS)
    with pytest.raises(ValueError, match=r"9 mode shapes, but 2 labels; give one to each"):
        read_uff(path, 0.1, label=(1, 3))


def test_files_without_shapes_are_refused(tmp_path):
    """What is missing is said, after the path."""
    shapes = mode_shapes(LABELS, PLACE, 0.1)
    with pytest.raises(ValueError, match=r"gone\.uff: there is no such file"):
        read_uff(tmp_path / "gone.uff", 0.1)
    (tmp_path / "text.uff").write_text("not a universal file\n")
    with pytest.raises(ValueError, match=r"text\.uff: (cannot be read as a universal file|no mode shape)"):
        read_uff(tmp_path / "text.uff", 0.1)
    with pytest.raises(ValueError, match=r"no mode shape among the data sets \(15\)"):
        read_uff(write(tmp_path / "nodes.uff", [], labels=()), 0.1)
    with pytest.raises(ValueError, match=r"node 101 has a shape but no coordinates"):
        read_uff(write(tmp_path / "shapes.uff", shapes, nodes="left out"), 0.1)


def test_a_travelling_wave_is_no_mode(tmp_path):
    """Half of its motion is out of phase with the other half."""
    shapes = mode_shapes(LABELS, PLACE, 0.1) + 1j * np.roll(mode_shapes(LABELS, PLACE, 0.1), 1, axis=0)
    with pytest.raises(ValueError, match=r"of mode 1 moves out of phase with the rest, allowed are 30%"):
        read_uff(write(tmp_path / "a.uff", shapes, analysis=3), 0.1)
