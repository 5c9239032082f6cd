"""What piezoelectric patches do to the modes of a free-free beam, by theory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.quantities import FloatArray, require_finite
from modaltouch.stimulus.shapes import mode_shapes


def patch_gains(
    label: ArrayLike, patches: Sequence[tuple[float, float]], length: float, strength: float = 1.0
) -> FloatArray:
    """Return how strongly piezoelectric patches wired together drive each mode, (n_modes,) array [m/s^2 per V].

    A patch bends the beam by a pair of moments at its ends, which a mode feels by the difference of its slopes there.
    Theory gives the ratios among the modes; the strength is measured on one of them. Rigid modes feel no moment
    pair: what drives them in practice, the tape under the beam, is not of this theory.

    Parameters
    ----------
    label : (n_modes,) array_like of int
        Mode labels of the paper, from 1.
    patches : sequence of (float, float)
        Left and right end of each patch, origin at mid-beam [m].
    length : float
        Length of the beam [m].
    strength : float
        Acceleration per volt and per slope difference [m^2/s^2 per V].

    Raises
    ------
    ValueError
        If a patch leaves the beam or has no length, or the strength is not finite.
    """
    require_finite("the strength of the patches", strength, "m^2/s^2 per V", "calibrate it on one mode")
    if not patches:
        raise ValueError("no patch is given; give at least one as (left end, right end)")
    for left, right in patches:
        if not left < right:
            raise ValueError(
                f"a patch runs from {left * 1e3:g} to {right * 1e3:g} mm; its left end must lie left of its right end"
            )
    ends = np.asarray(patches, dtype=float)
    slopes = mode_shapes(label, ends.ravel(), length, derivative=1).reshape(-1, *ends.shape)
    return np.asarray(strength * (slopes[:, :, 1] - slopes[:, :, 0]).sum(axis=1))
