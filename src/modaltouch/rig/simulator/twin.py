"""What lies behind the simulated generator: amplifier, the true beam, and what fingers on it feel."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from modaltouch.apparatus import Apparatus
from modaltouch.rig.simulator.afg import MID_CODE, Playback
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.timing import Timing
from modaltouch.stimulus.vibration import peak_velocity

FloatArray = NDArray[np.float64]
Setting = tuple[Playback | None, ...]
"""What each channel sends."""


def true_beam(apparatus: Apparatus, seed: int) -> ModalModel:
    """Return the beam as it is, which its identification does not quite meet.

    Natural frequencies, damping ratios and gains are those of the table times a log-normal factor of the stated
    relative spread, and each actuator set also drives the modes that the table leaves to another.

    Parameters
    ----------
    apparatus : Apparatus
        The identified beam, and in its section ``twin`` how far the true one is from it.
    seed : int
        Equal seeds give equal beams; changing one mismatch leaves the draws of the others alone.

    Returns
    -------
    ModalModel
        With a gain for every mode and channel.
    """
    twin, model = apparatus.twin, apparatus.modal_model()
    streams = np.random.default_rng(seed).spawn(3)
    frequency_draw, damping_draw = (rng.standard_normal(model.n_modes) for rng in streams[:2])
    gain_draw = streams[2].standard_normal(model.modal_gain.shape)
    gain = model.modal_gain.copy()
    strongest = np.take_along_axis(gain, np.abs(gain).argmax(axis=1)[:, None], axis=1)
    gain = np.where(gain == 0, twin.cross_gain * strongest, gain)
    return replace(
        model,
        natural_frequency=model.natural_frequency * np.exp(twin.natural_frequency_mismatch * frequency_draw),
        damping_ratio=np.minimum(model.damping_ratio * np.exp(twin.damping_ratio_mismatch * damping_draw), 0.99),
        modal_gain=gain * np.exp(twin.gain_mismatch * gain_draw),
    )


@dataclass
class Twin:
    """Amplifier and true beam behind a generator; computes a speed only when asked for it.

    Attributes
    ----------
    apparatus : Apparatus
        Amplifier, load, and the identified beam.
    seed : int
        Of the differences between true and identified beam.
    tripped : bool
        Whether the amplifier's protection has cut its output.
    n_computed : int
        Responses computed so far: another level of the same records needs none, as long as nothing saturates.
    """

    apparatus: Apparatus
    seed: int
    tripped: bool = False
    n_computed: int = field(default=0, init=False)
    _setting: Setting = field(default=(), init=False, repr=False)
    _felt: dict[float, float] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        self.beam = true_beam(self.apparatus, self.seed)

    def felt(self, playbacks: Sequence[Playback | None], positions: Sequence[float]) -> FloatArray:
        """Return the peak speed at points of the beam while the generator sends what it sends.

        Parameters
        ----------
        playbacks : sequence of Playback or None
            What each channel sends.
        positions : sequence of float
            Where, origin at mid-beam [m].

        Returns
        -------
        (n_positions,) array
            Highest speed over one burst and the decay after it [m/s]; 0 while nothing plays.
        """
        level = max((abs(playback.amplitude) for playback in playbacks if playback is not None), default=0.0)
        if self.tripped or level == 0:
            return np.zeros(len(positions))
        setting, scale = tuple(playbacks), 1.0
        if not any(self._saturates(playback) for playback in playbacks if playback is not None):
            setting, scale = _at_unit_level(playbacks, level), level
        if setting != self._setting:
            self._setting, self._felt = setting, {}
        missing = [x for x in dict.fromkeys(positions) if x not in self._felt]
        if missing:
            self.n_computed += 1
            self._felt.update(zip(missing, self._compute(setting, missing), strict=True))
        return scale * np.array([self._felt[x] for x in positions])

    def _saturates(self, playback: Playback) -> bool:
        """Return whether the amplifier reaches its limit."""
        peak = abs(playback.amplitude) / 2 * record_peak(playback.record) + abs(playback.offset)
        return peak * self._gain > self.apparatus.amplifier.limit_V

    @property
    def _gain(self) -> float:
        """Volts at the beam per open-circuit volt of the generator [1]."""
        return self.apparatus.amplifier.gain_V_per_V * self.apparatus.generator.load_factor

    def _compute(self, setting: Setting, positions: Sequence[float]) -> list[float]:
        amplifier = self.apparatus.amplifier_values()
        total = np.zeros(len(positions))
        # Bursts of unequal rate slide past each other, so that sooner or later their peaks meet.
        for clock in dict.fromkeys(_clock(playback) for playback in setting if playback is not None):
            together = [p if p is not None and _clock(p) == clock else None for p in setting]
            voltage, timing = self.beam_voltage(together)
            total += peak_velocity(self.beam, voltage, timing, positions, amplifier)
        return [float(speed) for speed in total]

    def beam_voltage(self, setting: Sequence[Playback | None]) -> tuple[FloatArray, Timing]:
        """Return the voltage that the amplifier gives during one burst, as a change from its idle level.

        Parameters
        ----------
        setting : sequence of Playback or None
            What each channel sends: records of one length, duration and period, at least one.

        Returns
        -------
        voltage : (n_channels, n_samples) array
            Held samples at the beam, saturated at the amplifier's limit [V].
        timing : Timing
            Clock of the samples.
        """
        first = next(playback for playback in setting if playback is not None)
        n_samples = len(first.record) // 2
        voltage = np.zeros((self.beam.n_channels, n_samples))
        for row, playback in zip(voltage, setting, strict=False):
            if playback is not None:
                row[:] = self._amplify(playback)
        period = max(min(first.period, 10 * first.duration), first.duration)
        timing = Timing(
            n_samples=n_samples,
            duration=first.duration,
            focusing_instant=first.duration / 2,
            repetition_rate=1 / period,
        )
        return voltage, timing

    def _amplify(self, playback: Playback) -> FloatArray:
        scale, shift = self._gain * playback.amplitude / (2 * MID_CODE), self._gain * playback.offset
        limit = self.apparatus.amplifier.limit_V
        codes = np.frombuffer(playback.record, ">u2").astype(float)
        rest = np.clip((playback.idle_code - MID_CODE) * scale + shift, -limit, limit)
        return np.asarray(np.clip((codes - MID_CODE) * scale + shift, -limit, limit) - rest)


def _at_unit_level(playbacks: Sequence[Playback | None], level: float) -> Setting:
    """Return the same records with the larger amplitude at 1 V, where a constant offset moves nothing."""
    return tuple(
        p if p is None else replace(p, amplitude=round(p.amplitude / level, 12), offset=0.0) for p in playbacks
    )


def _clock(playback: Playback) -> tuple[int, float, float]:
    return len(playback.record), playback.duration, playback.period


@functools.lru_cache(maxsize=8)
def record_peak(record: bytes) -> float:
    """Return the highest value of a record, as a part of half its amplitude [1]."""
    return float(np.abs(np.frombuffer(record, ">u2").astype(int) - MID_CODE).max() / MID_CODE)
