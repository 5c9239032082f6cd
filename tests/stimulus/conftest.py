"""The shipped beam in numbers: Table I, patches on two sets, an amplifier of 25 V/V up to 250 V."""

from collections.abc import Callable

import numpy as np
import pytest

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.stimulus import Stimulus, design_stimulus
from modaltouch.stimulus.target_field import TargetField

TABLE_I = (
    # label, Hz, damping ratio, mm/s^2 per V, channel
    (1, 229, 0.0437, 114, 0),
    (3, 2553, 0.0165, 654, 0),
    (5, 7137, 0.0265, 6500, 1),
    (7, 12701, 0.0168, -8346, 1),
    (9, 22810, 0.0112, 10414, 1),
    (11, 29390, 0.0166, -6285, 0),
    (13, 58303, 0.0101, -41448, 0),
    (15, 68543, 0.0176, -166030, 1),
    (17, 87855, 0.0147, 134615, 1),
)

ZONES = (-0.04, -0.02, 0.0, 0.02, 0.04)
LEVELS = (0.08, 0.1, 0.15, 0.2)


def shipped_model(cross_gain: float = 0.0) -> ModalModel:
    """Return Table I on two channels; the other channel drives each mode at a fraction of its gain."""
    gain = np.zeros((9, 2))
    for row, (_, _, _, value, channel) in zip(gain, TABLE_I, strict=True):
        row[channel], row[1 - channel] = value * 1e-3, cross_gain * value * 1e-3
    return ModalModel(
        label=tuple(row[0] for row in TABLE_I),
        natural_frequency=np.array([row[1] for row in TABLE_I], dtype=float),
        damping_ratio=np.array([row[2] for row in TABLE_I]),
        modal_gain=gain,
        length=0.1,
    )


@pytest.fixture(scope="session")
def model() -> ModalModel:
    """Return the shipped beam."""
    return shipped_model()


@pytest.fixture(scope="session")
def crossed_model() -> ModalModel:
    """Return the shipped beam with every mode on both channels."""
    return shipped_model(0.3)


@pytest.fixture(scope="session")
def zones() -> tuple[float, ...]:
    """Return the centres of zones A to E [m]."""
    return ZONES


@pytest.fixture(scope="session")
def design() -> Callable[..., Stimulus]:
    """Return a function that designs the shipped stimulus, except for the parts that it is given."""

    def design_shipped(
        model: ModalModel | None = None,
        *,
        target_field: TargetField | None = None,
        timing: Timing | None = None,
        amplifier: Amplifier | None = None,
        **options: object,
    ) -> Stimulus:
        return design_stimulus(
            shipped_model() if model is None else model,
            TargetField() if target_field is None else target_field,
            Timing(AFG3022B.converter) if timing is None else timing,
            Amplifier(gain=25.0, limit=250.0) if amplifier is None else amplifier,
            **{"levels": LEVELS if target_field is None else None, **options},
        )

    return design_shipped


@pytest.fixture(scope="session")
def shipped(design: Callable[..., Stimulus]) -> Stimulus:
    """Return the shipped stimulus by the exact law."""
    return design()


@pytest.fixture(scope="session")
def shipped_paper(design: Callable[..., Stimulus]) -> Stimulus:
    """Return the shipped stimulus by the paper's law."""
    return design(law="paper")


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a random generator with a fixed seed."""
    return np.random.default_rng(20_190_709)
