"""Fig. 2 and 5 to 8 of the paper for both laws; readable in greyscale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from modaltouch.lab.common import DARK, LIGHT, MIDDLE, NORMAL_95, SIGNED, FloatArray, draw_map
from modaltouch.lab.validation.evidence import Evidence, mean_velocity, root_mean_square, standard_error
from modaltouch.lab.validation.key_figures import AROUND, around_focus, coefficients, spectrogram_of
from modaltouch.report import FAINT, INK, house_style, quiet_grid

LAW_TITLES = {"exact": "law “exact”", "paper": "law “paper”, eq. (6) and (7)"}

PAPER_WORST = 6.0
"""Largest modal error reported in the paper, section IV-B [mm/s]."""


def draw_decomposition(evidence: Evidence) -> Figure:
    """Draw the coefficients of the target field, with the selected modes marked, as in Fig. 2."""
    stimulus, wished = evidence.stimulus, evidence.target_coefficient * 1e3
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
    with house_style(7.6, 2.7) as (figure, [[axes]]):
        for name, which, look in kinds:
            axes.bar(labels[which], wished[which], width=0.72, edgecolor=INK, linewidth=0.6, label=name, **look)
        axes.axhline(0, color=INK, linewidth=0.7)
        last = min(wished.size, 50)
        axes.set(xlabel="mode", ylabel="coefficient [mm/s]", xlim=(0.2, last + 0.8), xticks=range(1, last + 1, 2))
        axes.tick_params(axis="x", labelsize=7)
        axes.legend(frameon=False, loc="upper right")
        quiet_grid(axes)
    return figure


def draw_coefficients(evidences: Sequence[Evidence]) -> Figure:
    """Draw target and achieved coefficients of each law as in Fig. 6, and their difference."""
    with house_style(
        7.6, 2.3 * len(evidences) + 0.5, len(evidences), 2, width_ratios=(3, 2), sharex=True, sharey="col"
    ) as (figure, panels):
        for row, evidence in zip(panels, evidences, strict=True):
            lines = coefficients(evidence)
            _draw_bars(row[0], lines)
            _draw_errors(row[1], lines)
            for axes in row:
                axes.set_xticks(range(len(lines)), [str(line["mode"]) for line in lines])
                quiet_grid(axes)
            row[0].set_title(LAW_TITLES[evidence.stimulus.law], loc="left")
            row[0].set_ylabel("coefficient [mm/s]")
            row[1].set_ylabel("achieved minus desired [mm/s]")
        for axes in panels[-1]:
            axes.set_xlabel("mode")
        handles = [
            Patch(facecolor=LIGHT, edgecolor=INK, linewidth=0.6, label="desired of the selected modes"),
            Patch(facecolor=MIDDLE, edgecolor=INK, linewidth=0.6, hatch="////", label="predicted"),
            Patch(facecolor=DARK, edgecolor=INK, linewidth=0.6, label="achieved, measured"),
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False)
    return figure


def _draw_bars(axes: Axes, lines: list[dict[str, Any]]) -> None:
    kinds = (("target_mm_s", LIGHT, ""), ("predicted_mm_s", MIDDLE, "////"), ("achieved_mm_s", DARK, ""))
    for shift, (key, colour, hatch) in zip((-0.27, 0, 0.27), kinds, strict=True):
        place, values = np.arange(len(lines)) + shift, [line[key] for line in lines]
        axes.bar(place, values, width=0.26, color=colour, hatch=hatch, edgecolor=INK, linewidth=0.5)
    axes.axhline(0, color=INK, linewidth=0.7)


def _draw_errors(axes: Axes, lines: list[dict[str, Any]]) -> None:
    place = np.arange(len(lines))
    error = [line["achieved_mm_s"] - line["target_mm_s"] for line in lines]
    spread = [NORMAL_95 * (line["standard_error_mm_s"] or 0.0) for line in lines]
    for line in (-PAPER_WORST, PAPER_WORST):
        axes.axhline(line, color=FAINT, linewidth=0.8, linestyle="--")
    axes.text(len(lines) - 0.5, PAPER_WORST, "paper's worst", ha="right", va="bottom", fontsize=7, color=FAINT)
    axes.axhline(0, color=INK, linewidth=0.7)
    axes.vlines(place, 0, error, color=DARK, linewidth=1.2)
    axes.errorbar(place, error, yerr=spread, fmt="o", color=DARK, markersize=4, capsize=2, elinewidth=0.9)
    reach = 1.25 * max(PAPER_WORST, float(np.abs(error).max()))
    axes.set_ylim(-max(reach, axes.get_ylim()[1]), max(reach, axes.get_ylim()[1]))


def draw_fields(evidences: Sequence[Evidence]) -> Figure:
    """Draw the field at the focusing instant and the target as in Fig. 7, and their difference."""
    with house_style(7.6, 4.6, 2, len(evidences), sharex=True, sharey="row", height_ratios=(5, 2)) as (figure, panels):
        for column, evidence in zip(panels.T, evidences, strict=True):
            _draw_field(column[0], evidence)
            _draw_difference(column[1], evidence)
            for axes in column:
                quiet_grid(axes)
            column[0].set_title(LAW_TITLES[evidence.stimulus.law], loc="left")
        panels[0, 0].set_ylabel("velocity at the\nfocusing instant [mm/s]")
        panels[1, 0].set_ylabel("measured\nminus ... [mm/s]")
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    return figure


def _draw_field(axes: Axes, evidence: Evidence) -> None:
    place = evidence.position * 1e3
    for name, centre in evidence.zones.items():
        axes.text(centre * 1e3, 0.99, name, ha="center", va="top", color=FAINT, transform=axes.get_xaxis_transform())
    axes.plot(place, evidence.target_field * 1e3, color=INK, linestyle="--", linewidth=1, label="desired")
    axes.plot(place, evidence.selected_field * 1e3, color=MIDDLE, linewidth=2.6, label="selected modes")
    axes.plot(place, evidence.measured_field * 1e3, color=DARK, linewidth=1, label="measured, smooth")
    axes.errorbar(
        evidence.field.positions * 1e3,
        evidence.measured_points * 1e3,
        yerr=np.nan_to_num(NORMAL_95 * standard_error(evidence.snapshots) * 1e3),
        fmt="o",
        color=DARK,
        markersize=2.8,
        elinewidth=0.7,
        label="measured",
    )
    axes.set_ylim(top=1.13 * max(evidence.velocity, float(evidence.measured_points.max())) * 1e3)


def _draw_difference(axes: Axes, evidence: Evidence) -> None:
    place = evidence.position * 1e3
    from_target = (evidence.measured_field - evidence.target_field) * 1e3
    from_selected = (evidence.measured_field - evidence.selected_field) * 1e3
    axes.axhline(0, color=INK, linewidth=0.7)
    axes.plot(place, from_target, color=INK, linestyle="--", linewidth=1)
    axes.plot(place, from_selected, color=DARK, linewidth=1.4)
    for height, line, name, off in (
        (1.20, "- -", "the desired field", from_target),
        (1.04, "\N{EM DASH}", "the selected modes", from_selected),
    ):
        words = f"{line} from {name}: {root_mean_square(off):.1f} rms, {np.abs(off).max():.1f} max"
        axes.text(0.0, height, words, fontsize=7.5, transform=axes.transAxes)
    axes.set(xlabel="position along the beam [mm]", xlim=(place[0], place[-1]))


def draw_over_width(evidences: Sequence[Evidence]) -> Figure:
    """Draw velocity at the focusing instant, highest speed around it and torsion, over length and width."""
    fields = [_over_width(each) for each in evidences]
    highest = np.array([[float(np.abs(values).max()) * 1e3 for values in each] for each in fields]).max(axis=0)
    with house_style(7.6, 4.4, 3, len(evidences), sharex=True, sharey=True) as (figure, panels):
        for column, evidence, each in zip(panels.T, evidences, fields, strict=True):
            across = np.array([scan.across for scan in evidence.rows])
            y, x = (grid.ravel() for grid in np.meshgrid(across, evidence.field.positions, indexing="ij"))
            for axes, values, limit in zip(column, each, highest.tolist(), strict=True):
                drawn = draw_map(axes, x, y, values.ravel() * 1e3, limit)
                if evidence is evidences[-1]:
                    figure.colorbar(drawn, ax=panels[list(column).index(axes)], label="[mm/s]", pad=0.02)
            column[0].set_title(LAW_TITLES[evidence.stimulus.law], loc="left")
            column[-1].set_xlabel("position along the beam [mm]")
        for axes, name in zip(panels[:, 0], ("at the focus", "highest speed", "torsion at the focus"), strict=True):
            axes.set_ylabel(f"{name}:\nacross [mm]", fontsize=8)
    return figure


def _over_width(evidence: Evidence) -> tuple[FloatArray, FloatArray, FloatArray]:
    across = np.array([scan.across for scan in evidence.rows])
    torsion = np.outer(across / across[-1], evidence.torsion.mean(axis=0))
    return evidence.field_over_width.mean(axis=1), evidence.speed_over_width, torsion


LOWEST = 150.0
"""Lowest frequency of the spectrogram [Hz]."""


def draw_maps(evidences: Sequence[Evidence]) -> Figure:
    """Draw velocity over position and time around the focus as in Fig. 5."""
    highest = max(float(np.abs(mean_velocity(each.field)).max()) for each in evidences) * 1e3
    with house_style(7.6, 4.4, 1, len(evidences), sharex=True, sharey=True) as (figure, [panels]):
        for axes, evidence in zip(panels, evidences, strict=True):
            # A sixth of the shortest period is enough for a figure.
            time, velocity = around_focus(evidence, 2e-6)
            time, velocity, place = time * 1e3, velocity.T * 1e3, evidence.field.positions * 1e3
            look: dict[str, Any] = {"cmap": SIGNED, "vmin": -highest, "vmax": highest, "rasterized": True}
            image = axes.pcolormesh(place, time, velocity, shading="gouraud", **look)
            half = 0.5 * evidence.velocity * 1e3
            axes.contour(place, time, velocity, levels=[half], colors="black", linewidths=0.7)
            axes.axhline(evidence.instant * 1e3, color="white", linewidth=0.5, linestyle=":")
            for name, centre in evidence.zones.items():
                axes.text(centre * 1e3, time[0], name, ha="center", va="bottom", fontsize=8, color="white")
            axes.set_title(LAW_TITLES[evidence.stimulus.law], loc="left")
            ticks = evidence.instant * 1e3 + np.linspace(-AROUND, AROUND, 9) * 1e3 * 0.999
            axes.set(xlabel="position along the beam [mm]", ylim=(time[0], time[-1]), yticks=ticks)
            axes.yaxis.set_major_formatter("{x:.2f}")
        panels[0].set_ylabel("time [ms]")
        figure.colorbar(image, ax=panels, label="velocity [mm/s]", shrink=0.9, pad=0.02)
    return figure


def draw_spectrograms(evidences: Sequence[Evidence]) -> Figure:
    """Draw the spectrogram of the velocity at the focus as in Fig. 8."""
    found = [spectrogram_of(each) for each in evidences]
    top = 20 * np.log10(max(float(amplitude.max()) for *_, amplitude in found) * 1e3)
    with house_style(7.6, 3.6, 1, len(evidences), sharex=True, sharey=True) as (figure, [panels]):
        for axes, evidence, (time, frequency, amplitude) in zip(panels, evidences, found, strict=True):
            # Use logarithmically spaced rows, since more rows would coincide in the figure.
            wanted = np.searchsorted(frequency, np.geomspace(LOWEST, frequency[-1], 400))
            rows = np.unique(wanted.clip(1, frequency.size - 1))
            decibels = 20 * np.log10(np.maximum(amplitude[rows] * 1e3, 1e-9))
            image = axes.pcolormesh(
                time * 1e3, frequency[rows] * 1e-3, decibels, cmap="Greys", vmin=top - 60, vmax=top,
                shading="gouraud", rasterized=True,
            )  # fmt: skip
            axes.axvline(evidence.instant * 1e3, color=DARK, linewidth=0.7, linestyle=":")
            axes.set(xlabel="time [ms]", yscale="log", ylim=(frequency[rows[0]] * 1e-3, frequency[-1] * 1e-3))
            axes.set_title(LAW_TITLES[evidence.stimulus.law], loc="left")
            _mark_modes(axes, evidence)
        panels[0].set_ylabel("frequency [kHz]")
        ticks = (0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)
        panels[0].set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        panels[0].minorticks_off()
        figure.colorbar(image, ax=panels, label="amplitude [dB re 1 mm/s]", shrink=0.9, pad=0.02)
    return figure


def _mark_modes(axes: Axes, evidence: Evidence) -> None:
    model = evidence.stimulus.model
    for label, frequency in zip(model.label, model.natural_frequency, strict=True):
        selected = label in evidence.stimulus.selected
        axes.plot([0.0, 0.025], [frequency * 1e-3] * 2, color=DARK, linewidth=1.4 if selected else 0.6,
                  transform=axes.get_yaxis_transform())  # fmt: skip
        axes.text(0.035, frequency * 1e-3, f"{label}", va="center", fontsize=6.5, color=DARK if selected else FAINT,
                  transform=axes.get_yaxis_transform())  # fmt: skip


def draw_all(evidences: Sequence[Evidence]) -> dict[str, tuple[Figure, str]]:
    """Draw the figures, each with its caption, by file name."""
    drawn = {
        "fig_2": (
            draw_decomposition(evidences[0]),
            "Fig. 2: the desired field decomposed on the modes of the beam. The strongest of the modelled modes are "
            "selected; the other modelled modes are at rest at the focusing instant.",
        ),
        "fig_5": (
            draw_maps(evidences),
            "Fig. 5: measured velocity by position and time. Black lines: half of the level. The dotted line is the "
            "focusing instant.",
        ),
        "fig_6": (
            draw_coefficients(evidences),
            "Fig. 6: desired coefficients of the selected modes, those predicted on the identified beam, and "
            "those measured (least squares over all points at the focusing instant). Right: their difference with 95 % "
            "intervals from record to record.",
        ),
        "fig_7": (
            draw_fields(evidences),
            "Fig. 7: the field at the focusing instant, points with 95 % intervals, and the difference of the "
            "measured field from the desired one and from that of the selected modes [mm/s].",
        ),
        "fig_8": (
            draw_spectrograms(evidences),
            "Fig. 8: spectrogram of the measured velocity at the focus (Hann window of 4 ms). Marks on the left: the "
            "modelled modes, with the selected ones in bold.",
        ),
    }
    if evidences[0].further_rows:
        drawn["fig_7_map"] = (
            draw_over_width(evidences),
            "Fig. 7 over the width: measured velocity at the focusing instant, the highest speed within 1 ms of it, "
            "and torsion, which grows linearly across the beam.",
        )
    return drawn
