"""Closed-form responses of the twin's true beam, with the noise of averaged records."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modaltouch.lab.identification.joint_fit import identify
from modaltouch.lab.identification.modal_parameters import Identification
from modaltouch.lab.identification.responses import FrequencyResponses
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.simulator.true_beam import TrueBeam, true_beam

APPARATUS = Path(__file__).parents[3] / "protocols" / "apparatus" / "beam_100x6x2.yaml"
LENGTH = 0.1
PERIOD = 131_072 / 500e3
DELAY, BANDWIDTH = 4e-6, 250e3

MakeResponses = Callable[..., FrequencyResponses]


@pytest.fixture(scope="session")
def apparatus() -> Apparatus:
    """Return the shipped apparatus."""
    return Apparatus.read(APPARATUS)


@pytest.fixture(scope="session")
def beam(apparatus: Apparatus) -> TrueBeam:
    """Return the true beam of the twin: nine modes of the table, ten more of bending, three of torsion."""
    return true_beam(apparatus, 1)


@pytest.fixture(scope="session")
def exact(beam: TrueBeam) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return the velocity responses in closed form, (n_sets, n_points, n_bins)."""
    known: dict[tuple[int, int], np.ndarray] = {}

    def responses(frequency: np.ndarray, positions: np.ndarray) -> np.ndarray:
        key = frequency.size, positions.size
        if key not in known:
            known[key] = computed(frequency, positions)
        return known[key]

    def computed(frequency: np.ndarray, positions: np.ndarray) -> np.ndarray:
        omega, own = 2 * np.pi * frequency, 2 * np.pi * beam.natural_frequency[:, None]
        dynamic = 1j * omega / (own**2 - omega**2 + 2j * beam.damping_ratio[:, None] * own * omega)
        dynamic = dynamic * np.exp(-1j * omega * DELAY) / (1 + 1j * frequency / BANDWIDTH)
        shapes = beam.shapes(positions, 0.2e-3)
        return np.einsum("ks,kp,kf->spf", beam.modal_gain, shapes, dynamic, optimize=True)

    return responses


@pytest.fixture(scope="session")
def make(beam: TrueBeam, exact: Callable[..., np.ndarray]) -> MakeResponses:
    """Return a function that makes estimated responses for a seed and a noise relative to a reference.

    At unit noise the median over the points of the coherence at the peak of the weakest listed mode is 0.95. The mean
    of n_averages records has 1/n of the noise power, and the residual power has n - 1 degrees of freedom.
    """

    def responses(
        seed: int = 0,
        noise: float = 1.0,
        *,
        n_points: int = 41,
        n_averages: int = 10,
        highest: float = 110e3,
    ) -> FrequencyResponses:
        rng = np.random.default_rng(seed)
        frequency = np.arange(int(50 * PERIOD) + 1, int(highest * PERIOD)) / PERIOD
        positions = np.linspace(-LENGTH / 2, LENGTH / 2, n_points)
        response = exact(frequency, positions)
        heights = [
            np.median(np.abs(response[np.abs(gain).argmax(), :, np.abs(frequency - own).argmin()]) ** 2)
            for gain, own in zip(beam.table.modal_gain, beam.table.natural_frequency, strict=True)
            if own < highest
        ]
        power = noise**2 * min(heights) * 0.05 / 0.95 / (1 + (frequency / BANDWIDTH) ** 2)
        scatter = rng.standard_normal(response.shape) + 1j * rng.standard_normal(response.shape)
        response = response + scatter * np.sqrt(power / 2 / n_averages)
        residual = rng.gamma(n_averages - 1, 1.0, response.shape) * power / n_averages
        signal = np.abs(response) ** 2
        return FrequencyResponses(
            frequency, response, positions, ("centre", "side"), signal / (signal + residual), n_averages, BANDWIDTH
        )

    return responses


@pytest.fixture(scope="session")
def found(make: MakeResponses) -> Identification:
    """Return the identification from noisy responses alone, without initial poles or a number of modes."""
    return identify(make(0), LENGTH)
