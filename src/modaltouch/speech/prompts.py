"""All that a session may say, as samples at the device's rate and the protocol's level."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol import SpeechSection
from modaltouch.speech.espeak import synthesise

_SINE_RMS = math.sqrt(0.5)
"""Root mean square of a sine of full scale, 0 dB FS (AES17) [1]."""


@dataclass(frozen=True, eq=False)
class Prompts:
    """What can be said.

    Attributes
    ----------
    section : SpeechSection
        How the protocol wants it said.
    voice, library : str
        Who speaks.
    sampling_rate : float
        Samples per second [Hz].
    samples : mapping of str to (n_samples,) array
        What is heard, by its words, as a share of full scale [1].
    digests : mapping of str to str
        SHA-256 of the samples as the library made them, by the words.
    """

    section: SpeechSection
    voice: str
    library: str
    sampling_rate: float
    samples: Mapping[str, NDArray[np.float32]]
    digests: Mapping[str, str]

    @property
    def peak(self) -> float:
        """Largest sample of all, as a share of full scale [1]."""
        return max(float(np.abs(each).max()) for each in self.samples.values())

    def duration(self, words: str) -> float:
        """Return how long a prompt is [s]."""
        return len(self.samples[words]) / self.sampling_rate

    def describe(self) -> dict[str, Any]:
        """Return who says what, and how, for the record."""
        return {
            "voice": self.voice,
            "library": self.library,
            "screens": list(self.section.screens),
            "rate_words_per_min": self.section.rate_words_per_min,
            "level_dB_FS": self.section.level_dB_FS,
            "required": self.section.required,
            "prompts": [
                {"words": words, "duration_s": round(self.duration(words), 3), "sha256": self.digests[words]}
                for words in self.samples
            ],
        }


@lru_cache(maxsize=2)
def make_prompts(section: SpeechSection, voice: str, texts: tuple[str, ...], sampling_rate: float) -> Prompts:
    """Return prompts, of which all together have the level that the protocol gives.

    Parameters
    ----------
    section : SpeechSection
        How they are said.
    voice : str
        Who says them.
    texts : tuple of str
        What is said; at least one.
    sampling_rate : float
        Of the device [Hz].

    Raises
    ------
    SpeechError
        If they cannot be made.
    """
    made = synthesise(texts, voice, section.rate_words_per_min)
    power = sum(float(np.sum(each.astype(np.float64) ** 2)) for each in made.samples)
    rms = math.sqrt(power / sum(each.size for each in made.samples))
    gain = _SINE_RMS * 10 ** (section.level_dB_FS / 20) / rms
    return Prompts(
        section,
        voice,
        made.library,
        sampling_rate,
        {
            words: _resampled(each.astype(np.float64) * gain, made.sampling_rate, sampling_rate)
            for words, each in zip(texts, made.samples, strict=True)
        },
        {
            words: hashlib.sha256(each.astype("<i2").tobytes()).hexdigest()
            for words, each in zip(texts, made.samples, strict=True)
        },
    )


def _resampled(samples: NDArray[np.float64], of: float, at: float) -> NDArray[np.float32]:
    """Return samples taken at one rate at another one, by their spectrum: what is spoken begins and ends in silence."""
    ratio = Fraction(at / of).limit_denominator(1000)
    # Followed by silence up to a length of small factors, whose transform is fast.
    n_periods = -(-len(samples) // ratio.denominator)
    step = 1 << max(n_periods.bit_length() - 5, 0)
    n_periods = -(-n_periods // step) * step
    n_in, n_out = n_periods * ratio.denominator, n_periods * ratio.numerator
    spectrum = np.fft.rfft(samples, n_in)[: n_out // 2 + 1]
    longer = np.fft.irfft(spectrum, n_out) * (n_out / n_in)
    resampled: NDArray[np.float32] = longer[: round(len(samples) * at / of)].astype(np.float32)
    resampled.flags.writeable = False
    return resampled
