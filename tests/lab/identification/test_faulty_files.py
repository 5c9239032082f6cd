"""Files with faults that would shift or hide numbers are refused with the line or the cause."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from modaltouch.lab.identification.files import ResponseFormat, read_responses

VELOCITY = ResponseFormat("velocity")
OVER_TIME, RATE = "time_s,set,position_mm,drive,motion", 20e3
OVER_FREQUENCY = "frequency_Hz,set,position_mm,real,imag"
SEMICOLONS = OVER_FREQUENCY.replace(",", ";")
SPLIT = "more fields than columns: a decimal comma splits a number"
HEAD = "***End_of_Header***\nY_Unit_Label\tm/s^2\tN\nDelta_X\t5E-5\t5E-5\n***End_of_Header***\nX_Value\ta\tf\n"


def blow(start: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an impact of three samples from `start` on, and the following decay of a resonance at 500 Hz."""
    time = np.arange(4000) / RATE
    drive = np.zeros(time.size)
    drive[max(start, 0) : start + 3] = [0.5, 1.0, 0.7][max(-start, 0) :]
    since = time - start / RATE
    return drive, np.where(since > 0, np.exp(-60 * since) * np.sin(2 * np.pi * 500 * since), 0.0)


def write_times(path: Path, drive: np.ndarray, motion: np.ndarray) -> Path:
    """Write a time record as CSV."""
    lines = (f"{n / RATE:.6f},hammer,0,{a:.6g},{b:.6g}" for n, (a, b) in enumerate(zip(drive, motion, strict=True)))
    path.write_text("\n".join([OVER_TIME, *lines]))
    return path


@pytest.mark.parametrize(("line", "cells"), [("\tnan\t0", None), ("\t0.1", "'0.1'"), ("\t0.1\tx", "'0.1', 'x'")])
def test_a_faulty_line_of_a_labview_file_is_not_skipped(tmp_path: Path, line: str, cells: str | None) -> None:
    """A missing sample would shift all later ones, which no residual shows."""
    rows = [f"\t{motion:.6g}\t{drive:.6g}" for drive, motion in zip(*blow(200), strict=True)]
    path = tmp_path / "a.lvm"
    path.write_text(HEAD + "\n".join(rows))
    assert read_responses([path]).response.shape[1] == 1
    path.write_text(HEAD + "\n".join([*rows[:300], line, *rows[301:]]))
    words = "a value that is not a finite" if cells is None else rf"a.lvm:306: \[{cells}\] are not numbers of all 2"
    with pytest.raises(ValueError, match=words):
        read_responses([path])


def test_a_record_that_begins_within_an_impact_is_refused(tmp_path: Path) -> None:
    """Without the start of the impact the ratio of the spectra is not the response."""
    late, early = (read_responses([write_times(tmp_path / "a.csv", *blow(at))], VELOCITY) for at in (200, 1))
    n_bins = min(late.frequency.size, early.frequency.size)
    assert n_bins > 1000
    assert np.abs(early.response - late.response)[..., :n_bins].max() < 0.02 * np.abs(late.response).max()
    with pytest.raises(
        ValueError, match=r"a.csv: its record begins within an impact, whose start is missing: set a pr"
    ):
        read_responses([write_times(tmp_path / "a.csv", *blow(-1))], VELOCITY)


