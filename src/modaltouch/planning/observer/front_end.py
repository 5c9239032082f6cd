"""What a finger makes of the velocity under it: a whole history becomes one number, in the unit of a speed.

Nobody knows which feature of so short and broad a burst is compared; the front ends are hypotheses to plan for.
All scale with the level, so one history serves every level.

References
----------
Lamore, Muijser, Keemink, "Envelope detection of amplitude-modulated high-frequency sinusoidal signals by skin
mechanoreceptors", J. Acoust. Soc. Am. 79 (1986) 1082-1085: skin follows the envelope of vibration above 1 kHz.
Bolanowski et al., J. Acoust. Soc. Am. 84 (1988) 1680-1694: vibration itself is felt up to about 1 kHz.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.planning.observer.population import FRONT_ENDS, FrontEnd

FloatArray = NDArray[np.float64]

CUT_OFF = 1000.0
"""Highest frequency that the skin follows [Hz]."""

ORDER = 4
"""Order of the Butterworth response at `CUT_OFF`, applied without a shift in time."""


def sense(front_end: FrontEnd, history: ArrayLike, sampling_rate: float, instant: float) -> FloatArray:
    """Return what fingers feel of the velocity under them, (n_places,) array [m/s].

    Parameters
    ----------
    front_end : str
        One of `FRONT_ENDS`.
    history : (n_places, n_samples) array
        Velocity over one repetition of the burst [m/s].
    sampling_rate : float
        Samples per second [Hz].
    instant : float
        The focusing instant, from the first sample [s].

    Raises
    ------
    ValueError
        If the front end is unknown, or the focusing instant outside the history.
    """
    velocity = np.atleast_2d(np.asarray(history, dtype=float))
    if front_end == "peak":
        return np.asarray(np.abs(velocity).max(axis=1))
    if front_end == "rms":
        return np.asarray(np.sqrt((velocity**2).mean(axis=1)))
    if front_end == "below_1_khz":
        return np.asarray(np.abs(smooth(velocity, sampling_rate)).max(axis=1))
    if front_end == "envelope":
        return np.asarray(smooth(np.abs(velocity), sampling_rate).max(axis=1))
    if front_end != "peak_at_focus":
        raise ValueError(f"given the front end {front_end!r}; allowed: {', '.join(FRONT_ENDS)}")
    place = instant * sampling_rate
    last = velocity.shape[1] - 1
    if not 0 <= place <= last:
        raise ValueError(
            f"the focusing instant {instant:g} s lies outside the {velocity.shape[1]} samples; give the history of "
            "a whole repetition"
        )
    return np.array([abs(np.interp(place, np.arange(last + 1), row)) for row in velocity])


def smooth(velocity: FloatArray, sampling_rate: float) -> FloatArray:
    """Return what lies below `CUT_OFF`, without a shift in time, (n_places, n_samples) array [m/s].

    Parameters
    ----------
    velocity : (n_places, n_samples) array
        Histories that are at rest at both ends [m/s].
    sampling_rate : float
        Samples per second [Hz].
    """
    n_samples = velocity.shape[1]
    # Twice as long and filled up with rest, so that the end does not run into the beginning.
    length = 1 << (2 * n_samples - 1).bit_length()
    gain = 1 / np.sqrt(1 + (np.fft.rfftfreq(length, 1 / sampling_rate) / CUT_OFF) ** (2 * ORDER))
    return np.asarray(np.fft.irfft(np.fft.rfft(velocity, length) * gain, length)[:, :n_samples])
