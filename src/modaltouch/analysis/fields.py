"""Figure of the recorded target and predicted velocity fields, and the peak speeds at the zones."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from modaltouch.report import CONDITION_COLOURS, FAINT, INK, house_style, quiet_grid


def draw_fields(start: dict[str, Any], stimulus: str = "") -> Figure | None:
    """Plot the target and the predicted field at the highest level, and the peak speeds at the zones.

    Parameters
    ----------
    start : dict
        Start record of a session.
    stimulus : str
        Name of the stimulus; empty if there is only one.

    Returns
    -------
    Figure or None
        None without a record, or if the record contains no field and its protocol cannot be read by this version.
    """
    if not start.get("sources"):
        return None
    fields = _of(stimulus, start.get("stimulus", {}).get("fields") or _predict_again(start))
    if not fields:
        return None
    stimuli = _of(stimulus, start.get("stimulus", {}).get("stimuli", []))
    with house_style(7.6, 2.9, 1, 2, width_ratios=(3, 2)) as (figure, [[left, right]]):
        _draw_field(left, fields)
        _draw_zones(right, stimuli)
        whose = f" (levels of participant {start['participant']})" if start.get("sensation_levels") else ""
        touched = ", under the fingers that it is designed for" if "placement" in fields[0] else ""
        figure.suptitle(f"Stimulus: focus {fields[0]['focus']}, law {fields[0]['law']}{touched}{whose}", fontsize=9)
    return figure


def _of(stimulus: str, recorded: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [each for each in recorded if each.get("stimulus", "") == stimulus]


def _predict_again(start: dict[str, Any]) -> list[dict[str, Any]]:
    """Recompute the fields of a record without any from its protocol; empty if the protocol cannot be read."""
    from modaltouch.preflight import examine_findings
    from modaltouch.protocol import Findings, InputError

    try:
        preflight = examine_findings(Findings.recorded(start)).require()
        own = start.get("sensation_levels")
        return (preflight.with_levels(tuple(own["levels_mm_s"])) if own else preflight).fields
    except (InputError, KeyError, TypeError):
        return []


def _draw_field(axes: Axes, fields: list[dict[str, Any]]) -> None:
    field = fields[0]
    half, target = field["length_mm"] / 2, field["target_mm_s"]
    place = np.linspace(-half, half, len(target))
    reached = [each["predicted_mm_s"] for each in fields]
    for name, (first, last) in field["zones_mm"].items():
        axes.axvspan(first, last, color="#eef2f7", linewidth=0.8, ec="white", zorder=0)
        centre = (first + last) / 2
        axes.text(centre, 0.97, name, ha="center", va="top", color=FAINT, transform=axes.get_xaxis_transform())
    axes.plot(place, target, color=INK, linestyle="--", linewidth=1, label="target")
    for i, (each, predicted) in enumerate(zip(fields, reached, strict=True)):
        label = f"predicted, {each['placement']}" if "placement" in each else "predicted"
        style: dict[str, Any] = {
            "color": CONDITION_COLOURS[i % len(CONDITION_COLOURS)],
            "linestyle": ("-", "--", ":")[i % 3],
        }
        axes.plot(place, predicted, linewidth=1.6, label=label, **style)
    axes.set_ylim(min(0, 1.1 * np.min(reached)), 1.16 * max(np.max(target), np.max(reached)))
    axes.set_xlim(-half, half)
    axes.set_xlabel("place along the beam [mm]")
    axes.set_ylabel(f"velocity at the focusing\ninstant [mm/s], level {field['velocity_mm_s']:g}")
    axes.legend(frameon=False, loc="center left", fontsize=7)


def _draw_zones(axes: Axes, stimuli: list[dict[str, Any]]) -> None:
    highest = max((each["velocity_mm_s"] for each in stimuli), default=0.0)
    placed = [each for each in stimuli if "placement" in each and each["velocity_mm_s"] == highest]
    for i, stimulus in enumerate(placed or stimuli):
        zones = stimulus["zone_peak_mm_s"]
        style: dict[str, Any] = {"marker": "os^Dvp"[i % 6], "color": CONDITION_COLOURS[i % len(CONDITION_COLOURS)]}
        label = stimulus["placement"] if placed else format(float(stimulus["velocity_mm_s"]), "g")
        axes.plot(list(zones), list(zones.values()), linewidth=0.8, markersize=4, label=label, **style)
    axes.set_ylim(0, None)
    axes.set_xlabel("zone")
    axes.set_ylabel("peak speed [mm/s]")
    axes.legend(
        title="fingers at" if placed else "level [mm/s]",
        frameon=False,
        fontsize=7,
        title_fontsize=7,
        loc="upper left",
        bbox_to_anchor=(1, 1),
    )
    quiet_grid(axes)
