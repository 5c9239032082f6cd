"""The system driven by the simulated generator: amplifier, true beam, and the motion under the fingers."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from modaltouch.protocol import Apparatus
from modaltouch.rig.simulator.timeline import Playback
from modaltouch.rig.simulator.true_beam import (
    FloatArray,
    Held,
    generator_gains,
    refined,
    true_amplifier,
    true_beam,
)
from modaltouch.stimulus import BlockStates, DiagonalSystem

if TYPE_CHECKING:
    from modaltouch.rig.simulator.motion import StateHistory, TrueState
    from modaltouch.stimulus import Finger

SETTINGS_KEPT = 64
"""Number of cached settings with peaks, and of cached beams with fingers."""

Setting = tuple[Playback | None, ...]
"""Output of each channel."""


@dataclass
class Twin:
    """Amplifier and true beam behind a generator; results are computed on demand."""

    apparatus: Apparatus  # amplifier, load, and the identified beam
    seed: int  # seed of the differences between true and identified beam
    tripped: bool = False  # whether the amplifier's protection has disabled its output
    n_measured: int = field(default=0, init=False)  # number of measurements so far; the beam drifts with each
    # states of the beam for the latest measurement, with what they depend on
    histories: tuple[object, list[StateHistory]] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self.beam = true_beam(self.apparatus, self.seed)
        self.amplifier = true_amplifier(self.apparatus)
        self._gains = generator_gains(self.apparatus, self.seed) * (
            self.amplifier.gain * self.apparatus.generator.load_factor
        )
        # Limited caches, since a drifting beam has different equations for each measurement.
        self.peaks = functools.lru_cache(SETTINGS_KEPT)(self._peaks)
        """Peak speeds of a setting; valid for all levels of its records while beam and amplifier are linear."""
        self._system = functools.lru_cache(SETTINGS_KEPT)(
            lambda stretch, fingers: self.beam.equations(self.amplifier, fingers, stretch)
        )

    def fingers(self, *positions: float) -> list[Finger]:
        """Return the fingers of the section ``twin`` at positions on the beam [m]; empty if it has no finger."""
        section = self.beam.apparatus.twin.fingers
        return [] if section is None else [section.at(position) for position in positions]

    def system(self, touched: Sequence[Finger] = (), stretch: float = 1.0) -> DiagonalSystem:
        """Return the equations of the beam with fingers on it, behind its amplifier; `stretch` from that method."""
        return self._system(stretch, tuple(finger for finger in touched if finger.loads_beam))

    def stretch(self, playbacks: Sequence[Playback | None]) -> float:
        """Return the factor on every natural frequency during playback [1].

        Softening is that of a Duffing oscillator, proportional to the amplitude squared (Nayfeh & Mook 1979, Nonlinear
        Oscillations, sec. 4.1), linearised: throughout a burst the frequencies are those at its peak voltage.
        """
        twin = self.apparatus.twin
        highest = min(max(self._peak_voltages(playbacks), default=0.0) / self.amplifier.limit, 1.0)
        return 1.0 + twin.frequency_drift * self.n_measured - twin.softening * highest**2

    def felt(
        self,
        playbacks: Sequence[Playback | None],
        positions: Sequence[float],
        *,
        touched: Sequence[Finger] | None = None,
    ) -> FloatArray:
        """Return the peak speed at points of the beam for the output of the generator.

        The speed is the highest over one burst and the decay after it, (n_positions,) array [m/s]; 0 while nothing
        plays. Positions are from mid-beam [m]; by default, one finger is at each of them.
        """
        level = max((abs(playback.amplitude) for playback in playbacks if playback is not None), default=0.0)
        if level == 0:
            return np.zeros(len(positions))
        setting, scale, stretch = tuple(playbacks), 1.0, self.stretch(playbacks)
        if self._is_linear(playbacks):
            # The same records, scaled to at most 1 V, without offsets, which do not move the beam.
            unit = (
                each and replace(each, amplitude=round(each.amplitude / level, 12), offset=0.0) for each in playbacks
            )
            setting, scale = tuple(unit), level
        # Fingers that load the beam change its motion everywhere; the others only sense it.
        on_beam = self.fingers(*positions) if touched is None else touched
        fingers = tuple(sorted((finger for finger in on_beam if finger.loads_beam), key=lambda finger: finger.position))
        return scale * self.peaks(_once(setting), tuple(positions), fingers, stretch)

    def true_state(
        self,
        playbacks: Sequence[Playback | None],
        instant: float,
        *,
        first: bool = False,
        touched: Sequence[Finger] = (),
    ) -> TrueState:
        """Return the true state of the beam at an instant, not available from any instrument of the twin.

        The `instant` is the time since a trigger [s]: the first sample leaves the generator at 0 and moves the beam
        after the amplifier's delay. The `first` burst starts from rest, others after many.
        """
        from modaltouch.rig.simulator.motion import TrueState, state_at

        system = self.system(touched, self.stretch(playbacks))
        state = np.zeros(system.exponent.size, dtype=complex)
        for held in () if self.tripped else self.forces_of(playbacks):
            state = state + state_at(system, held, instant, first=first)
        velocity, displacement = (system.velocity @ state).real, (system.displacement @ state).real
        n_listed = self.beam.table.n_modes
        return TrueState(
            label=self.beam.table.label,
            velocity=velocity[:n_listed],
            displacement=displacement[:n_listed],
            unlisted_velocity=velocity[n_listed:],
        )

    def held_of(self, playbacks: Sequence[Playback | None]) -> list[Held]:
        """Return the amplifier's output, saturated at its limit: one entry per group of channels with equal timing."""
        clocks = dict.fromkeys(_clock(playback) for playback in playbacks if playback is not None)
        return [
            self._held([p if p is not None and _clock(p) == clock else None for p in playbacks]) for clock in clocks
        ]

    def forces_of(self, playbacks: Sequence[Playback | None]) -> list[Held]:
        """Return the forces on the beam, as voltages: the amplifier's output after the hysteresis of the actuators."""
        share, limit = self.apparatus.twin.hysteresis, self.amplifier.limit
        if not share:
            return self.held_of(playbacks)
        from modaltouch.rig.simulator.motion import lagging

        return [replace(held, voltage=lagging(held.voltage, share, limit)) for held in self.held_of(playbacks)]

    def _held(self, together: Sequence[Playback | None]) -> Held:
        first = next(playback for playback in together if playback is not None)
        n_samples, n_channels = len(first.record) // 2, self.beam.table.n_channels
        voltage, rest = np.zeros((n_channels, n_samples)), np.zeros(n_channels)
        limit = self.amplifier.limit
        for channel, playback in enumerate(together[:n_channels]):
            if playback is not None:
                zero, gain = playback.converter.mid_code, float(self._gains[channel])
                scale, shift = gain * playback.amplitude / (2 * zero), gain * playback.offset
                codes = np.frombuffer(playback.record, ">u2").astype(float)
                rest[channel] = np.clip((playback.idle_code - zero) * scale + shift, -limit, limit)
                voltage[channel] = np.clip((codes - zero) * scale + shift, -limit, limit) - rest[channel]
        return Held(voltage, rest, first.duration, first.period, first.converter)

    def _is_linear(self, playbacks: Sequence[Playback | None]) -> bool:
        """Test whether the motion of the beam is proportional to the level."""
        twin = self.apparatus.twin
        saturates = any(peak > self.amplifier.limit for peak in self._peak_voltages(playbacks))
        return not (saturates or twin.softening or twin.hysteresis or twin.finger_press_N)

    def _peak_voltages(self, playbacks: Sequence[Playback | None]) -> list[float]:
        """Return the peak voltage at the beam commanded by each output [V]."""
        return [
            (abs(each.amplitude) / 2 * record_peak(each.record, each.converter.mid_code) + abs(each.offset)) * gain
            for each, gain in zip(playbacks, self._gains.tolist(), strict=False)
            if each is not None
        ]

    def _peaks(
        self, setting: Setting, positions: tuple[float, ...], fingers: tuple[Finger, ...], stretch: float
    ) -> FloatArray:
        system, shapes, parts = self.system(fingers, stretch), self.beam.shapes(positions), self.forces_of(setting)
        press = self.apparatus.twin.finger_press_N
        if press is not None and fingers and len(parts) == 1:
            from modaltouch.rig.simulator.lift_off import PressedBeam

            pressed = PressedBeam.of(self.beam, self.amplifier, fingers, press, stretch)
            return np.asarray(np.abs(shapes.T @ pressed.velocities(*refined(system, parts[0]))).max(axis=1))
        output = shapes.T @ system.velocity
        # An upper bound for channels with different clocks, which it reaches if they drift relative to each other.
        peaks = (BlockStates.of(system, held.voltage, held.timing).peak(output) for held in parts)
        return sum(peaks, np.zeros(len(positions)))


def _once(setting: Setting) -> Setting:
    """Convert bursts followed by a pause to single bursts, since peaks are computed from rest anyway."""
    playing = [playback for playback in setting if playback is not None]
    if len({_clock(playback) for playback in playing}) > 1:
        return setting
    if playing[0].period <= playing[0].duration:
        return setting
    return tuple(playback and replace(playback, period=math.inf) for playback in setting)


def _clock(playback: Playback) -> tuple[float, ...]:
    return len(playback.record), playback.duration, playback.period


@functools.lru_cache(maxsize=8)
def record_peak(record: bytes, zero: int) -> float:
    """Return the peak magnitude of a record, as a fraction of half its amplitude [1]; `zero` is its code for 0 V."""
    return float(np.abs(np.frombuffer(record, ">u2").astype(int) - zero).max() / zero)
