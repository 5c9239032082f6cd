"""What a drive really does, read from the twin's true beam: no method sees any of this."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.validation.measures import contrast, root_mean_square, spot_width
from modaltouch.rig import Playback, Twin
from modaltouch.stimulus import TargetField

FloatArray = NDArray[np.float64]
Playbacks = Sequence[Playback | None]

POINTS = 201
"""Points along the beam at which a field is judged."""

REST = 0.02
"""Share of the level below which a wish counts as rest: a Gaussian never ends [1]."""

FINGER = 0.01
"""Width of what a finger touches [m]."""

FINGER_POINTS = 5
"""Points under a finger at which its highest speed is looked for."""

PLACES = 41
"""Points along the beam at which the highest speed anywhere is looked for."""


@dataclass(frozen=True)
class Task:
    """What a drive is judged by.

    Attributes
    ----------
    wish : TargetField
        The wished field, at its level.
    instant : float
        The focusing instant asked for, from the start of the burst [s].
    zones : dict of str to float
        Zones and their centres [m].
    pairs : tuple of (str, str)
        Zones that two fingers touch together.
    selected : callable
        Returns the field that the selected modes would make of the wish at positions [m], in m/s.
    """

    wish: TargetField
    instant: float
    zones: dict[str, float]
    pairs: tuple[tuple[str, str], ...]
    selected: Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class DriveAssessment:
    """What a drive did.

    Attributes
    ----------
    position, field : (POINTS,) arrays
        The true field at the focusing instant [m, m/s].
    at_focus : float
        Velocity at the focus then [m/s].
    rms_error, max_error : float
        From the wished field, along the beam [m/s].
    rms_from_selected : float
        From the field that the selected modes would make of the wish, along the beam [m/s].
    outside : float
        Highest speed then where the wish is rest [m/s].
    width_50, width_80 : float
        Of the spot [m].
    zone_peak : dict of str to float
        Highest speed at the centre of each zone, throughout [m/s].
    contrasts : dict of (str, str) to float
        Of the highest speeds at the centres, by the pair's zones [1].
    finger_contrasts : dict of (str, str) to float
        Of the highest speeds anywhere under a finger, FINGER wide; empty where it was not looked for [1].
    highest : float or None
        Highest speed anywhere on the beam, throughout [m/s]; None where it was not looked for.
    """

    position: FloatArray
    field: FloatArray
    at_focus: float
    rms_error: float
    max_error: float
    rms_from_selected: float
    outside: float
    width_50: float
    width_80: float
    zone_peak: dict[str, float]
    contrasts: dict[tuple[str, str], float]
    finger_contrasts: dict[tuple[str, str], float]
    highest: float | None


def judge(twin: Twin, playbacks: Playbacks, task: Task, *, everywhere: bool = True) -> DriveAssessment:
    """Return what a beam does under what a generator sends, repeated for long.

    The focusing instant is that at which what was sent by then has passed the amplifier: its true lag, which no
    method was told, delays every drive alike, and nobody feels a microsecond.

    Parameters
    ----------
    twin : Twin
        Amplifier and true beam.
    playbacks : sequence of Playback or None
        What each output sends.
    task : Task
        What was asked for.
    everywhere : bool
        Whether the highest speed is looked for along the whole beam, which takes longest.
    """
    half = twin.beam.table.length / 2
    position = np.linspace(-half, half, POINTS)
    state = twin.true_state(playbacks, task.instant + true_lag(twin))
    velocity = np.concatenate([state.velocity, state.unlisted_velocity])
    field = velocity @ twin.beam.shapes(position)
    miss = field - task.wish.velocity * task.wish.profile(position)
    zone_peak = dict(zip(task.zones, twin.felt(playbacks, list(task.zones.values())).tolist(), strict=True))
    places = np.linspace(-half, half, PLACES).tolist()
    return DriveAssessment(
        position=position,
        field=field,
        at_focus=float(velocity @ twin.beam.shapes(task.wish.centre)[:, 0]),
        rms_error=root_mean_square(miss),
        max_error=float(np.abs(miss).max()),
        rms_from_selected=root_mean_square(field - task.selected(position)),
        outside=float(np.abs(field[task.wish.profile(position) < REST]).max(initial=0.0)),
        width_50=spot_width(position, field, task.wish.centre, 0.5),
        width_80=spot_width(position, field, task.wish.centre, 0.8),
        zone_peak=zone_peak,
        contrasts={(a, b): contrast(zone_peak[a], zone_peak[b]) for a, b in task.pairs},
        finger_contrasts=_finger_contrasts(twin, playbacks, task) if everywhere else {},
        highest=float(twin.felt(playbacks, places).max()) if everywhere else None,
    )


def true_lag(twin: Twin) -> float:
    """Return by how much the amplifier holds a drive back: its delay, and that of its pole [s]."""
    bandwidth = twin.amplifier.bandwidth
    return twin.amplifier.delay + (0.0 if bandwidth is None else 1 / (2 * math.pi * bandwidth))


def _finger_contrasts(twin: Twin, playbacks: Playbacks, task: Task) -> dict[tuple[str, str], float]:
    """Return the contrasts of what whole fingers meet, by the pair's zones [1]."""
    half = twin.beam.table.length / 2
    under = np.linspace(-FINGER / 2, FINGER / 2, FINGER_POINTS)
    places = np.clip([centre + under for centre in task.zones.values()], -half, half)
    speeds = twin.felt(playbacks, places.ravel().tolist()).reshape(places.shape).max(axis=1)
    peak = dict(zip(task.zones, speeds.tolist(), strict=True))
    return {(left, right): contrast(peak[left], peak[right]) for left, right in task.pairs}
