"""The figure of run time against error: making a stimulus, predicting its effect, and whole commands."""

from typing import Any

from bars import RESULTS
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from modaltouch.report.page import INK, house_style

SIZES = {12_500: 18, 25_000: 36, 62_500: 64, 125_000: 110}
"""Area of the marker for each number of samples [pt^2]."""

MAKING = {
    ("paper", "14 bits"): ("the paper's law", "#c2541b", "X"),
    ("exact", "14 bits"): ("exact law", "#5bb8e8", "o"),
    ("exact", "14 bits, settled"): ("exact law,\nrounding\nerror\nsteered", "#0b3c8c", "o"),
}
PREDICTING = {
    "engine, state at t_F": ("modaltouch,\nonly $t_F$", "#0b3c8c", "o"),
    "engine, whole history": ("modaltouch, whole history", "#5bb8e8", "o"),
    "plain NumPy": ("plain NumPy", "#f4c518", "s"),
    "lfilter, nine calls": ("SciPy lfilter", "#2f9e77", "^"),
    "lsim, one call": ("SciPy lsim", "#c2541b", "D"),
    "forced_response, one call": ("control\nforced_response", "#9a5b9f", "v"),
}
COMMANDS = {
    "check": ("check", "#0b3c8c", "o"),
    "verify": ("verify", "#2f9e77", "^"),
    "simulate": ("simulate,\n24 trials", "#c2541b", "D"),
}
"""Label, colour and marker of each series."""

LEAST = 1e-17
"""Errors of zero are shown at this value."""

Points = list[dict[str, Any]]
Label = tuple[int, tuple[float, float], str]
"""Point next to the label of a series, by increasing number of samples; offset [pt] and alignment."""


def _dress(axis: Axes, title: str, errors: tuple[float, float], times: tuple[float, float]) -> None:
    axis.set(xscale="log", yscale="log", ylim=errors, xlim=times)
    axis.set_title(title, fontsize=10, loc="left")
    axis.grid(which="major", alpha=0.25, lw=0.6)
    axis.yaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_minor_locator(NullLocator())
    axis.yaxis.set_major_locator(LogLocator(numticks=9))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _draw_series(axis: Axes, points: Points, style: tuple[str, str, str], label: Label) -> None:
    """Draw one series, its marks growing with the number of samples, and its label beside one of them."""
    text, colour, marker = style
    points = sorted(points, key=lambda each: each["n_samples"])
    axis.scatter(
        [each["time_ms"] for each in points],
        [max(each["error"], LEAST) for each in points],
        s=[SIZES[each["n_samples"]] for each in points],
        c=colour,
        marker=marker,
        edgecolors=INK,
        linewidths=0.5,
        zorder=3,
    )
    nth, offset, side = label
    at = (points[nth]["time_ms"], max(points[nth]["error"], LEAST))
    axis.annotate(text, at, offset, textcoords="offset points", fontsize=8, ha=side, va="center", zorder=4)


def draw(points: Points) -> None:
    """Write ``time_against_error.png``: making a stimulus of nine modes, predicting them, and whole commands."""
    with house_style():
        figure = Figure(figsize=(11, 3.9), layout="none")
        axes = figure.subplots(1, 3, gridspec_kw={"wspace": 0.3, "width_ratios": (1, 1.25, 1)})
        figure.subplots_adjust(left=0.065, right=0.99, top=0.92, bottom=0.24)
        _dress(axes[0], "Make nine modes' codes", (1e-9, 1.0), (0.5, 20.0))
        _dress(axes[1], "Predict nine modes at $t_F$", (1e-18, 1.0), (0.012, 900.0))
        _dress(axes[2], "Whole commands", (1e-5, 1e-1), (100.0, 1500.0))
        axes[0].set_xticks([0.5, 1, 2, 5, 10, 20])
        axes[1].set_xticks([0.1, 1, 10, 100])
        axes[2].set_xticks([100, 200, 500, 1000])
        for key, style, at in zip(MAKING, MAKING.values(), _MAKING_LABELS, strict=True):
            some = [each for each in points if each["task"] == "making" and each["n_modes"] == 9]
            _draw_series(axes[0], [each for each in some if (each["law"], each["bits"]) == key], style, at)
        for axis, task, series, labels in (
            (axes[1], "predicting", PREDICTING, _PREDICTING_LABELS),
            (axes[2], "command", COMMANDS, _COMMAND_LABELS),
        ):
            some = [each for each in points if each["task"] == task]
            for who, at in zip(series, labels, strict=True):
                _draw_series(axis, [each for each in some if each["who"] == who], series[who], at)
        axes[0].set_ylabel("largest modal error at $t_F$ / peak")
        axes[2].set_ylabel("error of the field, $t_F$ ± 1 ms / peak")
        for axis, what in zip(axes, ("run time", "run time", "processor time"), strict=True):
            axis.set_xlabel(f"{what} on one core [ms]")
        handles = [
            Line2D([], [], ls="", marker="o", mfc="white", mec=INK, ms=area**0.5, label=f"{n:,} samples")
            for n, area in SIZES.items()
        ]
        figure.legend(handles=handles, loc="lower center", ncols=4, frameon=False, fontsize=8)
        RESULTS.mkdir(parents=True, exist_ok=True)
        figure.savefig(RESULTS / "time_against_error.png", dpi=130, metadata={"Software": None})


_MAKING_LABELS = ((-1, (0, 13), "center"), (-1, (10, 0), "left"), (-1, (22, 0), "left"))
_PREDICTING_LABELS = (
    (-1, (8, 17), "right"),
    (1, (0, -16), "left"),
    (-1, (10, 0), "left"),
    (-1, (0, 13), "center"),
    (-1, (0, 15), "center"),
    (1, (0, 17), "center"),
)
_COMMAND_LABELS = ((-1, (11, 0), "left"), (-1, (-11, 0), "right"), (-1, (0, -21), "center"))
