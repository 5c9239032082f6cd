"""The generator without burst mode plays one record per period, which cannot be exact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from modaltouch.preflight import Preflight, examine
from modaltouch.rig.afg3022b import AFG3022B

PROTOCOLS = Path(__file__).parents[2] / "protocols"


@pytest.fixture(scope="module")
def preflight() -> Preflight:
    """The paper's protocol, examined."""
    return examine(PROTOCOLS / "differentiated_stimulation.yaml")


def test_the_error_of_a_continuous_record_follows_from_its_edges(preflight: Preflight) -> None:
    """Sum over the edges of a 250 MHz clock at 7 Hz, 272 or 273 clock periods per point, up to 25 ms."""
    stimulus = preflight.stimulus
    volts = (AFG3022B.continuous_codes(stimulus.burst).astype(float) - 8191) * stimulus.volts_per_code(0.2)[:, None]
    clocks = np.ceil(np.arange(131_073) * (250e6 / 7 / 131_072) - 1e-6)
    assert set(np.unique(np.diff(clocks))) == {272.0, 273.0}
    edge = np.minimum(clocks / 250e6, 0.025)
    exponent = stimulus.model.exponent
    powers = np.exp(exponent[:, None] * (0.025 - edge))
    state = ((stimulus.model.modal_gain @ volts) * (powers[:, :-1] - powers[:, 1:])).sum(axis=1) / exponent
    velocity = state.real + exponent.real / exponent.imag * state.imag
    displacement = stimulus.model.angular_frequency / exponent.imag * state.imag
    error = max(np.abs(velocity - stimulus.target).max(), np.abs(displacement).max())
    assert 100 * preflight.as_dict()["stimuli"][-1]["worst_modal_error_mm_s"] < error * 1e3 < 0.0145
