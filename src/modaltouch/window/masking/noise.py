"""One period of noise: random phases over a spectrum that is exact, so that it repeats without a seam."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Kind = Literal["pink", "white"]

LOWEST, HIGHEST = 20.0, 20_000.0
"""Band of the noise: what can be heard [Hz]."""

PERIOD = 10.0
"""Length of the period [s]; nobody hears a repetition this slow."""

SEED = 20_120_501
"""Of the random phases: the noise of every session is the same."""

SINE_DB = 20 * math.log10(math.sqrt(2))
"""How far the rms of a sine of full scale, 0 dB FS (AES17), lies below full scale [dB]."""


@lru_cache(maxsize=4)
def make_noise(kind: Kind, sampling_rate: float) -> NDArray[np.float32]:
    """Return one period of noise with a root mean square of 1, without a seam and read-only, (n_samples,) array [1].

    Parameters
    ----------
    kind : str
        ``pink``, power falling with frequency, or ``white``, power even.
    sampling_rate : float
        Samples per second [Hz].

    Raises
    ------
    ValueError
        If the sampling rate leaves nothing of the band.
    """
    if not (math.isfinite(sampling_rate) and sampling_rate > 4 * LOWEST):
        raise ValueError(f"given a sampling rate of {sampling_rate} Hz; allowed: above {4 * LOWEST:g} Hz")
    n_samples = round(PERIOD * sampling_rate)
    frequency = np.fft.rfftfreq(n_samples, 1 / sampling_rate)
    in_band = (frequency >= LOWEST) & (frequency <= min(HIGHEST, 0.45 * sampling_rate))
    magnitude = np.zeros(frequency.size)
    magnitude[in_band] = 1.0 if kind == "white" else 1 / np.sqrt(frequency[in_band])
    # Raw words, whose stream numpy promises to keep: the same noise in every version.
    words = np.random.PCG64(SEED).random_raw(frequency.size)
    phase = words.astype(np.float64) * (2 * np.pi / 2.0**64)
    samples = np.fft.irfft(magnitude * np.exp(1j * phase), n_samples)
    noise: NDArray[np.float32] = (samples / np.sqrt(np.mean(samples**2))).astype(np.float32)
    noise.flags.writeable = False
    return noise


def highest_level(kind: Kind, sampling_rate: float) -> float:
    """Return the level at which the highest peak of a noise just reaches full scale [dB FS].

    Parameters
    ----------
    kind, sampling_rate
        As `make_noise` takes them.
    """
    crest = float(np.abs(make_noise(kind, sampling_rate)).max())
    return SINE_DB - 20 * math.log10(crest)


def amplitude_at(level: float) -> float:
    """Return the root mean square of noise at a level [dB FS], as a share of full scale [1].

    Examples
    --------
    >>> round(amplitude_at(0.0), 4)
    0.7071
    """
    return float(10 ** ((level - SINE_DB) / 20))
