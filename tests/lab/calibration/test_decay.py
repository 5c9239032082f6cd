"""Fits of free decays: residues and poles against known sums, unlisted modes, and noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modaltouch.lab.calibration.decay import find_poles, fit_poles, fit_residues

TIME = 30e-6 + np.arange(8000) / 400e3


def poles(frequency: list[float], damping: list[float]) -> np.ndarray:
    """Return the complex poles of natural frequencies [Hz] and damping ratios."""
    omega, ratio = 2 * np.pi * np.array(frequency), np.array(damping)
    return omega * (-ratio + 1j * np.sqrt(1 - ratio**2))


def records(pole: np.ndarray, residue: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """Return decays with given residues, (n_records, n_samples) array."""
    clean = (residue.T @ np.exp(np.outer(pole, TIME))).real
    return clean + noise * np.random.default_rng(seed).standard_normal(clean.shape)


LISTED = poles([229.0, 2553.0, 12701.0, 58303.0], [0.0437, 0.0165, 0.0168, 0.0101])
RESIDUES = np.random.default_rng(5).standard_normal((4, 3, 2)) @ np.array([1, 1j])


def test_residues_of_known_poles_are_exact() -> None:
    """Without noise, within 1e-9 of the largest."""
    found = fit_residues(TIME, records(LISTED, RESIDUES), LISTED)
    assert np.abs(found.residue - RESIDUES).max() < 1e-9


def test_an_offset_of_the_vibrometer_does_not_matter() -> None:
    """Constants of up to a third of a record's peak do not change poles or residues."""
    data = records(LISTED, RESIDUES, 0.001) + np.array([[0.2], [-1.0], [0.05]])
    found = find_poles(TIME, data, LISTED * 1.001)
    assert found.pole.size == 4
    assert np.abs(found.residue - RESIDUES).max() < 1e-3


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.floats(-0.005, 0.005), min_size=4, max_size=4),
    st.lists(st.floats(-0.2, 0.2), min_size=4, max_size=4),
    st.integers(0, 1000),
)
def test_poles_are_found_from_wrong_initial_values(frequency: list[float], damping: list[float], seed: int) -> None:
    """Errors of 0.5 % in frequency and 20 % in damping: without noise the poles are found within 1e-6."""
    residue = np.random.default_rng(seed).uniform(0.3, 1.0, (4, 3)) * np.exp(1j * seed)
    start = LISTED.real * (1 + np.array(damping)) + 1j * LISTED.imag * (1 + np.array(frequency))
    found = fit_poles(TIME, records(LISTED, residue), start)
    assert np.abs(found.pole / LISTED - 1).max() < 1e-6


def test_the_spread_is_the_standard_error_of_the_residues() -> None:
    """Over 200 draws of noise the residues scatter by the stated standard error, within 15 %."""
    draws = [fit_residues(TIME, records(LISTED, RESIDUES, 0.3, seed), LISTED) for seed in range(200)]
    error = np.array([draw.residue - RESIDUES for draw in draws])
    scatter = np.sqrt(0.5 * np.mean(np.abs(error) ** 2, axis=(0, 2)))
    assert scatter == pytest.approx(draws[0].spread, rel=0.15)


def test_an_unlisted_mode_is_found_and_does_not_bias() -> None:
    """A mode at 310 Hz beside one at 229 Hz, a tenth as strong: it causes a bias only if ignored."""
    every = np.append(LISTED, poles([310.0], [0.04]))
    residue = np.concatenate([RESIDUES, 0.1 * RESIDUES[:1]])
    data = records(every, residue, noise=0.01)
    ignored = np.abs(fit_poles(TIME, data, LISTED).residue[0] - RESIDUES[0]).max()
    found = find_poles(TIME, data, LISTED)
    assert found.pole.size == 5
    assert found.pole[4] == pytest.approx(every[4], rel=0.01)
    assert np.abs(found.residue[0] - RESIDUES[0]).max() < 0.1 * ignored


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_not_taken_for_a_mode(seed: int) -> None:
    """No pole is added to the listed ones if nothing else decays."""
    assert find_poles(TIME, records(LISTED, RESIDUES, 0.1, seed), LISTED).pole.size == LISTED.size