def test_a_motion_of_zeros_is_refused(tmp_path: Path) -> None:
    """A sensor that is not connected."""
    with pytest.raises(ValueError, match="a.csv: its motion is constant; measure it again"):
        read_responses([write_times(tmp_path / "a.csv", blow(200)[0], np.zeros(4000))], VELOCITY)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f'{OVER_FREQUENCY}\n"{"x" * 200_000}"', r"a.csv: is damaged or incomplete \(field larger"),
        (f"{OVER_FREQUENCY},real\n1,s,0,1,2,3", "a.csv:1: a column appears twice in frequency_Hz, set, position_mm"),
        (f"{OVER_FREQUENCY}\n1,s,0,1,2\nnan,s,0,1,2", "a.csv:3: 'nan,s,0,1,2' does not give a number for each column"),
        (f"{OVER_FREQUENCY}\n1,s,0,1,2", "a.csv: it has 1 bins; at least 32 are needed"),
        (f"{OVER_FREQUENCY}\n1,s,0,1,2,,\n2,s,0,0,1,5", f"a.csv:3: '2,s,0,0,1,5' has {SPLIT}"),
        (f"{OVER_FREQUENCY},,\n1,s,0,0,1,5", f"a.csv:2: '1,s,0,0,1,5' has {SPLIT}"),
        (SEMICOLONS + "\n999;s;0;0.5;2\n1,000;s;0;1.5;2", "a.csv:3: '1,000;s;0;1.5;2': commas and points are mixed"),
        (SEMICOLONS + "\n999;s;0;0,5;2\n1.000;s;0;1,5;2", "a.csv:3: '1.000;s;0;1,5;2': commas and points are mixed"),
        (f"{OVER_FREQUENCY}\n1,s,0,1,n/a", "a.csv:2: '1,s,0,1,n/a' does not give a number"),
        (f"{OVER_FREQUENCY}\n1,s,nan,1,2", "a.csv:2: '1,s,nan,1,2' does not give a number"),
    ],
)
def test_faulty_tables_are_reported(tmp_path: Path, text: str, words: str) -> None:
    """An unclosed quotation mark, two columns with one name, split or grouped numbers, words in place of numbers."""
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match=words):
        read_responses([tmp_path / "a.csv"], VELOCITY)


def write_responses(path: Path, undefined: int, real: str = "NaN", coherence: str = "nan") -> Path:
    """Write responses from 0 Hz on at six places, undefined at one frequency."""
    rng = np.random.default_rng(1)
    lines = [f"{OVER_FREQUENCY},coherence"]
    for place in range(6):
        lines += [f"{bin},s,{place},{each:.6f},1,0.9" for bin, each in enumerate(rng.standard_normal(40))]
        lines[place * 40 + 1 + undefined] = f"{undefined},s,{place},{real or 1},1,{coherence or 1}"
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize(("real", "coherence"), [("NaN", "nan"), ("", " -nan"), ("-Inf", "")])
def test_a_response_may_be_undefined_where_it_is_not_used(tmp_path: Path, real: str, coherence: str) -> None:
    """H1 and coherence are 0/0 at 0 Hz if nothing is driven there; programs export them as NaN."""
    responses = read_responses([write_responses(tmp_path / "a.csv", 0, real, coherence)], VELOCITY)
    assert np.isfinite(responses.response).all()
    assert responses.frequency[0] == 1
    path, words = write_responses(tmp_path / "b.csv", 7, real, coherence), "a value that is not finite|has a coherence"
    with pytest.raises(ValueError, match=f"b.csv: the response to s at 0 mm (contains )?({words})"):
        read_responses([path], VELOCITY)


def test_an_undefined_value_hides_no_other_fault(tmp_path: Path) -> None:
    """Magnitudes in place of real parts, of which that at 0 Hz is 0/0."""
    path = write_responses(tmp_path / "a.csv", 0)
    path.write_text(path.read_text().replace("-", ""))
    with pytest.raises(ValueError, match="a.csv: no response has a negative real part: magnitudes were exported"):
        read_responses([path], VELOCITY)


def test_an_axis_with_nan_is_reported_as_such(tmp_path: Path) -> None:
    """A single file cannot differ from another one."""
    frequency = np.where(np.arange(40) == 7, np.nan, np.arange(40.0))
    response = np.random.default_rng(1).standard_normal((1, 1, 40)) + 1j
    np.savez(tmp_path / "a.npz", frequency=frequency, response=response, sets=["v"], quantity="velocity")
    with pytest.raises(ValueError, match="a.npz: its frequencies are not evenly spaced and increasing"):
        read_responses([tmp_path / "a.npz"])


