"""Masking noise as samples: spectrum, periodicity, level and fades; no device is opened."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import welch

from modaltouch.protocol import Apparatus, MaskingSection
from modaltouch.protocol.apparatus import Sound
from modaltouch.window.masking import HIGHEST, LOWEST, LoopedNoise, MaskingNoise, amplitude_at, make_noise

RATE = 48_000.0


def octave_levels(noise: np.ndarray) -> np.ndarray:
    """Return the power in each octave band from 31.5 Hz to 8 kHz [dB], by Welch's method over several periods."""
    frequency, density = welch(np.tile(noise, 3).astype(float), RATE, nperseg=2**16)
    centres = 31.25 * 2.0 ** np.arange(9)
    bands = [(frequency >= centre / math.sqrt(2)) & (frequency < centre * math.sqrt(2)) for centre in centres]
    return np.array([10 * math.log10(density[band].sum()) for band in bands])


def test_pink_noise_has_equal_power_in_every_octave() -> None:
    """Within 0.5 dB over nine octaves, by Welch's method."""
    levels = octave_levels(make_noise("pink", RATE))
    assert np.ptp(levels) < 0.5


def test_white_noise_has_equal_power_in_every_hertz() -> None:
    """Each octave has 3.01 dB more than the one below, within 0.5 dB."""
    levels = octave_levels(make_noise("white", RATE))
    assert np.abs(np.diff(levels) - 10 * math.log10(2)).max() < 0.5


@pytest.mark.parametrize("kind", ["pink", "white"])
def test_the_noise_is_limited_to_the_audible_band(kind: str) -> None:
    """Below 20 Hz and above 20 kHz there is less than -80 dB of the total power."""
    power = np.abs(np.fft.rfft(make_noise(kind, RATE).astype(float))) ** 2  # type: ignore[arg-type]
    frequency = np.fft.rfftfreq(round(10 * RATE), 1 / RATE)
    outside = power[(frequency < LOWEST) | (frequency > HIGHEST)].sum()
    assert outside < 1e-8 * power.sum()


@pytest.mark.parametrize("rate", [8000.0, 44_100.0, RATE])
@pytest.mark.parametrize("kind", ["pink", "white"])
def test_the_period_has_no_seam(kind: str, rate: float) -> None:
    """The step from the last to the first sample is no larger than the largest step inside."""
    noise = make_noise(kind, rate)  # type: ignore[arg-type]
    assert abs(noise[0] - noise[-1]) <= np.abs(np.diff(noise)).max()
    assert np.sqrt(np.mean(noise.astype(float) ** 2)) == pytest.approx(1, rel=1e-5)
    # A shift of the period has the same spectrum, which a seam would not.
    shifted = np.roll(noise, len(noise) // 3).astype(float)
    assert np.allclose(np.abs(np.fft.rfft(shifted)), np.abs(np.fft.rfft(noise.astype(float))), atol=1e-6 * len(noise))


def test_the_noise_is_the_same_in_every_session() -> None:
    """Its phases come from a stream that NumPy guarantees."""
    make_noise.cache_clear()
    first = make_noise("pink", RATE).copy()
    make_noise.cache_clear()
    assert np.array_equal(first, make_noise("pink", RATE))
    assert not make_noise("pink", RATE).flags.writeable


@pytest.mark.parametrize("kind", ["pink", "white"])
def test_at_its_highest_level_the_peak_just_reaches_full_scale(kind: str) -> None:
    """The crest factor is about 5, so the highest level is about -11 dB FS (0 dB FS is a full-scale sine)."""
    apparatus = Apparatus.model_construct(sound=Sound(sampling_rate_Hz=RATE))
    level = MaskingNoise(MaskingSection(noise=kind, level_dB_FS=-20.0), apparatus).highest_level  # type: ignore[arg-type]
    peak = np.abs(make_noise(kind, RATE)).max() * amplitude_at(level)  # type: ignore[arg-type]
    assert peak == pytest.approx(1, rel=1e-6)
    assert -12.5 < level < -9.5


def test_a_level_is_the_rms_against_a_sine_of_full_scale() -> None:
    """AES17: 0 dB FS is the rms of a full-scale sine, 0.7071; -20 dB FS is a tenth of it."""
    assert amplitude_at(0) == pytest.approx(math.sqrt(0.5))
    assert amplitude_at(-20) == pytest.approx(math.sqrt(0.5) / 10)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(1, 900), min_size=1, max_size=30), st.integers(1, 400))
def test_blocks_of_any_size_join_without_a_gap(sizes: list[int], n_fade: int) -> None:
    """After the fade-in the period is played repeatedly, whatever block sizes the device requests."""
    period = np.random.default_rng(1).standard_normal(257).astype(np.float32)
    playback = LoopedNoise(period, n_fade)
    playback.fade(on=True)
    blocks = []
    for size in sizes:
        block = np.empty((size, 2), dtype=np.float32)
        playback.fill(block)
        blocks.append(block)
    played = np.concatenate(blocks)
    expected = np.resize(period, len(played))
    assert np.array_equal(played[:, 0], played[:, 1])
    assert np.array_equal(played[n_fade:, 0], expected[n_fade:])
    assert (np.abs(played[:n_fade, 0]) <= np.abs(expected[:n_fade])).all()


def test_fades_rise_and_fall_without_a_jump() -> None:
    """On a constant: half a sine from 0 to 1 in the given time, with no step beyond its steepest slope."""
    playback = LoopedNoise(np.ones(100, dtype=np.float32), 1000)
    out = np.empty((1, 1), dtype=np.float32)
    heard = [0.0]
    playback.fade(on=True)
    for _ in range(1200):
        playback.fill(out)
        heard.append(float(out[0, 0]))
    assert playback.is_faded(on=True)
    playback.fade(on=False)
    for _ in range(1200):
        playback.fill(out)
        heard.append(float(out[0, 0]))
    assert playback.is_faded(on=False)
    assert heard[501] == pytest.approx(0.5, abs=0.002)
    assert heard[1100] == 1
    assert heard[-1] == 0
    assert np.abs(np.diff(heard)).max() < 1.01 * np.pi / 2 / 1000
