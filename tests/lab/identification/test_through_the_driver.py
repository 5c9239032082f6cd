"""From chirp to Table I through generator, amplifier, beam, vibrometer and scope, against the twin's true beam.

``MODALTOUCH_SCANNED_POINTS`` sets the number of points: eight distinguish the lowest modes; 41, as in
``make soak-identification``, all nine, at a noise that gives the weakest a coherence of about 0.95.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from modaltouch.lab.identification.excitation import (
    LOWEST,
    Excitation,
    IdentificationPlan,
    Spectra,
    _with_range,
    evenly,
    excite,
)
from modaltouch.lab.identification.joint_fit import identify
from modaltouch.lab.identification.responses import responses_of
from modaltouch.lab.identification.shapes import mac
from modaltouch.lab.laboratory import Laboratory, MeasurementProgress, open_laboratory
from modaltouch.lab.scan import ScanPlan, read_scan, take_scan
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.source import Source
from modaltouch.record.chain import RecordInputError
from modaltouch.rig.interface import RigError
from modaltouch.rig.scope import Acquisition
from modaltouch.stimulus.shapes import mode_shapes

APPARATUS = Path(__file__).parents[3] / "protocols" / "apparatus" / "beam_100x6x2.yaml"
LENGTH = 0.1
N_POINTS = int(os.environ.get("MODALTOUCH_SCANNED_POINTS", "8"))
WHOLE = N_POINTS >= 26
EXCITATIONS: tuple[Excitation, ...] = get_args(Excitation)


class StoppedError(Exception):
    """The scan is interrupted."""


def with_noise(apparatus: Apparatus, density: float) -> Apparatus:
    """Return the apparatus with a given noise density of the vibrometer [um/s per root Hz]."""
    vibrometer = apparatus.twin.vibrometer.model_copy(update={"noise_um_s_per_sqrt_Hz": density})
    return apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update={"vibrometer": vibrometer})})


def density_of_the_bar(apparatus: Apparatus, campaign: IdentificationPlan) -> float:
    """Return the noise density for a coherence of about 0.95 at the weakest mode's peak [um/s per root Hz].

    That is the first mode: 0.9 mm/s per volt at every point.
    """
    burst = excite(apparatus, "centre", campaign.voltage, campaign.highest, campaign.excitation)
    power = campaign.voltage**2 * np.mean((burst.codes[0] / 8191.0 - 1) ** 2) / (campaign.highest - LOWEST)
    height = 0.114 / (2 * 0.0437 * 2 * np.pi * 229)
    return float(np.sqrt(height**2 * power * 0.05 / 0.95) * 1e6)


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("excitation", EXCITATIONS if WHOLE else EXCITATIONS[:1])
def test_the_twin_is_identified_through_all_its_instruments(
    apparatus: Apparatus, tmp_path: Path, excitation: Excitation
) -> None:
    """Frequencies within 0.1 %, damping and gains within 5 %, MAC above 0.99.

    Despite eight bits, two clocks, a delay, a low-pass, torsion beside the mid-line, and even modes.
    """
    labels = (1, 3, 5, 7, 9, 11, 13, 15, 17) if WHOLE else (1, 3, 5)
    campaign = IdentificationPlan(
        positions=evenly(LENGTH, N_POINTS, 0.5e-3),
        averages=10 if WHOLE else 2,
        voltage=50.0 if excitation == "multisine" else 20.0,
        highest=110e3 if WHOLE else 12e3,
        sets=("centre", "side"),
        excitation=excitation,
    )
    if WHOLE:
        apparatus = with_noise(apparatus, density_of_the_bar(apparatus, campaign))
    with open_laboratory(apparatus, repetition="continuous") as laboratory:
        scans = campaign.scan(laboratory, Source.load(APPARATUS), tmp_path)
        assert laboratory.simulator is not None
        true = laboratory.simulator.twin.beam.table
    bandwidth = (apparatus.acquisition.vibrometer_bandwidth_kHz or 0) * 1e3
    responses = responses_of(scans, bandwidth).between(60, campaign.highest)
    found = identify(responses, LENGTH)
    for label in labels:
        mode, k = found.by_label[label], true.label.index(label)
        assert mode.natural_frequency.value == pytest.approx(true.natural_frequency[k], rel=1e-3)
        assert mode.damping_ratio.value == pytest.approx(true.damping_ratio[k], rel=0.05)
        gain = np.array([estimate.value for estimate in mode.gain])
        assert gain == pytest.approx(true.modal_gain[k], abs=0.05 * np.abs(true.modal_gain[k]).max())
        assert mode.shape is not None
        assert mac(mode.shape[None], mode_shapes([label], responses.positions, LENGTH))[0, 0] > 0.99
    if WHOLE:
        assert 0.9 < min(found.by_label[label].coherence for label in labels) < 0.97


def small(**changes: Any) -> IdentificationPlan:
    """Return a scan of three points of one set."""
    return replace(IdentificationPlan((-0.04, 0.01, 0.049), 1, 20.0, 12e3, ("centre",)), **changes)


@pytest.fixture(scope="module")
def laboratory(apparatus: Apparatus) -> Any:
    """Return an open laboratory on the twin with continuous records."""
    with open_laboratory(apparatus, repetition="continuous") as opened:
        yield opened


def test_a_resumed_scan_keeps_its_range(laboratory: Laboratory, tmp_path: Path) -> None:
    """It measures only the remaining points, with the range of the beginning."""
    source, passed = Source.load(APPARATUS), iter(range(1))

    def check() -> None:
        if next(passed, None) is None:
            raise StoppedError

    with pytest.raises(StoppedError):
        small().scan(replace(laboratory, progress=MeasurementProgress(check=check)), source, tmp_path)
    half = read_scan(tmp_path / "scan_centre")
    with pytest.raises(RecordInputError, match="interrupted after 1 of 3 positions"):
        responses_of({"centre": half})
    shown: list[tuple[str, int, int]] = []
    heard = replace(laboratory, progress=MeasurementProgress(show=lambda *step: shown.append(step)))
    scans = small().scan(heard, source, tmp_path)
    assert shown == [("points, centre", n, 3) for n in (1, 2, 3)]
    assert scans["centre"].facts["settings"] == half.facts["settings"]


def test_saturated_records_are_refused_with_their_position(laboratory: Laboratory) -> None:
    """A range of 1 mm/s clips a motion of 8 mm/s."""
    burst = excite(laboratory.apparatus, "centre", 20.0, 12e3)
    narrow = Acquisition(3.125e6, 819_200, 1, (1,), velocity_range=1e-3, drive_range=25.0)
    with pytest.raises(RecordInputError, match="velocity reached the end of the range at 49 mm.* another folder"):
        take_scan(laboratory, ScanPlan(burst, burst.velocity, (0.049,), narrow), reduction=Spectra(12e3))


def test_a_clipped_first_record_is_refused(laboratory: Laboratory) -> None:
    """Its peak is unknown; the message has the remedy, before any position is measured."""
    burst = excite(laboratory.apparatus, "centre", 20.0, 12e3)
    narrow = Acquisition(3.125e6, 819_200, 1, (1,), velocity_range=1e-3, drive_range=25.0)
    with pytest.raises(RigError, match="velocity was overloaded at 49 mm, .* a wider range or a lower drive"):
        _with_range(laboratory, ScanPlan(burst, burst.velocity, (0.049,), narrow), "centre", 20.0)


def test_scans_at_different_positions_are_refused(laboratory: Laboratory) -> None:
    """Each set needs the same positions."""
    source = Source.load(APPARATUS)
    one, other = (small(positions=(place,)).scan(laboratory, source, None)["centre"] for place in (0.0, 0.01))
    with pytest.raises(
        RecordInputError, match="the positions in the scan of the set side differ from those of the first"
    ):
        responses_of({"centre": one, "side": other})


def test_scans_with_different_spectra_or_no_drive_are_refused(laboratory: Laboratory) -> None:
    """Other lines or averages would be read on the first set's axis; without a drive nothing can be divided."""
    one = small(positions=(0.0,)).scan(laboratory, Source.load(APPARATUS), None)["centre"]
    (kept,) = one.arrays
    for change in ({"frequency": 1.01 * kept["frequency"]}, {"n_records": np.array(7)}):
        with pytest.raises(RecordInputError, match="number of records of the set side at 0 mm differ .* same options"):
            responses_of({"centre": one, "side": replace(one, arrays=({**kept, **change},))})
    silent = replace(one, arrays=({**kept, "drive_power": 0 * kept["drive_power"]},))
    with pytest.raises(RecordInputError, match="the drive of the set centre at 0 mm is zero.* check the probe"):
        responses_of({"centre": silent})


