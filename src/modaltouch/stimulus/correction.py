"""What a calibration changes in a stimulus: the targets of the exact law, and the amplitude of each level."""

from __future__ import annotations

import math
from dataclasses import dataclass

from modaltouch.stimulus.quantities import FloatArray

LevelCorrections = tuple[tuple[float, float], ...]
"""Levels [m/s], each with its amplitude factor [1]."""


@dataclass(frozen=True, eq=False)
class Correction:
    """Corrected targets of the exact law, with which the real beam reaches the target field.

    Attributes
    ----------
    velocity, displacement : (n_modes,) arrays
        Target modal velocities, and target modal displacements times angular frequency, for the level `reference`
        [m/s].
    reference : float
        Level of these targets; those of other levels are proportional [m/s].
    corrections : tuple of (float, float)
        Levels [m/s], each with its amplitude factor [1].
    """

    velocity: FloatArray
    displacement: FloatArray
    reference: float
    corrections: LevelCorrections = ()

    def at(self, level: float) -> tuple[FloatArray, FloatArray]:
        """Return the targets for a level: modal velocities, and displacements times angular frequency [m/s]."""
        share = level / self.reference
        return self.velocity * share, self.displacement * share


def corrected(velocity: float, corrections: LevelCorrections) -> float:
    """Return the level to set so that a level is reached [m/s].

    Between two levels with factors, as in adaptive runs, the factor is interpolated linearly over the logarithm of the
    level; beyond them the level is set unchanged.
    """
    own = next((factor for level, factor in corrections if math.isclose(level, velocity)), None)
    if own is not None:
        return velocity * own
    below = max((each for each in corrections if each[0] < velocity), default=None)
    above = min((each for each in corrections if each[0] > velocity), default=None)
    if below is None or above is None:
        return velocity
    share = math.log(velocity / below[0]) / math.log(above[0] / below[0])
    return velocity * (below[1] + share * (above[1] - below[1]))
