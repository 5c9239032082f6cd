"""Section III-B, the gain from the resonance amplitude: printed with w^2, correct with w (erratum 1)."""

import numpy as np
import pytest
from forward import modal_history

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.modes import ModalModel


@pytest.fixture(scope="module")
def resonance():
    """Return (velocity per volt, G, xi, w) of mode 3, driven at resonance until steady."""
    model = ModalModel((3,), [2553.0], [0.0165], [[0.654]], 0.1)
    timing = Timing(AFG3022B.converter, n_samples=125_000, duration=0.05, focusing_instant=0.025)
    time = np.arange(timing.n_samples) * timing.hold
    velocity = modal_history(model, np.sin(2 * np.pi * 2553 * time)[None], timing)[0]
    return np.abs(velocity[-5000:]).max(), 0.654, 0.0165, 2 * np.pi * 2553


def test_speed_at_resonance_has_one_w(resonance):
    """The forward response at resonance: |eta'| = G |v| / (2 xi w)."""
    speed, gain, ratio, w = resonance
    assert speed == pytest.approx(gain / (2 * ratio * w), rel=1e-3)


def test_printed_formula_is_the_displacement(resonance):
    """Erratum 1: G |v| / (2 xi w^2) is the displacement in metres, four decades below the velocity in m/s."""
    speed, gain, ratio, w = resonance
    assert gain / (2 * ratio * w**2) == pytest.approx(speed / w, rel=1e-3)
    assert gain / (2 * ratio * w**2) < 1e-4 * speed
