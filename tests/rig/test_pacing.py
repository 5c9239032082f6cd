"""Bursts triggered one by one in virtual time: a late burst is dropped, and a failed trigger is never repeated."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modaltouch.rig.pacing import LATEST, LEASE, PATIENCE, Order, Pacer, Report
from modaltouch.rig.simulator import LocalClient
from modaltouch.rig.simulator.common import Reply
from modaltouch.system.clock import SYSTEM_CLOCK, VirtualClock

PERIOD = 1 / 7
ORDER = Order("TRIG:SEQ:IMM", n_bursts=14, first=10.0, period=PERIOD, duration=0.05, timeout=0.1)


class Beam:
    """Record the instants of triggers; the n-th one may take time or fail."""

    def __init__(self, clock: VirtualClock, *, takes: dict[int, float] | None = None, fails_at: int = 0) -> None:
        self.clock = clock
        self.takes = takes or {}
        self.fails_at = fails_at
        self.triggered: list[float] = []

    def trigger(self) -> None:
        self.triggered.append(self.clock.now())
        self.clock.sleep(self.takes.get(len(self.triggered), 0.0))
        if len(self.triggered) == self.fails_at:
            raise TimeoutError("no reply")


def play(pacer: Pacer, clock: VirtualClock, *, stalls: dict[int, float] | None = None) -> None:
    """Step a pacer to its end; before the n-th burst the computer is delayed by some seconds."""
    number = 0
    while (due := pacer.due) is not None:
        number += 1
        clock.sleep(max(due - clock.now(), 0.0) + 1e-9 + (stalls or {}).get(number, 0.0))
        pacer.step()


def test_bursts_are_triggered_one_period_apart() -> None:
    """Fourteen triggers at 10 s + k/7 s, all counted, and none after them."""
    clock = VirtualClock(9.9)
    beam = Beam(clock)
    pacer = Pacer(ORDER, beam.trigger, lambda: 0.0, clock)
    play(pacer, clock)
    assert beam.triggered == pytest.approx([10 + k * PERIOD for k in range(14)], abs=1e-6)
    report = pacer.report
    assert (report.due, report.played, report.dropped, report.ended) == (14, 14, 0, "count")
    assert report.first == pytest.approx((10.0, 10.0), abs=1e-6)
    assert pacer.silent_from == pytest.approx(10 + 13 * PERIOD + 0.05, abs=1e-6)


@given(st.dictionaries(st.integers(1, 14), st.floats(0, 2.0), max_size=5))
def test_no_burst_is_late_by_over_5_percent_or_made_up_later(stalls: dict[int, float]) -> None:
    """For any delays of the computer: each trigger within 5 % of its own instant; due = played + dropped."""
    clock = VirtualClock(9.9)
    beam = Beam(clock)
    pacer = Pacer(ORDER, beam.trigger, lambda: 0.0, clock)
    play(pacer, clock, stalls=stalls)
    phases = [(instant - 10.0) % PERIOD for instant in beam.triggered]
    assert all(min(phase, PERIOD - phase) <= LATEST * PERIOD + 1e-6 for phase in phases)
    gaps = [b - a for a, b in zip(beam.triggered, beam.triggered[1:], strict=False)]
    assert all(gap >= ORDER.duration for gap in gaps), "no trigger within a burst"
    assert pacer.report.due == pacer.report.played + pacer.report.dropped == 14
    assert pacer.report.played == len(beam.triggered)


def test_a_short_pause_between_bursts_reduces_the_tolerance() -> None:
    """A burst of 140 ms in 142.9 ms may be 2.9 ms late, not 7.1 ms: it must not overlap the next one."""
    assert replace(ORDER, duration=0.14).tolerance == pytest.approx(PERIOD - 0.14)
    assert ORDER.tolerance == pytest.approx(0.05 * PERIOD)


def test_no_trigger_follows_a_failed_one() -> None:
    """It is unknown whether that burst was played: no second attempt, no further burst."""
    clock = VirtualClock(9.9)
    beam = Beam(clock, fails_at=3)
    pacer = Pacer(ORDER, beam.trigger, lambda: 0.0, clock)
    play(pacer, clock)
    assert len(beam.triggered) == 3
    assert pacer.report.ended == "failed"
    assert pacer.report.reason == "trigger 3 failed (TimeoutError: no reply)"


def test_a_trigger_accepted_far_too_late_ends_the_stimulus() -> None:
    """Accepted half a period late or more, it may have been played at any time: the rhythm is lost."""
    clock = VirtualClock(9.9)
    pacer = Pacer(ORDER, Beam(clock, takes={5: 0.08}).trigger, lambda: 0.0, clock)
    play(pacer, clock)
    assert pacer.report.ended == "failed"
    assert pacer.report.reason == "trigger 5 was accepted 80 ms after it was due"


@pytest.mark.parametrize(
    ("silence", "n_played", "ended"), [(0.1, 14, "count"), (0.5, 12, "count"), (9.0, 3, "stalled")]
)
def test_bursts_are_dropped_while_no_heartbeat_arrives(silence: float, n_played: int, ended: str) -> None:
    """No heartbeat from 10.3 s on: bursts more than 0.18 s later are dropped, and after one second no more follow."""
    clock = VirtualClock(9.9)
    beam = Beam(clock)

    def quiet() -> float:
        return clock.now() - 10.3 if 10.3 < clock.now() < 10.3 + silence else 0.0

    pacer = Pacer(ORDER, beam.trigger, quiet, clock)
    play(pacer, clock)
    assert len(beam.triggered) == pacer.report.played
    assert pacer.report.ended == ended
    assert pacer.report.played == (4 if ended == "stalled" else n_played)


def test_dropped_bursts_are_counted_if_the_end_is_requested_meanwhile() -> None:
    """Delayed from 10.3 to 11.1 s with the end requested in between: three were played, five were due and dropped."""
    clock = VirtualClock(10.0)
    pacer = Pacer(ORDER, Beam(clock).trigger, lambda: 0.0, clock)
    for _ in range(3):
        pacer.step()
        clock.sleep(PERIOD + 1e-9)
    clock.sleep(11.1 - clock.now())
    pacer.end()
    pacer.step()
    report = pacer.report
    assert (report.due, report.played, report.dropped, report.ended) == (8, 3, 5, "asked")


def test_an_order_that_arrives_too_late_plays_nothing() -> None:
    """A request that waited in a pipe until all its instants had passed: all bursts are dropped."""
    clock = VirtualClock(20.0)
    beam = Beam(clock)
    pacer = Pacer(ORDER, beam.trigger, lambda: 0.0, clock)
    pacer.step()
    assert beam.triggered == []
    assert (pacer.report.due, pacer.report.dropped, pacer.report.ended) == (14, 14, "count")


@pytest.mark.parametrize(
    ("late", "n_played", "n_dropped"), [(0.0, 1, 0), (0.025, 1, 0), (0.0251, 0, 1), (0.475, 0, 1), (0.5, 1, 1)]
)
def test_a_burst_is_played_only_within_its_tolerance(late: float, n_played: int, n_dropped: int) -> None:
    """At its instant or up to a twentieth of 0.5 s later; after that the pacer waits for the next one."""
    clock = VirtualClock(10.0 + late)
    pacer = Pacer(replace(ORDER, period=0.5), Beam(clock).trigger, lambda: 0.0, clock)
    pacer.step()
    assert (pacer.report.played, pacer.report.dropped, pacer.report.ended) == (n_played, n_dropped, "")


@pytest.mark.parametrize(("takes", "ended"), [(0.2, ""), (0.25, ""), (0.26, "failed")])
def test_a_trigger_may_be_accepted_up_to_half_a_period_late(takes: float, ended: str) -> None:
    """The limit is 0.25 s at a period of 0.5 s."""
    clock = VirtualClock(10.0)
    pacer = Pacer(replace(ORDER, period=0.5), Beam(clock, takes={1: takes}).trigger, lambda: 0.0, clock)
    pacer.step()
    assert pacer.report.ended == ended


@pytest.mark.parametrize(
    ("silence", "n_bursts", "counts"),
    [
        (LEASE, 14, (1, 1, 0, "")),
        (LEASE + 1e-6, 14, (1, 0, 1, "")),
        (LEASE + 1e-6, 1, (1, 0, 1, "count")),
        (PATIENCE, 14, (1, 0, 1, "")),
        (PATIENCE + 1e-6, 14, (0, 0, 0, "stalled")),
    ],
)
def test_limits_on_the_time_without_a_heartbeat(
    silence: float, n_bursts: int, counts: tuple[int, int, int, str]
) -> None:
    """Over 0.18 s the burst that is due is dropped; over 1 s the stimulus ends."""
    clock = VirtualClock(10.0)
    pacer = Pacer(replace(ORDER, n_bursts=n_bursts), Beam(clock).trigger, lambda: silence, clock)
    pacer.step()
    report = pacer.report
    assert (report.due, report.played, report.dropped, report.ended) == counts


class Waits:
    """Replace the pacer's event: virtual time passes, and the end is requested at a given instant."""

    def __init__(self, clock: VirtualClock, asks_at: float) -> None:
        self.clock = clock
        self.asks_at = asks_at
        self.longest = 0.0

    def is_set(self) -> bool:
        return self.clock.now() >= self.asks_at

    def wait(self, seconds: float) -> bool:
        self.longest = max(self.longest, seconds)
        self.clock.sleep(min(seconds, max(self.asks_at - self.clock.now(), 0.0)))
        return self.is_set()


