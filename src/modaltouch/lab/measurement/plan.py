"""What a scan is to play and to record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from modaltouch.protocol import Apparatus
from modaltouch.rig import Acquisition
from modaltouch.stimulus import Burst


@dataclass(frozen=True, eq=False)
class ScanPlan:
    """What is played, where it is recorded, and how.

    Attributes
    ----------
    burst : Burst
        What the generator repeats.
    velocity : float
        Level at which it is played [m/s].
    positions : sequence of float
        Where velocity is recorded, in this order, origin at mid-beam [m].
    acquisition : Acquisition
        What is asked of the scope at each of them.
    about : mapping
        What else is to be known of the scan, plain values: the name of the stimulus, the actuator set, ...
    """

    burst: Burst
    velocity: float
    positions: Sequence[float]
    acquisition: Acquisition
    about: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse positions that are none, or one twice."""
        places = tuple(float(position) for position in self.positions)
        object.__setattr__(self, "positions", places)
        if not places:
            raise ValueError("no position is given; give at least one")
        if not all(math.isfinite(place) for place in places):
            raise ValueError(f"the positions {places} are not all finite numbers: give metres from mid-beam")
        if len(set(places)) < len(places):
            double = next(place for place in places if places.count(place) > 1)
            raise ValueError(f"the position {double * 1e3:g} mm is given twice; give each once")

    def check_on(self, apparatus: Apparatus) -> None:
        """Refuse positions beyond the ends of the beam.

        Raises
        ------
        ValueError
            If one is.
        """
        half = apparatus.beam.length_mm / 2
        for place in self.positions:
            if abs(place) * 1e3 > half * (1 + 1e-9):
                raise ValueError(
                    f"the position {place * 1e3:g} mm is not on the beam: it reaches from {-half:g} to {half:g} mm"
                )

    def settings(self) -> dict[str, Any]:
        """Return everything that must be the same when a scan goes on, as plain values."""
        return {
            "about": dict(self.about),
            "burst": {
                "sha256": self.burst.content_hash,
                "n_samples": int(self.burst.codes.shape[1]),
                "duration_s": self.burst.duration,
                "repetition_rate_Hz": self.burst.repetition_rate,
                "velocity_mm_s": self.burst.velocity * 1e3,
                "amplitude_V": list(self.burst.amplitude),
            },
            "velocity_mm_s": self.velocity * 1e3,
            "positions_mm": [place * 1e3 for place in self.positions],
            "acquisition": {**asdict(self.acquisition), "drives": list(self.acquisition.drives)},
        }
