"""Single bursts, each asked for at its instant: what is ordered, of whom, the pacer that counts them, its report.

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
"""A burst that would come later than this part of the period is left out [1]."""

LEASE = 0.18
"""A burst is left out if whoever ordered it has given no sign of life for this long [s]."""

PATIENCE = 1.0
"""After this long without a sign of life no further burst is played at all [s]."""

ALERT = 0.02
"""From so long before a burst on, its instant is waited for and nothing else [s]."""

HELD_UP = 0.05
"""What fails while a process comes round later than by this is not held against the instrument [s]."""

Ending = Literal["", "count", "asked", "stalled", "failed"]


@dataclass(frozen=True)
class Order:
    """Bursts to be played.

    Attributes
    ----------
    command : str
        What triggers one burst.
    n_bursts : int
        How many at most.
    first : float
        When the first is due, by the machine's monotonic clock [s].
    period : float
        From one to the next [s].
    duration : float
        Of one burst [s].
    timeout : float
        Longest wait for the instrument to take a trigger [s].
    """

    command: str
    n_bursts: int
    first: float
    period: float
    duration: float
    timeout: float

    @property
    def tolerance(self) -> float:
        """How late a burst may begin, so that rhythm and burst are whole [s]."""
        return min(LATEST * self.period, self.period - self.duration)


@dataclass
class Report:
    """What became of an order.

    Attributes
    ----------
    due, played, dropped : int
        Bursts that were due, whose trigger was taken, and that were left out because they would have come too late, or
        nobody was known to want them.
    first, last : (sent, taken) of float or None
        When the trigger of the first and of the last burst was sent, and taken by the instrument [s].
    latest : float
        Worst delay of a trigger that was sent [s].
    ended : str
        ``count`` (all were due), ``asked``, ``stalled`` (whoever ordered them fell silent), ``failed``; empty before.
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
        """Why the bursts ended that nobody ended; empty while all is well."""
        return f"{self.ended}: {self.reason}" if self.ended in ("stalled", "failed") else ""


class BurstPlayer(Transport, typing.Protocol):
    """What the driver asks of a watchdog: the way to the instrument, bursts, and outputs off without the driver."""

    def arm(self, *, plays_by_itself: bool) -> None:
        """Outputs may go on from now; `plays_by_itself`: and what they play does not end without a command."""

    def beat(self) -> str:
        """The session is alive; return why the bursts ended that nobody ended, or nothing."""

    def play(self, order: Order) -> Report:
        """Begin to play bursts; return once it is known whether the first was played."""

    def look(self) -> Report:
        """Return what was played so far."""

    def end(self) -> None:
        """Let no further burst go."""

    def report(self, *, wait: bool) -> Report:
        """Let no further burst go, and return what was played; with `wait`, once the last burst is over."""

    def held_up(self) -> float:
        """Return for how long this process, or the one that paces, was held up at most since `arm` [s]."""

    def disarm(self) -> None:
        """Outputs are off."""

    def release(self, *, clean: bool) -> None:
        """End it; unless clean, it switches the outputs off first."""


class Pacer:
    """Triggers bursts one by one; what is late is dropped, never repeated and never caught up.

    Parameters
    ----------
    order : Order
        What is to be played.
    trigger : callable
        Sends the command and returns once the instrument has taken it; whatever it raises ends the order.
    silence : callable
        For how long whoever ordered the bursts has given no sign of life [s].
    clock : Clock
        Tells the time.
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
        """When the next burst is due [s]; None if none will come."""
        if self.report.ended:
            return None
        return self.order.first + self.report.due * self.order.period

    @property
    def silent_from(self) -> float:
        """When the last burst that was triggered is over [s]."""
        return self.report.last[1] + self.order.duration if self.report.last else self.order.first

    def end(self) -> None:
        """Let no further burst go."""
        self._asked_to_end.set()

    def close(self) -> None:
        """Let no further burst go, where no thread `run`s it."""
        self.end()
        self._end_if_over()

    def step(self) -> None:
        """Trigger the burst that is due now, or leave out what is overdue."""
        report, order = self.report, self.order
        due = self.due
        # All of it, whoever asks for the end meanwhile: it was not played while it was wanted.
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
            # Within that time it may have been played at any instant: no count holds for a rhythm that is not kept.
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
        """Play to the end; `on_first` is called as soon as it is known whether the first burst was played."""
        told = False
        while (due := self.due) is not None:
            left = due - self._clock.now()
            if left > ALERT:
                # Somebody may end it meanwhile, or fall silent. Windows ends such a wait up to 16 ms late.
                self._asked_to_end.wait(min(left - ALERT, 0.05))
            else:
                self._clock.sleep(left)
            self.step()
            if not told and (self.report.due or self.report.ended):
                told = True
                on_first()


ROUNDING = 1e-9
"""What a sum of virtual times may lack [s]."""


class LocalClient:
    """The watchdog's client in virtual time: no process of its own, and bursts whose instants are virtual.

    Nothing of it survives its process, so that it is for a twin in that process alone.

    Parameters
    ----------
    transport : Transport
        The way to the instrument.
    clock : VirtualClock
        That of the session.
    """

    def __init__(self, transport: VisaSession, clock: VirtualClock) -> None:
        self._transport = transport
        self._clock = clock
        self._pacer: Pacer | None = None
        self.open, self.exchange, self.close = transport.open, transport.exchange, transport.close

    def arm(self, *, plays_by_itself: bool) -> None:
        """Take notice of nothing: this process watches itself."""

    def held_up(self) -> float:
        """Return 0: virtual time waits for everybody."""
        return 0.0

    def disarm(self) -> None:
        """Take notice of nothing."""

    def beat(self) -> str:
        """Return why the bursts ended that nobody ended; empty while all is well."""
        return self.look().lost

    def play(self, order: Order) -> Report:
        """Have bursts played, and let time pass until the first is; return the report as it stands then."""
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
        """Return what was played so far."""
        return self._pacer.report if self._pacer is not None else Report()

    def end(self) -> None:
        """Let no further burst go."""
        if self._pacer is not None:
            self._pacer.end()

    def report(self, *, wait: bool) -> Report:
        """Let no further burst go, and return what was played; with `wait`, once the last burst is over."""
        if self._pacer is None:
            return Report()
        self._pacer.close()
        if wait:
            self._clock.sleep(self._pacer.silent_from - self._clock.now())
        return self._pacer.report

    def release(self, *, clean: bool) -> None:
        """End the session with the instrument."""
        self._transport.release()
