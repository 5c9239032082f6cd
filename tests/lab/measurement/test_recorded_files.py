"""Records written as files by another scope, in a separate thread, give the results of a scope that is driven."""

from __future__ import annotations

import contextlib
import json
import re
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from modaltouch.lab import recorded_files
from modaltouch.lab.calibration import calibrate_each
from modaltouch.lab.calibration.file import corrected_inputs
from modaltouch.lab.laboratory import MeasurementProgress, open_laboratory
from modaltouch.lab.recorded_files import RecordedFiles
from modaltouch.preflight import examine
from modaltouch.preflight.single_design import design_to_fit
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.interface import RigError
from modaltouch.rig.scope import Acquisition, Recording
from modaltouch.rig.simulator import Simulator

PROTOCOLS = Path(__file__).parents[3] / "protocols"
N_FAULTY = 3
"""Which file is spoilt at first."""


def write(path: Path, recording: Recording, volts: float) -> None:
    """Write a recording as a lab's own program would: the vibrometer in volts, few digits in a CSV."""
    table = {
        "time_s": np.broadcast_to(recording.time, recording.velocity.shape),
        "velocity_V": recording.velocity / volts,
    }
    table |= {f"drive_{number}_V": recording.drive[:, number - 1] for number in range(1, recording.drive.shape[1] + 1)}
    part = path.with_suffix(".part")
    if path.suffix == ".npz":
        with part.open("wb") as file:
            np.savez(file, **table)
    else:
        rows = np.stack([column.ravel() for column in table.values()], axis=1)
        np.savetxt(part, rows, fmt="%.7g", delimiter=",", header=",".join(table), comments="")
    part.rename(path)


class LabScope(threading.Thread):
    """Follows ``wanted.json`` until it is stopped, faster and longer than requested; CSV if there are drives."""

    def __init__(self, folder: Path, simulator: Simulator) -> None:
        super().__init__(daemon=True)
        self._scope, self._folder = simulator.scope(), folder
        self._volts = simulator.apparatus.acquisition.sensitivity_mm_s_per_V * 1e-3
        self.ended = threading.Event()

    def run(self) -> None:
        done = None
        while not self.ended.wait(0.002):
            with contextlib.suppress(OSError, ValueError):
                wanted = json.loads((self._folder / "wanted.json").read_text(encoding="utf-8"))
                if done != (wanted["file"], wanted["refused"]):
                    done = wanted["file"], wanted["refused"]
                    self._record(wanted)

    def _record(self, wanted: dict) -> None:
        rate = 1.1 * wanted["sampling_rate_Hz"]
        n_samples = int(1.02 * (wanted["last_s"] - wanted["first_s"]) * rate) + 8
        drives = tuple(wanted["drives"])
        ranges = wanted["velocity_up_to_m_s"], wanted["drive_up_to_V"]
        self._scope.configure(Acquisition(rate, n_samples, wanted["n_records"], drives, wanted["first_s"], *ranges))
        recording = self._scope.measure(wanted["position_mm"] * 1e-3)
        path = self._folder / f"{wanted['file']}{'.csv' if drives else '.npz'}"
        if int(wanted["file"]) == N_FAULTY and not wanted["refused"]:
            path.write_bytes(b"half of a fi")
        else:
            write(path, recording, self._volts)


@pytest.fixture
def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look for files every 5 ms."""
    monkeypatch.setattr(recorded_files, "POLL", 0.005)


@pytest.mark.usefixtures("quickly")
def test_a_calibration_by_files_is_accurate(tmp_path: Path) -> None:
    """Through driver and files, one of them faulty at first: 0.3 mm/s at every mode by the twin's true state."""
    preflight, said = examine(PROTOCOLS / "demo.yaml").require(), list[str]()
    apparatus = preflight.experiment.apparatus
    folder = tmp_path / "records"
    scope = RecordedFiles(folder, apparatus, MeasurementProgress(say=said.append))
    with open_laboratory(apparatus, scope=scope) as laboratory:
        lab_scope = LabScope(folder, laboratory.simulator)
        lab_scope.start()
        try:
            outcome = calibrate_each(laboratory, apparatus, {"": preflight.inputs})[""]
        finally:
            lab_scope.ended.set()
            lab_scope.join()
        stimulus = design_to_fit(corrected_inputs(preflight.inputs, outcome.refined, outcome.correction))
        laboratory.load(stimulus.burst)
        assert laboratory.rig.fire(stimulus.target_field.velocity).started
        state = laboratory.simulator.true_state(stimulus.timing.focusing_instant)
    assert np.abs(state.velocity - stimulus.target).max() < 0.3e-3
    assert np.abs(state.displacement).max() < 0.3e-3
    assert outcome.turns[0].worst > 1e-3
    assert outcome.best.number > 0
    assert len(outcome.levels) == len(preflight.inputs.levels)
    (refusal,) = [line for line in said if line.endswith("write it again")]
    assert re.search(r"0003\.npz: cannot be read", refusal)
    assert re.search(
        r"waiting for .*0001\.csv or \.npz: 10 records at \+0\.00 mm of velocity, drive 1, drive 2", said[0]
    )
    assert not (folder / "wanted.json").exists()


