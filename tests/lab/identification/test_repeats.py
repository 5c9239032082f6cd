"""Impacts and repeats: read from time records, double impacts excluded, intervals that include their scatter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import pyuff
from numpy.typing import ArrayLike

from modaltouch.lab.identification.files import read_responses
from modaltouch.lab.identification.joint_fit import axis_error, identify, identify_each, over_repeats
from modaltouch.lab.identification.modal_parameters import WELL_FITTED, Identification
from modaltouch.lab.identification.responses import FrequencyResponses, ResponseFormat
from modaltouch.lab.identification.verdict import check_modes, repeatability

POLES = ((120.0, 0.012), (330.0, 0.008), (640.0, 0.006))
RESIDUES = (1.0, 0.6, -0.4)
RATE = 4096.0
ACCELERATION = ResponseFormat("acceleration")


def moved(force: np.ndarray, rng: np.random.Generator, stretch: float = 1.0, noise: float = 2e-4) -> np.ndarray:
    """Return the acceleration of three modes under a force that begins and ends at rest, with noise."""
    omega = 2 * np.pi * np.fft.rfftfreq(force.size, 1 / RATE)
    total = np.zeros(omega.size, dtype=complex)
    for (own, ratio), size in zip(POLES, RESIDUES, strict=True):
        pole = 2 * np.pi * own * stretch
        total += -(omega**2) * size / (pole**2 - omega**2 + 2j * ratio * pole * omega)
    motion = np.fft.irfft(total * np.fft.rfft(force), force.size)
    return motion + noise * np.abs(motion).max() * rng.standard_normal(force.size)


def hit(at: Sequence[int], n: int = 8192) -> np.ndarray:
    """Return a force of half sines of 0.7 ms, each of another height."""
    force = np.zeros(n)
    for number, start in enumerate(at):
        force[start : start + 4] += (200 - 10 * number) * np.sin(np.pi * np.array([0.2, 0.45, 0.7, 0.9]))
    return force


def write_csv(path: Path, records: Sequence[tuple[np.ndarray, np.ndarray]], place: str = "") -> Path:
    """Write time records one after the other, as repeats."""
    lines = ["time_s,set,position_mm,drive,motion"]
    for force, motion in records:
        lines += [
            f"{i / RATE!r},hammer,{place},{f!r},{m!r}"
            for i, (f, m) in enumerate(zip(force.tolist(), motion.tolist(), strict=True))
        ]
    path.write_text("\n".join(lines))
    return path


def impacts_of_a_day(path: Path, seed: int) -> Path:
    """Write three impacts between which the natural frequencies change by 5 in 10,000."""
    rng = np.random.default_rng(seed)
    return write_csv(path, [(hit([40]), moved(hit([40]), rng, 1 + 5e-4 * rng.standard_normal())) for _ in range(3)])


def test_two_days_of_one_beam_agree_within_their_intervals(tmp_path: Path) -> None:
    """Intervals over three repeats overlap and contain the truth; those of single fits do not."""
    alone, whole = [], []
    for seed in (1, 2):
        found = identify_each(
            read_responses([impacts_of_a_day(tmp_path / f"{seed}.csv", seed)], ACCELERATION).between(60, 900)
        )
        alone.append([mode.natural_frequency for mode in found.modes])
        whole.append(over_repeats(found))
    for (own, ratio), one, other in zip(POLES, *(found.modes for found in whole), strict=True):
        assert (one.n_repeats, other.n_repeats) == (3, 3)
        for mode in (one, other):
            assert own in mode.natural_frequency
            assert ratio in mode.damping_ratio
        assert one.natural_frequency.low < other.natural_frequency.high
        assert other.natural_frequency.low < one.natural_frequency.high
    assert any(one.low > other.high or other.low > one.high for one, other in zip(*alone, strict=True))
    assert repeatability(whole[0]) == "the intervals include the scatter of 3 measurements"


def test_files_without_positions_are_fitted_separately(tmp_path: Path) -> None:
    """One impact per file; with a single one the repeatability is unknown."""
    rng = np.random.default_rng(3)
    files = [write_csv(tmp_path / f"{k}.csv", [(hit([40]), moved(hit([40]), rng, 1 + k * 1e-4))]) for k in range(3)]
    found = over_repeats(identify_each(read_responses(files, ACCELERATION).between(60, 900)))
    assert [mode.n_repeats for mode in found.modes] == [3, 3, 3]
    half = found.modes[2].natural_frequency.high - found.modes[2].natural_frequency.value
    # Three values at even distances d: their deviation is d, Student's factor 4.303.
    assert half == pytest.approx(4.303 * 640e-4 / np.sqrt(3), rel=0.1)
    single = over_repeats(identify_each(read_responses(files[:1], ACCELERATION).between(60, 900)))
    assert repeatability(single).startswith("repeatability is unknown: the intervals come from one measurement")


def test_double_impacts_are_excluded_and_counted(tmp_path: Path) -> None:
    """Five impacts 2 s apart, the third doubled after 30 ms: four repeats, with a mark."""
    starts = [60, 8252, 16444, 16444 + 123, 24636, 32828]
    force = hit(starts, 41_000)
    responses = read_responses(
        [write_csv(tmp_path / "a.csv", [(force, moved(force, np.random.default_rng(4)))])], ACCELERATION
    )
    assert len(responses.repeats) == 4
    assert responses.n_averages == 4
    assert responses.marks == (
        "2 of 6 hits of a.csv were left out: double impacts, or cut off by the end of the record",
    )
    found = identify_each(responses.between(60, 900))
    assert [mode.natural_frequency.value for mode in found.modes] == pytest.approx([own for own, _ in POLES], rel=2e-4)
    rng, once, twice = np.random.default_rng(4), hit([60]), hit([60, 183])
    mixed = write_csv(tmp_path / "c.csv", [(force, moved(force, rng)) for force in (once, twice, once)])
    assert read_responses([mixed], ACCELERATION).marks[0].startswith("2 of 4 hits of c.csv were left out")
    force = hit([60, 183])
    double = write_csv(tmp_path / "b.csv", [(force, moved(force, np.random.default_rng(4)))])
    with pytest.raises(ValueError, match=r"b.csv: all 2 impacts are double hits: strike again"):
        read_responses([double], ACCELERATION)


def test_segments_of_a_labview_file_are_repeats(tmp_path: Path) -> None:
    """Three headers in one file, each with its data."""
    rng = np.random.default_rng(5)
    text = "LabVIEW Measurement\nMulti_Headings\tYes\n***End_of_Header***\n\n"
    for stretch in (1.0, 1.0002, 0.9998):
        force = hit([40])
        motion = moved(force, rng, stretch)
        text += "Channels\t2\nSamples\t8192\t8192\nY_Unit_Label\tN\tm/s^2\nX0\t0\t0\n"
        text += f"Delta_X\t{1 / RATE:.9E}\t{1 / RATE:.9E}\n"
        text += "***End_of_Header***\nX_Value\tForce\tAcceleration\tComment\n"
        text += "".join(f"\t{f:.8f}\t{a:.8f}\n" for f, a in zip(force, motion, strict=True)) + "\n"
    (tmp_path / "a.lvm").write_text(text)
    responses = read_responses([tmp_path / "a.lvm"])
    assert len(responses.repeats) == 3
    found = over_repeats(identify_each(responses.between(60, 900)))
    assert all(own in mode.natural_frequency for (own, _), mode in zip(POLES, found.modes, strict=True))


def test_time_records_of_a_universal_file_give_its_modes(tmp_path: Path) -> None:
    """Data set 58 of type 1, twice a force followed by an acceleration: two repeats of one response."""
    rng, file = np.random.default_rng(6), pyuff.UFF(str(tmp_path / "a.uff"))
    shared = {"type": 58, "func_type": 1, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0, "binary": 0, "abscissa_spacing": 1}
    ids = {f"id{number}": "NONE" for number in range(1, 6)}
    for _ in range(2):
        force = hit([40])
        for kind, node, data in ((13, 7, force), (12, 9, moved(force, rng))):
            kinds = {"ordinate_spec_data_type": kind, "abscissa_spec_data_type": 17, "orddenom_spec_data_type": 0}
            axis = np.arange(force.size) / RATE
            file.write_sets(
                [shared | ids | kinds | {"rsp_node": node, "x": axis, "data": data, "ord_data_type": 4}], "add"
            )
    responses = read_responses([tmp_path / "a.uff"])
    assert responses.sets == ("reference_7_node_9",)
    assert len(responses.repeats) == 2
    found = identify_each(responses.between(60, 900))
    assert [mode.natural_frequency.value for mode in found.modes] == pytest.approx([own for own, _ in POLES], rel=2e-4)


def test_random_excitation_is_averaged_with_its_coherence(tmp_path: Path) -> None:
    """A minute of noise in 14 windows: H1 with a coherence near 1 at the first two resonances."""
    rng = np.random.default_rng(7)
    force = rng.standard_normal(1 << 18)
    arrays = {"time": np.arange(force.size) / RATE, "drive": force[None, None], "motion": moved(force, rng)[None, None]}
    np.savez(tmp_path / "a.npz", sets=["shaker"], quantity="acceleration", **arrays)
    responses = read_responses([tmp_path / "a.npz"], ResponseFormat(n_averages=14)).between(60, 900)
    assert responses.coherence is not None
    peaks = [int(np.abs(responses.frequency - own).argmin()) for own, _ in POLES[:2]]
    assert (responses.coherence[0, 0, peaks] > 0.98).all()
    found = identify_each(responses)
    assert [mode.natural_frequency.value for mode in found.modes] == pytest.approx([own for own, _ in POLES], rel=1e-3)
    assert [mode.damping_ratio.value for mode in found.modes] == pytest.approx([ratio for _, ratio in POLES], rel=0.05)


def test_a_burst_that_comes_to_rest_needs_no_window(tmp_path: Path) -> None:
    """Half a second of noise and 1.5 s of decay: damping within 0.5 %."""
    rng = np.random.default_rng(9)
    force = np.where(np.arange(8192) < 2048, rng.standard_normal(8192), 0.0)
    np.savez(
        tmp_path / "a.npz", time=np.arange(8192) / RATE, drive=force[None, None], motion=moved(force, rng)[None, None],
        sets=["shaker"], quantity="acceleration",
    )  # fmt: skip
    responses = read_responses([tmp_path / "a.npz"], ResponseFormat(n_averages=10)).between(60, 900)
    assert responses.spacing == pytest.approx(0.5)
    found = identify_each(responses)
    assert [mode.damping_ratio.value for mode in found.modes] == pytest.approx([ratio for _, ratio in POLES], rel=5e-3)


def test_eight_bit_steps_are_not_saturation(tmp_path: Path) -> None:
    """A sine of 100 steps reaches its highest in every cycle; clipped at half, it is refused."""
    force = np.round(100 * np.sin(2 * np.pi * np.arange(8192) / 40.3))
    arrays = {"time": np.arange(8192) / RATE, "drive": force[None, None], "sets": ["shaker"], "quantity": "velocity"}
    np.savez(tmp_path / "a.npz", motion=force[None, None], **arrays)
    assert read_responses([tmp_path / "a.npz"], ResponseFormat(n_averages=4)).n_points == 1
    np.savez(tmp_path / "b.npz", motion=np.clip(force, -50, 50)[None, None], **arrays)
    with pytest.raises(ValueError, match="the motion stays at 50 for .* it was saturated"):
        read_responses([tmp_path / "b.npz"], ResponseFormat(n_averages=4))


def test_an_impact_clipped_for_three_samples_is_saturated(tmp_path: Path) -> None:
    """Equal samples with steep flanks; the gains would be nearly twice too large."""
    rng = np.random.default_rng(1)
    force, motion = hit([40]), moved(hit([40]), rng)
    assert read_responses([write_csv(tmp_path / "a.csv", [(force, motion)])], ACCELERATION).n_points == 1
    cut = write_csv(tmp_path / "b.csv", [(np.minimum(force, 0.55 * force.max()), motion)])
    with pytest.raises(ValueError, match="the excitation stays at .* for 3 samples: it was saturated"):
        read_responses([cut], ACCELERATION)


def test_intervals_of_gains_include_the_scatter_of_repeats(make) -> None:
    """Two scans of eight points, the second with a drive reading 10 % low: the intervals contain both."""
    scans = [make(seed, n_points=8, highest=12e3).between(1200, 9000) for seed in (0, 1)]
    scans[1] = FrequencyResponses(
        scans[1].frequency,
        1.1 * scans[1].response,
        *(getattr(scans[1], name) for name in ("positions", "sets", "coherence", "n_averages", "bandwidth")),
    )
    each: list[Identification] = [identify(scan, 0.1, most=0) for scan in scans]
    mean = identify(FrequencyResponses.of_repeats(scans), 0.1, most=0)
    found = over_repeats(mean)
    assert mean.responses.n_averages == 20
    for label, row in ((3, 0), (5, 1)):
        wide, narrow = found.by_label[label].gain[row], mean.by_label[label].gain[row]
        assert all(one.by_label[label].gain[row].value in wide for one in each)
        assert not all(one.by_label[label].gain[row].value in narrow for one in each)


@pytest.mark.parametrize(
    ("force", "words"),
    [
        (np.zeros(8192), "its excitation is constant"),
        (np.clip(hit([40]), 0, 60), "the excitation stays at 60 for .* it was saturated"),
        (np.ones(20), "it has 20 samples of the excitation and 20 of the motion; both need"),
    ],
)
def test_unusable_records_are_refused(tmp_path: Path, force: np.ndarray, words: str) -> None:
    """No excitation, a saturated one, and too few samples."""
    motion = np.random.default_rng(8).standard_normal(force.size)
    with pytest.raises(ValueError, match=words):
        read_responses([write_csv(tmp_path / "a.csv", [(force, motion)])], ACCELERATION)


def test_intervals_of_a_noiseless_impact_contain_the_truth(tmp_path: Path) -> None:
    """They include the curvature of the other modes' background, without which a frequency is 2.5 half-widths off."""
    file = write_csv(tmp_path / "quiet.csv", [(hit([40]), moved(hit([40]), np.random.default_rng(), noise=0.0))])
    found = identify_each(read_responses([file], ACCELERATION).between(60, 900))
    for (own, ratio), mode in zip(POLES, found.modes, strict=True):
        assert own in mode.natural_frequency
        assert ratio in mode.damping_ratio


