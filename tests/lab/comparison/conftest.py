"""Noiseless responses of the beam of Table I, and the shipped protocol."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from modaltouch.lab.contest import band
from modaltouch.lab.focusing_methods import TrainingData, TransferFunctions
from modaltouch.preflight import Preflight, examine
from modaltouch.stimulus.modes import ModalModel

PROTOCOL = Path(__file__).parents[3] / "protocols" / "differentiated_stimulation.yaml"


def responses_of(model: ModalModel, positions: np.ndarray, highest: float = 120e3) -> TransferFunctions:
    r"""Return the velocity responses of modes in closed form, :math:`\sum_k \varphi_k G_k i\omega / (...)`."""
    frequency = np.arange(1, int(highest * 0.262144)) / 0.262144
    omega = 2 * np.pi * frequency
    own = (
        1j
        * omega
        / (
            model.angular_frequency[:, None] ** 2
            - omega**2
            + 2j * model.damping_ratio[:, None] * model.angular_frequency[:, None] * omega
        )
    )
    response = np.einsum("kc,kp,kf->cpf", model.modal_gain, model.shapes(positions), own, optimize=True)
    window = band(frequency, 0.5 * model.natural_frequency.min(), 1.1 * model.natural_frequency.max())
    return TransferFunctions(frequency, response * window, positions)


@pytest.fixture(scope="session")
def preflight() -> Preflight:
    """Return the shipped protocol, examined."""
    return examine(PROTOCOL).require()


@pytest.fixture(scope="session")
def known(preflight: Preflight) -> TrainingData:
    """Return the data given to every method: the table and its responses."""
    stimulus = preflight.stimulus
    positions = np.round(np.linspace(-0.05, 0.05, 41), 9)
    responses = responses_of(stimulus.model, positions)
    field, timing, amplifier = stimulus.target_field, stimulus.timing, stimulus.amplifier
    return TrainingData(stimulus.model, responses, field, timing, amplifier, stimulus.release, stimulus.load_factor)
