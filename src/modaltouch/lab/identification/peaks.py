"""Initial poles from the peaks of the responses, and the delay that makes the responses real at these peaks."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modaltouch.lab.common import ComplexArray, FloatArray, low_pass
from modaltouch.lab.identification.kernel import Poles
from modaltouch.lab.identification.responses import FrequencyResponses, along
from modaltouch.lab.identification.time_records import DECAY
from modaltouch.stimulus import mode_shapes

FEWEST_BINS = 5.0
"""Half-power bandwidth, in bins, below which its damping ratio is unusable: up to thirty times too large [1]."""


@dataclass(frozen=True)
class HalfPower:
    """Estimates from a single peak by the half-power method."""

    peak_frequency: float  # frequency of the highest bin [Hz]
    height: float  # magnitude of the response there [m/s per unit of excitation]
    # half-power bandwidth divided by twice the frequency [1]; NaN if the response does not fall to half its power on
    # both sides before it rises again
    damping_ratio: float
    n_bins: float  # half-power bandwidth divided by the bin spacing [1]

    @property
    def verdict(self) -> str:
        """Reason why the damping ratio is unreliable; empty if it is reliable."""
        if math.isnan(self.damping_ratio):
            return "the peak does not fall to half its power on both sides"
        if self.n_bins < FEWEST_BINS:
            return f"{self.n_bins:.1f} bins across the peak, but at least {FEWEST_BINS:g} are needed: record for longer"
        return ""


def half_power(frequency: FloatArray, magnitude: FloatArray, near: float, reach: float) -> HalfPower:
    """Return peak and half-power bandwidth of a response near a frequency.

    Parameters
    ----------
    frequency : (n_bins,) array
        Evenly spaced frequencies [Hz].
    magnitude : (n_bins,) array
        Magnitude of one response.
    near, reach : float
        The highest bin within `reach` of `near` is the peak [Hz].
    """
    from scipy.signal import peak_widths

    spacing = float(frequency[1] - frequency[0])
    # A pole may lie beyond the band; the peak is then at the end of the band.
    near = float(np.clip(near, frequency[0], frequency[-1]))
    inside = np.flatnonzero(np.abs(frequency - near) <= max(reach, 1.5 * spacing))
    peak = int(inside[magnitude[inside].argmax()])
    power = magnitude.astype(float) ** 2
    span = np.array([power[peak]]), np.array([0]), np.array([power.size - 1])
    _, half, (left,), (right,) = peak_widths(power, [peak], rel_height=0.5, prominence_data=span)
    between = power[int(np.ceil(left)) : int(right) + 1]
    reached = power[int(left)] <= half and power[int(np.ceil(right))] <= half and between.max() <= power[peak]
    width = (right - left) * spacing if reached else math.nan
    return HalfPower(
        peak_frequency=float(frequency[peak]),
        height=float(magnitude[peak]),
        damping_ratio=width / (2 * float(frequency[peak])),
        n_bins=width / spacing,
    )


SIGNIFICANT = 7.0
"""Minimum height of a peak above its noise [standard deviations of the averaged quantity]."""

SAME_PEAK = 0.7
"""Distance below which two peaks count as one [half the larger of their half-power bandwidths]."""

FEWEST_LABELS = 6
"""Minimum number of shapes that the points must distinguish to separate the responses by shape."""

FEWEST_PHASES = 3
"""Minimum number of resonances needed to determine the measured quantity from their phases."""

LEAST_ROTATION = 0.8
"""Minimum phase change of a resonance across its half-power bandwidth; without noise it is pi/2 [rad]."""

RESONANCE_REST, CLEARLY_LESS = 0.1, 0.6
"""Largest residual power of a resonance fitted to a peak, relative to the power near the peak and to the residual for
the opposite sense of rotation [1]."""

WRONG_QUANTITY = 0.15
"""Difference by which the phases must fit another quantity better than velocity [mean cosine of twice the phase]."""

DAMPING_BOUNDS = (1e-5, 0.3)
"""Bounds of the damping ratio of a mode [1]."""

MOST_POLES = 60


def first_poles(responses: FrequencyResponses, length: float | None) -> Poles:
    """Return poles at the peaks of the responses, and the delay that makes the responses real there.

    If the positions are known, the responses are first separated by the shapes of a uniform free-free beam: each share
    then has one peak, with the noise averaged over all points.

    Parameters
    ----------
    responses : FrequencyResponses
        The responses.
    length : float or None
        Length of the beam [m].
    """
    shares = _shares(responses, length)
    peaks: list[_Peak] = []
    for share in shares:
        alone = len(shares) == 1
        peaks += _several_peaks(responses, share) if alone else _highest_peak(responses.frequency, share)
    kept: list[_Peak] = []
    for peak in sorted(peaks, key=lambda each: -each.height):
        # A peak on the flank of a higher one is leakage from that one into another share.
        apart = (abs(peak.frequency - each.frequency) / max(each.width, peak.width) for each in kept)
        if all(distance > SAME_PEAK for distance in apart):
            kept.append(peak)
    if not kept:
        raise ValueError(
            f"no resonance rises above the noise between {responses.frequency[0]:g} and {responses.frequency[-1]:g} "
            "Hz: drive harder, average more, or search where the beam's modes are"
        )
    chosen = sorted(kept[:MOST_POLES], key=lambda each: each.frequency)
    return Poles(
        np.array([each.frequency for each in chosen]),
        np.array([each.ratio for each in chosen]),
        first_delay(responses, chosen),
    )


@dataclass(frozen=True, eq=False)
class _Peak:
    """A peak of a share of the responses."""

    frequency: float
    ratio: float
    height: float
    share: ComplexArray
    rotation: float

    @property
    def width(self) -> float:
        """Half the half-power bandwidth [Hz]."""
        return self.ratio * self.frequency

    @property
    def rotates(self) -> bool:
        """Whether the phase changes as through a resonance, in either direction."""
        return abs(self.rotation) > LEAST_ROTATION


def _shares(responses: FrequencyResponses, length: float | None) -> list[ComplexArray]:
    """Return the responses divided by their noise, separated by shape if possible: a list of (n, n_bins) arrays."""
    white = responses.response / np.sqrt(responses.noise)[:, None, :]
    n_labels = along(responses.places)[0].size * 2 // 3 if responses.places else 0
    if responses.positions is None or length is None or n_labels < FEWEST_LABELS:
        return [white.reshape(-1, white.shape[-1])]
    shapes = mode_shapes(range(1, n_labels + 1), responses.positions, length)
    inverse = np.linalg.pinv(shapes.T)
    # Scale the rows so that the noise of each share has unit variance.
    inverse = inverse / np.linalg.norm(inverse, axis=1)[:, None]
    return list(np.stack([inverse @ each for each in white], axis=1))


def _highest_peak(frequency: FloatArray, share: ComplexArray) -> list[_Peak]:
    """Return the highest peak in the power of a share relative to its noise, if it is significant."""
    power = (np.abs(share) ** 2).mean(axis=0)
    return _found(frequency, share, power, prominence=0.7, least=1 + SIGNIFICANT**2)[:1]


def _several_peaks(responses: FrequencyResponses, share: ComplexArray) -> list[_Peak]:
    """Return all peaks in the power of all responses across which the phase changes as through a resonance."""
    flat = responses.response.reshape(share.shape)
    # All responses have equal weight, independent of their level.
    curve = (np.abs(flat) ** 2 / np.median(np.abs(flat) ** 2, axis=1)[:, None]).mean(axis=0)
    least = 1 + 3 * SIGNIFICANT / np.sqrt(share.shape[0])
    found = _found(responses.frequency, share, curve, prominence=0.9, least=0.0)
    return [peak for peak in found if peak.rotates and peak.height > least]


def _found(
    frequency: FloatArray, share: ComplexArray, curve: FloatArray, *, prominence: float, least: float
) -> list[_Peak]:
    """Return the peaks of a curve, highest first, with a minimum height and a minimum prominence of the logarithm."""
    from scipy.signal import find_peaks, peak_widths

    curve = np.maximum(curve, 1e-12)
    height = np.log(least) if least > 0 else None
    places = find_peaks(np.log(curve), height=height, prominence=prominence)[0]
    if places.size == 0:
        return []
    widths = peak_widths(curve, places, rel_height=0.5)[0]
    power = (np.abs(share) ** 2).mean(axis=0)
    spacing = float(frequency[1] - frequency[0])
    peaks = [
        _Peak(
            frequency=float(frequency[place]),
            ratio=_ratio(float(width), float(frequency[place]), spacing),
            height=float(power[place]),
            share=share,
            rotation=_rotation(share, int(place), max(round(float(width) / 2), 2)),
        )
        for place, width in zip(places, widths, strict=True)
    ]
    return sorted(peaks, key=lambda peak: -peak.height)


def _rotation(share: ComplexArray, place: int, reach: int) -> float:
    """Return the phase change across a peak, from `reach` bins before it to `reach` bins after it [rad]."""
    band = share[:, max(0, place - reach) : place + reach + 1]
    return float(np.angle((np.conj(band[:, :-1]) * band[:, 1:]).sum(axis=0)).sum())


def _ratio(width: float, frequency: float, spacing: float) -> float:
    """Return the damping ratio from a half-power bandwidth in bins."""
    if width < 3:
        # The peak is too narrow for its half-power bandwidth to be used.
        return min(0.01, spacing / frequency)
    return float(np.clip(width * spacing / (2 * frequency), 10 * DAMPING_BOUNDS[0], DAMPING_BOUNDS[1] / 2))


def _rises(responses: FrequencyResponses, peaks: Sequence[_Peak]) -> bool:
    """Return whether the highest peaks are resonances only after conjugation; noise is not a resonance either way.

    A resonance of either sense of rotation and a straight line are fitted around each peak.
    """
    left = np.zeros(2)
    whole = 0.0
    for peak in sorted((each for each in peaks if each.rotates), key=lambda each: -each.height)[:FEWEST_PHASES]:
        width = max(peak.width, responses.spacing)
        near = np.abs(responses.frequency - peak.frequency) <= 6 * width
        x = (responses.frequency[near] - peak.frequency) / width
        share = peak.share[:, near].T
        whole += float((np.abs(share - share.mean(axis=0)) ** 2).sum())
        for sense, sign in enumerate((1, -1)):
            rests = []
            for place, ratio in itertools.product(np.linspace(-1, 1, 9), np.geomspace(0.02, 3, 12)):
                columns = np.stack([1 / (sign * ratio + 1j * (x - place)), np.ones(x.size), x], axis=1)
                basis = np.linalg.qr(columns)[0]
                rests.append(float((np.abs(share - basis @ (basis.conj().T @ share)) ** 2).sum()))
            left[sense] += min(rests)
    falling, rising = left
    return bool(rising < RESONANCE_REST * whole and rising < CLEARLY_LESS * falling)


def first_delay(responses: FrequencyResponses, peaks: Sequence[_Peak]) -> float:
    """Return the delay that makes the responses real at their peaks [s].

    Twice the phase is used, since a shape has both signs. Over a band around a peak, the phases before and after it
    cancel, so its frequency need not be known accurately.
    """
    spacing = responses.spacing
    resolved = [peak for peak in peaks if peak.rotates and 2 * peak.width >= FEWEST_BINS * spacing]
    frequency = np.array([peak.frequency for peak in resolved])
    twice = []
    for peak in resolved:
        low, high = np.searchsorted(responses.frequency, [peak.frequency - peak.width, peak.frequency + peak.width])
        band = slice(max(0, int(low) - 1), int(high) + 1)
        own = peak.share[:, band] / low_pass(responses.frequency[band], responses.bandwidth)
        twice.append(complex((own**2).sum()) / max(float((np.abs(own) ** 2).sum()), 1e-300))
    turning = sum(np.sign(peak.rotation) * np.sqrt(peak.height) for peak in peaks if peak.rotates)
    if turning > 0 and _rises(responses, peaks):
        # Conjugated responses are real at resonance, those with exchanged parts imaginary.
        exchanged = bool(twice) and float(np.mean(np.real(twice[:FEWEST_PHASES]))) < -0.5
        raise ValueError(
            "the phase of the responses rises through their resonances, but that of a beam falls: "
            + (
                "their real and imaginary parts are exchanged; export them again"
                if exchanged
                else "they are conjugated, as if they followed exp(-i w t); say so with --conjugated, or export them "
                "with exp(+i w t)"
            )
        )
    if not resolved:
        return 0.0
    # Delays beyond half a cycle of the lowest frequency are ambiguous; the step is a sixteenth of one of the highest.
    step = 1 / (16 * frequency.max())
    reach = min(0.5 / frequency.min(), 200e-6 + 1 / frequency.max())
    tried = np.arange(-0.2 * reach, reach, step)
    score = (np.exp(4j * np.pi * np.outer(tried, frequency)) @ np.array(twice)).real
    # The phases of a free decay are arbitrary.
    certain = frequency.size >= FEWEST_PHASES and not any(DECAY in mark for mark in responses.marks)
    if certain and -score.min() > score.max() + WRONG_QUANTITY * frequency.size:
        raise ValueError(
            "the responses are imaginary at their resonances, but those of a velocity are real: they show a "
            "displacement or an acceleration; say which with --quantity"
        )
    good = np.flatnonzero(score >= 0.97 * score.max())
    return float(tried[good[np.abs(tried[good]).argmin()]])