ROOT = np.array([4.730040745, 7.853204624, 10.99560784, 14.13716549, 17.27875966])
"""Roots of cos x cosh x = 1, for the first five bending modes of a free-free beam."""


def roving(drift: np.ndarray, ratio: ArrayLike = 0.018, noise: float = 0.01) -> FrequencyResponses:
    """Return the repeats of a hammer that roves over 13 points of a beam of 0.5 m, with an accelerometer at 235 mm.

    Each blow finds the natural frequencies, from 95 Hz on, a part of their value higher: `drift`, (n_repeats, 13).
    The decay is cut off 1.99 s after a blow, at the end of a record; the noise is relative to the highest response.
    """
    frequency, places, rng = np.arange(0.5, 1600.0, 0.5), np.linspace(-0.24, 0.24, 13), np.random.default_rng(4)
    omega, turn = 2 * np.pi * frequency, (np.cosh(ROOT) - np.cos(ROOT)) / (np.sinh(ROOT) - np.sin(ROOT))

    def shapes(place: np.ndarray) -> np.ndarray:
        y = np.outer(ROOT, place / 0.5 + 0.5)
        return np.cosh(y) + np.cos(y) - turn[:, None] * (np.sinh(y) + np.sin(y))

    own = 2 * np.pi * 95 * (ROOT / ROOT[0]) ** 2 * (1 + drift[:, :, None])
    decay, ringing = np.multiply(ratio, own), own * np.sqrt(1 - np.square(ratio))
    pole = (-decay + 1j * ringing)[..., None]
    size = (1 + 1j * decay / ringing)[..., None] / 2
    dynamic = [
        part * (1 - np.exp(1.99 * (own - 1j * omega))) / (1j * omega - own)
        for part, own in ((size, pole), (size.conj(), pole.conj()))
    ]
    response = np.einsum("kp,rpkf->rpf", shapes(places) * shapes(np.array([0.235])), sum(dynamic))
    scatter = rng.standard_normal((2, *response.shape))
    response = response + noise * np.abs(response).max(axis=(0, 2), keepdims=True) * (scatter[0] + 1j * scatter[1])
    each = [FrequencyResponses(frequency, blows[np.newaxis], places, ("hammer",)) for blows in response]
    return FrequencyResponses.of_repeats(each)


