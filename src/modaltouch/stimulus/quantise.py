"""From volts to codes: one record for every level, on the generator's grid of amplitudes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.burst import MID_CODE, round_amplitude

FloatArray = NDArray[np.float64]

_LONGEST_STRETCH = 1.05
"""A full scale may pass the peak by this factor, which costs a fifteenth of a bit."""


def full_scale(least: float, shares: tuple[float, ...]) -> float:
    """Return an amplitude at or above the least whose shares lie on the generator's grid too.

    Parameters
    ----------
    least : float
        Smallest amplitude that holds the peak [V peak to peak].
    shares : tuple of float
        Levels as fractions of the highest [1].

    Returns
    -------
    float
        Of the amplitudes up to 5 % above the least, the one whose shares lie closest to the grid, the smallest
        of equals [V peak to peak].
    """
    if least <= 0:
        return 0.0
    step = max(10.0 ** (np.floor(np.log10(least)) - 3), 1e-4)
    first = int(np.ceil(least / step - 1e-9))
    last = max(first, int(least * _LONGEST_STRETCH / step))
    best, smallest_miss = round_amplitude(first * step), np.inf
    for count in range(first, last + 1):
        candidate = round_amplitude(count * step)
        if candidate < least * (1 - 1e-12):
            continue
        miss = max((abs(round_amplitude(candidate * s) / (candidate * s) - 1) for s in shares), default=0.0)
        if miss < smallest_miss - 1e-12:
            best, smallest_miss = candidate, miss
        if smallest_miss < 1e-12:
            break
    return best


def quantise(voltage: FloatArray, volts_per_code: FloatArray) -> NDArray[np.uint16]:
    """Return the nearest codes; the first and the last are mid-scale, where the generator idles.

    Parameters
    ----------
    voltage : (n_channels, n_samples) array
        At the beam [V].
    volts_per_code : (n_channels,) array
        At the beam [V]; 0 for a channel that stays silent.

    Returns
    -------
    (n_channels, n_samples) array of uint16
        Codes, 0 to 16382.

    Raises
    ------
    ValueError
        If a voltage passes the full scale.
    """
    codes = np.full(voltage.shape, MID_CODE, dtype=np.uint16)
    steps = np.empty(voltage.shape[1])
    for channel, (row, unit) in enumerate(zip(voltage, volts_per_code, strict=True)):
        if unit <= 0:
            continue
        np.rint(np.divide(row, unit, out=steps), out=steps)
        if max(steps.max(), -steps.min()) > MID_CODE:
            raise ValueError(
                f"channel {channel + 1} peaks at {np.abs(row).max():g} V, beyond its full scale of "
                f"{unit * MID_CODE:g} V: raise the full scale"
            )
        steps += MID_CODE
        codes[channel] = steps
    codes[:, 0] = codes[:, -1] = MID_CODE
    return codes


def signed_codes(codes: NDArray[np.uint16]) -> FloatArray:
    """Return codes counted from mid-scale, (n_channels, n_samples) array [1].

    Parameters
    ----------
    codes : (n_channels, n_samples) array of uint16
        Codes, 0 to 16382.
    """
    return codes.astype(float) - MID_CODE
