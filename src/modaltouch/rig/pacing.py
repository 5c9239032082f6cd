"""Bursts triggered one by one: the order, the pacer that triggers and counts them, and its report."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from modaltouch.rig.interface import describe_error
from modaltouch.system import Clock

LATEST = 0.05
"""Delay above which a burst is dropped, as a fraction of the period [1]."""

LEASE = 0.18
"""Time without a heartbeat of the client after which bursts are dropped [s]."""

PATIENCE = 1.0
"""Time without a heartbeat after which no further bursts are played [s]."""

ALERT = 0.02
"""Time before a burst during which the pacer only waits for its instant, without reacting to `end` [s]."""

HELD_UP = 0.05
"""Stall of a process above which a failure is not attributed to the instrument [s]."""

MOST_AWAITED = 5
"""Number of bursts within which a stimulus must start: it begins with the first burst that is not dropped."""

Ending = Literal["", "count", "asked", "stalled", "failed"]


@dataclass(frozen=True)
class Order:
    """Bursts to be played."""

    command: str
    n_bursts: int
    first: float  # due instant of the first burst, on the machine's monotonic clock [s]
    period: float  # time from one burst to the next [s]
    duration: float  # duration of one burst [s]
    timeout: float  # longest wait for the instrument to accept a trigger [s]

    @property
    def tolerance(self) -> float:
        """Largest delay of a burst that neither disturbs the rhythm nor overlaps the next burst [s]."""
        return min(LATEST * self.period, self.period - self.duration)


@dataclass
class Report:
    """Outcome of an order."""

    # due, played, dropped: number of bursts due, of triggers accepted, and of bursts dropped because they would have
    # been too late or the client had sent no heartbeat
    due: int = 0
    played: int = 0
    dropped: int = 0
    # first, last: instants at which the trigger of the first or the last burst was sent, and accepted [s]
    first: tuple[float, float] | None = None
    last: tuple[float, float] | None = None
    # why it ended: ``count`` (all bursts were due), ``asked``, ``stalled`` (no heartbeat) or ``failed``; else empty
    ended: Ending = ""
    reason: str = ""

    @property
    def lost(self) -> str:
        """Reason why the bursts ended without a request; empty if they did not."""
        return f"{self.ended}: {self.reason}" if self.ended in ("stalled", "failed") else ""


class Pacer:
    """Trigger bursts one by one; late bursts are dropped and never caught up.

    `trigger` sends the command and returns when the instrument has accepted it; any exception ends the order. `silence`
    returns the time since the client's last heartbeat [s].
    """

    def __init__(self, order: Order, trigger: Callable[[], object], silence: Callable[[], float], clock: Clock) -> None:
        self.order = order
        self.report = Report()
        self._trigger = trigger
        self._silence = silence
        self._clock = clock
        self._asked_to_end = threading.Event()

    @property
    def due(self) -> float | None:
        """Due instant of the next burst [s]; None after the end of the order."""
        if self.report.ended:
            return None
        return self.order.first + self.report.due * self.order.period

    @property
    def silent_from(self) -> float:
        """End of the last burst triggered [s]."""
        return self.report.last[1] + self.order.duration if self.report.last else self.order.first

    def end(self) -> None:
        """Trigger no further burst."""
        self._asked_to_end.set()

    def step(self) -> None:
        """Trigger the burst due now, and drop overdue ones."""
        report, order = self.report, self.order
        due = self.due
        # Every overdue burst is dropped, even if the end was requested meanwhile, as it was due before that.
        while due is not None and report.due < order.n_bursts and self._clock.now() > due + order.tolerance:
            report.due += 1
            report.dropped += 1
            due = self.due
        self._end_if_over()
        if report.ended or due is None or self._clock.now() < due:
            return
        report.due += 1
        if self._silence() > LEASE:
            report.dropped += 1
            self._end_if_over()
            return
        sent = self._clock.now()
        try:
            self._trigger()
        # Backends raise VisaIOError, OSError, ValueError and plain Exception.
        except Exception as error:
            # A heartbeat, answered meanwhile, reports the reason as soon as it is ended.
            report.reason, report.ended = f"trigger {report.due} failed ({describe_error(error)})", "failed"
            return
        taken = self._clock.now()
        report.played += 1
        report.first, report.last = report.first or (sent, taken), (sent, taken)
        if taken - due > order.period / 2:
            # The burst may have begun at any instant in this interval: the rhythm was not kept, so no count is claimed.
            report.reason = f"trigger {report.due} was accepted {(taken - due) * 1e3:.0f} ms after it was due"
            report.ended = "failed"
        self._end_if_over()

    def _end_if_over(self) -> None:
        report = self.report
        if report.ended:
            return
        if report.due >= self.order.n_bursts:
            report.ended = "count"
        elif self._asked_to_end.is_set():
            report.ended = "asked"
        elif self._silence() > PATIENCE:
            report.ended = "stalled"

    def run(self) -> None:
        """Play all bursts."""
        while (due := self.due) is not None:
            left = due - self._clock.now()
            if left > ALERT:
                # The end may be requested meanwhile, or heartbeats may stop. On Windows this wait may overrun by 16 ms.
                self._asked_to_end.wait(min(left - ALERT, 0.05))
            else:
                self._clock.sleep(left)
            self.step()
