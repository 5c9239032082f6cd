"""A generator as a value: specifications, table of commands, and the limits set by an apparatus.

`generator` and its helpers treat all instruments alike (outputs off at the end of every session, settings read back,
watchdog, settings restored). Everything specific to an instrument is in a separate module such as `afg3022b`:
specifications, table of commands, and storage of records.
"""

from __future__ import annotations

import math
import typing
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol import Apparatus
from modaltouch.rig.interface import RigError
from modaltouch.stimulus import Burst, Converter


@dataclass(frozen=True)
class Setting:
    """One setting of an instrument: command, query, and the replies that confirm it.

    In a table of commands, braces stand for a channel or a memory, and a lower-case value names a quantity.

    Attributes
    ----------
    header : str
        SCPI header.
    value : float or str
        A number, or a keyword in its short form.
    unit : str
        Unit sent with a number.
    tolerance : float
        Relative tolerance of a number on read-back [1].
    of : str
        Object of the setting, such as a memory, if not part of the header.
    replies : tuple of str
        Replies that confirm a keyword; by default the keyword as sent, or 0 or 1 for a boolean.
    """

    header: str
    value: float | str
    unit: str = ""
    tolerance: float = 1e-4
    of: str = ""
    replies: tuple[str, ...] = ()

    @property
    def off(self) -> Setting:
        """The same setting with the value ``OFF``."""
        return replace(self, value="OFF")

    @property
    def command(self) -> str:
        """Command that applies the setting."""
        value = self.value if isinstance(self.value, str) else f"{self.value:.12g}{self.unit}"
        return f"{self.header} {self.of},{value}" if self.of else f"{self.header} {value}"

    @property
    def query(self) -> str:
        """Query that reads the setting back."""
        return f"{self.header}? {self.of}" if self.of else f"{self.header}?"

    def confirmed_by(self, reply: str) -> bool:
        """Test whether a reply to the query confirms the setting."""
        if isinstance(self.value, str) and self.value != "INF":
            # A suffix of 1 may be omitted (SCPI-99, volume 1, 6.2.5.2).
            shown = {"ON": "1", "OFF": "0"}.get(self.value, self.value.removesuffix("1"))
            return reply.upper() in {each.upper() for each in self.replies or (self.value, shown)}
        try:
            number = float(reply)
        except ValueError:
            return False
        if isinstance(self.value, str):
            return number >= 9.9e37
        return math.isclose(number, self.value, rel_tol=self.tolerance, abs_tol=0.0 if self.value else 1e-4)

    def filled(self, **quantities: float | str) -> Setting:
        """Fill channel, memory and value into an entry of a table of commands."""
        value = quantities.get(self.value, self.value.format(**quantities)) if isinstance(self.value, str) else None
        return replace(
            self,
            header=self.header.format(**quantities),
            value=self.value if value is None else value,
            of=self.of.format(**quantities),
            replies=tuple(reply.format(**quantities) for reply in self.replies),
        )


class Records(typing.Protocol):
    """Interface to store and verify waveform records in an instrument."""

    @property
    def n_memories(self) -> int:
        """Number of different records that fit at the same time."""

    def store(self, controls: Any, records: Sequence[tuple[int, NDArray[np.uint16]]]) -> list[str]:
        """Store records, verify each for its channel, and return the value of ``{memory}`` for each.

        A record already stored, as known from this session or read back, is not sent again. `controls` is the
        `modaltouch.rig.controls.Controls` of the open instrument. Raises LinkError if the connection breaks,
        Unconfirmed if a record cannot be verified after two uploads.
        """


