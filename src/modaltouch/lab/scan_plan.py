"""What a scan plays and where it records: positions along the beam, in rows across its width."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.protocol import Apparatus
from modaltouch.rig import Acquisition
from modaltouch.stimulus import Burst


@dataclass(frozen=True, eq=False)
class ScanPlan:
    """What is played, where it is recorded, and how.

    Attributes
    ----------
    burst : Burst
        The burst that the generator repeats.
    velocity : float
        Level at which it is played [m/s].
    positions : sequence of float
        Positions at which velocity is recorded, in this order, origin at mid-beam [m].
    acquisition : Acquisition
        Settings of the scope at each position.
    about : mapping
        Further facts about the scan, plain values: the name of the stimulus, the actuator set, ...
    across : float
        Distance of the row of positions from the beam's mid-line [m].
    """

    burst: Burst
    velocity: float
    positions: Sequence[float]
    acquisition: Acquisition
    about: Mapping[str, Any] = field(default_factory=dict)
    across: float = 0.0

    def settings(self) -> dict[str, Any]:
        """Return everything that must stay the same when a scan is resumed, as plain values."""
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
"""Distance from the long edges of the beam to the outer rows [m]."""


def rows_over(apparatus: Apparatus, n_rows: int) -> tuple[float, ...]:
    """Return the distances of rows of positions from the mid-line, evenly from edge to edge, 0 among them [m].

    Raises
    ------
    ValueError
        If their number is not odd and positive, so that none would lie on the mid-line.
    """
    if n_rows < 1 or n_rows % 2 == 0:
        raise ValueError(
            f"given --rows {n_rows}; allowed: odd numbers; 1 scans only the mid-line, 3 or more show torsion"
        )
    half = apparatus.beam.width_mm * 0.5e-3 - EDGE
    return tuple(float(each) for each in np.round(np.linspace(-half, half, n_rows), 9)) if n_rows > 1 else (0.0,)


def row_name(name: str, across: float) -> str:
    """Return the name of a row's folder, which for the mid-line is the given name itself."""
    return f"{name}_{across * 1e3:+g}_mm" if across else name


def kept_rows(folder: Path, name: str) -> list[str]:
    """Return the suffixes of a name for the rows kept in a folder; the first is empty, for the mid-line."""
    return ["", *sorted(path.name.removeprefix(name) for path in folder.glob(f"{name}_*_mm"))]
