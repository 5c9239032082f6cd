"""PyVISA driver of an arbitrary function generator, for every supported model.

The outputs are off at all times except during a stimulus: after every failure they are switched off and read back, and
if this process cannot do so, the watchdog process, which holds the VISA session, does. After a failed exchange a reply
may belong to an earlier query, so the session is reopened, the instrument identified, its outputs switched off and
every setting applied again.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from modaltouch.protocol import Apparatus
from modaltouch.rig import instrument_of
from modaltouch.rig.connection import BurstPlayer, Connection, OutputState, Patience, start_watchdog
from modaltouch.rig.controls import Log
from modaltouch.rig.interface import MANY, Bursts, Firing, LinkError, Repetition, RigError, StimulusLost, Unconfirmed
from modaltouch.rig.pacing import HELD_UP, PATIENCE, Report
from modaltouch.rig.player import RELAYS_SETTLE, Player, numbers
from modaltouch.stimulus import Burst
from modaltouch.system import SYSTEM_CLOCK, Clock

LONGEST_LEAD = 0.3
"""Upper bound of `Generator.lead` [s]; the session blocks for that long."""

FORGETTING = 0.9
"""Smallest ratio of `Generator.lead` from one stimulus to the next [1]."""

UNMEASURED = 1e-3
"""Assumed upper bound of an unmeasured trigger latency [s]."""

MOST_DROPPED = 0.1
"""Fraction of dropped bursts above which a stimulus without a fixed number of bursts is presented again, if at least
two were dropped [1]; a single dropped burst is only recorded."""


class Generator(contextlib.AbstractContextManager["Generator"]):
    """A generator with two outputs, as a `modaltouch.rig.interface.Rig`.

    Parameters
    ----------
    address : str
        VISA address; the suffix ``@ivi`` selects the vendor's VISA library.
    apparatus : Apparatus
        The apparatus, with model, load, amplifier and limits.
    log : callable
        ``log(event, **facts)`` is called with every exchange and event.
    patience : Patience
        Timeouts and retries.
    repetition : str, optional
        ``single``, ``timer``, ``continuous`` or ``wired``; by default that of the apparatus.
    start_guard : callable
        Starts the watchdog; takes the address and the message that switches the outputs off.
    clock : Clock
        Clock of the session.

    Raises
    ------
    RigError
        If there is no such instrument at the address.
    """

    def __init__(
        self,
        address: str,
        apparatus: Apparatus,
        *,
        log: Log = lambda event, **facts: None,
        patience: Patience | None = None,
        repetition: Repetition | None = None,
        start_guard: Callable[[str, str], BurstPlayer] = start_watchdog,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        began = time.perf_counter()
        self._log = log
        self._clock = clock
        self._patience = patience or Patience()
        self._latency = apparatus.generator.trigger_latency
        self._last_beat = self._longest_silence = 0.0
        self.lead = RELAYS_SETTLE
        """Time by which `fire` should precede a stimulus [s]: RELAYS_SETTLE plus twice the preparation time."""
        self._silent = self._is_counted = False
        self.firing: Firing | None = None
        """The latest firing; unconfirmed if `stop` found changed settings or outputs."""
        self._on = False
        self._closed = False
        self._connection = Connection(
            address,
            apparatus,
            guard=start_guard(address, instrument_of(apparatus).off),
            log=log,
            patience=self._patience,
            clock=clock,
        )
        repetition = repetition or apparatus.generator.repeats
        self._player = Player(self._connection.controls, self._connection.limits, repetition)
        self._connection.open()
        self.identity, self.address = self._connection.identity, address
        self._opened_in = time.perf_counter() - began

    def command_latency(self, n: int = 50) -> tuple[dict[str, Any], str]:
        """Measure and assess the latencies of the instrument, with `n` commands of each kind.

        The values are those of `modaltouch.rig.checklist.measure_latency`. Nothing is played.

        Raises
        ------
        RigError
            If the connection to the instrument is lost.
        """
        from modaltouch.rig.checklist import measure_latency

        return measure_latency(self, self._player.set_levels, self._opened_in, n=n)

    def load(self, burst: Burst, *further: Burst, repetition: Repetition | None = None) -> None:
        """Upload and verify the records of both channels, and apply every setting except the amplitudes.

        Parameters
        ----------
        burst, *further : Burst
            Bursts with one record for each of the two outputs. If the memories cannot hold all records, each burst is
            uploaded when it is fired.
        repetition : str, optional
            Repetition of these bursts, until others are loaded; by default the usual one.

        Raises
        ------
        RigError
            If the instrument does not confirm the upload; the outputs are off.
        """
        self.stop()
        self._player.take((burst, *further), repetition)
        self._bring(self._player.replay)

    def fire(
        self,
        velocity: float,
        *,
        n_bursts: int = MANY,
        exactly: bool = False,
        silent: bool = False,
        which: int = 0,
        due: float = -math.inf,
    ) -> Firing:
        """Set the level, switch the outputs on and play bursts until `end` or `stop`.

        Its parameters are those of `Rig.fire`.

        Returns
        -------
        Firing
            Not started, with the outputs off, if the instrument did not confirm a setting, or the connection was lost
            and restored; the trial must then be presented again.

        Raises
        ------
        RigError
            If nothing is loaded, the level exceeds a limit, or the connection to the instrument is lost; the outputs
            are off.
        """
        commanded = self._player.amplitudes(velocity, which)
        if self._on:
            self.stop()
        if not self._player.holds(which):
            # An upload takes longer than the watchdog's timeout during a stimulus, so it precedes `arm`.
            self._bring(lambda: self._player.choose(which))
        self._is_counted = exactly
        self.firing = Firing(
            commanded,
            (),
            self._clock.now(),
            math.inf,
            repetition=self._player.repetition,
            trigger_latency="unknown" if self._latency is None else "measured",
        )
        self._last_beat, self._longest_silence = self._clock.now(), 0.0
        with self._off_on_failure("starting the stimulus"):
            self._on = True
            try:
                self._connection.guard.arm(free_running=self._player.free_running and not silent)
                self._player.choose(which)
                read_back = self._player.prepare(commanded, silent=silent)
                self.firing = replace(self.firing, confirmed_amplitude=numbers(read_back))
                self._begin(self.firing, n_bursts, due, silent=silent)
            except (Unconfirmed, LinkError) as error:
                self._abandon(self.firing, error)
        return self.firing

    def _bring(self, records: Callable[[], None]) -> None:
        """Upload records, over a new connection if the first one is lost."""
        with self._off_on_failure("loading the stimulus"):
            try:
                records()
            except LinkError:
                self._connection.restore("loading the stimulus", (), self._player.replay)

    def _abandon(self, firing: Firing, error: Unconfirmed | LinkError) -> None:
        """Switch the outputs off after a stimulus that did not start properly, and record the reason."""
        read_back, reason = error.read_back if isinstance(error, Unconfirmed) else (), str(error)
        self.firing = replace(firing, confirmed_amplitude=numbers(read_back), reason=reason)
        self._log("unconfirmed", reason=reason)
        if isinstance(error, LinkError):
            # A trigger may still be in flight; closing the connection discards it.
            self._connection.controls.close(broken=True)
        self._switch_off("starting the stimulus")
        # A failure during a stall of this computer is not attributed to the instrument.
        if self._connection.guard.held_up() > HELD_UP:
            self.firing = replace(self.firing, stalled=True)
        if isinstance(error, Unconfirmed):
            # Apply any changed setting again before the next attempt.
            self._connection.restore("starting the stimulus", (), self._player.replay)

    def _begin(self, firing: Firing, n_bursts: int, due: float, *, silent: bool) -> None:
        """Switch the outputs on, play the first burst when it is due, and record its onset."""
        clock, self._silent = self._clock, silent
        set_after = clock.now() - firing.onset
        # No heartbeat is sent during this wait, so the outputs are switched on only at its end.
        clock.sleep(due - clock.now() - (0.0 if self._player.free_running else 2 * RELAYS_SETTLE))
        started = clock.now()
        self._player.switch_on()
        on = clock.now()
        needed = RELAYS_SETTLE + 2 * (set_after + on - started)
        self.lead = min(max(needed, FORGETTING * self.lead), LONGEST_LEAD)
        due = max(due, on + RELAYS_SETTLE)
        if silent:
            clock.sleep(due - on)
            span, bursts = (due, due), Bursts(0, 0, 0, 0)
        elif self._player.repetition == "single":
            order = self._player.order(n_bursts, due, self._patience.trigger)
            report = self._connection.guard.play(order)
            if report.first is None:
                self.firing = replace(firing, stalled=report.ended != "failed")
                raise LinkError(report.reason or "this computer was held up: no burst could be played in time")
            span = self._sample_left(report.first)
            bursts = self._count(report)
        else:
            span = (started, on + (self._player.period if self._player.repetition != "continuous" else 0.0))
            bursts = Bursts()
        middle, half = sum(span) / 2, (span[1] - span[0]) / 2
        # The rate of pulses at the trigger input, if any, is unknown here.
        if not silent and self._player.repetition != "wired":
            bursts = replace(bursts, first_s=middle, uncertainty_s=half)
        self.firing = replace(firing, onset=middle, onset_uncertainty=half, started=True, bursts=bursts)
        self._last_beat = clock.now()

    def _sample_left(self, trigger: tuple[float, float]) -> tuple[float, float]:
        """Return earliest and latest instant of the first sample, given those of the trigger, (sent, accepted) [s]."""
        if self._latency is not None:
            return trigger[0] + self._latency[0], trigger[1] + self._latency[1]
        # No claim below 1 ms: an immediate acknowledgement by the link says nothing about the instrument.
        return trigger[0], max(trigger[1], trigger[0] + UNMEASURED) + UNMEASURED

    def end(self) -> None:
        """Trigger no further burst; a burst in progress is completed."""
        if self._on and not self._player.free_running:
            self._connection.guard.end()

    def stop(self, *, at_once: bool = False) -> None:
        """Switch both outputs off with confirmation, and update `firing`: bursts played, and unchanged settings.

        Parameters
        ----------
        at_once : bool
            Whether to truncate a burst in progress; otherwise it is completed first, if bursts are triggered one by
            one.

        Raises
        ------
        RigError
            If the instrument does not confirm that the outputs are off.
        """
        was_on, firing = self._on, self.firing
        if not was_on or firing is None or not firing.started:
            self._switch_off("switching the outputs off")
            return
        self._longest_silence = max(self._longest_silence, self._clock.now() - self._last_beat)
        # Nothing is confirmed until the end of the stimulus is.
        unknown = Bursts(firing.bursts.asked, dropped=firing.bursts.dropped)
        self.firing = replace(firing, reason="the end of the stimulus was not confirmed", bursts=unknown)
        try:
            report, fault = (None, ()) if at_once else self._ask_report(wait=True)
            if at_once:
                self.end()
            if fault:
                # A trigger may still be in flight; closing the connection discards it.
                self._connection.controls.close(broken=True)
            off = self._clock.now()
            found = self._switch_off("switching the outputs off")
            if at_once:
                report, fault = self._ask_report(wait=False)
        except RigError as error:
            self.firing = replace(self.firing, reason=str(error))
            raise
        self.firing = self._concluded(firing, report, (*fault, *found.faults), off)
        if not self.firing.confirmed:
            self._log("unconfirmed", reason=self.firing.reason)
        if found.differences and not found.renewed:
            self._connection.restore("making the settings again", (), self._player.replay)

    def _ask_report(self, *, wait: bool) -> tuple[Report | None, tuple[str, ...]]:
        """Return the pacer's report, and the reasons why the stimulus does not count."""
        if self._player.free_running or self._silent:
            return None, ()
        try:
            report = self._connection.guard.report(wait=wait)
        except LinkError as error:
            return None, (str(error),)
        return report, (report.reason,) if report.ended == "failed" else ()

    def _concluded(self, firing: Firing, report: Report | None, faults: tuple[str, ...], off: float) -> Firing:
        """Return the firing with its final counts and confirmation."""
        held_up = self._longest_silence
        stalled = held_up > PATIENCE
        reasons = [f"{'; '.join(faults)} when the stimulus ended"] if faults else []
        bursts = firing.bursts
        if report is not None:
            bursts = self._count(report, off)
            bursts = replace(bursts, first_s=firing.bursts.first_s, uncertainty_s=firing.bursts.uncertainty_s)
            too_many = report.dropped > (0 if self._is_counted else max(MOST_DROPPED * report.due, 1))
            if report.ended == "stalled" or too_many:
                stalled = True
                reasons.append(f"{report.dropped} of {report.due} bursts would have been too late and were left out")
        if faults:
            # Any trigger may have been lost, even the first.
            bursts = Bursts(bursts.asked, dropped=bursts.dropped)
            # After a stall, the outputs were switched off by the watchdog.
            if not (stalled and all(fault.startswith("output ") for fault in faults)):
                held_up = self._connection.guard.held_up()
                stalled = held_up > HELD_UP
        if stalled:
            reasons.insert(0, f"this computer was held up for {held_up:.1f} s")
        return replace(firing, confirmed=not reasons, reason="; ".join(reasons), stalled=stalled, bursts=bursts)

    def _count(self, report: Report, off: float = math.inf) -> Bursts:
        """Return the burst counts of a report; the last burst was cut if the outputs went `off` before its end [s]."""
        was_cut = report.last is not None and off < report.last[1] + self._player.duration
        return Bursts(report.due, report.played, report.played - was_cut, report.dropped)

    def heartbeat(self) -> None:
        """Signal to the watchdog that the session is alive; takes well under a microsecond.

        Raises
        ------
        StimulusLost
            If the bursts ended before `end` or `stop` was called.
        RigError
            If the watchdog process has died while outputs may be on; they have been switched off.
        """
        now = self._clock.now()
        if self._on:
            self._longest_silence = max(self._longest_silence, now - self._last_beat)
        self._last_beat = now
        try:
            lost = self._connection.guard.beat() if self._on else ""
        except LinkError as error:
            self._switch_off("going on without a watchdog")
            raise RigError(f"{error}; the outputs were switched off over a new connection") from error
        if lost:
            raise StimulusLost(f"the bursts ended before the stimulus did ({lost})")

    def close(self) -> None:
        """Switch the outputs off and release the instrument; never raises.

        If the outputs cannot be confirmed off, the watchdog stays and keeps trying.
        """
        if self._closed:
            return
        self._closed = True
        off = False
        try:
            self.stop()
            off = True
            with contextlib.suppress(LinkError, Unconfirmed):
                self._player.unlock()
        # On any failure, even a full disk for the log, the watchdog is left to switch the outputs off.
        except Exception as error:
            with contextlib.suppress(Exception):
                self._log("close_failed", reason=str(error))
        finally:
            self._connection.guard.release(clean=off)

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _switch_off(self, doing: str) -> OutputState:
        """Switch the outputs off and stop the trigger; return the state of the outputs before."""
        was_on, self._on = self._on, False
        expected = self._player.expected if was_on else ()
        found = self._connection.switch_off(doing, expected, self._player.replay)
        if was_on:
            # A failure is harmless: with the outputs off no trigger moves the beam, and the next start checks it.
            with contextlib.suppress(LinkError, Unconfirmed):
                self._player.stop_trigger()
        return found

    @contextlib.contextmanager
    def _off_on_failure(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (LinkError, Unconfirmed) as error:
            self._switch_off(doing)
            raise RigError(f"{doing} failed: {error}; the outputs are off; run `modaltouch rig check`") from error
        except BaseException:
            if self._on:
                self._switch_off(doing)
            raise
