"""The lowest lines of a recording's spectrum, against NumPy's transform of the whole."""

from __future__ import annotations

import numpy as np
import pytest

from modaltouch.lab.identification.excitation import low_lines


@pytest.mark.parametrize(
    ("n_samples", "n_lines"), [(8192, 300), (8192, 600), (8192, 1500), (8192, 4096), (6250, 700), (2**10 + 1, 512)]
)
def test_the_lowest_lines_are_those_of_the_whole_transform(n_samples: int, n_lines: int) -> None:
    """In eight, four, two parts or one, as divides the record: to single precision."""
    record = np.random.default_rng(n_samples + n_lines).standard_normal(n_samples)
    whole = np.fft.rfft(record)[1 : n_lines + 1]
    assert np.abs(low_lines(record, n_lines) - whole).max() < 1e-6 * np.abs(whole).max()
