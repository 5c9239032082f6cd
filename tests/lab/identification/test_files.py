"""Files of other programs: stated facts are used, missing ones requested, wrong ones reported."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modaltouch.lab.identification.files import ResponseFormat, read_responses
from modaltouch.lab.identification.joint_fit import identify_each
from modaltouch.lab.identification.peaks import half_power

POLES = ((120.0, 0.012), (330.0, 0.008), (640.0, 0.006))
RESIDUES = np.array([[1.0, 0.6, -0.4], [0.7, -1.0, 0.9]])


def accelerance(frequency: np.ndarray, residue: np.ndarray) -> np.ndarray:
    """Return the acceleration per newton of three modes."""
    omega = 2 * np.pi * frequency
    total = np.zeros(frequency.size, dtype=complex)
    for (own, ratio), size in zip(POLES, residue, strict=True):
        pole = 2 * np.pi * own
        total += -(omega**2) * size / (pole**2 - omega**2 + 2j * ratio * pole * omega)
    return total


@pytest.fixture
def frequency() -> np.ndarray:
    """Return a frequency axis from 0 with steps of 0.5 Hz."""
    return np.arange(0, 1600) * 0.5


def noisy(values: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return values with noise of a thousandth of their maximum."""
    rng = np.random.default_rng(seed)
    size = 1e-3 * np.abs(values).max()
    return values + size * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))


def write_uff(path: Path, frequency: np.ndarray, *, kind: int = 12) -> Path:
    """Write two responses as data sets 58, 164 and 15."""
    import pyuff

    file = pyuff.UFF(str(path))
    nodes = {"node_nums": [1, 2], "x": [0.0, 0.3], "y": [0, 0], "z": [0, 0]}
    extra = dict.fromkeys(("def_cs", "disp_cs", "color"), [0, 0])
    sets: list[dict[str, Any]] = [{"type": 15, **nodes, **extra}]
    for node, residue in enumerate(RESIDUES, start=1):
        sets.append(
            {
                "type": 58,
                "func_type": 4,
                "rsp_node": node,
                "rsp_dir": 3,
                "ref_node": 1,
                "ref_dir": 3,
                "rsp_ent_name": "NONE",
                "ref_ent_name": "NONE",
                "data": noisy(accelerance(frequency, residue), node),
                "x": frequency,
                "id1": "test",
                "ordinate_spec_data_type": kind,
                "orddenom_spec_data_type": 13,
                "abscissa_spec_data_type": 18,
                "abscissa_spacing": 1,
                "binary": 0,
            }
        )
    for each in sets:
        file.write_sets(each, "add")
    return path


def write_csv(path: Path, frequency: np.ndarray, *, conjugated: bool = False) -> Path:
    """Write two responses in long form."""
    lines = ["frequency_Hz,set,position_mm,real,imag"]
    for place, residue in zip((-20, 20), RESIDUES, strict=True):
        values = noisy(accelerance(frequency, residue))
        values = np.conj(values) if conjugated else values
        lines += [
            f"{f!r},hammer,{place},{v.real!r},{v.imag!r}"
            for f, v in zip(frequency.tolist(), values.tolist(), strict=True)
        ]
    path.write_text("\n".join(lines))
    return path


def write_npz(path: Path, frequency: np.ndarray) -> Path:
    """Write two responses as arrays with their quantity."""
    values = np.array([[noisy(accelerance(frequency, residue)) for residue in RESIDUES]])
    np.savez(path, frequency=frequency, response=values, sets=["hammer"], quantity="acceleration")
    return path


