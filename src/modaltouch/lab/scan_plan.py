"""What a scan plays and where: positions along the beam, in rows over its width."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.lab.laboratory import TooFewPointsError
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
    across : float
        Where the row of positions lies across the beam, from its mid-line [m].
    """

    burst: Burst
    velocity: float
    positions: Sequence[float]
    acquisition: Acquisition
    about: Mapping[str, Any] = field(default_factory=dict)
    across: float = 0.0

    def settings(self) -> dict[str, Any]:
        """Return everything that must stay the same when a scan continues, as plain values."""
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
            **({"across_mm": self.across * 1e3} if self.across else {}),
            "acquisition": {**asdict(self.acquisition), "drives": list(self.acquisition.drives)},
        }


EDGE = 0.5e-3
"""From the long edges of the beam to the outer rows [m]."""


def rows_over(apparatus: Apparatus, n_rows: int) -> tuple[float, ...]:
    """Return where rows of positions lie across a beam, evenly from edge to edge; one lies on the mid-line [m].

    Raises
    ------
    TooFewPointsError
        If their number is even, so that none does.
    """
    if n_rows < 1 or n_rows % 2 == 0:
        raise TooFewPointsError(
            f"given --rows {n_rows}; allowed: odd numbers; 1 scans only the mid-line, 3 or more show torsion"
        )
    half = apparatus.beam.width_mm * 0.5e-3 - EDGE
    return tuple(float(each) for each in np.round(np.linspace(-half, half, n_rows), 9)) if n_rows > 1 else (0.0,)


def row_name(name: str, across: float) -> str:
    """Return the name of a row's folder; that of the mid-line is the name that is given."""
    return f"{name}_{across * 1e3:+g}_mm" if across else name


def kept_rows(folder: Path, name: str) -> list[str]:
    """Return what the folders of the rows that were measured have after a name: nothing first, for the mid-line."""
    return ["", *sorted(path.name.removeprefix(name) for path in folder.glob(f"{name}_*_mm"))]
