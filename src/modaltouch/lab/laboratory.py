"""Generator and scope, simulated or real, with the outputs on only while a record is taken."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from modaltouch.protocol import Apparatus
from modaltouch.rig import (
    Acquisition,
    Firing,
    Generator,
    Recording,
    Rig,
    RigError,
    Scope,
    StimulusLost,
    instrument_of,
)
from modaltouch.stimulus import Burst
from modaltouch.system import SYSTEM_CLOCK, Interruption, VirtualClock

if TYPE_CHECKING:
    from modaltouch.rig import Simulator


Mode = Literal["simulated", "real"]

SIMULATED = "simulated"
"""Address of the twin."""

ATTEMPTS = 3
"""Number of attempts at a record if the computer stalls."""

SETTLING_TIME = 0.5
"""Time from the first burst until the motion is periodic: 30 decay times of a mode of 20 Hz bandwidth [s]."""


def quiet(*_: object, **__: object) -> None:
    """Accept any arguments and do nothing."""


@dataclass(frozen=True)
class MeasurementProgress:
    """Callbacks of a running measurement, by default without effect.

    Attributes
    ----------
    show : callable
        Called with the name of a step, the amount done, and the total.
    say : callable
        Called with a line of text.
    aim : callable
        Called with the coordinates of a point, along the beam from mid-beam and across it from the mid-line [m];
        returns once the vibrometer's spot is there.
    check : callable
        Called between records; may raise to stop.
    """

    show: Callable[[str, int, int], None] = quiet
    say: Callable[[str], None] = quiet
    aim: Callable[[float, float], None] = quiet
    check: Callable[[], None] = quiet

    @contextmanager
    def interruptible(self) -> Iterator[MeasurementProgress]:
        """Yield the same callbacks, with a `check` that raises after a signal."""
        with Interruption() as interruption:
            yield replace(self, check=interruption.check)


SILENT_PROGRESS = MeasurementProgress()
"""Callbacks that report nothing and never wait."""


@dataclass(frozen=True, eq=False)
class Laboratory:
    """A rig and the instruments that measure it.

    Attributes
    ----------
    apparatus : Apparatus
        The apparatus, from its file.
    rig : Rig
        The generator, with amplifier and beam behind it.
    scope : Scope
        Vibrometer and scope.
    mode : str
        ``simulated`` if the generator is, else ``real``.
    progress : MeasurementProgress
        Callbacks of the measurement; called with the outputs off.
    settling_time : float
        Wait between the first burst and the first record [s]; 0 for the twin, which computes the steady state.
    simulator : Simulator or None
        The twin, which holds the true values; for evaluating results, never for measuring.
    """

    apparatus: Apparatus
    rig: Rig
    scope: Scope
    mode: Mode
    progress: MeasurementProgress = SILENT_PROGRESS
    settling_time: float = SETTLING_TIME
    simulator: Simulator | None = None

    def load(self, burst: Burst) -> None:
        """Load a burst into the generator and verify it; the outputs are off."""
        self.rig.load(burst)

    def record(self, position: float, velocity: float, acquisition: Acquisition, across: float = 0.0) -> Recording:
        """Record velocity and drive at a position while the loaded burst repeats, then switch the outputs off.

        A record disturbed by a stall of this computer is repeated, up to `ATTEMPTS` attempts in total.

        Parameters
        ----------
        position : float
            Position along the beam, origin at mid-beam [m].
        velocity : float
            Level at which the burst is played [m/s].
        acquisition : Acquisition
            Settings of the scope.
        across : float
            Distance from the beam's mid-line [m].

        Raises
        ------
        RigError
            If the rig fails, or the generator does not confirm its output both before and after the record.
        """
        self.scope.configure(acquisition)
        self.progress.aim(position, across)
        for _ in range(ATTEMPTS):
            recording, firing = self._record_once(position, across, velocity, acquisition)
            if firing is not None and firing.confirmed and recording is not None:
                return recording
            if firing is None or not firing.stalled:
                break
        reason, remedy = "nothing was played" if firing is None else firing.reason, "measure again"
        if firing is not None and firing.stalled:
            remedy = f"this computer was too busy in {ATTEMPTS} attempts in a row; close other programs, and {remedy}"
        raise RigError(f"at {position * 1e3:g} mm the record is not valid: {reason}; the outputs are off; {remedy}")

    def _record_once(
        self, position: float, across: float, velocity: float, acquisition: Acquisition
    ) -> tuple[Recording | None, Firing | None]:
        """Return a record, or None if the bursts stopped during it, and the firing."""
        firing = self.rig.fire(velocity)
        if not firing.started:
            raise RigError(
                f"the generator did not confirm what it should play ({firing.reason}); the outputs are off; run "
                "`modaltouch rig check`"
            )
        recording = None
        try:
            longest = acquisition.n_records * acquisition.n_samples / acquisition.sampling_rate
            with suppress(StimulusLost), self._alive(self.settling_time + longest + self.scope.slowest):
                time.sleep(self.settling_time)
                recording = self.scope.measure(position, across)
        finally:
            self.rig.stop()
        return recording, self.rig.firing

    @contextmanager
    def _alive(self, longest: float) -> Iterator[None]:
        """Send heartbeats to the watchdog while the scope blocks this process, but no longer than `longest` [s]."""
        ended, failures = threading.Event(), list[RigError]()
        deadline = time.monotonic() + longest

        def beat() -> None:
            try:
                while not ended.wait(0.1) and time.monotonic() < deadline:
                    self.rig.heartbeat()
            except RigError as error:
                failures.append(error)

        self.rig.heartbeat()
        beating = threading.Thread(target=beat, daemon=True, name="heartbeat")
        beating.start()
        try:
            yield
        finally:
            ended.set()
            beating.join()
        if failures:
            raise failures[0]


@contextmanager
def open_laboratory(
    apparatus: Apparatus,
    address: str = SIMULATED,
    progress: MeasurementProgress = SILENT_PROGRESS,
    *,
    seed: int | None = None,
    repetition: Literal["single", "timer", "continuous", "wired"] | None = None,
    scope: Scope | None = None,
    **options: Any,
) -> Iterator[Laboratory]:
    """Open generator and scope; however the context ends, the outputs are off.

    Parameters
    ----------
    apparatus : Apparatus
        The apparatus, from its file.
    address : str
        ``simulated``, or the generator's VISA address; with a real one a PicoScope is opened unless `scope` is given.
    progress : MeasurementProgress
        Callbacks of the measurement; `aim` is not used with the twin.
    seed : int, optional
        Seed of the twin, in place of the one in its apparatus file.
    repetition : str, optional
        ``continuous`` plays one burst after the other without a gap, as for a periodic excitation; None uses the
        setting of the apparatus, as in a session.
    scope : Scope, optional
        Scope to use instead of the twin's or a PicoScope; closed here.
    **options
        Further arguments of `modaltouch.rig.Generator`.

    Raises
    ------
    RigError
        If an instrument is missing or refuses.
    """
    with ExitStack() as stack:

        def open_generator(**how: Any) -> Rig:
            return stack.enter_context(Generator(apparatus=apparatus, **{"repetition": repetition, **how, **options}))

        if address == SIMULATED:
            from modaltouch.rig import Simulator

            # The twin is computed in this process, too slowly for a real clock.
            clock = VirtualClock(SYSTEM_CLOCK.now())
            simulator = stack.enter_context(Simulator(apparatus, seed, clock=clock))
            scope = stack.enter_context(scope or simulator.scope())
            rig = open_generator(**simulator.driver_options)
            yield Laboratory(apparatus, rig, scope, "simulated", replace(progress, aim=quiet), 0.0, simulator)
            return
        # Open the scope first: without one, the generator is not needed.
        scope = stack.enter_context(scope or Scope.open(apparatus))
        rig = open_generator(address=address)
        mode: Mode = "simulated" if instrument_of(apparatus).is_simulated(rig.identity) else "real"
        yield Laboratory(apparatus, rig, scope, mode, progress)
