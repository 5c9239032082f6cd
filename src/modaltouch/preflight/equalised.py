"""Levels at which every placement has the same velocity in the band that fingertips feel, instead of the same peak."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modaltouch.preflight.design_inputs import DesignInputs
from modaltouch.stimulus import Stimulus


def equalised(inputs: DesignInputs, stimulus: Stimulus, first: tuple[DesignInputs, Stimulus]) -> DesignInputs:
    """Return what a placement is designed from, at levels with the band velocity that the first placement has.

    Velocity, since felt intensity goes with it (Grigorii et al. 2021, under load, 20 to 400 Hz); the channels of touch
    span 0.4 to above 500 Hz (Bolanowski et al. 1988, J. Acoust. Soc. Am. 84, 1680).

    Parameters
    ----------
    inputs, stimulus
        Of the placement, at the levels asked.
    first : (DesignInputs, Stimulus)
        Of the first placement.
    """
    share = round(_band_velocity(*first) / _band_velocity(inputs, stimulus), 4)
    return replace(inputs, levels={key: level * share for key, level in inputs.levels.items()}, share=share)


def _band_velocity(inputs: DesignInputs, stimulus: Stimulus) -> float:
    """Return the root mean square velocity at the focus in the band, over the level [1]."""
    level, (low, high) = inputs.reference * 1e-3, inputs.section.equalise_band_Hz or (0.0, np.inf)
    velocity = stimulus.velocity_history([inputs.centre_mm * 1e-3], level, whole_period=True)[0]
    frequency = np.fft.rfftfreq(velocity.size, 1 / stimulus.timing.sampling_rate)
    size = np.abs(np.fft.rfft(velocity)) / velocity.size
    return float(np.sqrt(2 * (size[(frequency >= low) & (frequency <= high)] ** 2).sum())) / level