def write_lvm(path: Path, *, unit: str = "g", clipped: bool = False) -> Path:
    """Write an impact and its decay as LabVIEW does, with decimal commas."""
    rate, n = 4096.0, 8192
    time = np.arange(n) / rate - 0.01
    force = np.where((time > 0) & (time < 5e-4), 200 * np.sin(np.pi * time / 5e-4), 0.0)
    motion = np.zeros(n)
    for (own, ratio), size in zip(POLES, RESIDUES[0], strict=True):
        pole = 2 * np.pi * own
        damped = pole * np.sqrt(1 - ratio**2)
        since = np.arange(n) / rate
        decay = np.exp(-ratio * pole * since) * np.sin(damped * since)
        # Displacement by convolution, acceleration by its second difference: exact enough for natural frequencies.
        displacement = np.convolve(force, decay)[:n] * size / damped / rate
        motion += np.gradient(np.gradient(displacement, 1 / rate), 1 / rate)
    motion = motion / 9.80665
    motion += 3e-4 * motion.max() * np.random.default_rng(2).standard_normal(n)
    if clipped:
        motion = np.clip(motion, -0.5 * motion.max(), 0.5 * motion.max())
    head = [
        "LabVIEW Measurement\t", "Separator\tTab", "Decimal_Separator\t,", "***End_of_Header***\t", "\t",
        "Channels\t2\t\t", f"Y_Unit_Label\t{unit}\tNewtons\t", f"Delta_X\t{1 / rate:.9E}\t{1 / rate:.9E}\t",
        "***End_of_Header***\t\t", "X_Value\tAcceleration\tForce\tComment",
    ]  # fmt: skip
    head = [line.replace(".", ",") if line.startswith("Delta") else line for line in head]
    rows = [f"\t{a:.6f}\t{f:.6f}".replace(".", ",") for a, f in zip(motion, force, strict=True)]
    path.write_text("\n".join(head + rows))
    return path