@pytest.mark.parametrize(
    ("asks_at", "silent_at", "ended", "at"),
    [
        (20.03, 99.0, "asked", 20.03),
        (99.0, 20.03, "stalled", 21.03),
        (99.0, 99.0, "count", 30.0),
        (9.95, 99, "asked", 9.95),
    ],
)
def test_the_pacer_ends_on_request_without_heartbeat_or_when_done(
    asks_at: float, silent_at: float, ended: str, at: float
) -> None:
    """Bursts at 10, 20 and 30 s: it ends promptly, not at the next burst."""
    clock = VirtualClock(9.87)
    order = replace(ORDER, n_bursts=3, period=10.0)
    pacer = Pacer(order, Beam(clock).trigger, lambda: max(clock.now() - silent_at, 0.0), clock)
    pacer._asked_to_end = waits = Waits(clock, asks_at)
    pacer.run()
    assert pacer.report.ended == ended
    assert clock.now() == pytest.approx(at, abs=0.06)
    assert waits.longest <= 0.05


class Ticks(Waits):
    """The same on Windows, where a wait ends at a tick of the system timer (64 per second)."""

    def wait(self, seconds: float) -> bool:
        end = math.ceil((self.clock.now() + seconds) * 64) / 64
        return super().wait(end - self.clock.now())


