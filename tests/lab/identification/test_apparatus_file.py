"""Apparatus files from an identification: values, intervals and provenance; all other settings are kept."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from modaltouch.cli import app
from modaltouch.lab.identification.modal_parameters import Estimate, Identification
from modaltouch.lab.identification.report import export, identified_apparatus, write_identification
from modaltouch.lab.identification.responses import FrequencyResponses
from modaltouch.lab.identification.verdict import check_modes
from modaltouch.protocol import InputError
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.source import Source
from modaltouch.rig.simulator.true_beam import TrueBeam
from modaltouch.stimulus.other_shapes import MeasuredShapes

pytestmark = pytest.mark.usefixtures("svg_alone")

APPARATUS = Path(__file__).parents[3] / "protocols" / "apparatus" / "beam_100x6x2.yaml"
LABELS = (1, 3, 5, 7, 9, 11, 13, 15, 17)
FACTS = {"date": "2026-01-01T00:00:00", "mode": "simulated", "source": "test"}


def test_the_file_is_read_back_with_every_number(found: Identification, tmp_path: Path) -> None:
    """Values within their intervals, gains of both sets, provenance; beam and zones unchanged."""
    source = Source.load(APPARATUS)
    name, text = identified_apparatus(source, found, LABELS, FACTS)
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    before, after = Apparatus.read(APPARATUS), Apparatus.read(path)
    assert after.apparatus == "beam_100x6x2_identified"
    assert after.zones == before.zones
    assert after.amplifier == before.amplifier
    for mode in after.modes:
        mine = found.by_label[mode.label]
        assert mode.natural_frequency_Hz == pytest.approx(mine.natural_frequency.value, rel=1e-6)
        assert mode.gain_mm_s2_per_V["side"] == pytest.approx(mine.gain[1].value * 1e3, rel=1e-6)
        assert mode.intervals_95 is not None
        low, high = mode.intervals_95.natural_frequency_Hz or (0, 0)
        assert low < mode.natural_frequency_Hz < high
        assert set(mode.intervals_95.gain_mm_s2_per_V) == {"centre", "side"}
        assert mode.provenance is not None
        assert "joint fit" in mode.provenance.damping_ratio
        assert mode.assumed == ()
    assert after.identified is not None
    assert after.identified.replaced_sha256 == source.sha256
    assert after.identified.velocity_delay_us == pytest.approx(4.0, abs=0.01)


def test_intervals_of_gains_include_the_sensitivity(found: Identification) -> None:
    """With a vibrometer 0.8 % off, within its 1 %, each interval contains the true gain."""
    stated = found.with_sensitivity_uncertainty(0.01)
    for mode, before in zip(stated.modes, found.modes, strict=True):
        assert mode.natural_frequency == before.natural_frequency
        for gain, exact in zip(mode.gain, before.gain, strict=True):
            assert gain.value == exact.value
            assert exact.value / 1.008 in gain
            half = np.hypot(exact.high - exact.value, 0.01 * exact.value)
            assert [gain.value - gain.low, gain.high - gain.value] == pytest.approx([half, half])


def test_newly_listed_modes_are_removed_from_the_twin(found: Identification, tmp_path: Path) -> None:
    """Label 4 becomes a mode of the table; as an unlisted one it would be there twice."""
    _, text = identified_apparatus(Source.load(APPARATUS), found, (1, 3, 4, 5), FACTS)
    path = tmp_path / "all.yaml"
    path.write_text(text, encoding="utf-8")
    apparatus = Apparatus.read(path)
    assert [mode.label for mode in apparatus.modes] == [1, 3, 4, 5]
    assert 4 not in [mode.label for mode in apparatus.twin.unlisted_modes if mode.family == "bending"]


def test_a_reversed_interval_is_refused(found: Identification, tmp_path: Path) -> None:
    """With the line, for files edited by hand."""
    _, text = identified_apparatus(Source.load(APPARATUS), found, (1,), FACTS)
    line = next(row for row in text.splitlines() if "damping_ratio: [" in row)
    path = tmp_path / "edited.yaml"
    path.write_text(text.replace(line, line.split("[")[0] + "[0.06, 0.05]"), encoding="utf-8")
    with pytest.raises(InputError, match=r"edited.yaml:\d+:\d+: .*an interval from 0.06 to 0.05"):
        Apparatus.read(path)


def test_the_folder_has_table_shapes_and_figures(found: Identification, tmp_path: Path) -> None:
    """Table I with half-power values, shapes that the stimulus engine reads, and empty cells for missing numbers."""
    name, text = identified_apparatus(Source.load(APPARATUS), found, LABELS, FACTS)
    values = write_identification(found, tmp_path / "out", "file", "beam.csv", labels=LABELS, apparatus=(name, text))
    files = {name: Path(path) for name, path in values["files"].items()}
    with files["table_1.csv"].open(encoding="utf-8", newline="") as opened:
        rows = list(csv.DictReader(opened))
    first = rows[0]
    assert float(first["natural_frequency_Hz_low"]) < float(first["natural_frequency_Hz"])
    assert float(first["half_power_damping_ratio"]) == pytest.approx(float(first["damping_ratio"]), rel=0.25)
    assert "nan" not in files["table_1.csv"].read_text()
    json.loads(files["identification.json"].read_text())
    table = np.genfromtxt(files["shapes.csv"], delimiter=",", names=True)
    labels = tuple(int(column.removeprefix("mode_")) for column in table.dtype.names[1:])
    values = np.array([table[column] for column in table.dtype.names[1:]])
    shapes = MeasuredShapes(labels, table["position_mm"] * 1e-3, values, 0.1)
    row = shapes.label.index(13)
    np.testing.assert_allclose(shapes.shape[row], found.by_label[13].shape, rtol=2e-3, atol=2e-3)
    for picture in ("fits", "stability", "complexity", "fig_4"):
        assert files[f"{picture}.svg"].stat().st_size > 10_000
        assert f"{picture}.png" in files


def test_missing_and_incoherent_modes_are_reported_together(found: Identification) -> None:
    """With the remedy for each."""
    weak = replace(found.by_label[3], coherence=0.2)
    modes = tuple(weak if mode.label == 3 else mode for mode in found.modes if mode.label != 9)
    with pytest.raises(ValueError, match=r"(?s)mode 3 has a coherence of 0.20 .*--averages.*mode 9 was not found"):
        check_modes(replace(found, modes=modes), LABELS)
    check_modes(found, LABELS)


def write_responses(path: Path, exact: Callable[..., np.ndarray], sets: list[str]) -> Path:
    """Write responses of eight points up to 12 kHz, with a little noise, as another program exports them."""
    frequency, positions = np.arange(16, 3100) * 3.9, np.linspace(-0.05, 0.05, 8)
    response = exact(frequency, positions)[: len(sets)]
    rng = np.random.default_rng(0)
    response = response + 1e-5 * (rng.standard_normal(response.shape) + 1j * rng.standard_normal(response.shape))
    np.savez(path, frequency=frequency, response=response, positions=positions, sets=sets, quantity="velocity")
    return path


def test_files_with_positions_give_an_apparatus_file(
    exact: Callable[..., np.ndarray], beam: TrueBeam, tmp_path: Path
) -> None:
    """Both sets at eight points: modes 1, 3 and 5 with gains within 5 %."""
    file, out = write_responses(tmp_path / "lab.npz", exact, ["centre", "side"]), tmp_path / "out"
    command = ["identify", str(file), "--apparatus", str(APPARATUS), "--modes", "1,3,5", "--out", str(out), "--json"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    after = Apparatus.read(Path(json.loads(done.stdout)["apparatus_file"]))
    for mode in after.modes:
        true = beam.table.modal_gain[beam.table.label.index(mode.label)] * 1e3
        gains = [mode.gain_mm_s2_per_V["centre"], mode.gain_mm_s2_per_V["side"]]
        assert gains == pytest.approx(true, abs=0.05 * np.abs(true).max())
        for name, (low, high) in mode.intervals_95.gain_mm_s2_per_V.items():
            assert high - low >= 0.02 * abs(mode.gain_mm_s2_per_V[name])  # sensitivity_uncertainty_percent
    assert after.identified is not None
    assert after.identified.mode == "file"


def test_a_missing_actuator_set_is_reported(exact: Callable[..., np.ndarray], tmp_path: Path) -> None:
    """It is refused unless --set says that only the other one was measured."""
    file, out = write_responses(tmp_path / "lab.npz", exact, ["centre"]), tmp_path / "out"
    command = ["identify", str(file), "--apparatus", str(APPARATUS), "--modes", "1,3", "--out", str(out)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 2
    assert "the files contain responses to centre, but none to the actuator set side" in " ".join(done.stderr.split())
    assert not out.exists()
    done = CliRunner().invoke(app, [*command, "--set", "centre", "--json"])
    assert done.exit_code == 0, done.output
    after = Apparatus.read(Path(json.loads(done.stdout)["apparatus_file"]))
    assert after.unknown_gains() == ((1, "side"), (3, "side"))


@pytest.mark.parametrize("n_files", [1, 2])
def test_responses_to_a_hammer_give_a_table_but_no_apparatus(
    exact: Callable[..., np.ndarray], beam: TrueBeam, tmp_path: Path, n_files: int
) -> None:
    """Universal files of a roving hammer, wherever their origin: a force belongs to no actuator set."""
    frequency, positions = np.arange(1000.0, 15e3, 8.0), np.linspace(-0.049, 0.049, 13)
    response, rng = exact(frequency, positions)[1:], np.random.default_rng(2)
    files = [tmp_path / f"{number}.uff" for number in range(n_files)]
    for file in files:
        noise = rng.standard_normal(response.shape) + 1j * rng.standard_normal(response.shape)
        noisy = response + 1e-4 * np.abs(response).max() * noise
        hammered = FrequencyResponses(frequency, noisy, positions + 0.3, ("reference_16",), per="N")
        export(Identification((), Estimate(0, 0, 0), 1.0, hammered, None, noisy), file)
    command = ["identify", *map(str, files), "--modes", "3,5,7", "--out", str(tmp_path / "out"), "--json"]
    done = CliRunner().invoke(app, [*command, "--apparatus", str(APPARATUS)])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result["apparatus_file"] is None
    assert [each[:23] for each in result["warnings"]] == ["the excitation is a for"]
    for label in (3, 5, 7):
        mode = next(each for each in result["modes"] if each["label"] == label)
        own = beam.table.natural_frequency[beam.table.label.index(label)]
        assert mode["natural_frequency_Hz"]["value"] == pytest.approx(own, rel=1e-4)
        assert mode["gain_mm_s2_per_V"] == {}


def test_an_estimate_contains_its_interval() -> None:
    """1.96 standard deviations each way."""
    estimate = Estimate.of(10.0, 1.0)
    assert 11.9 in estimate
    assert 12.1 not in estimate