ASKED = Acquisition(sampling_rate=1e5, n_samples=50, n_records=2, drives=(1,), start=1e-3)


@pytest.fixture(scope="module")
def apparatus() -> Apparatus:
    """Return the shipped apparatus."""
    return Apparatus.read(PROTOCOLS / "apparatus" / "beam_100x6x2.yaml")


def csv_of(*, rate: float = 1e5, first: float = 1e-3, n: int = 50, n_records: int = 2, late: float = 0.0) -> list[str]:
    """Return the lines of a valid file with as many digits as a scope prints."""
    rows = [
        f"{first + late * record + sample / rate:.7f},{0.1 + 0.01 * (sample % 7) + 0.001 * record:.4f},{record:.2f}"
        for record in range(n_records)
        for sample in range(n)
    ]
    return ["time_s,velocity_V,drive_1_V", *rows]


def changed(line: int, text: str) -> list[str]:
    """Return that file with one line replaced, counted from 1."""
    lines = csv_of()
    lines[line - 1] = text
    return lines


@pytest.mark.usefixtures("quickly")
@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([], r"csv:1: the column time_s is missing"),
        (["time_s,velocity_V", "0,1"], r"csv:1: the column drive_1_V is missing; found: time_s, velocity_V"),
        (["time_s,speed,drive_1_V", "0,1,2"], r"csv:1: the column velocity_V is missing"),
        (changed(4, "0.00102,oops,0"), r"csv:4:2: 'oops' is not a number"),
        (changed(7, "0.00105,0.1"), r"csv:7: the line has 2 cells, but the header has 3"),
        (changed(4, "0.00102,1_000,0"), r"csv:4:2: '1_000' is not a number"),
        (changed(9, "0.00107,nan,0"), r"csv:9: velocity_V is not a finite number"),
        (changed(2, "nan,0.1,0"), r"csv:2: time_s is not a finite number"),
        (changed(9, "inf,0.1,0"), r"csv:9: time_s is not a finite number"),
        (changed(4, "0.00102,0.1\udcb5,0"), r"csv:4:2: '0.1\ufffd' is not a number"),
        (changed(12, "0.001105,0.1,0"), r"csv:12: time_s is not evenly spaced"),
        (csv_of()[:-1], r"csv:52: the record that begins here has 49 samples, but the first has 50"),
        (csv_of(n_records=3), r"contains 3 records of 50 samples; 2 records were requested"),
        (csv_of(rate=5e4), r"was sampled at 50 kHz; allowed: 100 to 5000 kHz"),
        (csv_of(first=2e-3), r"last from 2 to 2\.49 ms after the trigger; 1 to 1\.49 ms were requested"),
        (csv_of(n=40), r"last from 1 to 1\.39 ms"),
        (csv_of(late=1e-6), r"its records differ by 1000 ns, at most 20 ns are allowed; switch off interpolation"),
        ([csv_of()[0], *csv_of()[1:51], *csv_of()[1:51]], r"its 2 records are identical; record 2 bursts"),
        (
            [line.replace(",", ";") for line in csv_of()],
            r"time_s is missing; .*; save it as UTF-8, with commas between",
        ),
        ([line.replace(".", ",") for line in csv_of()], r"csv:2: the line has 6 cells.* points in decimals"),
        ([csv_of()[0] + ",velocity_V", *(line + ",9" for line in csv_of()[1:])], r"csv:1: a column appears twice"),
    ],
)
def test_a_wrong_file_is_refused_and_may_be_written_again(
    apparatus: Apparatus, tmp_path: Path, lines: list[str], said: str
) -> None:
    """The refusal is on the screen and in ``wanted.json``; the same name is then accepted."""
    heard = list[str]()

    def hear(text: str) -> None:
        heard.append(text)
        wanted = json.loads((tmp_path / "wanted.json").read_text(encoding="utf-8"))
        content = csv_of() if len(heard) > 1 else lines
        (tmp_path / f"{wanted['file']}.csv").write_text("\n".join(content), encoding="utf-8", errors="surrogateescape")

    with RecordedFiles(tmp_path, apparatus, MeasurementProgress(say=hear)) as scope:
        scope.configure(ASKED)
        recording = scope.measure(0.0125)
    assert re.search(said, heard[1])
    assert recording.velocity.shape == (2, 49)
    assert recording.velocity[0, 0] == pytest.approx(0.1 * apparatus.acquisition.sensitivity_mm_s_per_V * 1e-3)
    assert recording.drive[:, 0, 0] == pytest.approx([0, 1])
    assert recording.time[[0, -1]] == pytest.approx([1e-3, 1.48e-3])
    assert recording.overloaded == ()


