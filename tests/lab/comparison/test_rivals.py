"""The rival methods: focusing by time reversal, the inverse filter, and regularisation."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from forward import velocity_history
from hypothesis import given, settings
from hypothesis import strategies as st

from modaltouch.lab.focusing_methods import (
    TrainingData,
    TransferFunctions,
    inverse_filter,
    regularised_inverse,
    time_reversal,
)
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.target_field import TargetField


@dataclass(frozen=True, eq=False)
class InTime(TransferFunctions):
    """Responses given in time: modes without damping have no spectrum on a grid."""

    given: np.ndarray

    def in_time(self, spectrum: np.ndarray, first: float, step: float, n: int) -> np.ndarray:
        return self.given / step


def lossless(source: float = 0.031) -> tuple[ModalModel, TrainingData]:
    """Return twelve almost undamped modes driven by a force at one point, so that reciprocity holds."""
    label = tuple(range(1, 13))
    frequency = 180.0 * (np.arange(12) + 1.7) ** 1.6
    bare = ModalModel(label, frequency, np.full(12, 1e-9), np.zeros((12, 1)), 0.1)
    model = replace(bare, modal_gain=bare.shapes([source]) * 1.0)
    timing = Timing(AFG3022B.converter, n_samples=12_500, duration=0.05, focusing_instant=0.05, repetition_rate=7.0)
    places = np.linspace(-0.05, 0.05, 41)
    ago = (np.arange(12_500) + 0.5) * timing.hold
    # Undamped: eta' after an impulse is G cos(w t).
    courses = model.modal_gain[:, 0, None] * np.cos(model.angular_frequency[:, None] * ago)
    given = (model.shapes(places).T @ courses)[None] * timing.hold
    responses = InTime(np.array([1.0, 2.0]), np.zeros((1, 41, 2), complex), places, given)
    return model, TrainingData(model, responses, TargetField(centre=-0.02), timing, Amplifier(1.0, 1e9))


def test_reversal_focuses_in_time_and_space_on_a_lossless_reciprocal_beam():
    """Autocorrelation: maximal in time at the focusing instant and in space at the focus.

    Twelve modes and one source leave side lobes, the highest at the end of the beam, which moves twice as much.
    """
    model, known = lossless()
    voltage = time_reversal(known)
    places = known.responses.position
    history = velocity_history(model, voltage, known.timing, [-0.02])[0]
    field = velocity_history(model, voltage, known.timing, places)[:, -1]
    assert int(np.abs(history).argmax()) >= known.timing.n_samples - 2
    # The last value of the history is a step before the focusing instant.
    assert history[-1] == pytest.approx(0.2, rel=0.02)
    assert places[int(np.abs(field).argmax())] == pytest.approx(-0.02)
    assert np.abs(field[np.abs(places + 0.02) > 0.01]).max() < 0.8 * 0.2


def test_reversal_is_the_autocorrelation_of_the_impulse_response():
    """The field at t_F is A sum of h(x) h(x0), by NumPy's correlation at lag zero."""
    _, known = lossless()
    steps = time_reversal(known)
    amplitude = steps[0, -2] / known.towards[0, known.focus, 1]
    for point in (0, 7, known.focus):
        at_zero = np.correlate(known.towards[0, point], known.towards[0, known.focus], "valid")[0]
        assert known.expected(steps)[point] == pytest.approx(amplitude * at_zero, rel=2e-3, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_drive_of_equal_energy_moves_the_focus_more_than_reversal(seed):
    """By the Cauchy-Schwarz inequality (matched filter)."""
    _, known = lossless()
    steps = time_reversal(known)
    other = np.random.default_rng(seed).normal(size=steps.shape) + steps * np.random.default_rng(seed).normal()
    other *= np.linalg.norm(steps) / np.linalg.norm(other)
    best = known.expected(steps)[known.focus]
    assert known.expected(other)[known.focus] <= best * (1 + 2e-3)


def test_inverse_without_regularisation_hits_a_square_problem():
    """As many points as outputs, no noise: H V = U at every frequency."""
    rng = np.random.default_rng(5)
    H = rng.normal(size=(3, 3, 50)) + 1j * rng.normal(size=(3, 3, 50))
    target = rng.normal(size=(3, 50)) + 1j * rng.normal(size=(3, 50))
    drive = regularised_inverse(H, target, 0.0)
    assert np.einsum("cmf,cf->mf", H, drive) == pytest.approx(target, abs=1e-9)


def test_regularisation_trades_error_for_energy():
    """Tikhonov: more regularisation means less drive and a larger error."""
    rng = np.random.default_rng(6)
    H = rng.normal(size=(2, 9, 40)) + 1j * rng.normal(size=(2, 9, 40))
    target = rng.normal(size=(9, 40)) + 0j
    drives = [regularised_inverse(H, target, strength) for strength in (0, 1e-3, 1e-2, 1e-1, 1)]
    energy = [float((np.abs(drive) ** 2).sum()) for drive in drives]
    missed = [float((np.abs(np.einsum("cmf,cf->mf", H, drive) - target) ** 2).sum()) for drive in drives]
    assert energy == sorted(energy, reverse=True)
    assert missed == sorted(missed)


def test_impulse_responses_are_those_of_the_modes(known):
    """Closed form G phi e^{-at} (cos bt - a/b sin bt) from 100 us on; the band causes less than 1 %."""
    model, step = known.model, known.step
    ago = (np.arange(known.n_before) + 0.5) * step
    a, b = -model.exponent.real[:, None], model.exponent.imag[:, None]
    courses = np.exp(-a * ago) * (np.cos(b * ago) - a / b * np.sin(b * ago))
    exact = np.einsum("kc,kp,kj->cpj", model.modal_gain, model.shapes(known.responses.position), courses) * step
    late = slice(125, None)
    assert np.abs(known.towards - exact)[..., late].max() < 0.01 * np.abs(exact).max()


def test_every_rival_keeps_the_voltage_limit(known):
    """With a low limit each method plays at the limit and expects a lower velocity."""
    poor = replace(known, amplifier=replace(known.amplifier, limit=2.0))
    for way in (time_reversal, inverse_filter):
        drive = way(poor)
        assert np.abs(drive).max() == pytest.approx(2.0, rel=1e-3), way.__name__
        steps = drive[:, : poor.n_before * poor.stride : poor.stride]
        assert poor.expected(steps)[poor.focus] < 0.1, way.__name__
