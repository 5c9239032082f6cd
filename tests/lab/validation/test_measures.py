"""Widths, durations, contrast and spectrogram, against closed forms."""

import math

import numpy as np
import pytest

from modaltouch.lab.validation.evidence import contrast, spot_width
from modaltouch.lab.validation.key_figures import spectrogram


@pytest.mark.parametrize("fraction", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_width_of_a_triangle(fraction, sign):
    """A base b is b (1 - fraction) wide, for either sign, also if its centre is not a sampled point."""
    place = np.linspace(-0.05, 0.05, 78)
    field = sign * 0.2 * np.maximum(0, 1 - np.abs(place - 0.003) / 0.028)
    place, field = np.append(place, 0.003), np.append(field, sign * 0.2)
    order = np.argsort(place)
    width = spot_width(place[order], field[order], 0.003, fraction)
    # Straight lines between points 1.3 mm apart are exact on a triangle, but for where it reaches zero.
    assert width == pytest.approx(0.056 * (1 - fraction), rel=1e-9)


def test_a_field_that_never_falls_is_as_wide_as_the_beam():
    """From end to end."""
    assert spot_width(np.linspace(-0.05, 0.05, 11), np.ones(11), 0.0, 0.5) == pytest.approx(0.1)


def test_a_field_without_a_focus_has_no_width():
    """NaN instead of a number."""
    assert math.isnan(spot_width(np.linspace(-1, 1, 5), np.zeros(5), 0.0, 0.5))


def test_the_duration_of_a_cosine_above_nine_tenths():
    """cos(w t) > 0.9 for |t| < arccos(0.9) / w; later crests do not count."""
    time, omega = np.linspace(-1e-4, 1e-4, 20_001), 2 * np.pi * 29_390
    assert spot_width(time, np.cos(omega * time), 0.0, 0.9) == pytest.approx(2 * math.acos(0.9) / omega, rel=1e-5)


def test_contrast_is_the_faster_over_the_slower():
    """In either order; infinite beside a zone at rest."""
    assert contrast(0.2, -0.1) == contrast(-0.1, 0.2) == 2.0
    assert contrast(0.2, 0.0) == math.inf


def test_the_spectrogram_of_a_sine():
    """A steady sine of 0.05 m/s has this amplitude at its frequency and none an octave away."""
    time = np.arange(50_000) / 1e6
    _, frequency, amplitude = spectrogram(time, 0.05 * np.sin(2 * np.pi * 7137 * time), 20e3)
    row = np.unravel_index(amplitude.argmax(), amplitude.shape)[0]
    assert frequency[row] == pytest.approx(7137, abs=63)
    assert amplitude.max() == pytest.approx(0.05, rel=0.01)
    assert amplitude[np.abs(frequency - 14_274) < 100].max() < 1e-5
    assert frequency[-1] <= 20e3


def test_the_spectrogram_of_a_short_record_has_one_window():
    """Instead of an empty picture."""
    time = np.arange(1000) / 1e6
    middle, frequency, amplitude = spectrogram(time, 0.05 * np.sin(2 * np.pi * 7137 * time), 20e3)
    assert amplitude.shape == (frequency.size, middle.size) == (81, 1)
    assert amplitude.max() == pytest.approx(0.05, rel=0.01)
