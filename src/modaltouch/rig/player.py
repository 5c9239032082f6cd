"""The burst in the instrument: its records, its settings, and what has it played; no failures here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.controls import CHANNELS, USER_MEMORIES, Controls, Unconfirmed
from modaltouch.rig.interface import RigError
from modaltouch.rig.pacing import Order
from modaltouch.rig.settings import (
    ARMED,
    STOPPED,
    Limits,
    Setting,
    amplitudes,
    burst_settings,
    continuous_codes,
    continuous_settings,
    guarded_settings,
    level_setting,
    lock_setting,
    record_peaks,
    refuse_steps,
    timer_setting,
)
from modaltouch.stimulus import Burst
from modaltouch.system import Clock

Repetition = Literal["single", "timer", "continuous", "wired"]
"""``single``: each burst is triggered by itself; ``timer``: by the free timer of the generator; ``wired``: by pulses at
its trigger input; ``continuous``: one record of a whole period plays on and on."""

RELAYS_SETTLE = 0.05
"""From switching the outputs on to the first burst [s]: relays close and bounce in a few milliseconds."""


class Player:
    """Plays one burst at a time, of those whose records lie in the instrument.

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
        self.repetition: Repetition = repetition
        self._continuous = repetition == "continuous"
        self._trigger_command = ""
        self._bursts: tuple[Burst, ...] = ()
        self._peaks: tuple[tuple[float, ...], ...] = ()
        self._chosen = 0
        self._by_burst: tuple[tuple[Setting, ...], ...] = ()
        self._settings: tuple[Setting, ...] = ()
        self._let_go = STOPPED
        self._levels: tuple[Setting, ...] = ()

    @property
    def expected(self) -> tuple[Setting, ...]:
        """Every setting that must read back while the burst plays."""
        return (*self._settings, *self._levels, *self._trigger(self._let_go))

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

    def take(self, bursts: Sequence[Burst]) -> None:
        """Make bursts those that can be played, the first of them chosen; `replay` brings them into the instrument.

        Raises
        ------
        RigError
            If one does not begin and end at rest, or they have more records than the instrument has memories.
        """
        self._bursts, self._settings, self._levels = (), (), ()
        for burst in bursts:
            refuse_steps(burst)
        records = {codes.tobytes() for burst in bursts for codes in self._records(burst)}
        if len(records) > len(USER_MEMORIES):
            raise RigError(
                f"the bursts have {len(records)} records: the generator has {len(USER_MEMORIES)} memories; the outputs "
                "are off; load fewer bursts"
            )
        self._bursts, self._chosen = tuple(bursts), 0
        self._peaks = tuple(record_peaks(burst) for burst in bursts)

    def replay(self) -> None:
        """Have the records in the instrument and make every setting but the level.

        Raises
        ------
        LinkError, Unconfirmed
            If the instrument does not confirm it.
        """
        self._settings = self._levels = ()
        if not self._bursts:
            return
        make = continuous_settings if self._continuous else burst_settings
        slots: list[int] = []
        by_burst: list[list[Setting]] = []
        for burst in self._bursts:
            by_burst.append([])
            for channel, record in zip(CHANNELS, self._records(burst), strict=True):
                slots.append(self._controls.store(record, channel, slots))
                by_burst[-1] += make(channel, slots[-1], burst)
            by_burst[-1] += [timer_setting(burst)] if self.repetition == "timer" else []
        locks = [lock_setting(slot, "ON") for slot in dict.fromkeys(slots)]
        self._controls.apply_each([*by_burst[self._chosen], *locks])
        if self.repetition == "single" and not self._trigger_command:
            self._trigger_command = self._controls.trigger_command()
            # What that has triggered, behind outputs that are off, is over before the first burst is due.
            self._clock.sleep(2 * max(burst.duration for burst in self._bursts))
        guarded = guarded_settings(self._limits)
        self._by_burst = tuple((*guarded, *settings, *locks) for settings in by_burst)
        self._settings = self._by_burst[self._chosen]

    def choose(self, which: int) -> None:
        """Play one of the bursts from now on; its records are there, so that settings alone change.

        Raises
        ------
        LinkError, Unconfirmed
            If the instrument does not confirm it.
        """
        if which == self._chosen or not self._settings:
            self._chosen = which
            return
        self._chosen, before = which, set(self._settings)
        # First the settings that will be: what fails on the way is found to differ, and made again.
        self._settings = self._by_burst[which]
        self._controls.apply_each([setting for setting in self._settings if setting not in before])

    def _records(self, burst: Burst) -> NDArray[np.uint16]:
        return continuous_codes(burst) if self._continuous else burst.codes

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
        return amplitudes(self._bursts[which], self._peaks[which], velocity, self._limits)

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
        self._let_go = ARMED if self.repetition == "timer" and not silent else STOPPED
        read_back = self.set_levels(commanded)
        changed = self._controls.differences([*self._settings, *self._trigger(STOPPED)])
        if changed:
            raise Unconfirmed("; ".join(changed), read_back)
        return read_back

    def switch_on(self) -> None:
        """Switch the outputs on; a timer is let go, and a continuous record begins with its first sample.

        Raises
        ------
        LinkError, Unconfirmed
            If the instrument does not confirm a step.
        """
        if self._continuous:
            self._controls.command("SOUR1:PHAS:INIT")
        self._controls.outputs_on()
        if self._let_go is ARMED:
            self._controls.apply([ARMED])

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
        """Set both amplitudes in one message, and return what was read back.

        Raises
        ------
        LinkError, Unconfirmed
            If the instrument does not confirm it.
        """
        channels = zip(CHANNELS, commanded, strict=True)
        self._levels = tuple(level_setting(channel, amplitude) for channel, amplitude in channels)
        return self._controls.apply(self._levels)

    def stop_trigger(self) -> None:
        """Let the trigger wait for an input that nothing is wired to.

        Raises
        ------
        LinkError, Unconfirmed
            If the instrument does not confirm it.
        """
        if self.repetition == "timer":
            self._controls.apply([STOPPED])

    def unlock(self) -> None:
        """Leave the memories to whoever comes next.

        Raises
        ------
        LinkError, Unconfirmed
            If the instrument does not confirm it.
        """
        locks = [setting for setting in self._settings if setting.of]
        self._controls.apply_each([replace(setting, value="OFF") for setting in locks])

    def _trigger(self, setting: Setting) -> tuple[Setting, ...]:
        return () if self._continuous else (setting,)


def numbers(replies: tuple[str, ...]) -> tuple[float, ...]:
    """Return what was read back as numbers; empty if it was not numbers."""
    try:
        return tuple(float(reply) for reply in replies)
    except ValueError:
        return ()
