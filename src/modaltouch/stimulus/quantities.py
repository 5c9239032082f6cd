"""Array types of physical quantities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


class DesignError(ValueError):
    """A design that cannot be made.

    Parameters
    ----------
    message : str
        What is wrong, and what to do.
    parameter : str
        Parameter at fault, by its name in this package.
    mode : int
        Label of the mode that it belongs to; 0 if it does not belong to a mode.
    """

    def __init__(self, message: str, parameter: str, mode: int = 0) -> None:
        super().__init__(message)
        self.parameter, self.mode = parameter, mode