WRITERS: dict[str, tuple[Callable[..., Path], ResponseFormat]] = {
    "modes.uff": (write_uff, ResponseFormat()),
    "modes.csv": (write_csv, ResponseFormat("acceleration")),
    "modes.npz": (write_npz, ResponseFormat()),
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_modes(tmp_path: Path, frequency: np.ndarray, name: str) -> None:
    """Natural frequencies within 0.02 %, damping ratios within 2 %, and the first peak in m/s per N."""
    write, how = WRITERS[name]
    responses = read_responses([write(tmp_path / name, frequency)], how)
    found = identify_each(responses)
    assert [mode.natural_frequency.value for mode in found.modes] == pytest.approx([own for own, _ in POLES], rel=2e-4)
    assert [mode.damping_ratio.value for mode in found.modes] == pytest.approx([ratio for _, ratio in POLES], rel=0.02)
    at = int(np.abs(responses.frequency - 120).argmin())
    highest = np.abs(responses.response[..., at]).max()
    assert highest == pytest.approx(1.0 / (2 * 0.012 * 2 * np.pi * 120), rel=0.01)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_spreadsheets_with_decimal_commas_are_read(tmp_path: Path, frequency: np.ndarray, separator: str) -> None:
    """A German spreadsheet writes semicolons, or tabs, where another writes commas, and commas for points."""
    plain = write_csv(tmp_path / "plain.csv", frequency)
    other = tmp_path / "other.csv"
    other.write_text(plain.read_text().replace(",", separator).replace(".", ","), encoding="utf-8-sig")
    how = ResponseFormat("acceleration")
    assert np.array_equal(*(read_responses([path], how).response for path in (plain, other)))


def test_data_sets_that_are_not_needed_are_not_read(
    tmp_path: Path, frequency: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    """The library prints groups of elements (2467), in the middle of the output of --json, while it reads them."""
    path = write_uff(tmp_path / "modes.uff", frequency)
    numbers = [[1, 0, 0, 0, 0, 0, 0, 1], [8, 110, 0, 0]]
    head, entity = ("".join(f"{number:10}" for number in row) for row in numbers)
    group = f"    -1\n  2467\n{head}\nLeft\n{entity}\n    -1\n"
    path.write_text(path.read_text() + group)
    assert read_responses([path]).n_points == 2
    assert capsys.readouterr().out == ""


def test_positions_of_a_universal_file_are_from_the_middle(tmp_path: Path, frequency: np.ndarray) -> None:
    """Nodes 0.3 m apart are at -0.15 and 0.15 m; the reference gives a valid name of an actuator set."""
    responses = read_responses([write_uff(tmp_path / "modes.uff", frequency)])
    assert responses.sets == ("reference_1",)
    assert responses.positions == pytest.approx([-0.15, 0.15])


def test_a_hammer_record_gives_its_modes(tmp_path: Path) -> None:
    """One impact in LabVIEW's format, in g and N: frequencies within 0.05 %, damping within 5 %."""
    found = identify_each(read_responses([write_lvm(tmp_path / "blow.lvm")]).between(60, 900))
    assert [mode.natural_frequency.value for mode in found.modes] == pytest.approx([own for own, _ in POLES], rel=5e-4)
    assert [mode.damping_ratio.value for mode in found.modes] == pytest.approx([ratio for _, ratio in POLES], rel=0.05)


def test_a_conjugated_file_needs_its_option(tmp_path: Path, frequency: np.ndarray) -> None:
    """Responses by exp(-i w t) are refused without --conjugated and read correctly with it."""
    path = write_csv(tmp_path / "modes.csv", frequency, conjugated=True)
    with pytest.raises(ValueError, match="conjugated.*--conjugated"):
        identify_each(read_responses([path], ResponseFormat("acceleration")))
    found = identify_each(read_responses([path], ResponseFormat("acceleration", conjugated=True)))
    assert found.modes[1].natural_frequency.value == pytest.approx(330, rel=2e-4)


def test_noise_is_not_called_conjugated(tmp_path: Path, frequency: np.ndarray) -> None:
    """Of ten responses as noisy as their peaks, none gets this wrong remedy."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        values = accelerance(frequency, RESIDUES[0])
        noise = rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)
        path = tmp_path / f"{seed}.npz"
        response = (values * (1 + 0.7 * noise))[None, None]
        np.savez(path, frequency=frequency, response=response, sets=["hammer"], quantity="acceleration")
        said = ""
        try:
            identify_each(read_responses([path]))
        except ValueError as error:
            said = str(error)
        assert "--conjugated" not in said


def test_a_wrong_quantity_is_refused(tmp_path: Path, frequency: np.ndarray) -> None:
    """An acceleration taken for a velocity is imaginary at its resonances."""
    path = write_csv(tmp_path / "modes.csv", frequency)
    with pytest.raises(ValueError, match="imaginary at their resonances.*--quantity"):
        identify_each(read_responses([path], ResponseFormat("velocity")))
    with pytest.raises(ValueError, match="does not say whether it contains a velocity.*--quantity"):
        read_responses([path])
    named = write_uff(tmp_path / "modes.uff", frequency)
    with pytest.raises(ValueError, match="its quantity is acceleration, but --quantity says velocity"):
        read_responses([named], ResponseFormat("velocity"))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.xyz", "", "files that end in '.xyz' cannot be read; allowed: .uff"),
        ("a.yaml", "", "allowed: .uff, .unv, .csv, .npz, .lvm; give an apparatus with --apparatus"),
        ("a.csv", "frequency,re\n1,2", "a.csv:1: the column frequency_Hz is missing"),
        ("a.csv", "frequency_Hz,set,position_mm,real,imag\n1,s,0,x,2", "a.csv:2: '1,s,0,x,2' does not give a number"),
        ("a.csv", "frequency_Hz,set,position_mm,real,imag\n", "no line below the header"),
        ("a.lvm", "nothing", r"there is no \*\*\*End_of_Header\*\*\*"),
        ("a.npz", "nothing", "cannot be read .* it needs frequency"),
        ("a.uff", "nothing", "universal file|no frequency response"),
    ],
)
def test_damaged_files_are_reported(tmp_path: Path, name: str, content: str, words: str) -> None:
    """With path, line if possible, and the remedy."""
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(ValueError, match=words):
        read_responses([path], ResponseFormat("velocity"))


@pytest.mark.parametrize("line", ["", "Delta_X\tfast\tfast\t", "Delta_X\t", "Delta_X\t0,0\t0,0\t"])
def test_a_labview_file_without_a_time_step_is_refused(tmp_path: Path, line: str) -> None:
    """National Instruments, "Specification for the LabVIEW Measurement File": each segment states its Delta_X."""
    path = write_lvm(tmp_path / "a.lvm")
    lines = path.read_text().splitlines()
    path.write_text("\n".join(line if each.startswith("Delta_X") else each for each in lines))
    with pytest.raises(ValueError, match=r"a.lvm: its header gives no time step \(Delta_X\)"):
        read_responses([path])


def test_a_missing_file_and_an_uneven_axis_are_refused(tmp_path: Path) -> None:
    """The second has a jump in its frequencies."""
    with pytest.raises(ValueError, match="there is no such file"):
        read_responses([tmp_path / "none.csv"])
    frequency = np.append(np.arange(40.0), 99.0)
    np.savez(tmp_path / "a.npz", frequency=frequency, response=np.ones((1, 1, 41)), sets=["v"], quantity="velocity")
    with pytest.raises(ValueError, match="not evenly spaced"):
        read_responses([tmp_path / "a.npz"])


def test_frequencies_of_few_digits_are_evenly_spaced(tmp_path: Path) -> None:
    """Six digits, as in data set 58, of bins 7.3 Hz apart at 20 kHz: the even axis is restored."""
    frequency = 7.3 * np.arange(1, 3001)
    printed = np.array([float(f"{each:.5e}") for each in frequency])
    response = np.random.default_rng(0).standard_normal((1, 1, 3000))
    np.savez(tmp_path / "a.npz", frequency=printed, response=response, sets=["v"], quantity="velocity")
    assert read_responses([tmp_path / "a.npz"]).frequency == pytest.approx(frequency, rel=1e-5)
    assert np.ptp(np.diff(read_responses([tmp_path / "a.npz"]).frequency)) < 1e-6


def blow(path: Path, **spoilt: np.ndarray) -> Path:
    """Write a burst of sines and its decay as arrays over time, with an offset, or altered arrays."""
    time = np.arange(4096) / 4096
    drive = np.where((time > 0.01) & (time < 0.3), np.sin(2 * np.pi * (50 + 500 * time) * time), 0.0)
    motion = np.convolve(drive, np.exp(-20 * time) * np.sin(2 * np.pi * 120 * time))[: time.size]
    arrays = {"time": time, "drive": drive[None, None] + 0.5, "motion": motion[None, None] + 30, **spoilt}
    np.savez(path, **arrays, sets=["hammer"], quantity="velocity")
    return path


def test_records_with_lost_samples_or_nan_are_refused(tmp_path: Path) -> None:
    """Forty lost samples would shift all frequencies by 1 %."""
    time = np.arange(4096) / 4096
    time[2000:] += 40 / 4096
    with pytest.raises(ValueError, match=r"a.npz: its times are not evenly spaced.*: samples are missing"):
        read_responses([blow(tmp_path / "a.npz", time=time)])
    motion = np.full((1, 1, 4096), np.nan)
    with pytest.raises(ValueError, match=r"a.npz: its excitation or motion has a value that is not a finite number"):
        read_responses([blow(tmp_path / "a.npz", motion=motion)])


def test_a_truncated_decay_is_marked(tmp_path: Path) -> None:
    """An impact recorded for a quarter of the time in which its motion decays."""
    time = np.arange(2048) / 4096
    drive = np.where(abs(time - 0.01) < 2e-3, np.cos(2 * np.pi * 125 * (time - 0.01)), 0.0)
    motion = np.exp(-2 * time) * np.sin(2 * np.pi * 120 * time)
    path = blow(tmp_path / "a.npz", time=time, drive=drive[None, None], motion=motion[None, None])
    assert read_responses([path]).marks == (
        "the motion of a.npz has not died out at the end of a record: record for longer",
    )
    noisy = np.where(time < 0.1, motion, 0.0) + 0.06 * np.random.default_rng(0).standard_normal(time.size)
    assert read_responses([blow(path, time=time, drive=drive[None, None], motion=noisy[None, None])]).marks == ()


def test_a_window_without_a_record_before_the_impact_is_marked(tmp_path: Path) -> None:
    """The noise of the drive fades with it; a window of the drive alone, which sets its later half to 0, is none."""
    time, rng = np.arange(4096) / 4096, np.random.default_rng(0)
    drive = np.where(time < 4e-3, np.sin(np.pi * time / 4e-3), 1e-3 * rng.standard_normal(time.size))
    motion = np.exp(-20 * time) * np.sin(2 * np.pi * 120 * time)
    for decay, length, marked in ((0.0, 1.0, False), (6.0, 1.0, True), (0.0, 0.5, False)):
        arrays = {"drive": drive * np.exp(-decay * time) * (time < length), "motion": motion * np.exp(-decay * time)}
        path = blow(tmp_path / "a.npz", time=time, **{name: each[None, None] for name, each in arrays.items()})
        assert ("an exponential window" in " ".join(read_responses([path]).marks)) == marked


def test_a_record_without_impacts_needs_averages(tmp_path: Path) -> None:
    """A single spectrum of noise has peaks like resonances."""
    drive, motion = np.random.default_rng(0).standard_normal((2, 1, 1, 4096))
    with pytest.raises(ValueError, match="its excitation goes on throughout, so averages are needed: give --averages"):
        read_responses([blow(tmp_path / "a.npz", drive=drive, motion=motion)])


def test_a_burst_with_an_offset_is_one_spectrum(tmp_path: Path) -> None:
    """An amplifier's offset is not motion, so the record is not divided into windows."""
    assert read_responses([blow(tmp_path / "a.npz")]).spacing == pytest.approx(1.0)


def test_a_drive_with_a_sharp_end_ends_the_band(tmp_path: Path) -> None:
    """A burst of sines up to 600 Hz: no response is given above, where there is only noise."""
    lines = np.exp(2j * np.pi * np.random.default_rng(1).random(2049)) * (np.arange(2049) <= 600)
    burst = np.fft.irfft(lines) * (np.arange(4096) > 40)
    motion = np.convolve(burst, np.exp(-0.01 * np.arange(4096)) * np.sin(np.arange(4096)))[:4096]
    still = np.zeros(4096)
    arrays = {name: np.append(each, still)[None, None] for name, each in (("drive", burst), ("motion", motion))}
    read = read_responses([blow(tmp_path / "a.npz", time=np.arange(8192) / 4096, **arrays)])
    assert read.frequency[-1] == pytest.approx(600, abs=2)


@pytest.mark.parametrize("coherence", [np.nan, 100.0, -0.1])
def test_an_invalid_coherence_is_refused(tmp_path: Path, frequency: np.ndarray, coherence: float) -> None:
    """In per cent, negative, or NaN."""
    arrays = {"response": accelerance(frequency, RESIDUES[0])[None, None], "coherence": coherence}
    np.savez(tmp_path / "a.npz", frequency=frequency, sets=["v"], quantity="acceleration", **arrays)
    with pytest.raises(ValueError, match="the response to v 1 has a coherence that is not between 0 and 1 throughout"):
        read_responses([tmp_path / "a.npz"], ResponseFormat(n_averages=4))


def test_an_axis_one_bin_too_high_is_refused(tmp_path: Path, frequency: np.ndarray) -> None:
    """The Fourier transform of real records is real at 0 Hz, and nowhere else in the band."""
    even = np.arange(frequency.size) * (step := frequency[1] - frequency[0])
    response = accelerance(even, RESIDUES[0]) + 1e-3  # the offset of a sensor, which any record has
    assert response[0].imag == 0 < response[0].real
    for first in (0.0, step):
        np.savez(
            tmp_path / "a.npz", frequency=even + first, response=response[None, None], sets=["v"], quantity="velocity"
        )
        if not first:
            assert read_responses([tmp_path / "a.npz"]).frequency[0] == step
            continue
        with pytest.raises(ValueError, match=f"first frequency, {step:.6g} Hz, are all real.* that much too high"):
            read_responses([tmp_path / "a.npz"])


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda h: np.abs(h) + 1j * np.degrees(np.angle(h)), "magnitudes were exported in its place"),
        (lambda h: np.abs(h) * np.exp(1j * np.degrees(np.angle(h))), "degrees were taken for radians"),
        (lambda h: h.real + 0j, "the imaginary part is zero throughout"),
        (lambda h: 1j * h.imag, "the real part is zero throughout"),
        (
            lambda h: (20 * np.log10(np.maximum(np.abs(h), 1e-6)) - 100) * np.exp(1j * np.angle(h)),
            "they are decibels",
        ),
    ],
    ids=["amplitude and phase", "degrees", "real part", "imaginary part", "decibels"],
)
def test_other_forms_of_a_response_are_refused(
    tmp_path: Path, frequency: np.ndarray, made: Callable, said: str
) -> None:
    """At six positions: anything but real and imaginary parts."""
    response = made(np.tile(accelerance(frequency, RESIDUES[0]), (1, 6, 1)))
    np.savez(
        tmp_path / "a.npz", frequency=frequency, response=response, sets=["v"], quantity="velocity",
        positions=np.arange(6.0),
    )  # fmt: skip
    with pytest.raises(ValueError, match=f"{said}; export real and imaginary part"):
        read_responses([tmp_path / "a.npz"])


