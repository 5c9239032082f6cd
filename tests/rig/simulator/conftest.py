"""A twin for measurements, and the signals of its channels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.apparatus_sections import TrueAmplifier
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.simulator.timeline import Playback
from modaltouch.rig.simulator.twin import Twin
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.stimulus import design_stimulus
from modaltouch.stimulus.target_field import TargetField


def make_playback(amplitude: float = 4.0, *, n: int = 2000, hertz: float = 229.0, code: int = 8191) -> Playback:
    """Return a windowed sine of 50 ms every 1/7 s."""
    time = np.arange(n) * 0.05 / n
    wave = np.sin(2 * np.pi * hertz * time) * np.sin(np.pi * time / 0.05) ** 2
    record = np.round(8191 + 8191 * wave).astype(">u2").tobytes()
    return Playback(record, amplitude, 0.0, 0.05, 1 / 7, code)


@pytest.fixture(name="playback")
def _playback() -> Callable[..., Playback]:
    """Return `make_playback`."""
    return make_playback


def make_with_twin(apparatus: Apparatus, **values: Any) -> Apparatus:
    """Return an apparatus whose twin differs only in the given values."""
    spreads = ("natural_frequency_mismatch", "damping_ratio_mismatch", "gain_mismatch", "generator_gain_mismatch")
    zero = dict.fromkeys((*spreads, "cross_gain"), 0.0) | {"unlisted_modes": (), "amplifier": TrueAmplifier()}
    return apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update=zero | values)})


@pytest.fixture(name="with_twin")
def _with_twin() -> Callable[..., Apparatus]:
    """Return `make_with_twin`."""
    return make_with_twin


@pytest.fixture
def twin(apparatus: Apparatus) -> Twin:
    """Return a twin."""
    return Twin(apparatus, seed=1)


@pytest.fixture(scope="session")
def shipped_burst(apparatus: Apparatus) -> list[Playback]:
    """Return the playbacks of both channels for the shipped stimulus at 200 mm/s."""
    design = design_stimulus(
        apparatus.modal_model(), TargetField(), Timing(AFG3022B.converter), apparatus.amplifier_values()
    )
    burst = design.burst
    return [
        Playback(codes.astype(">u2").tobytes(), amplitude, 0.0, burst.duration, 1 / 7, 8191)
        for codes, amplitude in zip(burst.codes, burst.amplitude_for(0.2), strict=True)
    ]
