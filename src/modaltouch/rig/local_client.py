"""Stands in a watchdog's place for a session in virtual time, before a twin in the same process."""

from __future__ import annotations

from modaltouch.rig.pacing import Order, Pacer, Report
from modaltouch.rig.visa import VisaSession
from modaltouch.system import VirtualClock

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
        report = self._pacer.report if self._pacer is not None else Report()
        return f"{report.ended}: {report.reason}" if report.ended == "failed" else ""

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
