"""Array types, constants and functions shared by the lab's sub-packages."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

NORMAL_95 = 1.959963984540054
"""Half-width of a 95 % interval of a normal distribution, in standard deviations."""


def low_pass(frequency: NDArray[np.floating[Any]], corner: float | None) -> ComplexArray:
    """Return the frequency response of a first-order low-pass [1]; ones if its `corner` [Hz] is None."""
    return np.asarray(1 / (1 + 1j * frequency / (np.inf if corner is None else corner)))
