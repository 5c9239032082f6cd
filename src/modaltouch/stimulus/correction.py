"""What a calibration changes of a stimulus: the targets of the exact law, and the amplitude of each level."""

from __future__ import annotations

import math
from dataclasses import dataclass

from modaltouch.stimulus.quantities import FloatArray

LevelCorrections = tuple[tuple[float, float], ...]
"""Levels [m/s], each with the factor of its amplitude [1]."""


@dataclass(frozen=True, eq=False)
class Correction:
    """Corrected targets: what the exact law is to aim at so that the real beam reaches the target field.

    Attributes
    ----------
    velocity, displacement : (n_modes,) arrays
        Modal velocities, and modal displacements times angular frequency, to be aimed at for the level `reference`
        [m/s].
    reference : float
        Level for which they hold; at any other they hold in proportion [m/s].
    corrections : tuple of (float, float)
        Levels [m/s], each with the factor of its amplitude [1].
    """

    velocity: FloatArray
    displacement: FloatArray
    reference: float
    corrections: LevelCorrections = ()

    def at(self, level: float) -> tuple[FloatArray, FloatArray]:
        """Return what to aim at for a level: modal velocities, and displacements times angular frequency [m/s]."""
        share = level / self.reference
        return self.velocity * share, self.displacement * share


def corrected(velocity: float, corrections: LevelCorrections) -> float:
    """Return the level to be set for a level to be reached [m/s].

    Between two levels with factors, as adaptive runs play, the factor runs straight over the logarithm of the level; a
    level beyond them all is set as it is.
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