@dataclass(frozen=True)
class Commands:
    """Table of commands of a generator: settings in which braces stand for channel and memory.

    Attributes
    ----------
    output, level : Setting
        Output of a ``{channel}`` on, and its ``amplitude``.
    quiet : tuple of Setting
        Settings of a ``{channel}`` before anything is loaded: load and units, standby amplitude (``quiet_amplitude``),
        voltage limits (``highest``, ``lowest``).
    burst, continuous : tuple of Setting
        Settings for a ``{channel}`` to play a ``{memory}``, followed by those in `triggered`, or to repeat it without a
        trigger, at a ``burst_rate`` or ``repetition_rate`` of records, or a ``sampling_rate``.
    triggered : tuple of Setting
        Settings for a ``{channel}`` to play its waveform once per trigger.
    stopped, wired : Setting
        Trigger source: commands only, or the trigger input; per ``{channel}`` if the channels have separate sources.
    trigger : str
        Command that triggers a burst on all channels.
    align : str
        Command that restarts repeating records at their first sample, on all channels.
    pulses : tuple of Setting
        Settings for a pulse at the trigger output with each commanded burst; empty if there always is one.
    timer, armed : Setting or None
        Time between triggers (``period``), and this timer as the trigger source; None if the channels share no timer.
    locks : tuple of Setting
        Settings that protect a ``{memory}`` from changes at the front panel; empty if there is no such lock.
    marks : tuple of Setting
        A ``mark``, different for different records, on the memory via which every record is stored. Storing another
        record erases it, even if the memories are unlocked and locked again. Empty if there is no such memory.
    """

    output: Setting
    level: Setting
    quiet: tuple[Setting, ...]
    burst: tuple[Setting, ...]
    continuous: tuple[Setting, ...]
    triggered: tuple[Setting, ...]
    stopped: Setting
    wired: Setting
    trigger: str
    align: str
    pulses: tuple[Setting, ...] = ()
    timer: Setting | None = None
    armed: Setting | None = None
    locks: tuple[Setting, ...] = ()
    marks: tuple[Setting, ...] = ()


@dataclass(frozen=True)
class Instrument:
    """A two-channel generator."""

    models: tuple[str, ...]  # model names in the reply to ``*IDN?``; the specifications are those of the first
    converter: Converter  # codes, record length, clock and amplitude grid
    channels: tuple[int, ...]  # numbers of its outputs
    # lowest_amplitude, quiet_amplitude: smallest amplitude and standby amplitude, into an open circuit [V peak to peak]
    lowest_amplitude: float
    quiet_amplitude: float
    highest_output: float  # largest output magnitude into an open circuit [V]
    commands: Commands
    records: Records  # storage of waveform records
    questions: tuple[int, ...]  # numbers of the questions that `modaltouch rig check` answers for this instrument

    @property
    def off(self) -> str:
        """Message that switches all outputs off and queries their state; on a second line, the trigger output off."""
        outputs = self.on_all(self.commands.output)
        commands = [*(each.off.command for each in outputs), *(each.query for each in outputs)]
        lines = commands, [each.off.command for each in self.commands.pulses]
        return "\n".join(";".join(f":{part}" for part in line) for line in lines if line)

    def on_all(self, entry: Setting, **quantities: float) -> tuple[Setting, ...]:
        """Fill in an entry for every channel, or once if it applies to all channels."""
        return tuple(dict.fromkeys(entry.filled(channel=channel, **quantities) for channel in self.channels))

    def is_simulated(self, identity: str) -> bool:
        """Test whether a reply to ``*IDN?`` is that of the simulator, whose serial number is SIMULATED."""
        return "SIMULATED" in identity.split(",")

    def limits(self, apparatus: Apparatus) -> Limits:
        """Return the limits of the outputs in an apparatus."""
        gain, velocity = apparatus.to_beam, apparatus.safety.velocity_limit_mm_s * 1e-3
        return Limits(self, self.highest_level(apparatus), apparatus.amplifier.limit_V, gain, velocity)

    def highest_level(self, apparatus: Apparatus) -> float:
        """Return the largest output magnitude, into an open circuit, allowed by amplifier and generator [V]."""
        # Rounded down to 10 mV, so that rounding by the instrument cannot exceed it.
        return min(math.floor(apparatus.amplifier.limit_V / apparatus.to_beam * 100 + 1e-6) / 100, self.highest_output)

    def level(self, channel: int, amplitude: float) -> Setting:
        """Return the setting of an amplitude, into an open circuit [V peak to peak]."""
        return self.commands.level.filled(channel=channel, amplitude=amplitude)

    def burst_settings(self, channel: int, memory: str, burst: Burst, *, continuous: bool) -> tuple[Setting, ...]:
        """Return the settings for a channel to play a memory once per trigger, or to repeat it without triggers."""
        table = self.commands.continuous if continuous else (*self.commands.burst, *self.commands.triggered)
        whole = self.converter.max_points * burst.repetition_rate
        rates = {
            "burst_rate": 1 / burst.duration,
            "repetition_rate": burst.repetition_rate,
            "sampling_rate": whole if continuous else burst.codes.shape[1] / burst.duration,
        }
        return tuple(entry.filled(channel=channel, memory=memory, **rates) for entry in table)

    def timer(self, burst: Burst) -> tuple[Setting, ...]:
        """Return the setting of the time between triggers; empty if the channels share no timer."""
        entry = self.commands.timer
        return () if entry is None else self.on_all(entry, period=1 / burst.repetition_rate)

    def continuous_codes(self, burst: Burst) -> NDArray[np.uint16]:
        """Return codes, (n_channels, max_points) array, of a whole period, to be repeated without burst mode.

        It is not exact, since the steps of the burst are shifted to the nearest point of the longest record: at 7 Hz
        and 131,072 points by up to 0.55 us. With the shipped stimulus of 200 mm/s, modal velocities are then off by up
        to 0.014 mm/s, compared with 1e-5 mm/s for the burst itself (computed by `modaltouch.preflight.exploration`).
        """
        n_channels, n_samples = burst.codes.shape
        n_points = self.converter.max_points
        middles = (np.arange(n_points) + 0.5) / (n_points * burst.repetition_rate)
        held = np.floor(middles / burst.duration * n_samples).astype(int)
        codes = np.full((n_channels, n_points), self.converter.mid_code, dtype=np.uint16)
        playing = held < n_samples
        codes[:, playing] = burst.codes[:, held[playing]]
        return codes


