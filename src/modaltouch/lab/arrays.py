"""Types of the arrays that the lab computes with, and what is computed in several of its parts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

NORMAL_95 = 1.959963984540054
"""Half-width of a 95 % interval of a normal distribution, in standard deviations."""


def low_pass(frequency: NDArray[np.floating[Any]], corner: float | None) -> ComplexArray:
    """Return the response of a first-order low-pass with a corner frequency [Hz]; ones if it has none [1]."""
    return np.asarray(1 / (1 + 1j * frequency / (np.inf if corner is None else corner)))
