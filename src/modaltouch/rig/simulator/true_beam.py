"""The true beam of a twin, with unlisted modes, deviations from the mode table and fingers, under held bursts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.protocol import Apparatus
from modaltouch.rig.simulator.timeline import CONVERTER
from modaltouch.stimulus import Amplifier, Converter, DiagonalSystem, ModalModel, Timing, mode_shapes

if TYPE_CHECKING:
    from modaltouch.stimulus import Finger

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

LARGEST_PHASE_STEP = 0.3
"""Phase of the fastest mode between computed instants [rad], for which the error of cubic interpolation is 2e-5."""

LONGEST_SILENCE = 10
"""Time over which a burst and its decay are followed, in durations of the burst [1]."""


@dataclass(frozen=True, eq=False)
class TrueBeam:
    """All modes of a beam, those of the table first."""

    table: ModalModel  # the modes of the table with their true values
    apparatus: Apparatus  # the apparatus; its section ``twin`` lists the modes not in the table
    # (n_unlisted, n_channels): modal gains of the unlisted modes, accelerations per volt at the beam [m/s^2 per V]
    unlisted_gain: FloatArray
    width: float  # width of the beam, for its torsion modes [m]
    mass: float  # moving mass of the beam [kg]

    @cached_property
    def natural_frequency(self) -> FloatArray:
        """Undamped natural frequency of each mode, without fingers, (n_modes,) array [Hz]."""
        return np.append(
            self.table.natural_frequency, [mode.natural_frequency_Hz for mode in self.apparatus.twin.unlisted_modes]
        )

    @cached_property
    def damping_ratio(self) -> FloatArray:
        """Damping ratio of each mode, without fingers, (n_modes,) array [1]."""
        return np.append(self.table.damping_ratio, [mode.damping_ratio for mode in self.apparatus.twin.unlisted_modes])

    @cached_property
    def modal_gain(self) -> FloatArray:
        """Modal acceleration per volt at the beam, (n_modes, n_channels) array [m/s^2 per V]."""
        return np.concatenate([self.table.modal_gain, self.unlisted_gain])

    def shapes(self, position: ArrayLike, offset: ArrayLike = 0.0) -> FloatArray:
        """Return the mode shapes at points of the beam, (n_modes, n_points) array [1].

        `position` is along the beam from its middle, `offset` across it from its mid-line [m].
        """
        x = np.atleast_1d(np.asarray(position, dtype=float))
        across = np.broadcast_to(np.asarray(offset, dtype=float), x.shape)
        rows = [self.table.shapes(x)]
        for mode in self.apparatus.twin.unlisted_modes:
            if mode.family == "bending":
                rows.append(mode_shapes([mode.label], x, self.table.length))
            else:
                # A torsion shape of a uniform free-free beam, of unit mean square over its area.
                order = mode.label
                along = (-1) ** order * np.cos(order * math.pi * (x / self.table.length + 0.5))
                rows.append((math.sqrt(24.0) * across / self.width * along)[None])
        return np.concatenate(rows)

    def equations(self, amplifier: Amplifier, touched: Sequence[Finger] = (), stretch: float = 1.0) -> DiagonalSystem:
        """Return the equations of the beam behind its amplifier, with fingers on it.

        Fingers couple all modes, torsion included (see `modaltouch.stimulus.fingers`). The inputs are the amplifier's
        output voltages without its pole and delay; `stretch` is a factor on every natural frequency [1].
        """
        loads = [(finger.contact(self._over_width, self.table.length) / self.mass, finger) for finger in touched]
        return DiagonalSystem.of_modes(
            2 * np.pi * stretch * self.natural_frequency, self.damping_ratio, self.modal_gain, loads, amplifier
        )

    def _over_width(self, along: FloatArray) -> FloatArray:
        """Return the mode shapes on two lines at +-width / sqrt(12), where torsion has its mean square."""
        across = self.width / math.sqrt(12.0) * np.repeat([-1.0, 1.0], along.size)
        return self.shapes(np.tile(along, 2), across)


def true_beam(apparatus: Apparatus, seed: int) -> TrueBeam:
    """Return the true beam, which deviates from the identified one.

    Natural frequencies, damping ratios and modal gains are those of the table times a log-normal factor with the
    relative spread in section ``twin``. Each actuator set also drives the modes that the table assigns to another one,
    and there are modes not in the table. Equal seeds give equal beams; changing one deviation does not affect the draws
    of the others.
    """
    twin, model = apparatus.twin, apparatus.modal_model()
    streams = np.random.default_rng(seed).spawn(3)
    frequency_draw, damping_draw = (rng.standard_normal(model.n_modes) for rng in streams[:2])
    gain_draw = streams[2].standard_normal(model.modal_gain.shape)
    gain = model.modal_gain.copy()
    strongest = np.take_along_axis(gain, np.abs(gain).argmax(axis=1)[:, None], axis=1)
    gain = np.where(gain == 0, twin.cross_gain * strongest, gain)
    table = replace(
        model,
        natural_frequency=model.natural_frequency * np.exp(twin.natural_frequency_mismatch * frequency_draw),
        damping_ratio=np.minimum(model.damping_ratio * np.exp(twin.damping_ratio_mismatch * damping_draw), 0.99),
        modal_gain=gain * np.exp(twin.gain_mismatch * gain_draw),
    )
    unlisted_gain = np.zeros((len(twin.unlisted_modes), model.n_channels))
    for row, mode in zip(unlisted_gain, twin.unlisted_modes, strict=True):
        for name, value in mode.gain_mm_s2_per_V.items():
            row[apparatus.actuator_sets[name].channel - 1] = value * 1e-3
    return TrueBeam(
        table=table,
        apparatus=apparatus,
        unlisted_gain=unlisted_gain,
        width=apparatus.beam.width_mm * 1e-3,
        mass=apparatus.beam.mass if twin.beam_mass_g is None else twin.beam_mass_g * 1e-3,
    )


def generator_gains(apparatus: Apparatus, seed: int) -> FloatArray:
    """Return the true output voltage per volt set on each generator output, (n_channels,) array [V/V]."""
    n_channels = apparatus.modal_model().n_channels
    draw = np.random.default_rng(seed).spawn(4)[3].standard_normal(n_channels)
    return np.asarray(np.exp(apparatus.twin.generator_gain_mismatch * draw))


def true_amplifier(apparatus: Apparatus) -> Amplifier:
    """Return the true amplifier, in SI units; values not given in ``twin`` are the identified ones."""
    known, true = apparatus.amplifier_values(), apparatus.twin.amplifier
    return Amplifier(
        gain=known.gain if true.gain_V_per_V is None else true.gain_V_per_V,
        limit=known.limit if true.limit_V is None else true.limit_V,
        bandwidth=known.bandwidth if true.bandwidth_kHz is None else true.bandwidth_kHz * 1e3,
        delay=known.delay if true.delay_us is None else true.delay_us * 1e-6,
    )


@dataclass(frozen=True, eq=False)
class Held:
    """The held samples of single or repeated bursts, as voltages before the amplifier's pole."""

    voltage: FloatArray  # (n_channels, n_samples): deviation from the voltage at rest [V]
    rest: FloatArray  # (n_channels,): voltage at rest, between bursts [V]
    duration: float  # duration of one burst [s]
    period: float  # time from one burst to the next [s]; infinite for a single burst
    converter: Converter = CONVERTER

    @property
    def hold(self) -> float:
        """Duration of each sample [s]."""
        return self.duration / int(self.voltage.shape[1])

    @property
    def timing(self) -> Timing:
        """Clock of one burst."""
        return Timing(
            self.converter,
            n_samples=self.voltage.shape[1],
            duration=self.duration,
            focusing_instant=self.duration / 2,
            repetition_rate=1 / min(self.period, LONGEST_SILENCE * self.duration),
        )

    def within_period(self, time: FloatArray) -> FloatArray:
        """Return times since the start of the latest burst [s]; times before a single burst stay negative."""
        if math.isinf(self.period):
            return time
        return time if time.min() >= 0 and time.max() < self.period else np.mod(time, self.period)


def refined(system: DiagonalSystem, held: Held) -> tuple[FloatArray, float]:
    """Return the voltages on a grid in which no mode advances by more than LARGEST_PHASE_STEP, and its step [s]."""
    times = max(1, math.ceil(float(np.abs(system.exponent.imag).max()) * held.hold / LARGEST_PHASE_STEP))
    return held.voltage if times == 1 else np.repeat(held.voltage, times, axis=1), held.hold / times
