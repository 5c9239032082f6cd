"""The burst in the instrument: its records, its settings, and what has it played; no failures here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.controls import Controls
from modaltouch.rig.instrument import Limits, Setting
from modaltouch.rig.interface import Repetition, RigError, Unconfirmed
from modaltouch.rig.pacing import Order
from modaltouch.stimulus import Burst
from modaltouch.system import Clock

LARGEST_STEP = 0.01
"""How far from zero a record may begin and end, as a part of its full scale [1]."""

RELAYS_SETTLE = 0.05
"""From switching the outputs on to the first burst [s]: relays close and bounce in a few milliseconds."""


class Player:
    """Plays one burst at a time, of those whose records lie in the instrument.

    What talks to the instrument raises LinkError or Unconfirmed if it does not confirm a step.

    Parameters
    ----------
    controls : Controls
        Of an open instrument.
    limits : Limits
        What may leave it.
    repetition : str
        How the burst repeats.
    clock : Clock
        By which it waits.
    """

    def __init__(self, controls: Controls, limits: Limits, repetition: Repetition, clock: Clock) -> None:
        self._clock = clock
        self._controls = controls
        self._limits = limits
        self._instrument = limits.instrument
        self._table = limits.instrument.commands
        self.repetition: Repetition = repetition
        self._usual: Repetition = repetition
        self._trigger_command = ""
        self._bursts: tuple[Burst, ...] = ()
        self._chosen = 0
        self._by_burst: dict[int, tuple[Setting, ...]] = {}
        self._settings: tuple[Setting, ...] = ()
        self._stopped = self._let_go = self._instrument.on_all(self._table.stopped)
        self._levels: tuple[Setting, ...] = ()

    @property
    def expected(self) -> tuple[Setting, ...]:
        """Every setting that must read back while the burst plays."""
        return (*self._settings, *self._levels, *(() if self._continuous else self._let_go))

    @property
    def _continuous(self) -> bool:
        return self.repetition == "continuous"

    @property
    def plays_by_itself(self) -> bool:
        """Whether what is played does not end unless it is told to."""
        return self.repetition != "single"

    @property
    def period(self) -> float:
        """From one burst to the next [s]."""
        return 1 / self._bursts[self._chosen].repetition_rate

    @property
    def duration(self) -> float:
        """Of one burst [s]."""
        return self._bursts[self._chosen].duration

    def take(self, bursts: Sequence[Burst], repetition: Repetition | None = None) -> None:
        """Make bursts those that can be played, the first of them chosen; `replay` brings them into the instrument.

        They repeat as the instrument's usually do if no other repetition is given.

        Raises
        ------
        RigError
            If one does not begin and end at rest or has more records than the instrument has memories, or the
            repetition asks for a timer that it has not.
        """
        self._bursts, self._settings, self._levels = (), (), ()
        self.repetition = repetition or self._usual
        if self.repetition == "timer" and self._table.timer is None:
            raise RigError(
                f"the repetition `timer` was asked for, but a {self._instrument.models[0]} has no timer that its "
                "channels share; the outputs are off; write generator.repetition: single"
            )
        for burst in bursts:
            _refuse_steps(burst)
        n_records, n_memories = max(map(self._n_records, bursts), default=0), self._instrument.records.n_memories
        if n_records > n_memories:
            raise RigError(
                f"a burst has {n_records} records, but the generator has {n_memories} memories; the outputs are off; "
                "use a generator with more memories"
            )
        self._bursts, self._chosen = tuple(bursts), 0

    def _n_records(self, *bursts: Burst) -> int:
        """Return how many different records bursts have."""
        return len({codes.tobytes() for burst in bursts for codes in self._records(burst)})

    def holds(self, which: int) -> bool:
        """Return whether a burst's records are in the instrument, so that settings alone choose it."""
        return which in self._by_burst

    def replay(self) -> None:
        """Have the records in the instrument and make every setting but the level.

        Of more records than it has memories, those of the chosen burst.
        """
        self._settings = self._levels = ()
        self._by_burst = {}
        if not self._bursts:
            return
        channels = self._instrument.channels
        fit = self._n_records(*self._bursts) <= self._instrument.records.n_memories
        held = dict(enumerate(self._bursts)) if fit else {self._chosen: self._bursts[self._chosen]}
        records = [each for burst in held.values() for each in zip(channels, self._records(burst), strict=True)]
        memories = self._controls.store(records)
        by_burst: dict[int, list[Setting]] = {}
        for place, (number, burst) in enumerate(held.items()):
            settings = by_burst[number] = []
            for channel, memory in zip(channels, memories[place * len(channels) :], strict=False):
                settings += self._instrument.burst_settings(channel, memory, burst, continuous=self._continuous)
            settings += self._instrument.timer(burst) if self.repetition == "timer" else ()
        locks = self._instrument.records.locks(memories)
        self._controls.apply_each([*by_burst[self._chosen], *locks])
        if self.repetition == "single" and not self._trigger_command:
            self._trigger_command = self._controls.trigger_command()
            # What that has triggered, behind outputs that are off, is over before the first burst is due.
            self._clock.sleep(2 * max(burst.duration for burst in self._bursts))
        guarded = self._limits.guarded_settings()
        self._by_burst = {number: (*guarded, *settings, *locks) for number, settings in by_burst.items()}
        self._settings = self._by_burst[self._chosen]

    def choose(self, which: int) -> None:
        """Play one of the bursts from now on; where its records are there, settings alone change."""
        was, before = self._chosen, set(self._settings)
        self._chosen = which
        if which == was or not before:
            return
        if self.holds(which):
            # First the settings that will be: what fails on the way is found to differ, and made again.
            self._settings = self._by_burst[which]
            self._controls.apply_each([setting for setting in self._settings if setting not in before])
        else:
            self.replay()

    def _records(self, burst: Burst) -> NDArray[np.uint16]:
        return self._instrument.continuous_codes(burst) if self._continuous else burst.codes

    def amplitudes(self, velocity: float, which: int = 0) -> tuple[float, ...]:
        """Return the amplitude of each channel at a level [m/s] of a burst, open circuit [V peak to peak].

        Raises
        ------
        RigError
            If nothing is loaded, or the level is beyond a limit.
        """
        # Settings are there only once every record was verified and every setting read back.
        if not self._bursts or not self._settings:
            raise RigError(
                "fire was called before a burst was loaded and verified; the outputs are off; load a burst first"
            )
        if not 0 <= which < len(self._bursts):
            raise RigError(
                f"burst {which} was asked for: 0 to {len(self._bursts) - 1} are loaded; the outputs are off; load it "
                "with the others"
            )
        return self._limits.amplitudes(self._bursts[which], velocity)

    def prepare(self, commanded: tuple[float, ...], *, silent: bool = False) -> tuple[str, ...]:
        """Set both levels with the trigger stopped, see that nothing else changed, and return what was read back.

        `silent` goes through the same steps, so that relays and time betray nothing, but no burst will be let go.

        Raises
        ------
        RigError
            If it shall be silent and the repetition would play as soon as the outputs are on.
        LinkError, Unconfirmed
            If the instrument does not confirm a step.
        """
        if silent and self.repetition in ("continuous", "wired"):
            raise RigError(
                f"a catch trial needs the repetition `single`: with `{self.repetition}` the beam moves as soon as the "
                "outputs are on; the outputs are off; leave out schedule.catch_trials"
            )
        sources = {"timer": self._table.armed, "wired": self._table.wired}
        source = None if silent else sources.get(self.repetition)
        self._let_go = self._stopped if source is None else self._instrument.on_all(source)
        read_back = self.set_levels(commanded)
        changed = self._controls.differences([*self._settings, *(() if self._continuous else self._stopped)])
        if changed:
            raise Unconfirmed("; ".join(changed), read_back)
        return read_back

    def switch_on(self) -> None:
        """Switch the outputs on; timer or input are let go, and a continuous record begins with its first sample."""
        if self._continuous:
            self._controls.command(self._table.align)
        self._controls.outputs_on()
        if self._let_go != self._stopped:
            self._controls.apply(self._let_go)

    def order(self, n_bursts: int, first: float, timeout: float) -> Order:
        """Return what is asked of a pacer.

        Parameters
        ----------
        n_bursts : int
            How many bursts at most.
        first : float
            When the first is due [s].
        timeout : float
            Longest wait for the instrument to take a trigger [s].
        """
        return Order(self._trigger_command, n_bursts, first, self.period, self.duration, timeout)

    def set_levels(self, commanded: tuple[float, ...]) -> tuple[str, ...]:
        """Set both amplitudes in one message, and return what was read back."""
        channels = zip(self._instrument.channels, commanded, strict=True)
        self._levels = tuple(self._instrument.level(channel, amplitude) for channel, amplitude in channels)
        return self._controls.apply(self._levels)

    def stop_trigger(self) -> None:
        """Let no trigger come by itself."""
        if self._let_go != self._stopped:
            self._controls.apply(self._stopped)

    def unlock(self) -> None:
        """Leave the memories to whoever comes next."""
        locks = [setting for setting in self._settings if setting.of]
        self._controls.apply_each([setting.off for setting in locks])


def _refuse_steps(burst: Burst) -> None:
    """Refuse a burst that does not rise from zero and fall back to it."""
    for number, end in enumerate(burst.ends, start=1):
        if end > LARGEST_STEP:
            raise RigError(
                f"the record of output {number} begins or ends at {end:.1%} of its full scale: at most "
                f"{LARGEST_STEP:.0%} is allowed, since the outputs rest there between bursts; the outputs are off; "
                "ramp the drive on and off"
            )


def numbers(replies: tuple[str, ...]) -> tuple[float, ...]:
    """Return what was read back as numbers; empty if it was not numbers."""
    try:
        return tuple(float(reply) for reply in replies)
    except ValueError:
        return ()
