"""Bursts that are triggered one by one: the order for them, the pacer that triggers and counts them, and its report.

`LocalClient` plays them in virtual time, without a process of its own.
"""

from __future__ import annotations

import threading
import typing
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from modaltouch.rig.link import Transport, describe_error
from modaltouch.rig.visa import VisaSession
from modaltouch.system import Clock, VirtualClock

LATEST = 0.05
"""A burst that would come later than this fraction of the period is dropped [1]."""

LEASE = 0.18
"""A burst is dropped if the client has sent no heartbeat for this long [s]."""

PATIENCE = 1.0
"""After this long without a heartbeat no further burst is played at all [s]."""

ALERT = 0.02
"""For this long before a burst the pacer waits for its instant alone, and is not woken by a call of `end` [s]."""

HELD_UP = 0.05
"""A failure is not blamed on the instrument if a process was stalled for longer than this [s]."""

Ending = Literal["", "count", "asked", "stalled", "failed"]


@dataclass(frozen=True)
class Order:
    """Bursts to be played.

    Attributes
    ----------
    command : str
        Command that triggers one burst.
    n_bursts : int
        Highest number of bursts.
    first : float
        When the first burst is due, by the machine's monotonic clock [s].
    period : float
        Time from one burst to the next [s].
    duration : float
        Duration of one burst [s].
    timeout : float
        Longest wait for the instrument to accept a trigger [s].
    """

    command: str
    n_bursts: int
    first: float
    period: float
    duration: float
    timeout: float

    @property
    def tolerance(self) -> float:
        """How late a burst may begin without disturbing the rhythm or running into the next burst [s]."""
        return min(LATEST * self.period, self.period - self.duration)


@dataclass
class Report:
    """What became of an order.

    Attributes
    ----------
    due, played, dropped : int
        Numbers of bursts that were due, whose trigger was accepted, and that were dropped because they would have come
        too late, or because the client had sent no heartbeat.
    first, last : (sent, accepted) of float or None
        When the triggers of the first and the last burst were sent, and accepted by the instrument [s].
    latest : float
        Longest delay of a trigger that was sent [s].
    ended : str
        Why it ended: ``count`` (all bursts were due), ``asked``, ``stalled`` (the client sent no heartbeat) or
        ``failed``; empty until then.
    reason : str
        How it failed.
    """

    due: int = 0
    played: int = 0
    dropped: int = 0
    first: tuple[float, float] | None = None
    last: tuple[float, float] | None = None
    latest: float = 0.0
    ended: Ending = ""
    reason: str = ""

    @property
    def lost(self) -> str:
        """Why the bursts ended without a request; empty while all is well."""
        return f"{self.ended}: {self.reason}" if self.ended in ("stalled", "failed") else ""


class BurstPlayer(Transport, typing.Protocol):
    """The watchdog as the driver uses it: holds the transport, plays bursts, and switches off if the driver cannot."""

    def arm(self, *, free_running: bool) -> None:
        """Note that outputs may be on from now on; `free_running`: what they play does not end without a command."""

    def beat(self) -> str:
        """Note that the session is alive; return why the bursts ended without a request, empty while all is well."""

    def play(self, order: Order) -> Report:
        """Begin to play bursts; return the report once it is known whether the first was played."""

    def look(self) -> Report:
        """Return the report so far."""

    def end(self) -> None:
        """Trigger no further burst."""

    def report(self, *, wait: bool) -> Report:
        """Trigger no further burst, and return the report; with `wait`, once the last burst is over."""

    def held_up(self) -> float:
        """Return the longest stall of this process, or of the one that paces the bursts, since `arm` [s]."""

    def disarm(self) -> None:
        """Note that the outputs are off."""

    def release(self, *, clean: bool) -> None:
        """Release the watchdog; unless `clean`, it switches the outputs off first."""


