"""Coefficients and field at the focusing instant: the paper's Fig. 2, 6 and 7, both laws; legible without colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from modaltouch.lab.validation.evidence import Evidence
from modaltouch.lab.validation.key_figures import coefficients, key_figures
from modaltouch.report import FAINT, INK, house_style, new_figure, quiet_grid

FloatArray = NDArray[np.float64]

DARK, MIDDLE, LIGHT = "#0b3c8c", "#5bb8e8", "#dbe3ee"
"""Measured, predicted, wished: far apart in lightness, so that they differ without colour."""

LAW_TITLES = {"exact": "law “exact”", "paper": "law “paper”, eq. (6) and (7)"}

PAPER_WORST = 6.0
"""Largest modal error that the paper reports, section IV-B [mm/s]."""


def draw_decomposition(evidence: Evidence) -> Figure:
    """Return the coefficients of the wished field, in the form of Fig. 2: which modes it needs, which are selected."""
    stimulus, wished = evidence.observation.stimulus, evidence.wished_coefficient * 1e3
    labels = np.arange(1, wished.size + 1)
    kinds: tuple[tuple[str, Any, dict[str, Any]], ...] = (
        ("selected", np.isin(labels, stimulus.selected), {"color": DARK}),
        (
            "modelled, not selected",
            np.isin(labels, stimulus.model.label) & ~np.isin(labels, stimulus.selected),
            {"facecolor": MIDDLE, "hatch": "////"},
        ),
        ("not modelled", ~np.isin(labels, stimulus.model.label), {"facecolor": "white"}),
    )
    with house_style():
        figure = new_figure(7.6, 2.7)
        axes = figure.subplots()
        for name, which, look in kinds:
            axes.bar(labels[which], wished[which], width=0.72, edgecolor=INK, linewidth=0.6, label=name, **look)
        axes.axhline(0, color=INK, linewidth=0.7)
        axes.set_xlim(0.2, min(wished.size, 50) + 0.8)
        axes.set_xticks([*range(1, min(wished.size, 50) + 1, 2)])
        axes.tick_params(axis="x", labelsize=7)
        axes.set_xlabel("mode")
        axes.set_ylabel("coefficient [mm/s]")
        axes.legend(frameon=False, loc="upper right")
        quiet_grid(axes)
    return figure


def draw_coefficients(evidences: Sequence[Evidence]) -> Figure:
    """Return wished and achieved coefficients of each law, in the form of Fig. 6, and their difference."""
    with house_style():
        figure = new_figure(7.6, 2.3 * len(evidences) + 0.5)
        panels = figure.subplots(len(evidences), 2, squeeze=False, width_ratios=(3, 2), sharex=True, sharey="col")
        for row, evidence in zip(panels, evidences, strict=True):
            lines = coefficients(evidence)
            _draw_bars(row[0], lines)
            _draw_errors(row[1], lines)
            row[0].set_title(LAW_TITLES[evidence.law], loc="left")
            row[0].set_ylabel("coefficient [mm/s]")
            row[1].set_ylabel("achieved less wished [mm/s]")
        for axes in panels[-1]:
            axes.set_xlabel("mode")
        handles = [
            Patch(facecolor=LIGHT, edgecolor=INK, linewidth=0.6, label="wished of the selected modes"),
            Patch(facecolor=MIDDLE, edgecolor=INK, linewidth=0.6, hatch="////", label="predicted"),
            Patch(facecolor=DARK, edgecolor=INK, linewidth=0.6, label="achieved, measured"),
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False)
    return figure


def _draw_bars(axes: Axes, lines: list[dict[str, Any]]) -> None:
    place = np.arange(len(lines))
    kinds = (("target_mm_s", LIGHT, ""), ("predicted_mm_s", MIDDLE, "////"), ("achieved_mm_s", DARK, ""))
    for shift, (key, colour, hatch) in zip((-0.27, 0, 0.27), kinds, strict=True):
        values = [line[key] for line in lines]
        axes.bar(place + shift, values, width=0.26, color=colour, hatch=hatch, edgecolor=INK, linewidth=0.5)
    axes.axhline(0, color=INK, linewidth=0.7)
    axes.set_xticks(place, [str(line["mode"]) for line in lines])
    quiet_grid(axes)


def _draw_errors(axes: Axes, lines: list[dict[str, Any]]) -> None:
    place = np.arange(len(lines))
    error = [line["achieved_mm_s"] - line["target_mm_s"] for line in lines]
    spread = [1.96 * (line["standard_error_mm_s"] or 0.0) for line in lines]
    for line in (-PAPER_WORST, PAPER_WORST):
        axes.axhline(line, color=FAINT, linewidth=0.8, linestyle="--")
    axes.text(len(lines) - 0.5, PAPER_WORST, "paper's worst", ha="right", va="bottom", fontsize=7, color=FAINT)
    axes.axhline(0, color=INK, linewidth=0.7)
    axes.vlines(place, 0, error, color=DARK, linewidth=1.2)
    axes.errorbar(place, error, yerr=spread, fmt="o", color=DARK, markersize=4, capsize=2, elinewidth=0.9)
    reach = 1.25 * max(PAPER_WORST, float(np.abs(error).max()))
    axes.set_ylim(-max(reach, axes.get_ylim()[1]), max(reach, axes.get_ylim()[1]))
    axes.set_xticks(place, [str(line["mode"]) for line in lines])
    quiet_grid(axes)


def draw_fields(evidences: Sequence[Evidence]) -> Figure:
    """Return the field at the focusing instant against the wished one, in the form of Fig. 7, and how far it is off."""
    with house_style():
        figure = new_figure(7.6, 4.6)
        shape: dict[str, Any] = {"squeeze": False, "sharex": True, "sharey": "row", "height_ratios": (5, 2)}
        panels = figure.subplots(2, len(evidences), **shape)
        for column, evidence in zip(panels.T, evidences, strict=True):
            _draw_field(column[0], evidence)
            _draw_difference(column[1], evidence)
            column[0].set_title(LAW_TITLES[evidence.law], loc="left")
            column[1].set_xlabel("position along the beam [mm]")
        panels[0, 0].set_ylabel("velocity at the\nfocusing instant [mm/s]")
        panels[1, 0].set_ylabel("measured\nless ... [mm/s]")
        handles, names = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper center", ncols=len(names), frameon=False)
    return figure


def _draw_field(axes: Axes, evidence: Evidence) -> None:
    place = evidence.position * 1e3
    _mark_zones(axes, evidence)
    axes.plot(place, evidence.wished_field * 1e3, color=INK, linestyle="--", linewidth=1, label="wished")
    axes.plot(place, evidence.target_field * 1e3, color=MIDDLE, linewidth=2.6, label="selected modes")
    axes.plot(place, evidence.measured_field * 1e3, color=DARK, linewidth=1, label="measured, smooth")
    axes.errorbar(
        evidence.observation.field.positions * 1e3,
        evidence.measured_points * 1e3,
        yerr=np.nan_to_num(1.96 * evidence.points_error * 1e3),
        fmt="o",
        color=DARK,
        markersize=2.8,
        elinewidth=0.7,
        label="measured",
    )
    axes.set_ylim(top=1.13 * max(evidence.observation.velocity, float(evidence.measured_points.max())) * 1e3)
    quiet_grid(axes)


def _draw_difference(axes: Axes, evidence: Evidence) -> None:
    place = evidence.position * 1e3
    from_wish = (evidence.measured_field - evidence.wished_field) * 1e3
    from_selected = (evidence.measured_field - evidence.target_field) * 1e3
    axes.axhline(0, color=INK, linewidth=0.7)
    axes.plot(place, from_wish, color=INK, linestyle="--", linewidth=1)
    axes.plot(place, from_selected, color=DARK, linewidth=1.4)
    errors = key_figures(evidence, ())["field_error"]
    for height, line, name, key in (
        (1.20, "- -", "the wish", "measured_from_wished"),
        (1.04, "\N{EM DASH}", "the selected modes", "measured_from_selected_modes"),
    ):
        words = f"{line} from {name}: {errors[key]['rms_mm_s']:.1f} rms, {errors[key]['max_mm_s']:.1f} max"
        axes.text(0.0, height, words, fontsize=7.5, transform=axes.transAxes)
    axes.set_xlim(place[0], place[-1])
    quiet_grid(axes)


def _mark_zones(axes: Axes, evidence: Evidence) -> None:
    for name, centre in evidence.observation.zones.items():
        axes.text(centre * 1e3, 0.99, name, ha="center", va="top", color=FAINT, transform=axes.get_xaxis_transform())
