"""The burst in the instrument: its records, its settings, and the order in which it starts; no failures here."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Literal

from modaltouch.rig.controls import CHANNELS, Controls, Unconfirmed
from modaltouch.rig.interface import Firing, RigError
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
from modaltouch.stimulus.burst import Burst

Repetition = Literal["burst", "continuous"]
"""``burst``: one record at each tick of the trigger timer; ``continuous``: one record of a whole period."""


class Player:
    """Plays one burst at a time.

    Parameters
    ----------
    controls : Controls
        Of an open instrument.
    limits : Limits
        What may leave it.
    repetition : str
        How the burst repeats.
    """

    def __init__(self, controls: Controls, limits: Limits, repetition: Repetition) -> None:
        self._controls = controls
        self._limits = limits
        self._continuous = repetition == "continuous"
        self._burst: Burst | None = None
        self._peaks: tuple[float, ...] = ()
        self._settings: tuple[Setting, ...] = ()
        self._let_go = ARMED
        self._at_rest = 0.0
        self._levels: tuple[Setting, ...] = ()

    @property
    def expected(self) -> tuple[Setting, ...]:
        """Every setting that must read back while the burst plays."""
        return (*self._settings, *self._levels, *self._trigger(self._let_go))

    def take(self, burst: Burst) -> None:
        """Make a burst the one to be played; `replay` brings it into the instrument.

        Raises
        ------
        RigError
            If it does not begin and end at rest.
        """
        self._burst, self._settings, self._levels = None, (), ()
        refuse_steps(burst)
        self._burst, self._peaks = burst, record_peaks(burst)

    def replay(self) -> None:
        """Have the records in the instrument and make every setting but the level.

        Raises
        ------
        LinkError, Unconfirmed
            If the instrument does not confirm it.
        """
        self._settings = self._levels = ()
        if self._burst is None:
            return
        codes = continuous_codes(self._burst) if self._continuous else self._burst.codes
        make = continuous_settings if self._continuous else burst_settings
        slots: list[int] = []
        settings: list[Setting] = []
        for channel, record in zip(CHANNELS, codes, strict=True):
            slots.append(self._controls.store(record, channel, slots))
            settings += [*make(channel, slots[-1], self._burst), lock_setting(slots[-1], "ON")]
        settings += [] if self._continuous else [timer_setting(self._burst)]
        self._controls.apply_each(settings)
        self._settings = (*guarded_settings(self._limits), *settings)

    def amplitudes(self, velocity: float) -> tuple[float, ...]:
        """Return the amplitude of each channel at a level [m/s], open circuit [V peak to peak].

        Raises
        ------
        RigError
            If nothing is loaded, or the level is beyond a limit.
        """
        # Settings are there only once every record was verified and every setting read back.
        if self._burst is None or not self._settings:
            raise RigError(
                "fire was called before a burst was loaded and verified; the outputs are off; load a burst first"
            )
        return amplitudes(self._burst, self._peaks, velocity, self._limits)

    def start(self, commanded: tuple[float, ...], *, silent: bool = False) -> Firing:
        """Set both levels with the trigger stopped, see that nothing else changed, switch on, let the trigger go.

        `silent` goes through the same steps, so that relays and time betray nothing, but the trigger stays stopped.

        Raises
        ------
        RigError
            If it shall be silent and the repetition knows no trigger.
        LinkError, Unconfirmed
            If the instrument does not confirm a step.
        """
        if silent and self._continuous:
            raise RigError(
                "a catch trial needs the repetition `burst`: a continuous record plays as soon as the outputs are "
                "on; the outputs are off; leave out schedule.catch_trials"
            )
        self._let_go = STOPPED if silent else ARMED
        read_back = self.set_levels(commanded)
        changed = self._controls.differences([*self._settings, *self._trigger(STOPPED)])
        if changed:
            raise Unconfirmed("; ".join(changed), read_back)
        if silent:
            # A burst that had begun when the trigger was stopped plays to its end.
            time.sleep(max(self._at_rest - time.perf_counter(), 0.0))
        if self._continuous:
            self._controls.command("SOUR1:PHAS:INIT")
        started = time.perf_counter()
        self._controls.outputs_on()
        if not self._continuous:
            started = time.perf_counter()
            self._controls.apply([self._let_go])
        took = time.perf_counter() - started
        period = 1 / self._burst.repetition_rate if self._burst is not None else 0.0
        return Firing(commanded, numbers(read_back), True, started, took + period)

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
        self._controls.apply_each(self._trigger(STOPPED))
        self._at_rest = time.perf_counter() + (self._burst.duration if self._burst is not None else 0.0)

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