def test_a_universal_file_with_too_few_coordinates_is_damaged(tmp_path: Path) -> None:
    """Two nodes with coordinates of only one, as after a lost line."""
    sets = [{"type": 15, "node_nums": [1, 2], "x": [0.0], "y": [0.0], "z": [0.0]}]
    response = {"type": 58, "func_type": 4, "rsp_dir": 3, "ref_node": 1, "x": np.arange(40.0), "data": np.ones(40) * 1j}
    sets += [response | {"rsp_node": node} for node in (1, 2)]
    (tmp_path / "a.uff").write_text("")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("modaltouch.lab.identification.universal_file._read_sets", lambda path: sets)
        with pytest.raises(ValueError, match=r"a.uff: is damaged or incomplete \(list index out of range\)"):
            read_responses([tmp_path / "a.uff"], VELOCITY)


def test_a_response_of_zeros_is_reported_with_its_position(tmp_path: Path) -> None:
    """It has no noise, so nothing else distinguishes it from a node."""
    response = np.random.default_rng(1).standard_normal((2, 8, 400)) + 1j
    response[1, 3] = 0
    arrays = {"frequency": np.arange(400.0), "sets": ["centre", "side"], "quantity": "velocity"}
    np.savez(tmp_path / "a.npz", response=response, positions=np.linspace(-0.04, 0.03, 8), **arrays)
    with pytest.raises(ValueError, match="a.npz: the response to side at -10 mm is zero throughout; measure it again"):
        read_responses([tmp_path / "a.npz"])


def responses(**changes: object) -> dict[str, object]:
    """Return the arrays of a file of random responses, with changes."""
    response = np.random.default_rng(1).standard_normal((2, 8, 400)) + 1j
    places = {"positions": np.linspace(-0.04, 0.03, 8), "sets": ["centre", "side"], "quantity": "velocity"}
    return {"frequency": np.arange(400.0), "response": response, **places, **changes}


@pytest.mark.parametrize(
    ("where", "source", "said"),
    [
        (
            np.s_[0, 2],
            np.s_[0, 3],
            "a.npz: the responses to centre at -20 mm and centre at -10 mm are identical: one is a copy",
        ),
        (
            np.s_[1],
            np.s_[0],
            "a.npz: the responses to centre at -40 mm and side at -40 mm are identical: one is a copy",
        ),
        (np.s_[:, 3, 100:150], np.s_[:, 3, 100:101], "centre at -10 mm has the same value at 50 frequencies in a row"),
        (
            np.s_[..., 5::5],
            None,
            "to centre at -40 mm is zero at 79 of 399 frequencies; measure it again, export it",
        ),
    ],
    ids=["a point copied", "a set copied", "a value held", "gaps filled with zeros"],
)
def test_values_that_were_not_measured_are_refused(tmp_path: Path, where: object, source: object, said: str) -> None:
    """Noise never repeats and is never exactly zero."""
    arrays = responses()
    response = np.asarray(arrays["response"])
    response[where] = 0 if source is None else response[source].copy()
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ValueError, match=said):
        read_responses([tmp_path / "a.npz"])


def test_zeros_outside_the_band_do_not_matter(tmp_path: Path) -> None:
    """Exports fill unexcited frequencies with zeros: a narrower band is read, the whole axis is refused."""
    arrays = responses()
    np.asarray(arrays["response"])[..., 300:] = 0
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ValueError, match="is zero at 100 of 399 frequencies; .* use a narrower band"):
        read_responses([tmp_path / "a.npz"])
    assert read_responses([tmp_path / "a.npz"], ResponseFormat(band=(0.0, 299.0))).frequency[-1] == 399


def test_mirror_images_may_be_identical(tmp_path: Path) -> None:
    """As in noiseless computed responses of a symmetric beam."""
    arrays = responses(positions=np.linspace(-0.035, 0.035, 8))
    response = np.asarray(arrays["response"])
    response[:, 4:] = response[:, 3::-1]
    np.savez(tmp_path / "a.npz", **arrays)
    assert read_responses([tmp_path / "a.npz"]).response.shape == (2, 8, 399)


