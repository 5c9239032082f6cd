"""What is played to identify a rig: a burst that rings every modelled mode, and one that tells amplifier and clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus import (
    MID_CODE,
    Amplifier,
    Burst,
    ModalModel,
    Taper,
    Timing,
    peak_velocity,
    round_amplitude,
    round_to_codes,
    synthesise,
    unsigned_codes,
)

FloatArray = NDArray[np.float64]

SHARE = 0.6
"""Part of the amplifier's and of the velocity limit that identification uses [1]: the table may be wrong by a third."""

RISE, FALL = 1.0e-3, 0.05e-3
"""Tapers of a probe: its end is steep, so that the fastest modes still ring after it [s]."""

SWEEP = 2.0e-3
"""Length of each sweep of the timing burst [s]."""

_GOLDEN = np.pi * (3 - np.sqrt(5))


def probe_voltage(model: ModalModel, timing: Timing, channel: int) -> FloatArray:
    """Return voltages on one channel that ring every modelled mode at the focusing instant.

    Each mode is driven by its own decay, reversed in time, the strongest responding the least.

    Parameters
    ----------
    model : ModalModel
        The modes, known roughly.
    timing : Timing
        Clock of the samples; nothing is played after the focusing instant.
    channel : int
        Counted from 0.

    Returns
    -------
    (n_channels, n_samples) array
        Of no particular size.
    """
    n_before, _ = timing.samples_until(timing.focusing_instant)
    voltage = np.zeros((model.n_channels, timing.n_samples))
    response = np.abs(model.modal_gain).max(axis=1) / -model.exponent.real
    response = np.where(response > 0, response, np.median(response[response > 0]))
    # Phases by the golden angle keep the tones from peaking together.
    amplitude = (response**-0.5 * np.exp(1j * _GOLDEN * np.arange(model.n_modes)))[None, :]
    synthesise(amplitude, model.exponent, timing.hold, voltage[channel : channel + 1, :n_before])
    Taper.fitting(n_before, RISE * timing.sampling_rate, FALL * timing.sampling_rate).apply(
        voltage[channel : channel + 1, :n_before]
    )
    return voltage


def timing_voltage(model: ModalModel, timing: Timing) -> FloatArray:
    """Return voltages on all channels that tell the amplifier's lag at the start and at the end of a burst.

    Parameters
    ----------
    model : ModalModel
        The modes; the sweep covers their frequencies.
    timing : Timing
        Clock of the samples.

    Returns
    -------
    (n_channels, n_samples) array
        A sweep with soft ends within the first and within the last `SWEEP` seconds.
    """
    n = min(int(SWEEP * timing.sampling_rate), timing.n_samples // 2)
    time = np.arange(n) * timing.hold
    low, high = 0.2 * model.natural_frequency.max(), 1.2 * model.natural_frequency.max()
    high = min(high, timing.sampling_rate / 4)
    phase = 2 * np.pi * (low * time + 0.5 * (high - low) / (n * timing.hold) * time**2)
    sweep = np.sin(phase) * np.sin(np.pi * np.arange(n) / n) ** 2
    voltage = np.zeros((model.n_channels, timing.n_samples))
    voltage[:, :n] = sweep
    voltage[:, timing.n_samples - n :] = sweep
    return voltage


def identifying_burst(
    voltage: FloatArray,
    model: ModalModel,
    timing: Timing,
    amplifier: Amplifier,
    *,
    load_factor: float,
    velocity_limit: float,
) -> Burst:
    """Return a burst of voltages, as large as the limits allow with room for a table that is wrong by a third.

    Parameters
    ----------
    voltage : (n_channels, n_samples) array
        Of any size.
    model : ModalModel
        The modes, known roughly.
    timing : Timing
        Clock of the samples.
    amplifier : Amplifier
        Its gain and limit.
    load_factor : float
        Share of the generator's open-circuit voltage that reaches the amplifier [1].
    velocity_limit : float
        Highest velocity of the beam, and within the vibrometer's range [m/s].
    """
    points = np.linspace(-0.5, 0.5, 4 * max(model.label) + 1) * model.length
    speed = float(peak_velocity(model, voltage, timing, points).max())
    highest = np.abs(voltage).max(axis=1)
    scale = SHARE * min(amplifier.limit / highest.max(), velocity_limit / max(speed, 1e-30))
    to_beam = amplifier.gain * load_factor
    amplitude = [round_amplitude(2 * float(volts) * scale / to_beam) for volts in highest]
    # Amplitudes are rounded to the instrument's grid: codes are made for what it then plays.
    unit = np.array(amplitude) * to_beam / 2 / MID_CODE
    fitted = np.where(highest > 0, unit * MID_CODE / np.where(highest > 0, highest, 1.0), 0.0)
    codes = round_to_codes(voltage * fitted[:, None], unit)
    return Burst(
        codes=unsigned_codes(codes),
        duration=timing.duration,
        repetition_rate=timing.repetition_rate,
        velocity=speed * scale,
        amplitude=tuple(amplitude),
    )


def commanded_voltage(burst: Burst, to_beam: float, velocity: float | None = None) -> FloatArray:
    """Return what a burst commands at the beam, (n_channels, n_samples) array [V].

    Parameters
    ----------
    burst : Burst
        The burst.
    to_beam : float
        Volts at the beam per volt of the open generator, as told [1].
    velocity : float, optional
        Level [m/s]; the burst's own if not given.
    """
    amplitude = burst.amplitude if velocity is None else burst.amplitude_for(velocity)
    unit = np.array(amplitude) * (to_beam / 2 / MID_CODE)
    return np.asarray((burst.codes.astype(float) - MID_CODE) * unit[:, None])
