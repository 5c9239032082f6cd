"""The shipped stimulus for the figures of the paper."""

import numpy as np
import pytest

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.stimulus import Stimulus, design_stimulus
from modaltouch.stimulus.target_field import TargetField

FREQUENCY = (229, 2553, 7137, 12701, 22810, 29390, 58303, 68543, 87855)
RATIO = (0.0437, 0.0165, 0.0265, 0.0168, 0.0112, 0.0166, 0.0101, 0.0176, 0.0147)
CENTRE = (114, 654, 0, 0, 0, -6285, -41448, 0, 0)
SIDE = (0, 0, 6500, -8346, 10414, 0, 0, -166030, 134615)


@pytest.fixture(scope="session")
def model() -> ModalModel:
    """Return Table I on the centre and the side set."""
    gain = np.array([CENTRE, SIDE], dtype=float).T * 1e-3
    return ModalModel(tuple(range(1, 18, 2)), np.array(FREQUENCY, float), np.array(RATIO), gain, 0.1)


@pytest.fixture(scope="session")
def shipped(model: ModalModel) -> Stimulus:
    """Return the shipped stimulus by the exact law."""
    levels = (0.08, 0.1, 0.15, 0.2)
    return design_stimulus(
        model, TargetField(), Timing(AFG3022B.converter), Amplifier(gain=25.0, limit=250.0), levels=levels
    )


@pytest.fixture(scope="session")
def shipped_paper(model: ModalModel) -> Stimulus:
    """Return the shipped stimulus by the paper's law."""
    return design_stimulus(
        model, TargetField(), Timing(AFG3022B.converter), Amplifier(gain=25.0, limit=250.0), law="paper"
    )
