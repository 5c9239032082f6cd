"""Real beams, measured by others: published natural frequencies, and limits of the data.

`MODALTOUCH_MEASURED_DATA` gives the folder of the data, by default beside the checkout. Without it these tests are
skipped; a path that does not exist is an error.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from modaltouch.lab.identification.files import ResponseFormat, read_responses
from modaltouch.lab.identification.joint_fit import identify_each
from modaltouch.lab.identification.responses import FrequencyResponses, as_velocity

pytestmark = pytest.mark.measured_data


@pytest.fixture(scope="module")
def data() -> Path:
    """Return the folder of measured data, or skip the test."""
    named = os.environ.get("MODALTOUCH_MEASURED_DATA")
    root = Path(__file__).resolve().parents[3]
    beside = [Path(named)] if named else [parent / "shared" / "data" for parent in root.parents]
    for folder in beside:
        if (folder / "ORIGIN.md").is_file():
            return folder
    if named:
        pytest.fail(f"MODALTOUCH_MEASURED_DATA names {named}, which holds no ORIGIN.md: name the folder of the data")
    pytest.skip("the measured data are no part of the project: set MODALTOUCH_MEASURED_DATA to their folder")


def test_the_slender_beam_of_pyuff(data: Path, tmp_path: Path) -> None:
    """Six published natural frequencies within 0.011 Hz, a hundredth of a bin.

    The peaks are a fraction of a bin wide, so half-power damping is meaningless, and is reported as such.
    """
    files = sorted((data / "pyuff").glob("meas_point_*.txt"))
    assert len(files) == 3
    numbers = [np.array([complex(line.replace(" ", "")) for line in file.read_text().splitlines()]) for file in files]
    np.savez(tmp_path / "a.npz", frequency=np.arange(len(numbers[0])), response=[[*numbers]], sets=["hammer"])
    responses = read_responses([tmp_path / "a.npz"], ResponseFormat("acceleration")).between(30, 1000)
    found = identify_each(responses)
    stated = [51.52, 142.18, 278.67, 460.40, 687.17, 958.54]
    assert len(found.modes) == len(stated)
    for mode, frequency in zip(found.modes, stated, strict=True):
        assert mode.natural_frequency.value == pytest.approx(frequency, abs=0.011)
        assert mode.half_power.verdict
        assert mode.half_power.damping_ratio > 3 * mode.damping_ratio.value


def test_the_hammered_beam_of_the_image_based_tutorial(data: Path) -> None:
    """Four published natural frequencies within 0.01 %."""
    responses = read_responses([data / "ladisk_imagebased" / "acceleration.lvm"]).between(300, 7300)
    found = identify_each(responses)
    frequency = np.array([mode.natural_frequency.value for mode in found.modes])
    for stated in (695.75, 1898.1, 3671.2, 5975.0):
        assert np.abs(frequency / stated - 1).min() < 1e-4


def test_the_modal_constants_of_sdypy_are_recovered(data: Path) -> None:
    """Responses rebuilt from published poles and constants: frequencies within 0.01 %, damping within 3 %."""
    reference = json.loads((data / "sdypy_ema" / "reference.json").read_text(encoding="utf-8"))
    stated, ratio = np.array(reference["nat_freq_Hz"]), np.array(reference["showcase_damping"])
    constants = np.array(reference["modal_constants_re"]) + 1j * np.array(reference["modal_constants_im"])
    frequency = np.arange(100, 9000) * 0.5
    omega, pole = 2 * np.pi * frequency, 2 * np.pi * stated * (-ratio + 1j * np.sqrt(1 - ratio**2))
    receptance = np.einsum("pk,kf->pf", constants, 1 / (1j * omega - pole[:, None]))
    receptance += np.einsum("pk,kf->pf", constants.conj(), 1 / (1j * omega - pole.conj()[:, None]))
    velocity = as_velocity(frequency, receptance, "displacement")
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(velocity.shape) + 1j * rng.standard_normal(velocity.shape)
    velocity = velocity + 1e-6 * np.abs(velocity).max() * noise
    found = identify_each(FrequencyResponses(frequency, velocity[:, None], None, tuple("abcdef")))
    for own, damping in zip(stated, ratio, strict=True):
        mode = min(found.modes, key=lambda each: abs(each.natural_frequency.value - own))
        assert mode.natural_frequency.value == pytest.approx(own, rel=1e-4)
        assert mode.damping_ratio.value == pytest.approx(damping, rel=0.03)