class Pacer:
    """Triggers bursts one by one; a late burst is dropped, and none is repeated or made up for later.

    Parameters
    ----------
    order : Order
        Bursts to be played.
    trigger : callable
        Sends the command and returns once the instrument has accepted it; whatever it raises ends the order.
    silence : callable
        Returns the time since the client's last heartbeat [s].
    clock : Clock
        Clock of the pacer.
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
        """When the next burst is due [s]; None once the order has ended."""
        if self.report.ended:
            return None
        return self.order.first + self.report.due * self.order.period

    @property
    def silent_from(self) -> float:
        """When the last burst that was triggered ends [s]."""
        return self.report.last[1] + self.order.duration if self.report.last else self.order.first

    def end(self) -> None:
        """Trigger no further burst."""
        self._asked_to_end.set()

    def close(self) -> None:
        """Trigger no further burst, if no thread `run`s the pacer."""
        self.end()
        self._end_if_over()

    def step(self) -> None:
        """Trigger the burst that is due now, and drop those that are overdue."""
        report, order = self.report, self.order
        due = self.due
        # Every overdue burst is dropped, even if the end was requested meanwhile: it was due before that.
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
            report.ended, report.reason = "failed", f"trigger {report.due} failed ({describe_error(error)})"
            return
        taken = self._clock.now()
        report.played += 1
        report.first, report.last = report.first or (sent, taken), (sent, taken)
        report.latest = max(report.latest, sent - due)
        if taken - due > order.period / 2:
            # The burst may have begun at any instant in this time: the rhythm was not kept, so no count is claimed.
            report.ended = "failed"
            report.reason = f"trigger {report.due} was accepted {(taken - due) * 1e3:.0f} ms after it was due"
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

    def run(self, on_first: Callable[[], None]) -> None:
        """Play all bursts; `on_first` is called as soon as it is known whether the first was played."""
        reported = False
        while (due := self.due) is not None:
            left = due - self._clock.now()
            if left > ALERT:
                # The end may be requested meanwhile, or heartbeats may stop. Windows ends such a wait up to 16 ms late.
                self._asked_to_end.wait(min(left - ALERT, 0.05))
            else:
                self._clock.sleep(left)
            self.step()
            if not reported and (self.report.due or self.report.ended):
                reported = True
                on_first()


ROUNDING = 1e-9
"""Rounding error of a sum of virtual times [s]."""


class LocalClient:
    """A watchdog client in virtual time, which plays bursts without a process of its own.

    It cannot outlive its process, and is therefore only for a twin in that same process.

    Parameters
    ----------
    transport : VisaSession
        Transport to the instrument.
    clock : VirtualClock
        Clock of the session.
    """

    def __init__(self, transport: VisaSession, clock: VirtualClock) -> None:
        self._transport = transport
        self._clock = clock
        self._pacer: Pacer | None = None
        self.open, self.exchange, self.close = transport.open, transport.exchange, transport.close

    def arm(self, *, free_running: bool) -> None:
        """Do nothing: no other process watches this one."""

    def held_up(self) -> float:
        """Return 0: in virtual time nothing stalls."""
        return 0.0

    def disarm(self) -> None:
        """Do nothing."""

    def beat(self) -> str:
        """Return why the bursts ended without a request; empty while all is well."""
        return self.look().lost

    def play(self, order: Order) -> Report:
        """Schedule bursts, and let time pass until the first is played; return the report at that time."""
        message = order.command.encode() + b"\n"
        pacer = self._pacer = Pacer(
            order,
            lambda: self._transport.exchange(message, timeout=order.timeout, reply=False),
            lambda: 0.0,
            self._clock,
        )

        def step() -> None:
            pacer.step()
            if pacer.due is not None:
                self._clock.call_at(pacer.due, step)

        self._clock.call_at(order.first, step)
        self._clock.sleep(order.first - self._clock.now() + ROUNDING)
        return pacer.report

    def look(self) -> Report:
        """Return the report so far."""
        return self._pacer.report if self._pacer is not None else Report()

    def end(self) -> None:
        """Trigger no further burst."""
        if self._pacer is not None:
            self._pacer.end()

    def report(self, *, wait: bool) -> Report:
        """Trigger no further burst, and return the report; with `wait`, once the last burst is over."""
        if self._pacer is None:
            return Report()
        self._pacer.close()
        if wait:
            self._clock.sleep(self._pacer.silent_from - self._clock.now())
        return self._pacer.report

    def release(self, *, clean: bool) -> None:
        """End the session with the instrument."""
        self._transport.release()
