"""Measuring the clock that times every record, and the verdict on it."""

from __future__ import annotations

from modaltouch.system.timing import assess_clock, measure_clock

GOOD = {"name": "clock_gettime(CLOCK_MONOTONIC)", "is_monotonic": True, "drift_ppm": 3.0, "step_ms": 1e-4}
GOOD |= {"wait_median_ms": 1.06, "wait_p95_ms": 1.1, "wait_max_ms": 2.0}


def test_the_clock_of_this_machine_is_monotonic() -> None:
    """It advances in steps below 10 us, and no wait of a millisecond is shorter than that."""
    measured, verdict = measure_clock(30)
    assert measured["is_monotonic"]
    assert 0 < measured["step_ms"] < 1e-2
    assert 1 <= measured["wait_median_ms"] <= measured["wait_p95_ms"] <= measured["wait_max_ms"]
    assert verdict == assess_clock(measured)


def test_each_clock_fault_has_a_remedy() -> None:
    """A good clock has no remedy."""
    assert assess_clock(GOOD) == "A wait of 1 ms takes 1.06 ms, 95 % of them under 1.1 ms: good."
    assert "switch power saving off" in assess_clock(GOOD | {"wait_p95_ms": 12.0})
    assert "use another machine" in assess_clock(GOOD | {"is_monotonic": False})
    assert "steps by 16 ms" in assess_clock(GOOD | {"step_ms": 16.0})
    assert "wait a few minutes" in assess_clock(GOOD | {"drift_ppm": -900.0})