@pytest.mark.parametrize(
    ("drift", "noise"),
    [
        (0.01 * np.linspace(-1, 1, 39).reshape(13, 3).T, 0.003),
        (0.015 * np.random.default_rng(5).standard_normal((5, 13)), 0.003),
    ],
)
def test_drift_between_blows_is_no_noise(drift: np.ndarray, noise: float) -> None:
    """A hammer that roves while the beam warms up, or whose suspension changes the frequencies from blow to blow."""
    with pytest.raises(ValueError, match="cause is drift: let the beam warm up, .* and scan all sets again$"):
        check_modes(identify(roving(drift, noise=noise), 0.5), (3, 4, 5, 6, 7))


def test_repeats_that_differ_at_resonances_only_have_drifted() -> None:
    """Narrow resonances, 0.7 % apart: no other position, sign or unit leaves what is between them as it was."""
    with pytest.raises(
        ValueError, match="measurement 2 does not repeat .*; it does between the resonances, so the beam drifted"
    ):
        roving(np.array([[0.0], [0.007]]) * np.ones(13), ratio=0.003, noise=1e-4)


def test_a_decay_cut_off_by_the_end_of_a_record_is_no_error_of_the_axis() -> None:
    """0.8 % of the first mode's motion is left after 2 s: more than the noise, and no bin that is off."""
    found = identify(roving(np.zeros((3, 13)), ratio=[0.004, 0.003, 0.003, 0.004, 0.004], noise=3e-4), 0.5)
    assert 1.5 < found.misfit < WELL_FITTED
    assert axis_error(found) == ""
