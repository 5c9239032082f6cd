"""Array types of physical quantities, and checks of single values."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

EXTREME = 1e30
"""Largest magnitude of any quantity in SI units, and inverse of the smallest; squares do not overflow."""


def require_positive(name: str, value: float, unit: str, remedy: str) -> None:
    """Raise ValueError for a quantity that is not finite and between 1 / `EXTREME` and `EXTREME`."""
    unit = f" {unit}" if unit else ""
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} is {value}{unit}; it must be a finite number above 0{unit}: {remedy}")
    if not 1 / EXTREME <= value <= EXTREME:
        raise ValueError(
            f"{name} is {value}{unit}; it must lie between {1 / EXTREME:g} and {EXTREME:g}{unit}: {remedy}"
        )


def require_not_negative(name: str, value: float, unit: str, remedy: str) -> None:
    """Raise ValueError for a quantity that is not finite, or below zero."""
    unit = f" {unit}" if unit else ""
    if not (math.isfinite(value) and value >= 0):
        raise ValueError(f"{name} is {value}{unit}; it must be 0{unit} or above: {remedy}")


def require_finite(name: str, value: float, unit: str, remedy: str) -> None:
    """Raise ValueError for a quantity that is NaN or infinite."""
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value} {unit}; it must be a finite number: {remedy}")
