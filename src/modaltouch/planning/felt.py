"""Front ends, which reduce the velocity under a finger to a single felt speed.

References
----------
Lamore, Muijser, Keemink, "Envelope detection of amplitude-modulated high-frequency sinusoidal signals by skin
mechanoreceptors", J. Acoust. Soc. Am. 79 (1986) 1082-1085: skin follows the envelope of vibration above 1 kHz.
Bolanowski et al., J. Acoust. Soc. Am. 84 (1988) 1680-1694: thresholds up to 500 Hz, rising above 250 Hz.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.planning.observer import FloatArray, FrontEnd
from modaltouch.stimulus import Stimulus

CUT_OFF = 1000.0
"""Cut-off frequency of the skin [Hz]."""

ORDER = 4
"""Order of the zero-phase Butterworth filter at `CUT_OFF`."""


def sense(front_end: FrontEnd, history: ArrayLike, sampling_rate: float) -> FloatArray:
    """Return the felt speed for each velocity history, (n_places,) array [m/s].

    Parameters
    ----------
    front_end : {"rms", "below_1_khz", "envelope"}
        A front end that needs the whole history.
    history : (n_places, n_samples) array
        Velocity over one repetition of the burst, from rest to rest [m/s].
    sampling_rate : float
        Samples per second [Hz].
    """
    velocity = np.atleast_2d(np.asarray(history, dtype=float))
    if front_end == "rms":
        return np.asarray(np.sqrt((velocity**2).mean(axis=1)))
    if front_end == "envelope":
        velocity = np.abs(velocity)
    n_samples = velocity.shape[1]
    # Zero-pad to twice the length, so that the end does not wrap around to the beginning.
    length = 1 << (2 * n_samples - 1).bit_length()
    gain = 1 / np.sqrt(1 + (np.fft.rfftfreq(length, 1 / sampling_rate) / CUT_OFF) ** (2 * ORDER))
    smooth = np.fft.irfft(np.fft.rfft(velocity, length) * gain, length)[:, :n_samples]
    return np.asarray((smooth if front_end == "envelope" else np.abs(smooth)).max(axis=1))


def felt_per_level(stimulus: Stimulus, zones: Mapping[str, float], front_end: FrontEnd) -> dict[str, float]:
    """Return the speed felt at each zone per unit of level [1].

    The beam and every front end are linear in the level. The generator's amplitude grid (four digits) is neglected.

    Parameters
    ----------
    stimulus : Stimulus
        The stimulus.
    zones : mapping of str to float
        Centres of the zones, origin at mid-beam [m].
    front_end : str
        Front end of the fingers.
    """
    places, level = np.array(list(zones.values())), stimulus.target_field.velocity
    if front_end == "peak":
        values = stimulus.peak_velocity(places, level)
    elif front_end == "peak_at_focus":
        values = np.abs(stimulus.velocity_at_focus(places, level))
    else:
        # Use a whole repetition: a beam that is not actively stopped keeps vibrating after the burst.
        history = stimulus.velocity_history(places, level, whole_period=True)
        values = sense(front_end, history, stimulus.timing.sampling_rate)
    return dict(zip(zones, (values / level).tolist(), strict=True))
