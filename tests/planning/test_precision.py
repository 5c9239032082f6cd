"""Widths by the thousand, against the intervals of the analysis one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from modaltouch.analysis.intervals import clopper_pearson, clustered_difference, paired_mean
from modaltouch.planning.questions import difference_width, share_width, slope_width, tango_width

N_ANSWERS = 6


@settings(max_examples=40, deadline=None)
@given(arrays(np.int64, st.tuples(st.just(2), st.integers(1, 12)), elements=st.integers(0, N_ANSWERS // 2)))
def test_widths_of_differences_equal_the_analysis(counts: np.ndarray) -> None:
    """Expected: half of high less low of `clustered_difference`, constant answers included."""
    interval = clustered_difference(counts[0], counts[1], N_ANSWERS)
    expected = (interval.high - interval.low) / 2
    assert difference_width(counts[:1], counts[1:], N_ANSWERS)[0] == pytest.approx(expected, abs=1e-7)


def test_widths_of_slopes_equal_the_analysis() -> None:
    """Expected: `paired_mean` of the slopes at their largest size, as question b prints it."""
    levels = np.array([80.0, 100.0, 150.0, 200.0])
    shares = np.random.default_rng(1).integers(0, 3, (5, 9, 4)) / 2
    centred = levels - levels.mean()
    weights = 100 * centred / (centred**2).sum()
    steepest = weights[weights > 0].sum()
    intervals = [paired_mean(rows @ weights, steepest) for rows in shares]
    expected = [(interval.high - interval.low) / 2 * steepest for interval in intervals]
    assert slope_width(shares, levels.tolist()) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("n", [0, 1, 10])
def test_widths_of_shares_equal_the_analysis(n: int) -> None:
    """Expected: Clopper and Pearson's interval for every count, none out of none included."""
    counts = np.arange(n + 1)
    intervals = [clopper_pearson(k, n) for k in counts]
    expected = [(interval.high - interval.low) / 2 for interval in intervals]
    assert share_width(counts, np.full(n + 1, n)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("n", "half_width"), [(10, 0.278), (20, 0.161), (35, 0.099), (50, 0.071)])
def test_without_discordance_the_width_is_in_closed_form(n: int, half_width: float) -> None:
    """Expected: z^2 / (n + z^2), the figures of the statistics plan, section 3."""
    assert tango_width(np.zeros(1), np.zeros(1), n)[0] == pytest.approx(half_width, abs=5e-4)
