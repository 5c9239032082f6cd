"""Hysteresis of piezoelectric actuators: the force that lags behind the voltage."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

PLAYS = (0.2, 0.4, 0.6, 0.8)
"""Half widths of the play operators, as parts of the amplifier's limit [1]."""


def lagging(voltage: FloatArray, share: float, limit: float) -> FloatArray:
    r"""Return the voltages that would have an actuator without hysteresis give the same force.

    A share of it follows play operators of equal weight, :math:`y_k = \max(v_k - r, \min(v_k + r, y_{k-1}))` (Prandtl
    and Ishlinskii; Visintin 1994, Differential Models of Hysteresis, sec. III.2). Their half widths are evenly spread:
    loops then grow with the square of the voltage, as by Rayleigh's law for piezoelectric ceramics (Damjanovic 1997,
    J. Appl. Phys. 82, 1788).

    Parameters
    ----------
    voltage : (n_channels, n_samples) array
        Of bursts that repeat, as a change from rest [V].
    share : float
        Of the force that lags [1].
    limit : float
        Of the amplifier [V].
    """
    result = (1 - share) * voltage
    for row, volts in zip(result, voltage, strict=True):
        turns = np.append(np.flatnonzero(np.diff(np.sign(np.diff(volts)))) + 1, volts.size - 1)
        # Between two turns the voltage is monotone: what was reached at the first of them tells the rest.
        part = np.searchsorted(turns, np.arange(volts.size))
        for width in np.array(PLAYS) * limit:
            reached = 0.0
            for _ in range(2):  # the second burst begins where the first one, and so every other, ends
                before = []
                for volt in volts[turns].tolist():
                    before.append(reached)
                    reached = max(volt - width, min(volt + width, reached))
            play = np.clip(np.array(before)[part], volts - width, volts + width)
            row += share / len(PLAYS) * (play - reached)
    return np.asarray(result)
