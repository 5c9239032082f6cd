"""The picture of run time against error: making a stimulus of 3, 6 or 9 modes, and predicting what one does."""

from typing import Any

from bars import RESULTS
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from modaltouch.report.style import INK, house_style

SIZES = {12_500: 18, 25_000: 36, 62_500: 64, 125_000: 110}
BITS = {
    "10 bits": "#d3e3f3",
    "12 bits": "#8fbbe0",
    "14 bits": "#3f83c4",
    "14 bits, settled": "#0b3c8c",
    "before rounding": "#f4c518",
}
MEANS = {
    "engine, state at t_F": ("#0b3c8c", "o"),
    "engine, whole history": ("#5bb8e8", "o"),
    "plain NumPy": ("#f4c518", "s"),
    "lfilter, nine calls": ("#2f9e77", "^"),
    "lsim, one call": ("#c2541b", "D"),
    "forced_response, one call": ("#9a5b9f", "v"),
}
LAWS = {"exact": "o", "paper": "X"}
ROUNDED = {bits: "s" if bits == "before rounding" else "o" for bits in BITS}
"""What no generator plays has a form of its own."""

LEAST = 1e-17
"""Errors of nothing at all are shown here."""


def _mark(axis: Axes, points: list[dict[str, Any]], colour: str, marker: str) -> None:
    for point in points:
        axis.scatter(
            point["time_ms"],
            max(point["error"], LEAST),
            s=SIZES[point["n_samples"]] * (1.2 if marker == "X" else 1.0),
            c=colour,
            marker=marker,
            edgecolors=INK,
            linewidths=0.5,
            zorder=3,
        )


def _front(axis: Axes, points: list[dict[str, Any]]) -> None:
    front = sorted((each for each in points if each["front"]), key=lambda each: each["time_ms"])
    times = [each["time_ms"] for each in front]
    errors = [max(each["error"], LEAST) for each in front]
    axis.step([times[0], *times, axis.get_xlim()[1]], [1.0, *errors, errors[-1]], "-", where="post", c=INK, lw=1.0)


def _dress(axis: Axes, title: str) -> None:
    axis.set(xscale="log", yscale="log", ylim=(3e-18, 1.0), title=title)
    axis.title.set_fontsize(9)
    axis.grid(which="major", alpha=0.25, lw=0.6)
    axis.yaxis.set_minor_locator(NullLocator())
    axis.set_yticks([10.0**power for power in range(-16, 1, 2)])
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))


def _keys(figure: Figure) -> None:
    def key(label: str, colour: str, marker: str, size: float = 7.0) -> Line2D:
        return Line2D([], [], ls="", marker=marker, mfc=colour, mec=INK, mew=0.5, ms=size, label=label)

    rounding = [key(label, colour, ROUNDED[label]) for label, colour in BITS.items()]
    laws = [key("exact law", "white", "o"), key("law of the paper", "white", "X", 8.0)]
    samples = [key(f"{n:,} samples", "white", "o", size**0.5) for n, size in SIZES.items()]
    front = [Line2D([], [], c=INK, lw=1.0, label="front: nothing is\nfaster and nearer")]
    means = [key(who, *style) for who, style in MEANS.items()]
    for place, title, handles in (
        ((0.69, 0.47), "making", [*rounding, *laws]),
        ((0.69, 0.235), "predicting", means),
        ((0.85, 0.47), "both", [*samples, *front]),
    ):
        legend = figure.legend(
            handles=handles, title=title, loc="upper left", bbox_to_anchor=place, frameon=False, alignment="left"
        )
        legend.get_title().set_fontweight("bold")


def draw(points: list[dict[str, Any]]) -> None:
    """Write ``stimulus.svg`` and ``stimulus.png``: upper row making, by modes; below predicting, and the keys."""
    with house_style():
        figure = Figure(figsize=(10, 7.2))
        grid = figure.add_gridspec(2, 3, left=0.075, right=0.985, top=0.95, bottom=0.075, hspace=0.3, wspace=0.08)
        making = [each for each in points if each["task"] == "making"]
        first: Axes | None = None
        for column, n_modes in enumerate(sorted({each["n_modes"] for each in making})):
            axis = figure.add_subplot(grid[0, column], sharex=first, sharey=first)
            first = first or axis
            some = [each for each in making if each["n_modes"] == n_modes]
            _dress(axis, f"Making a stimulus of {n_modes} modes")
            for bits, colour in BITS.items():
                for law, marker in {**LAWS, "exact": ROUNDED[bits]}.items():
                    _mark(axis, [p for p in some if (p["bits"], p["law"]) == (bits, law)], colour, marker)
            axis.tick_params(labelleft=column == 0)
            _front(axis, some)
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis = figure.add_subplot(grid[1, :2])
        _dress(axis, "Predicting nine modes at $t_F$")
        predicting = [each for each in points if each["task"] == "predicting"]
        for who, (colour, marker) in MEANS.items():
            _mark(axis, [p for p in predicting if p["who"] == who], colour, marker)
        _front(axis, predicting)
        for each in figure.axes:
            each.set_xlabel("run time on one core [ms]")
        for each in (figure.axes[0], axis):
            each.set_ylabel("worst modal error at $t_F$, over the peak")
        _keys(figure)
        RESULTS.mkdir(parents=True, exist_ok=True)
        figure.savefig(RESULTS / "stimulus.svg", metadata={"Date": None})
        figure.savefig(RESULTS / "stimulus.png", dpi=110, metadata={"Software": None})
