r"""Time reversal: each output plays its own impulse response at the focus backwards.

With :math:`h_c(x_0, t)` the velocity at the focus after an impulse of output c, the drive
:math:`v_c(t) = A\, h_c(x_0, t_F - t)` makes

.. math:: \dot w(x, t_F) = A \sum_c \int h_c(x, \tau)\, h_c(x_0, \tau)\, d\tau

at the focusing instant: at the focus all add up as an autocorrelation, elsewhere they do not. It is the matched
filter: no drive of equal energy makes more velocity there. Nothing is asked of the other points.

The 1-bit variant plays the sign alone, :math:`v_c = A\,\mathrm{sign}\,h_c(x_0, t_F - t)`: more velocity per volt of
peak, at the price of a coarser field.

References
----------
C. Hudin, J. Lozada, V. Hayward, "Localized Tactile Feedback on a Transparent Surface through Time-Reversal Wave
Focusing", IEEE Trans. Haptics 8(2), 188-198, 2015, doi 10.1109/TOH.2015.2411267; A. Derode, A. Tourin, M. Fink,
"Ultrasonic pulse compression with one-bit time reversal through multiple scattering", J. Appl. Phys. 85, 6343, 1999.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.comparison.training_data import TrainingData

FloatArray = NDArray[np.float64]


def time_reversal(known: TrainingData) -> FloatArray:
    """Return the recorded impulse responses at the focus alone, reversed, as voltages at the level or limit [V]."""
    return known.to_level(known.towards[:, known.focus, ::-1])


def one_bit_reversal(known: TrainingData) -> FloatArray:
    """Return the signs of the reversed impulse responses, as `time_reversal`."""
    return known.to_level(np.sign(known.towards[:, known.focus, ::-1]))