def test_a_file_given_twice_is_refused(tmp_path: Path) -> None:
    """Its scatter of zero would be stated as that of two measurements."""
    for name in ("a.npz", "b.npz"):
        np.savez(tmp_path / name, **responses())
    with pytest.raises(ValueError, match="two measurements are identical: the same one was given twice"):
        read_responses([tmp_path / "a.npz", tmp_path / "b.npz"])


def test_directions_of_a_universal_file_are_signs(tmp_path: Path) -> None:
    """A sensor along -Z, code -3 of data set 58, inverts its measurement."""
    values = np.random.default_rng(1).standard_normal((2, 40)) + 1j
    common = {"type": 58, "func_type": 4, "ref_node": 1, "x": np.arange(40.0), "ordinate_spec_data_type": 11}
    nodes = {"type": 15, "node_nums": [1, 2], "x": [0.0, 0.1], "y": [0.0, 0.0], "z": [0.0, 0.0]}
    sets = [nodes, *({**common, "rsp_node": n + 1, "rsp_dir": 3 - 6 * n, "data": values[n]} for n in range(2))]
    (tmp_path / "a.uff").write_text("")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("modaltouch.lab.identification.universal_file._read_sets", lambda path: sets)
        read = read_responses([tmp_path / "a.uff"])
        assert read.response[0] == pytest.approx(np.array([[1], [-1]]) * values[:, 1:])
        sets[1]["orddenom_spec_data_type"] = 12
        with pytest.raises(ValueError, match="a.uff: it contains ratios of two motions; export responses to the exc"):
            read_responses([tmp_path / "a.uff"])


def test_time_columns_of_a_labview_file_are_not_channels(tmp_path: Path) -> None:
    """`X_Columns Multi` has a column of times before each channel."""
    path, rows = tmp_path / "a.lvm", [f"{motion:.6g}\t{drive:.6g}" for drive, motion in zip(*blow(200), strict=True)]
    path.write_text(HEAD + "\n".join(f"\t{row}" for row in rows))
    expected = read_responses([path]).response
    multi = HEAD.replace("***End", "X_Columns\tMulti\n***End", 1)
    path.write_text(
        multi + "\n".join(f"{n / RATE}\t" + row.replace("\t", f"\t{n / RATE}\t") for n, row in enumerate(rows))
    )
    assert read_responses([path]).response == pytest.approx(expected)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("Delta_X\t5E-5\t5E-5", "Delta_X\t5E-5\t1E-4"), "motion and excitation differ in time step or start"),
        (("Delta_X", "X0\t0\t1E-3\nDelta_X"), "motion and excitation differ in time step or start"),
        (("Delta_X", "Samples\t9000\t9000\nDelta_X"), "a record has 4000 of 9000 samples: the file was cut off"),
    ],
)
def test_a_labview_file_must_agree_with_its_header(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    """Channels with different times, and a truncated file."""
    rows = [f"\t{motion:.6g}\t{drive:.6g}" for drive, motion in zip(*blow(200), strict=True)]
    (tmp_path / "a.lvm").write_text(HEAD.replace(*change) + "\n".join(rows))
    with pytest.raises(ValueError, match=f"a.lvm: {said}"):
        read_responses([tmp_path / "a.lvm"])


def test_complex_frequencies_are_refused(tmp_path: Path) -> None:
    """NumPy would only warn and drop the imaginary part."""
    bins = np.arange(64)
    response = (bins + 1j)[None, None]
    np.savez(tmp_path / "a.npz", frequency=bins + 1j, response=response, sets=["centre"], positions=[0.0])
    with pytest.raises(ValueError, match="cannot be read .*complex"):
        read_responses([tmp_path / "a.npz"], ResponseFormat("velocity"))
