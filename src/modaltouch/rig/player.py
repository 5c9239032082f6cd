"""Player of bursts stored in the instrument: records, settings and triggers; failures are handled elsewhere."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.controls import Controls
from modaltouch.rig.instrument import Limits, Setting
from modaltouch.rig.interface import Repetition, RigError, Unconfirmed
from modaltouch.rig.pacing import Order
from modaltouch.stimulus import Burst

LARGEST_STEP = 0.01
"""Largest magnitude of the first and last sample of a record, as a fraction of full scale [1]."""

MARKS = 30_000
"""Number of different marks on the memory via which records are stored."""

RELAYS_SETTLE = 0.05
"""Time from switching the outputs on to the first burst [s]; relays close and bounce within a few milliseconds."""


class Player:
    """Player of the bursts stored in the instrument, one at a time.

    Methods that send commands raise LinkError or Unconfirmed if the instrument does not confirm a step. `repetition` is
    the usual one of the bursts.
    """

    def __init__(self, controls: Controls, limits: Limits, repetition: Repetition) -> None:
        self._controls = controls
        self._limits = limits
        self._instrument = limits.instrument
        self._table = limits.instrument.commands
        self.repetition: Repetition = repetition
        self._usual: Repetition = repetition
        self._bursts: tuple[Burst, ...] = ()
        self._chosen = 0
        self._by_burst: dict[int, tuple[Setting, ...]] = {}
        self._stopped = self._let_go = self._instrument.on_all(self._table.stopped)
        self._levels: tuple[Setting, ...] = ()

    @property
    def _settings(self) -> tuple[Setting, ...]:
        """Settings of the selected burst, each of which was read back; empty unless its records are stored."""
        return self._by_burst.get(self._chosen, ())

    @property
    def expected(self) -> tuple[Setting, ...]:
        """All settings that must read back unchanged while the burst plays."""
        return (*self._settings, *self._levels, *(() if self._continuous else self._let_go))

    @property
    def _continuous(self) -> bool:
        return self.repetition == "continuous"

    @property
    def free_running(self) -> bool:
        """Whether bursts repeat without commands, until the outputs or the trigger are switched off."""
        return self.repetition != "single"

    @property
    def period(self) -> float:
        """Time from one burst to the next [s]."""
        return 1 / self._bursts[self._chosen].repetition_rate

    @property
    def duration(self) -> float:
        """Duration of one burst [s]."""
        return self._bursts[self._chosen].duration

    def take(self, bursts: Sequence[Burst], repetition: Repetition | None = None) -> None:
        """Set the bursts to be played and select the first; `replay` uploads them.

        Without `repetition`, they are repeated as usual. Raises RigError if a burst has other channels than the
        instrument, does not begin and end at rest, or is to be repeated by a timer that the instrument lacks.
        """
        self._bursts, self._by_burst, self._levels = (), {}, ()
        self.repetition = repetition or self._usual
        if self.repetition == "timer" and self._table.timer is None:
            raise RigError(
                f"the repetition `timer` was asked for, but a {self._instrument.models[0]} has no timer that its "
                "channels share; the outputs are off; write generator.repetition: single"
            )
        n_channels = len(self._instrument.channels)
        for burst in bursts:
            if len(burst.codes) != n_channels:
                raise RigError(
                    f"the burst has {len(burst.codes)} channels: the generator has {n_channels}; the outputs are off; "
                    "give each output an actuator set in the apparatus file"
                )
            _refuse_steps(burst)
        self._bursts, self._chosen = tuple(bursts), 0

    def holds(self, which: int) -> bool:
        """Test whether the records of a burst are stored in the instrument, so that settings suffice to select it."""
        return which in self._by_burst

    def replay(self) -> None:
        """Upload the records and apply every setting except the amplitudes.

        If there are more records than memories, only those of the selected burst are uploaded.
        """
        self._by_burst, self._levels = {}, ()
        if not self._bursts:
            return
        channels = self._instrument.channels
        different = {codes.tobytes() for burst in self._bursts for codes in self._records(burst)}
        fit = len(different) <= self._instrument.records.n_memories
        held = dict(enumerate(self._bursts)) if fit else {self._chosen: self._bursts[self._chosen]}
        records = [each for burst in held.values() for each in zip(channels, self._records(burst), strict=True)]
        memories = self._controls.store(records)
        by_burst: dict[int, list[Setting]] = {}
        for place, (number, burst) in enumerate(held.items()):
            settings = by_burst[number] = []
            for channel, memory in zip(channels, memories[place * len(channels) :], strict=False):
                settings += self._instrument.burst_settings(channel, memory, burst, continuous=self._continuous)
            settings += self._instrument.timer(burst) if self.repetition == "timer" else ()
            settings += self._table.pulses if self.repetition == "single" else ()
        locks = [lock.filled(memory=memory) for lock in self._table.locks for memory in dict.fromkeys(memories)]
        mark = 2.0 * (500 + zlib.crc32("".join(self._controls.stored.values()).encode()) % MARKS)
        locks += [each.filled(mark=mark) for each in self._table.marks]
        self._controls.apply_each([*by_burst[self._chosen], *locks])
        guarded = self._limits.guarded_settings()
        self._by_burst = {number: (*guarded, *settings, *locks) for number, settings in by_burst.items()}

    def choose(self, which: int) -> None:
        """Select the burst to be played from now on; if its records are stored, only settings change."""
        was, before = self._chosen, set(self._settings)
        self._chosen = which
        if which == was:
            return
        if self.holds(which):
            # The new settings are expected from here on, so that one that fails is found to differ and applied again.
            self._controls.apply_each([setting for setting in self._settings if setting not in before])
        else:
            self.replay()

    def _records(self, burst: Burst) -> NDArray[np.uint16]:
        return self._instrument.continuous_codes(burst) if self._continuous else burst.codes

    def amplitudes(self, velocity: float, which: int) -> tuple[float, ...]:
        """Return the amplitude of each channel for a burst at a level [m/s], into an open circuit [V peak to peak]."""
        # Settings exist only after every record has been verified and every setting read back.
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

    def prepare(self, commanded: tuple[float, ...], *, silent: bool) -> tuple[str, ...]:
        """Set both amplitudes with the trigger stopped, check all other settings, and return the values read back.

        With `silent` the steps are the same, so that neither relays nor timing reveal a catch trial, but no burst will
        be triggered; raises RigError for a repetition whose bursts play as soon as the outputs are on.
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
        """Switch the outputs on; enable the timer or trigger input, or restart a continuous record."""
        if self._continuous:
            self._controls.complete(self._table.align)
        self._controls.apply(self._instrument.on_all(self._table.output))
        if self._let_go != self._stopped:
            self._controls.apply(self._let_go)

    def order(self, n_bursts: int, first: float, timeout: float) -> Order:
        """Return the order for a pacer: the `first` burst due then, each to be accepted within `timeout` [s]."""
        return Order(self._table.trigger, n_bursts, first, self.period, self.duration, timeout)

    def set_levels(self, commanded: tuple[float, ...]) -> tuple[str, ...]:
        """Set both amplitudes in one message and return the values read back."""
        channels = zip(self._instrument.channels, commanded, strict=True)
        self._levels = tuple(self._instrument.level(channel, amplitude) for channel, amplitude in channels)
        return self._controls.apply(self._levels)

    def stop_trigger(self) -> None:
        """Disable the timer or the trigger input."""
        if self._let_go != self._stopped:
            self._controls.apply(self._stopped)

    def unlock(self) -> None:
        """Unlock the memories for other users, and switch the trigger output off."""
        headers = {setting.header for setting in (*self._table.locks, *self._table.pulses)}
        self._controls.apply_each([setting.off for setting in self._settings if setting.header in headers])


def _refuse_steps(burst: Burst) -> None:
    """Reject a burst that does not begin and end at rest."""
    for number, end in enumerate(burst.ends, start=1):
        if end > LARGEST_STEP:
            raise RigError(
                f"the record of output {number} begins or ends at {end:.1%} of its full scale: at most "
                f"{LARGEST_STEP:.0%} is allowed, since the outputs rest there between bursts; the outputs are off; "
                "ramp the drive on and off"
            )


def numbers(replies: tuple[str, ...]) -> tuple[float, ...]:
    """Convert values read back to numbers; empty if any of them is not a finite number."""
    try:
        values = tuple(float(reply) for reply in replies)
    except ValueError:
        return ()
    return values if all(map(math.isfinite, values)) else ()
