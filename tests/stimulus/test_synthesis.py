"""The synthesis kernel against extended precision and its own invariants."""

import tracemalloc

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modaltouch.stimulus.dynamics import moments
from modaltouch.stimulus.synthesis import BLOCK, CHUNK, decay, synthesise

EPS = np.finfo(float).eps


def exponents(frequency, ratio):
    """Return -a + ib of modes."""
    w = 2 * np.pi * np.asarray(frequency, dtype=float)
    xi = np.asarray(ratio, dtype=float)
    return w * (-xi + 1j * np.sqrt((1 - xi) * (1 + xi)))


def reference(amplitude, exponent, hold, n_samples, places):
    """Return the sums at some samples in thirty digits."""
    mpmath.mp.dps = 30
    sums = np.zeros((amplitude.shape[0], len(places)))
    for j, place in enumerate(places):
        time = mpmath.mpf(hold) * (n_samples - 1 - int(place))
        factors = [mpmath.exp(mpmath.mpc(e.real, e.imag) * time) for e in exponent]
        for c, row in enumerate(amplitude):
            sums[c, j] = sum((mpmath.mpc(a.real, a.imag) * f).real for a, f in zip(row, factors, strict=True))
    return sums


def test_table_i_is_synthesised_to_rounding(model, rng):
    """For Table I the error against mpmath is at most 1e-14 of the peak."""
    amplitude = rng.normal(size=(2, 9)) + 1j * rng.normal(size=(2, 9))
    n_samples, hold = 125_000, 4e-7
    out = np.empty((2, n_samples))
    synthesise(amplitude, model.exponent, hold, out)
    late = n_samples - 1 - rng.integers(0, 3000, 60)
    places = np.unique(np.concatenate([rng.integers(0, n_samples, 60), late]))
    error = out[:, places] - reference(amplitude, model.exponent, hold, n_samples, places)
    assert np.abs(error).max() <= 1e-14 * np.abs(out).max()


@settings(max_examples=30, deadline=None)
@given(
    n_samples=st.integers(1, 3 * BLOCK + 1),
    ratio=st.floats(1e-6, 0.99),
    frequency=st.floats(1.0, 1.2e6),
    seed=st.integers(0, 2**31),
)
def test_error_grows_with_the_phase_alone(n_samples, ratio, frequency, seed):
    """At most 4 eps b|t| for phases beyond a few cycles; damping ratios from 1e-6 to 0.99."""
    rng = np.random.default_rng(seed)
    exponent = exponents([frequency, frequency * (1 + 1e-6)], [ratio, ratio])
    amplitude = rng.normal(size=(1, 2)) + 1j * rng.normal(size=(1, 2))
    out = np.empty((1, n_samples))
    synthesise(amplitude, exponent, 4e-7, out)
    places = np.unique(rng.integers(0, n_samples, 4))
    error = out[:, places] - reference(amplitude, exponent, 4e-7, n_samples, places)
    phase = exponent.imag.max() * 4e-7 * n_samples
    assert np.abs(error).max() <= max(1e-14, 4 * EPS * phase) * np.abs(amplitude).sum()


@pytest.mark.parametrize("n_samples", [1, BLOCK - 1, BLOCK, BLOCK + 1, BLOCK * CHUNK + 77])
def test_blocks_and_chunks_join_without_a_seam(n_samples, model):
    """Each sample equals the plain expression evaluated on its own."""
    amplitude = np.ones((1, 9)) * np.exp(1j * np.arange(9))
    out = np.full((1, n_samples), np.nan)
    synthesise(amplitude, model.exponent, 4e-7, out)
    ago = np.arange(n_samples)[::-1]
    for part in np.array_split(np.arange(n_samples), max(1, n_samples // 20_000)):
        plain = (amplitude @ np.exp(model.exponent[:, None] * (4e-7 * ago[part]))).real
        assert out[:, part] == pytest.approx(plain, abs=2e-12)


def test_ten_seconds_do_not_overflow():
    """The term exp(a t_F) overflows, exp(a (t - t_F)) does not."""
    exponent = exponents([88e3], [0.0147])
    assert -exponent.real[0] * 10.0 > np.log(np.finfo(float).max)
    decayed = decay(exponent, 4e-7, np.array([0, 25_000_000]))
    assert decayed[0].tolist() == [1, 0]


def test_a_channel_without_amplitude_is_exactly_zero(model):
    """Its samples are 0.0, and the other channel is unaffected."""
    out = np.full((2, 1000), np.nan)
    amplitude = np.zeros((2, 9), dtype=complex)
    amplitude[1, 0] = 1.0
    synthesise(amplitude, model.exponent, 4e-7, out)
    assert (out[0] == 0.0).all()
    assert np.isfinite(out[1]).all()


@given(factor=st.sampled_from([2.0, 0.5, 1024.0, 2.0**-20]), seed=st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_scaling_by_two_is_exact(factor, seed, model):
    """Powers of two cause no rounding, so the samples scale exactly."""
    rng = np.random.default_rng(seed)
    amplitude = rng.normal(size=(1, 9)) + 1j * rng.normal(size=(1, 9))
    one, other = np.empty((1, 5000)), np.empty((1, 5000))
    synthesise(amplitude, model.exponent, 4e-7, one)
    synthesise(amplitude * factor, model.exponent, 4e-7, other)
    assert (other == one * factor).all()


def test_no_memory_grows_with_the_samples(model):
    """Eight times the samples need less than 1.1 times the temporary memory."""
    amplitude = np.ones((2, 9), dtype=complex)
    peaks = []
    for n_samples in (BLOCK * CHUNK, 8 * BLOCK * CHUNK):
        out = np.empty((2, n_samples))
        tracemalloc.start()
        synthesise(amplitude, model.exponent * 1e-3, 4e-7, out)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0]


@given(n_samples=st.integers(1, 4 * BLOCK), seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_moments_are_the_adjoint_of_synthesis(n_samples, seed, model):
    """<synthesise(A), v> = Re sum(A * moments(v)): the two kernels are transposes of each other."""
    rng = np.random.default_rng(seed)
    amplitude = rng.normal(size=(2, 9)) + 1j * rng.normal(size=(2, 9))
    voltage = rng.normal(size=(2, n_samples))
    out = np.empty((2, n_samples))
    synthesise(amplitude, model.exponent, 4e-7, out)
    inner = float((amplitude * moments(voltage, model.exponent, 4e-7)).real.sum())
    assert float((out * voltage).sum()) == pytest.approx(inner, abs=1e-11 * n_samples)