def test_a_missing_drive_is_reported(laboratory: Laboratory, tmp_path: Path) -> None:
    """A tripped amplifier: refused before any position is measured, and nothing is written."""
    assert laboratory.simulator is not None
    laboratory.simulator.twin.tripped = True
    try:
        with pytest.raises(RigError, match="the drive of the actuator set centre measures .* but 20 V"):
            small().scan(laboratory, Source.load(APPARATUS), tmp_path)
    finally:
        laboratory.simulator.twin.tripped = False
    assert list(tmp_path.iterdir()) == []
    assert laboratory.simulator.outputs == (False, False)


def test_velocity_beyond_the_safety_limit_is_refused(apparatus: Apparatus) -> None:
    """A limit of 5 mm/s: the first record of the beam's end shows more, and the outputs are off."""
    safety = apparatus.safety.model_copy(update={"velocity_limit_mm_s": 5.0})
    careful = apparatus.model_copy(update={"safety": safety})
    with (
        open_laboratory(careful, repetition="continuous") as laboratory,
        pytest.raises(RigError, match="mm/s, but the safety limit is 5; the outputs are off; lower --drive-V"),
    ):
        small(voltage=100.0).scan(laboratory, Source.load(APPARATUS), None)


def test_the_range_is_at_most_that_of_the_vibrometer(apparatus: Apparatus) -> None:
    """A motion that nearly fills the range is measured with all of it."""
    knobs = apparatus.acquisition.model_copy(update={"range_mm_s": 7.5})
    tight = apparatus.model_copy(update={"acquisition": knobs})
    with open_laboratory(tight, repetition="continuous") as laboratory:
        scans = small(positions=(0.049,)).scan(laboratory, Source.load(APPARATUS), None)
    assert scans["centre"].arrays[0]["overloaded"].size == 0
    assert scans["centre"].facts["settings"]["acquisition"]["velocity_range"] == pytest.approx(0.0075)