def test_coarse_system_timer_ticks_do_not_delay_bursts() -> None:
    """15.6 ms exceeds the tolerance of a burst: the last part of each wait is slept, which is precise on Windows."""
    clock = VirtualClock(9.87)
    beam = Beam(clock)
    pacer = Pacer(ORDER, beam.trigger, lambda: 0.0, clock)
    pacer._asked_to_end = Ticks(clock, asks_at=99.0)
    pacer.run()
    assert (pacer.report.played, pacer.report.dropped) == (14, 0)
    assert beam.triggered == pytest.approx([10.0 + n * PERIOD for n in range(14)], abs=1e-6)


def test_a_step_after_the_end_only_ends_a_pacer() -> None:
    """No burst follows, even if one is due."""
    clock = VirtualClock(10.0)
    beam = Beam(clock)
    pacer = Pacer(ORDER, beam.trigger, lambda: 0.0, clock)
    pacer.end()
    pacer.step()
    assert pacer.report.ended == "asked"
    assert pacer.due is None
    assert beam.triggered == []


def test_no_burst_follows_a_request_to_end() -> None:
    """Requested between two bursts: only those triggered by then count."""
    order = replace(ORDER, first=SYSTEM_CLOCK.now(), period=0.02, duration=0.01, n_bursts=1_000_000)
    triggered: list[float] = []
    played = threading.Event()
    pacer = Pacer(order, lambda: triggered.append(SYSTEM_CLOCK.now()) or played.set(), lambda: 0.0, SYSTEM_CLOCK)
    thread = threading.Thread(target=pacer.run)
    thread.start()
    assert played.wait(10)
    pacer.end()
    thread.join(10)
    assert pacer.report.ended == "asked"
    assert pacer.report.played == len(triggered) >= 1


def test_bursts_of_a_twin_are_played_in_virtual_time() -> None:
    """`play` returns with the first burst; the others follow as time passes, and none after the last or the end."""
    clock, sent = VirtualClock(9.5), []

    def execute(message: bytes) -> Reply:
        sent.append((message, clock.now()))
        return Reply()

    instrument: Any = SimpleNamespace(n_starts=0, execute=execute)
    client = LocalClient(instrument, clock)
    assert (client.report(wait=True), client.held_up()) == (Report(), 0.0)
    report = client.play(replace(ORDER, n_bursts=3))
    assert (report.played, clock.now()) == (1, pytest.approx(10.0, abs=1e-6))
    clock.sleep(1.0)
    assert (client.look().played, client.look().ended) == (3, "count")
    assert [message for message, _ in sent] == [b"TRIG:SEQ:IMM\n"] * 3
    assert [instant for _, instant in sent] == pytest.approx([10 + k * PERIOD for k in range(3)], abs=1e-6)
    client.play(replace(ORDER, first=clock.now() + 1))
    report = client.report(wait=True)
    assert (report.played, report.ended) == (1, "asked")
    clock.sleep(1.0)
    assert len(sent) == 4