@contextlib.contextmanager
def answering(
    apparatus: Apparatus, folder: Path, told: Callable[[str], object] = str
) -> Iterator[Callable[..., Recording]]:
    """Open a folder for one command, and return a function that measures once with given velocities [V]."""

    def hear(text: str) -> None:
        told(text)
        # A second command, which ends because the generator is in use, leaves the request.
        RecordedFiles(folder, apparatus, MeasurementProgress()).close()
        name = json.loads((folder / "wanted.json").read_text(encoding="utf-8"))["file"]
        np.savez(folder / f"{name}.npz", time_s=answer[0], velocity_V=answer[1], drive_1_V=answer[1])

    answer: list[np.ndarray] = []
    with RecordedFiles(folder, apparatus, MeasurementProgress(say=hear)) as scope:

        def measure(time: np.ndarray, volts: np.ndarray) -> Recording:
            answer[:] = time, volts
            scope.configure(ASKED)
            return scope.measure(0.0)

        yield measure


@pytest.fixture
def answered(apparatus: Apparatus, tmp_path: Path) -> Iterator[Callable[..., Recording]]:
    """Return a function that measures once in a separate folder."""
    with answering(apparatus, tmp_path) as measure:
        yield measure


@pytest.mark.usefixtures("quickly")
def test_a_clipped_record_is_overloaded(apparatus: Apparatus, tmp_path: Path) -> None:
    """A sine of 8 bits is not; clipped at 0.9 of its peak, or out of range, it is, and the lab is told."""
    time, told = 1e-3 + np.arange(60) / 1e5, list[str]()
    volts = np.round(127 * np.sin(2 * np.pi * 3137 * time + [[0.0], [0.1]])) / 127 * 0.1
    with answering(apparatus, tmp_path, told.append) as answered:
        assert answered(time, volts).overloaded == ()
        # Two samples at the peak of each record, and none at the next code.
        assert answered(time, np.where(np.arange(60) // 2 == 10, 0.11, volts + [[0], [1e-3]])).overloaded == ()
        assert answered(time, np.clip(volts, -0.09, 0.09)).overloaded == ("velocity",)
        assert answered(time, 1e3 * volts).overloaded == ("velocity",)
    assert told[-1].endswith("0004.npz: its velocity is clipped or out of range, with up to 5000 mm/s")


@pytest.mark.usefixtures("quickly")
@pytest.mark.parametrize(("factor", "rate"), [(1, 1e5), (2, 1e5), (2.5, 1.25e5), (7, 1e5)])
def test_faster_records_are_thinned_out(answered: Callable[..., Recording], factor: float, rate: float) -> None:
    """Every n-th sample, so that the converter's steps are no closer than at the requested rate."""
    time = 1e-3 + np.arange(int(60 * factor)) / (1e5 * factor)
    recording = answered(time, np.sin(3137 * time + [[0.0], [0.1]]) / 100)
    assert recording.sampling_rate == pytest.approx(rate)
    assert recording.velocity[0] == pytest.approx(0.05 * np.sin(3137 * recording.time) / 100, abs=1e-12)
    assert recording.velocity.shape == recording.drive[:, 0].shape == (2, int(49e-5 * rate + 0.1))


@pytest.mark.usefixtures("quickly")
def test_another_sampling_rate_at_the_next_point_is_refused(
    answered: Callable[..., Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Records at two points are compared sample by sample, even if they end at the same instant."""
    answered(1e-3 + np.arange(60) / 1e5, np.sin(np.arange(120)).reshape(2, 60) / 100)
    monkeypatch.setattr(RecordedFiles, "slowest", 0.2)
    with pytest.raises(RigError, match="its sampling instants differ from those of the records before"):
        answered(1e-3 + np.arange(90) / 1.5e5, np.sin(np.arange(180)).reshape(2, 90) / 100)


@pytest.mark.usefixtures("quickly")
def test_different_sampling_instants_are_refused(
    answered: Callable[..., Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Records at two points are compared sample by sample: a shift of 30 ns is refused."""
    time, volts = 1e-3 + np.arange(60) / 1e5, np.sin(np.arange(120)).reshape(2, 60) / 100
    answered(time, volts)
    answered(time + 10e-9, 2 * volts)
    monkeypatch.setattr(RecordedFiles, "slowest", 0.2)
    with pytest.raises(RigError, match=r"no usable record arrived as .*0003\.csv or \.npz within"):
        answered(time + 30e-9, 3 * volts)


@pytest.mark.usefixtures("quickly")
def test_a_trace_saved_twice_is_refused(answered: Callable[..., Recording], monkeypatch: pytest.MonkeyPatch) -> None:
    """A scope that was not armed again writes the previous trace under the next name."""
    time, volts = 1e-3 + np.arange(60) / 1e5, np.sin(np.arange(120)).reshape(2, 60) / 100
    answered(time, volts)
    monkeypatch.setattr(RecordedFiles, "slowest", 0.2)
    with pytest.raises(
        RigError, match=r"no usable record .* \(.*0002.npz: its velocity is identical to that of 0001.npz; arm the"
    ):
        answered(time, volts[::-1])


@pytest.mark.usefixtures("quickly")
def test_a_trace_saved_twice_is_refused_by_the_next_command(
    apparatus: Apparatus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A scan is resumed while the scope still has the last trace; unreadable files are ignored."""
    time, volts = 1e-3 + np.arange(60) / 1e5, np.sin(np.arange(120)).reshape(2, 60) / 100
    with answering(apparatus, tmp_path) as measure:
        measure(time, volts)
    monkeypatch.setattr(RecordedFiles, "slowest", 0.2)
    with (
        answering(apparatus, tmp_path) as measure,
        pytest.raises(RigError, match=r"0002.npz: its velocity is identical to that of 0001.npz; arm the"),
    ):
        measure(time, volts)
    (tmp_path / "0003.npz").write_bytes(b"no zip file")
    with answering(apparatus, tmp_path) as measure:
        measure(time, 2 * volts)


@pytest.mark.usefixtures("quickly")
def test_a_share_that_is_lost_is_waited_for(
    apparatus: Apparatus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder that cannot be read for a while is one without the record."""
    monkeypatch.setattr(RecordedFiles, "slowest", 0.05)
    folder, lost = tmp_path / "records", tmp_path / "lost"
    with RecordedFiles(folder, apparatus, MeasurementProgress(say=lambda _: folder.rename(lost))) as scope:
        scope.configure(ASKED)
        with pytest.raises(RigError, match=r"no usable record arrived as .*0001\.csv"):
            scope.measure(0.0)


@pytest.mark.usefixtures("quickly")
@pytest.mark.parametrize(
    ("endings", "shape", "said"),
    [
        ([".part.npz", ".NPZ"], (2, 60), ""),
        ([".npz", ".NPZ"], (2, 60), r"0001\.NPZ: 0001\.npz also exists; delete one of the two"),
        ([".npz"], (1, 2, 60), "cannot be read .an array has more than 2 dimensions"),
        ([".npz"], (60,), "its 2 records are identical"),
        ([".txt"], (2, 60), r"0001\.txt is not read: the record that is awaited is 0001\.csv or 0001\.npz"),
    ],
)
def test_each_record_has_exactly_one_file(
    apparatus: Apparatus,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    endings: list[str],
    shape: tuple[int, ...],
    said: str,
) -> None:
    """The extension may be in capitals; other names are named, two files, or one trace for two, are refused."""
    heard, time = list[str](), np.broadcast_to(1e-3 + np.arange(60) / 1e5, (2, 60))

    def hear(text: str) -> None:
        heard.append(text)
        for ending in endings:
            with (tmp_path / f"0001{ending}").open("wb") as file:
                np.savez(file, time_s=time, velocity_V=np.sin(np.arange(np.prod(shape))).reshape(shape), drive_1_V=time)

    monkeypatch.setattr(RecordedFiles, "slowest", 0.3)
    with RecordedFiles(tmp_path, apparatus, MeasurementProgress(say=hear)) as scope:
        scope.configure(ASKED)
        if not said:
            assert scope.measure(0.0).velocity.shape == (2, 49)
            return
        with pytest.raises(RigError, match=rf"no usable record arrived .* \(.*0001\{endings[-1]}"):
            scope.measure(0.0)
    assert re.search(said, heard[1])


@pytest.mark.parametrize("order", ["calibrate", "validate"])
def test_commands_wait_for_files(order: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With `--record` and no files, the wait ends with the missing file's name, and nothing is written."""
    from modaltouch.lab import calibrate, validate

    monkeypatch.setattr(RecordedFiles, "slowest", 0.01)
    folder, out = tmp_path / "records", tmp_path / "out"
    orders = {
        "calibrate": lambda: calibrate(PROTOCOLS / "demo.yaml", out, record=folder),
        "validate": lambda: validate(PROTOCOLS / "demo.yaml", out=out, record=folder),
    }
    with pytest.raises(RigError, match=r"no usable record arrived as .*records.0001\.csv or \.npz within 0\.00"):
        orders[order]()
    assert not out.exists()