@pytest.mark.parametrize("kind", EXCITATIONS)
def test_the_excitation_is_flat_and_periodic(apparatus: Apparatus, kind: Excitation) -> None:
    """At least 0.26 s, the requested peak, nothing on the other output, within 3 dB over the band."""
    burst = excite(apparatus, "side", 20.0, 100e3, kind)
    assert burst.duration >= 0.26
    assert burst.repetition_rate == pytest.approx(1 / burst.duration)
    assert (burst.codes[0] == 8191).all()
    wave = burst.codes[1] / 8191.0 - 1
    assert np.abs(wave).max() * burst.amplitude[1] / 2 * 25 == pytest.approx(20.0, rel=1e-3)
    power = np.abs(np.fft.rfft(wave)) ** 2
    line = np.fft.rfftfreq(wave.size, burst.duration / wave.size)
    inside = power[(line > 100) & (line < 98e3)]
    smooth = np.convolve(inside, np.ones(25) / 25, "valid")
    assert (smooth > 0.5 * inside.mean()).all()
    assert (smooth < 2 * inside.mean()).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("side", 300.0, 50e3), "an excitation of 300 V was requested: allowed above 0 and up to 250 V"),
        (("side", 20.0, 300e3), "an excitation up to 300 kHz was requested"),
    ],
)
def test_excitation_out_of_bounds_is_refused(apparatus: Apparatus, arguments: Any, words: str) -> None:
    """Voltage and frequency."""
    with pytest.raises(ValueError, match=words):
        excite(apparatus, *arguments)