def test_a_damaged_universal_file_is_reported(tmp_path: Path, frequency: np.ndarray) -> None:
    """Truncated in its second response; and with a letter for a digit."""
    whole = write_uff(tmp_path / "a.uff", frequency).read_text()
    (tmp_path / "b.uff").write_text(whole[: len(whole) * 7 // 10])
    with pytest.raises(ValueError, match="b.uff: it ends within a data set: it was cut off"):
        read_responses([tmp_path / "b.uff"])
    lines = whole.splitlines()
    lines[99] = lines[99].replace(".", "x", 1)
    (tmp_path / "c.uff").write_text("\n".join(lines))
    with pytest.raises(ValueError, match="c.uff: cannot be read as a universal file"):
        read_responses([tmp_path / "c.uff"])


def test_an_exponential_window_is_marked(tmp_path: Path) -> None:
    """Noise that decays with the motion."""
    rng, time = np.random.default_rng(0), np.arange(4096) / 4096
    drive = np.where(abs(time - 0.1) < 2e-3, np.cos(2 * np.pi * 125 * (time - 0.1)), 0.0)
    motion = np.where(time > 0.1, np.exp(-20 * (time - 0.1)) * np.sin(2 * np.pi * 120 * time), 0.0)
    motion = (motion + 1e-3 * rng.standard_normal(4096)) * np.exp(-5 * np.maximum(time - 0.1, 0))
    path = blow(tmp_path / "a.npz", drive=drive[None, None], motion=motion[None, None])
    assert any("exponential window" in mark for mark in read_responses([path]).marks)


def test_unknown_units_and_saturated_records_are_refused(tmp_path: Path) -> None:
    """A unit of mils, and a record that stays at its end of range."""
    with pytest.raises(ValueError, match="its channels are in mil, Newtons; it needs one motion"):
        read_responses([write_lvm(tmp_path / "a.lvm", unit="mil")])
    with pytest.raises(ValueError, match="the motion stays at .* it was saturated; measure again"):
        read_responses([write_lvm(tmp_path / "b.lvm", clipped=True)])


def test_the_free_decay_of_a_saturated_record_may_be_used(tmp_path: Path) -> None:
    """After the last saturated sample: first mode within 0.1 %, damping within 5 %, with a mark."""
    path = write_lvm(tmp_path / "b.lvm", clipped=True)
    responses = read_responses([path], ResponseFormat(use_clipped=True))
    assert responses.marks[0].startswith("the record b.lvm was saturated: only its free decay from ")
    found = identify_each(responses.between(60, 900))
    assert found.modes[0].natural_frequency.value == pytest.approx(120, rel=1e-3)
    assert found.modes[0].damping_ratio.value == pytest.approx(0.012, rel=0.05)


def test_a_set_missing_at_a_position_is_reported(tmp_path: Path, frequency: np.ndarray) -> None:
    """Two excitations, one of them at a single position."""
    path = write_csv(tmp_path / "modes.csv", frequency)
    other = [line.replace("hammer", "shaker") for line in path.read_text().splitlines() if ",-20," in line]
    path.write_text(path.read_text() + "\n" + "\n".join(other))
    with pytest.raises(ValueError, match="shaker has no response at 20 mm, but another excitation has"):
        read_responses([path], ResponseFormat("acceleration"))


def test_the_half_power_method_on_a_single_mode() -> None:
    """Bandwidth over twice the frequency is the damping ratio, within 0.1 %."""
    frequency = np.arange(900, 1100, 0.02)
    omega, own = 2 * np.pi * frequency, 2 * np.pi * 1000
    response = np.abs(1j * omega / (own**2 - omega**2 + 2j * 0.005 * own * omega))
    peak = half_power(frequency, response, 1000, 10)
    assert peak.damping_ratio == pytest.approx(0.005, rel=1e-3)
    assert peak.verdict == ""


def test_half_power_needs_five_bins_across_the_peak() -> None:
    """For a mode 10 Hz wide, bins 4 Hz apart are reported as too coarse."""
    frequency = np.arange(900, 1100, 4.0)
    omega, own = 2 * np.pi * frequency, 2 * np.pi * 1001
    response = np.abs(1j * omega / (own**2 - omega**2 + 2j * 0.005 * own * omega))
    peak = half_power(frequency, response, 1001, 10)
    assert "bins across the peak, but at least 5 are needed" in peak.verdict


def test_noise_at_the_drive_lowers_h1(tmp_path: Path) -> None:
    """Noise of 30 % of the drive: H1 falls by 1 / (1 + 0.3^2) (Bendat and Piersol, 2010)."""
    rng = np.random.default_rng(0)
    drive = rng.standard_normal(1 << 16)
    seen = drive + 0.3 * rng.standard_normal(drive.size)
    np.savez(
        tmp_path / "noisy.npz", time=np.arange(drive.size) * 1e-4, drive=[[seen]], motion=[[2 * drive]], sets=["V"]
    )
    responses = read_responses([tmp_path / "noisy.npz"], ResponseFormat("velocity", n_averages=63))
    assert float(np.median(np.abs(responses.response))) == pytest.approx(2 / 1.09, rel=0.01)
