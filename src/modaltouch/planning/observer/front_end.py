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

from modaltouch.planning.observer.population import FrontEnd

FloatArray = NDArray[np.float64]

CUT_OFF = 1000.0
"""Highest frequency that the skin follows [Hz]."""

ORDER = 4
"""Order of the Butterworth response at `CUT_OFF`, applied without a shift in time."""


def sense(front_end: FrontEnd, history: ArrayLike, sampling_rate: float) -> FloatArray:
    """Return what fingers feel of the velocity under them, (n_places,) array [m/s].

    Parameters
    ----------
    front_end : {"rms", "below_1_khz", "envelope"}
        Those that need the whole history.
    history : (n_places, n_samples) array
        Velocity over one repetition of the burst [m/s].
    sampling_rate : float
        Samples per second [Hz].
    """
    velocity = np.atleast_2d(np.asarray(history, dtype=float))
    if front_end == "rms":
        return np.asarray(np.sqrt((velocity**2).mean(axis=1)))
    low = front_end == "below_1_khz"
    felt = np.abs(smooth(velocity, sampling_rate)) if low else smooth(np.abs(velocity), sampling_rate)
    return np.asarray(felt.max(axis=1))


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
