r"""The level at the focus exactly, the field as nearly as the amplifier allows.

Minimise :math:`v^T D^{-1} v + \mu^{-1} |x(t_F) - x_F|^2` over all modal states, under the level's condition: with the
level as a further row of the reachability, :math:`(W + \mu\,\mathrm{diag}(0, 1, \ldots)) y = b`. The larger
:math:`\mu`, the lower the voltage and the farther the field; it is bisected until the peak meets the limit.
"""

from __future__ import annotations

import numpy as np

from modaltouch.stimulus.drive import Drive, Steering, exact_drive
from modaltouch.stimulus.quantities import FloatArray

_HALVINGS = 14
"""Of the bracket of the logarithm of mu, which spans sixteen decades: to 0.2 % of mu."""

_BRACKET = -10.0, 6.0
"""Powers of ten of mu, over the mean of the Gramian's diagonal."""


def level_first_drive(steering: Steering, shape: FloatArray, limit: float) -> Drive:
    """Return voltages that meet the level at the focus exactly, within a limit if any field allows it.

    Parameters
    ----------
    steering : Steering
        What the whole field would be.
    shape : (n_modes,) array
        Mode shapes at the focus [1].
    limit : float
        Highest voltage at the beam [V].
    """
    whole = exact_drive(steering)
    if np.abs(whole.before_focus).max() <= limit:
        return whole
    n = steering.driven.size
    level = np.concatenate([shape[steering.driven], np.zeros(n)])
    rows = np.concatenate([level[None], np.eye(2 * n)])
    gram, goal = rows @ steering.reach.gramian() @ rows.T, rows @ steering.goal
    ridge = np.diag(np.append(0.0, np.ones(2 * n))) * np.trace(gram[1:, 1:]) / (2 * n)
    voltage = np.zeros_like(whole.voltage)
    before = voltage[:, : whole.n_before]

    def write(power: float) -> float:
        """Write the voltages of a mu, scaled to the level, and return their peak."""
        multiplier = np.linalg.lstsq(gram + 10.0**power * ridge, goal, rcond=None)[0]
        steering.reach.write(rows.T @ multiplier, before)
        short, _ = steering.short(before)
        before[:] *= goal[0] / (goal[0] - level @ short)
        return float(np.abs(before).max())

    low, high = _BRACKET
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if write(middle) > limit else (low, middle)
    write(high)
    short, state = steering.short(before)
    steering.end(voltage, state)
    return Drive(voltage, whole.condition_number, float(np.abs(short).max()), whole.n_before)