@dataclass(frozen=True)
class Limits:
    """Limits of the outputs of a generator in an apparatus."""

    instrument: Instrument
    level: float  # largest output magnitude into an open circuit [V]
    beam: float  # highest voltage at the beam [V]
    gain: float  # voltage at the beam per open-circuit voltage of the generator [V/V]
    velocity: float  # highest peak velocity at the focus [m/s]

    @property
    def quiet_amplitude(self) -> float:
        """Standby amplitude of an idle channel [V peak to peak]."""
        return min(self.instrument.quiet_amplitude, 2 * self.level)

    def quiet_settings(self, channel: int) -> tuple[Setting, ...]:
        """Return the settings applied once, before anything is loaded: load, units, standby amplitude, limits."""
        bounds = {"highest": self.level, "lowest": -self.level, "quiet_amplitude": self.quiet_amplitude}
        return tuple(entry.filled(channel=channel, **bounds) for entry in self.instrument.commands.quiet)

    def guarded_settings(self) -> tuple[Setting, ...]:
        """Return the quiet settings of all channels that remain valid during stimuli: all except the amplitude."""
        levels = [level.query for level in self.instrument.on_all(self.instrument.commands.level)]
        quiet = [setting for channel in self.instrument.channels for setting in self.quiet_settings(channel)]
        return tuple(setting for setting in quiet if setting.query not in levels)

    def amplitudes(self, burst: Burst, velocity: float) -> tuple[float, ...]:
        """Return the amplitude of each channel at a level [m/s], into an open circuit [V peak to peak].

        Raises RigError if the level exceeds a limit or cannot be played.
        """
        if not (math.isfinite(velocity) and 0 < velocity <= self.velocity):
            raise RigError(
                f"a peak velocity of {velocity * 1e3:g} mm/s was asked for: allowed above 0, up to the safety "
                f"limit of {self.velocity * 1e3:g} mm/s; the outputs stay off; change the protocol, or the "
                "limit in the apparatus file"
            )
        each = zip(burst.amplitude_for(velocity), burst.shares.tolist(), burst.peaks, strict=True)
        return tuple(self._playable(number, *needed, velocity) for number, needed in enumerate(each, start=1))

    def _playable(self, number: int, amplitude: float, share: float, peak: float, velocity: float) -> float:
        where = f"{velocity * 1e3:g} mm/s needs {amplitude:g} V peak to peak of output {number}"
        remedy = "the outputs stay off; lower the velocity, or correct the apparatus file"
        if peak == 0:
            return self.quiet_amplitude
        beam = amplitude / share / 2 * peak * self.gain
        if not beam <= self.beam * (1 + 1e-9):
            raise RigError(f"{where}, {beam:.1f} V at the beam: allowed at most {self.beam:g} V; {remedy}")
        # A record that uses only a fraction of the codes covers only that fraction of the output range.
        lowest, highest = self.instrument.lowest_amplitude, 2 * self.level * share
        if not lowest <= amplitude <= highest:
            raise RigError(f"{where}: allowed {lowest:g} to {highest:g} V; {remedy}")
        return amplitude
