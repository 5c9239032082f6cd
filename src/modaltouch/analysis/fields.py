"""The wished and the predicted velocity field, computed again from the texts that the record keeps."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from modaltouch.preflight import Preflight, examine_findings
from modaltouch.protocol import Findings, InputError, Sources
from modaltouch.report import CONDITION_COLOURS, FAINT, INK, house_style, quiet_grid

POINTS = 201


def draw_fields(start: dict[str, Any], stimulus: str = "") -> Figure | None:
    """Return the wished and the predicted field at the highest level, and the peak speeds at the zones.

    Parameters
    ----------
    start : dict
        Start record of a session.
    stimulus : str
        Which of several stimuli; empty where there is one.

    Returns
    -------
    Figure or None
        None without a record, and where this version can no longer read the protocol that it keeps.
    """
    if not start.get("sources"):
        return None
    try:
        preflight = examine_findings(Findings.restored(Sources.from_dict(start["sources"]))).require()
    except (InputError, KeyError, TypeError):
        return None
    if stimulus not in preflight.parts:
        return None
    preflight = preflight.parts[stimulus]
    stimuli = [each for each in start.get("stimulus", {}).get("stimuli", []) if each.get("stimulus", "") == stimulus]
    with house_style():
        figure = Figure(figsize=(7.6, 2.9))
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        own = start.get("sensation_levels")
        velocities = own["levels_mm_s"] if own else preflight.experiment.protocol.conditions.peak_velocities_mm_s
        _draw_field(left, preflight, max(velocities))
        _draw_zones(right, stimuli)
        whose = f" (levels of participant {start['participant']})" if own else ""
        figure.suptitle(f"Stimulus: focus {preflight.experiment.protocol.stimulus.focus}, law "
                        f"{preflight.experiment.protocol.stimulus.law}{whose}", fontsize=9)  # fmt: skip
    return figure


def _draw_field(axes: Axes, preflight: Preflight, level: float) -> None:
    experiment, stimulus = preflight.experiment, preflight.stimulus
    half = experiment.apparatus.beam.length_mm / 2
    place = np.linspace(-half, half, POINTS)
    velocity = level * 1e-3
    wished = stimulus.wish.profile(place * 1e-3) * level
    predicted = stimulus.velocity_at_focus(place * 1e-3, velocity) * 1e3
    for name, zone in experiment.apparatus.zones.items():
        axes.axvspan(zone.centre_mm - zone.width_mm / 2, zone.centre_mm + zone.width_mm / 2, color="#eef2f7",
                     linewidth=0.8, ec="white", zorder=0)  # fmt: skip
        axes.text(zone.centre_mm, 0.97, name, ha="center", va="top", color=FAINT, transform=axes.get_xaxis_transform())
    axes.plot(place, wished, color=INK, linestyle="--", linewidth=1, label="target")
    axes.plot(place, predicted, color=CONDITION_COLOURS[0], linewidth=1.6, label="predicted")
    axes.set_ylim(min(0, 1.1 * predicted.min()), 1.16 * max(wished.max(), predicted.max()))
    axes.set_xlabel("place along the beam [mm]")
    axes.set_ylabel(f"velocity at the focusing\ninstant [mm/s], level {level:g}")
    axes.legend(frameon=False, loc="center left", fontsize=7)


def _draw_zones(axes: Axes, stimuli: list[dict[str, Any]]) -> None:
    for i, stimulus in enumerate(stimuli):
        zones = stimulus["zone_peak_mm_s"]
        style: dict[str, Any] = {"marker": "os^Dvp"[i % 6], "color": CONDITION_COLOURS[i % len(CONDITION_COLOURS)]}
        label = format(float(stimulus["velocity_mm_s"]), "g")
        axes.plot(list(zones), list(zones.values()), linewidth=0.8, markersize=4, label=label, **style)
    axes.set_ylim(0, None)
    axes.set_xlabel("zone")
    axes.set_ylabel("peak speed [mm/s]")
    axes.legend(
        title="level [mm/s]", frameon=False, fontsize=7, title_fontsize=7, loc="upper left", bbox_to_anchor=(1, 1)
    )
    quiet_grid(axes)
