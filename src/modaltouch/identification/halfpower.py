"""Peak picking and half-power bandwidth, as the paper does, and when the resolution is too coarse for them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

FEWEST_BINS = 5.0
"""Half-power bandwidth, in bins, below which its damping is worthless: up to thirty times too large [1]."""


@dataclass(frozen=True)
class HalfPower:
    """What a single peak says.

    Attributes
    ----------
    peak_frequency : float
        Of the highest bin [Hz].
    height : float
        Of the response there [m/s per unit of excitation].
    damping_ratio : float
        Half-power bandwidth over twice the frequency [1]; NaN where the response does not fall to half its power on
        both sides before it rises again.
    n_bins : float
        Half-power bandwidth over the distance of two bins [1].
    """

    peak_frequency: float
    height: float
    damping_ratio: float
    n_bins: float

    @property
    def resolved(self) -> bool:
        """Whether the bins are fine enough for the damping to mean anything."""
        return self.n_bins >= FEWEST_BINS

    @property
    def verdict(self) -> str:
        """What is wrong with the damping ratio; empty if nothing is."""
        if math.isnan(self.damping_ratio):
            return "the peak does not fall to half its power on both sides"
        if not self.resolved:
            return f"{self.n_bins:.1f} bins across the peak, at least {FEWEST_BINS:g} are needed: a longer record"
        return ""


def half_power(frequency: FloatArray, magnitude: FloatArray, near: float, reach: float) -> HalfPower:
    """Return peak and half-power bandwidth of a response near a frequency.

    Parameters
    ----------
    frequency : (n_bins,) array
        Evenly spaced [Hz].
    magnitude : (n_bins,) array
        Of one response.
    near, reach : float
        The highest bin within `reach` of `near` is the peak [Hz].
    """
    spacing = float(frequency[1] - frequency[0])
    # A pole may lie beyond the band, whose end is then all there is of it.
    near = float(np.clip(near, frequency[0], frequency[-1]))
    inside = np.flatnonzero(np.abs(frequency - near) <= max(reach, 1.5 * spacing))
    peak = int(inside[magnitude[inside].argmax()])
    power = magnitude.astype(float) ** 2
    left, right = _crossing(power, peak, -1), _crossing(power, peak, +1)
    width = (right + left) * spacing if left is not None and right is not None else math.nan
    return HalfPower(
        peak_frequency=float(frequency[peak]),
        height=float(magnitude[peak]),
        damping_ratio=width / (2 * float(frequency[peak])),
        n_bins=width / spacing,
    )


def _crossing(power: FloatArray, peak: int, step: int) -> float | None:
    """Return how many bins from a peak its power is a half, by a straight line between bins; None if it never is."""
    half = power[peak] / 2
    index = peak
    while 0 <= index + step < power.size:
        before, index = index, index + step
        if power[index] <= half:
            part = (power[before] - half) / (power[before] - power[index])
            return float(abs(before - peak) + part)
        if power[index] > power[peak]:
            return None
    return None
