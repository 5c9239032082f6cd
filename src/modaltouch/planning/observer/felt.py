"""Front ends: what a finger feels of the velocity under it, as one number; at the zones, once for all levels.

References
----------
Lamore, Muijser, Keemink, "Envelope detection of amplitude-modulated high-frequency sinusoidal signals by skin
mechanoreceptors", J. Acoust. Soc. Am. 79 (1986) 1082-1085: skin follows the envelope of vibration above 1 kHz.
Bolanowski et al., J. Acoust. Soc. Am. 84 (1988) 1680-1694: vibration itself is felt up to about 1 kHz.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.planning.observer.population import FrontEnd
from modaltouch.stimulus import Stimulus

FloatArray = NDArray[np.float64]

CUT_OFF = 1000.0
"""Highest frequency that the skin follows [Hz]."""

ORDER = 4
"""Order of the Butterworth response at `CUT_OFF`, applied with zero phase."""


def sense(front_end: FrontEnd, history: ArrayLike, sampling_rate: float) -> FloatArray:
    """Return what fingers feel of the velocity under them, (n_places,) array [m/s].

    Parameters
    ----------
    front_end : {"rms", "below_1_khz", "envelope"}
        One of those that need the whole history.
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
    """Return histories low-pass filtered at `CUT_OFF` with zero phase, (n_places, n_samples) array [m/s].

    Parameters
    ----------
    velocity : (n_places, n_samples) array
        Histories that are at rest at both ends [m/s].
    sampling_rate : float
        Samples per second [Hz].
    """
    n_samples = velocity.shape[1]
    # Padded with zeros to twice the length, so that the end does not wrap around to the beginning.
    length = 1 << (2 * n_samples - 1).bit_length()
    gain = 1 / np.sqrt(1 + (np.fft.rfftfreq(length, 1 / sampling_rate) / CUT_OFF) ** (2 * ORDER))
    return np.asarray(np.fft.irfft(np.fft.rfft(velocity, length) * gain, length)[:, :n_samples])


class FeltSpeeds:
    """What fingers feel at the zones.

    Everything is computed when first asked for, at the reference level, and scaled to the others: the beam and
    every front end are linear in the level. Only the generator's amplitude grid (four digits) is neglected.

    Parameters
    ----------
    stimulus : Stimulus
        The stimulus of all levels.
    zones : mapping of str to float
        Centres of the zones, origin at mid-beam [m].
    front_end : str
        Front end of the fingers.
    """

    def __init__(self, stimulus: Stimulus, zones: Mapping[str, float], front_end: FrontEnd) -> None:
        self._stimulus = stimulus
        self._zones = dict(zones)
        self._front_end = front_end

    def at(self, zone: str, velocity: float) -> float:
        """Return what a finger feels at the centre of a zone at a level [m/s].

        Parameters
        ----------
        zone : str
            Name of the zone.
        velocity : float
            Peak velocity at the focus [m/s].

        Raises
        ------
        ValueError
            If there is no such zone.
        """
        if zone not in self._zones:
            raise ValueError(f"given the zone {zone!r}; allowed: {', '.join(self._zones)}")
        return self._per_velocity[zone] * velocity

    @cached_property
    def _per_velocity(self) -> dict[str, float]:
        """What is felt at each zone for a level of 1 m/s [1]."""
        stimulus, places = self._stimulus, np.array(list(self._zones.values()))
        level = stimulus.target_field.velocity
        if self._front_end == "peak":
            values = stimulus.peak_velocity(places, level)
        elif self._front_end == "peak_at_focus":
            values = np.abs(stimulus.velocity_at_focus(places, level))
        else:
            # A whole repetition: a beam that is not actively stopped goes on vibrating after the burst.
            history = stimulus.velocity_history(places, level, whole_period=True)
            values = sense(self._front_end, history, stimulus.timing.sampling_rate)
        return {name: float(value) / level for name, value in zip(self._zones, values, strict=True)}
