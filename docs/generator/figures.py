"""The figures of the explanation, drawn from what the engine computes at this build."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import modaltouch
from generator.field import typical_finger
from generator.pages import write
from modaltouch.report import CONDITION_COLOURS, FAINT, PAIR_COLOURS, house_style, quiet_grid
from modaltouch.report.page import render

PLACE = np.linspace(-50, 50, 401)
"""Along the beam [mm]."""


def _modes(stimulus):
    figure = Figure(figsize=(6.4, 2.6))
    axes = figure.subplots(1, 3, sharey=True)
    shapes = stimulus.model.shapes(PLACE * 1e-3)
    for k, each in enumerate(axes):
        each.plot(PLACE, shapes[k], color=PAIR_COLOURS[0])
        each.axhline(0, color=FAINT, linewidth=0.6)
        each.set_title(f"mode {stimulus.model.label[k]}: {stimulus.model.natural_frequency[k]:,.0f} Hz")
        each.set_xlabel("place on the beam (mm)")
    axes[0].set_ylabel("shape (1)")
    return figure


def _adding_up(stimulus):
    figure = Figure(figsize=(6.4, 4.2))
    axes = figure.subplots(2, 2, sharex=True, sharey=True).ravel()
    shapes, target = stimulus.model.shapes(PLACE * 1e-3), stimulus.target * 1e3
    wanted = stimulus.target_field.profile(PLACE * 1e-3) * stimulus.target_field.velocity * 1e3
    order = np.argsort(-np.abs(target))
    for each, n in zip(axes, (1, 2, 3, 6), strict=True):
        each.plot(PLACE, wanted, color=FAINT, linewidth=1, linestyle="--", label="target")
        each.plot(PLACE, target[order[:n]] @ shapes[order[:n]], color=PAIR_COLOURS[0], label="sum of the modes")
        labels = ", ".join(str(stimulus.model.label[k]) for k in sorted(order[:n]))
        each.set_title(f"mode {labels}" if n == 1 else f"modes {labels}")
        quiet_grid(each)
    axes[0].legend(frameon=False)
    for each in axes[2:]:
        each.set_xlabel("place on the beam (mm)")
    for each in axes[::2]:
        each.set_ylabel("velocity (mm/s)")
    return figure


def _voltages(stimulus):
    figure = Figure(figsize=(6.4, 3.0))
    axes = figure.subplots(1, 2, width_ratios=(3, 2))
    volts = stimulus.voltage_played(stimulus.target_field.velocity)
    time = np.arange(volts.shape[1]) / stimulus.timing.sampling_rate * 1e3
    for each, (low, high) in zip(axes, ((0, 50), (24.5, 25.5)), strict=True):
        kept = np.flatnonzero((time >= low) & (time <= high))[:: 10 if high - low > 10 else 1]
        for channel, name in enumerate(("centre set", "side set")):
            each.plot(time[kept], volts[channel, kept], color=CONDITION_COLOURS[channel], linewidth=0.7, label=name)
        each.axvline(25, color=FAINT, linewidth=0.8, linestyle=":")
        each.set_xlabel("time (ms)")
    axes[0].set_ylabel("voltage at the beam (V)")
    axes[0].legend(frameon=False)
    axes[1].set_title("about the focusing instant")
    return figure


def _over_time(stimulus):
    figure = Figure(figsize=(6.4, 3.0))
    axes = figure.subplots()
    history = stimulus.velocity_history([-0.04, -0.02, 0.0], stimulus.target_field.velocity) * 1e3
    time = np.arange(history.shape[1]) / stimulus.timing.sampling_rate * 1e3
    near = np.abs(time - 25) < 0.8
    for row, name, colour in zip(history, "ABC", (PAIR_COLOURS[1], PAIR_COLOURS[2], PAIR_COLOURS[0]), strict=True):
        axes.plot(time[near], row[near], color=colour, label=f"zone {name}", linewidth=2 if name == "C" else 1.1)
    axes.axvline(25, color=FAINT, linewidth=0.8, linestyle=":")
    axes.set_xlabel("time (ms)")
    axes.set_ylabel("velocity (mm/s)")
    axes.legend(frameon=False)
    quiet_grid(axes)
    return figure


def _open_loop(checked):
    figure = Figure(figsize=(6.4, 2.8))
    axes = figure.subplots()
    found = checked.explore(sensitivity=True)["sensitivity"]
    rows = found["table"][:8][::-1]
    names = [f"{row['error']:.1%} {row['parameter'].replace('_', ' ')}, mode {row['mode']}" for row in rows]
    axes.barh(names, [row["field_mm_s"] for row in rows], color=PAIR_COLOURS[0], height=0.6)
    axes.set_xlabel(f"largest change of the field at {found['velocity_mm_s']:.0f} mm/s (mm/s)")
    return figure


def _under_fingers(stimulus):
    figure = Figure(figsize=(6.4, 3.0))
    axes = figure.subplots()
    beam = stimulus.touched((typical_finger(-40), typical_finger(0)))
    unit = stimulus.volts_per_code(0.1)
    axes.plot(
        PLACE, stimulus.velocity_at_focus(PLACE * 1e-3, 0.1) * 1e3, color=FAINT, linestyle="--", label="untouched"
    )
    axes.plot(
        PLACE,
        beam.velocity_at_focus(PLACE * 1e-3, unit) * 1e3,
        color=CONDITION_COLOURS[1],
        label="same voltages, two fingers",
    )
    designed = modaltouch.examine("under_the_finger").require().designs["A-C"].stimulus
    axes.plot(
        PLACE,
        designed.velocity_at_focus(PLACE * 1e-3, 0.1) * 1e3,
        color=PAIR_COLOURS[0],
        label="designed for the fingers",
    )
    for place in (-40, 0):
        axes.axvspan(place - 5, place + 5, color="#e3e7ec", zorder=0)
    axes.set_xlabel("place on the beam (mm); grey: the fingers, on A and C")
    axes.set_ylabel("velocity (mm/s)")
    axes.legend(frameon=False)
    return figure


def write_figures(folder: Path) -> None:
    """Draw every figure of the explanation."""
    checked = modaltouch.examine("differentiated_stimulation").require()
    stimulus = checked.stimulus
    with house_style():
        figures = {
            "modes": _modes(stimulus),
            "adding_up": _adding_up(stimulus),
            "voltages": _voltages(stimulus),
            "over_time": _over_time(stimulus),
            "open_loop": _open_loop(checked),
            "under_fingers": _under_fingers(stimulus),
        }
    for name, figure in figures.items():
        write(folder / f"{name}.svg", render(figure, "svg"))
