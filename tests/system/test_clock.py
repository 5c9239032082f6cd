"""The clock behind every time in a record, measured, and the verdict's words."""

from __future__ import annotations

from dataclasses import replace

import pytest

from modaltouch.system.clock_timing import ClockTiming, measure_clock

GOOD = ClockTiming("clock_gettime(CLOCK_MONOTONIC)", True, 1e-7, 1.06e-3, 1.1e-3, 2e-3, 3.0)


def test_the_clock_of_this_machine_only_goes_forward() -> None:
    """Expected: monotonic, in steps below 10 us, and no wait of a millisecond is shorter than that."""
    measured = measure_clock(30)
    assert measured.is_monotonic
    assert 0 < measured.step < 1e-5
    assert 1e-3 <= measured.wait_median <= measured.wait_p95 <= measured.wait_max
    assert measured.as_dict()["wait_median_ms"] == pytest.approx(measured.wait_median * 1e3)


def test_what_a_person_should_do_is_said() -> None:
    """Each fault has its remedy; a good clock has none."""
    assert GOOD.verdict == "A wait of 1 ms takes 1.06 ms, 95 % of them under 1.1 ms: good."
    assert "switch power saving off" in replace(GOOD, wait_p95=0.012).verdict
    assert "use another machine" in replace(GOOD, is_monotonic=False).verdict
    assert "steps by 16 ms" in replace(GOOD, step=0.016).verdict
    assert "wait some minutes" in replace(GOOD, drift_ppm=-900.0).verdict
