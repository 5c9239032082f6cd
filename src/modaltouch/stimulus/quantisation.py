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
        # Across 10 V the grid is coarser than the steps: rounding may leave the stretch at either end.
        if not least * (1 - 1e-12) <= candidate <= max(least * _LONGEST_STRETCH, first * step) * (1 + 1e-12):
            continue
        miss = max((abs(round_amplitude(candidate * s) / (candidate * s) - 1) for s in shares), default=0.0)
        if miss < smallest_miss - 1e-12:
            best, smallest_miss = candidate, miss
        if smallest_miss < 1e-12:
            break
    return best


def round_to_codes(voltage: FloatArray, volts_per_code: FloatArray) -> FloatArray:
    """Return the nearest signed codes; the first and the last are 0, where the generator idles.

    Parameters
    ----------
    voltage : (n_channels, n_samples) array
        At the beam [V].
    volts_per_code : (n_channels,) array
        At the beam [V]; 0 for a channel that stays silent.

    Returns
    -------
    (n_channels, n_samples) array
        Whole numbers, -8191 to 8191 [1].

    Raises
    ------
    ValueError
        If a voltage passes the full scale.
    """
    steps = np.empty(voltage.shape)
    for channel, (row, unit, out) in enumerate(zip(voltage, volts_per_code, steps, strict=True)):
        if unit <= 0:
            out[:] = 0.0
            continue
        np.rint(np.divide(row, unit, out=out), out=out)
        if max(out.max(), -out.min()) > MID_CODE:
            raise ValueError(
                f"channel {channel + 1} peaks at {np.abs(row).max():g} V, beyond its full scale of "
                f"{unit * MID_CODE:g} V: raise the full scale"
            )
    steps[:, 0] = steps[:, -1] = 0.0
    return steps


def unsigned_codes(signed: FloatArray) -> NDArray[np.uint16]:
    """Return codes as the generator takes them, 0 to 16382, (n_channels, n_samples) array.

    Parameters
    ----------
    signed : (n_channels, n_samples) array
        Codes counted from mid-scale [1].
    """
    codes = np.empty(signed.shape, dtype=np.uint16)
    return np.add(signed, MID_CODE, out=codes, casting="unsafe")


def signed_codes(codes: NDArray[np.uint16]) -> FloatArray:
    """Return codes counted from mid-scale, (n_channels, n_samples) array [1].

    Parameters
    ----------
    codes : (n_channels, n_samples) array of uint16
        Codes, 0 to 16382.
    """
    return np.subtract(codes, MID_CODE, dtype=float)
