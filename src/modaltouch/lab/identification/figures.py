"""The figures of an identification: responses with their peaks, coherence, and shapes as in Fig. 4."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from modaltouch.lab.arrays import FloatArray
from modaltouch.lab.identification.estimates import Identification, IdentifiedMode
from modaltouch.report import CONDITION_COLOURS, FAINT, INK, house_style, quiet_grid
from modaltouch.stimulus import mode_shapes

STYLES = ("-", "--", ":", "-.")
"""Of the lines, so that nothing hangs on colour."""

DRAWN_BINS = 1500
"""Bins that a curve keeps: a figure shows no more."""

PANELS_PER_ROW = 3


def draw_responses(identification: Identification) -> Figure:
    """Return the responses, root mean square over the points, with every mode at its place."""
    responses = identification.responses
    size = np.sqrt((np.abs(responses.response) ** 2).mean(axis=1)) * 1e3
    with house_style():
        figure = Figure(figsize=(7.6, 4.0))
        axes = figure.subplots()
        for row, name in enumerate(responses.sets):
            kept = _thinned(responses.frequency, size[row])
            colour = CONDITION_COLOURS[row % len(CONDITION_COLOURS)]
            axes.plot(responses.frequency[kept] / 1e3, size[row][kept], STYLES[row % 4], color=colour, lw=1, label=name)
        _logarithmic(axes)
        top, bottom = float(size.max()), float(np.percentile(size, 1))
        axes.set_ylim(bottom / 2, top * 4)
        for mode in identification.modes:
            _mark(axes, identification, mode, size, top)
        unit = "volt" if identification.length is not None else "unit of excitation"
        axes.set_ylabel(f"rms velocity per {unit} [mm/s]")
        axes.set_title("Responses; filled: joint fit, labelled by mode; ring: picked peak, where half-power is sound")
        figure.legend(loc="outside lower center", ncols=4, frameon=False, title="excitation", title_fontsize=8)
    return figure


def _mark(axes: Axes, identification: Identification, mode: IdentifiedMode, size: FloatArray, top: float) -> None:
    frequency = mode.natural_frequency.value
    bin_ = int(np.abs(identification.responses.frequency - frequency).argmin())
    height = float(size[:, bin_].max())
    labelled = mode.label is not None
    axes.plot(frequency / 1e3, height, "o", ms=4 if labelled else 2.5, color=INK if labelled else FAINT, zorder=3)
    if not mode.half_power.verdict:
        axes.plot(mode.half_power.peak_frequency / 1e3, height, "o", ms=8, mfc="none", mec=INK, mew=0.8, zorder=3)
    if labelled:
        axes.annotate(
            str(mode.label),
            (frequency / 1e3, height),
            xytext=(0, 8 + 9 * ((mode.label or 0) % 2)),
            textcoords="offset points",
            ha="center",
            fontsize=8,
        )


def draw_coherence(identification: Identification) -> Figure:
    """Return the coherence over the points: its median, and the band that holds eight points of ten."""
    responses = identification.responses
    coherence = responses.coherence
    with house_style():
        figure = Figure(figsize=(7.6, 1.2 + 1.7 * len(responses.sets)))
        panels = figure.subplots(len(responses.sets), 1, sharex=True, squeeze=False)[:, 0]
        for row, (axes, name) in enumerate(zip(panels, responses.sets, strict=True)):
            if coherence is None:
                continue
            low, median, high = np.percentile(coherence[row], [10, 50, 90], axis=0)
            kept = _thinned(responses.frequency, -median)
            frequency = responses.frequency[kept] / 1e3
            axes.fill_between(frequency, low[kept], high[kept], color="#d5dae1", lw=0)
            axes.plot(frequency, median[kept], color=CONDITION_COLOURS[row % len(CONDITION_COLOURS)], lw=0.9)
            for mode in identification.modes:
                if mode.label is not None:
                    axes.axvline(mode.natural_frequency.value / 1e3, color=FAINT, lw=0.5, ls=":")
            axes.set_xscale("log")
            axes.set_ylim(0, 1.02)
            axes.set_xlim(frequency[0], frequency[-1])
            axes.set_ylabel(f"{name}: coherence")
        _plain_ticks(panels[-1])
        panels[-1].set_xlabel("frequency [kHz]; dotted: identified modes")
        figure.suptitle("Coherence: median over the points, and its 10th to 90th percentile (shaded)", fontsize=10)
    return figure


def draw_shapes(identification: Identification) -> Figure:
    """Return the measured shapes over those of a uniform free-free beam, as in Fig. 4."""
    modes = [mode for mode in identification.modes if mode.label is not None and mode.shape is not None]
    positions, length = identification.responses.positions, identification.length
    n_rows = math.ceil(len(modes) / PANELS_PER_ROW)
    with house_style():
        figure = Figure(figsize=(7.6, 0.5 + 1.5 * n_rows))
        panels = figure.subplots(n_rows, PANELS_PER_ROW, sharex=True, sharey=True, squeeze=False)
        for axes in panels.ravel()[len(modes) :]:
            axes.set_axis_off()
        for axes, mode in zip(panels.ravel(), modes, strict=False):
            if positions is None or length is None or mode.shape is None or mode.label is None:
                continue
            fine = np.linspace(-length / 2, length / 2, 401)
            axes.axhline(0, color="#e3e7ec", lw=0.8)
            axes.plot(fine * 1e3, mode_shapes([mode.label], fine, length)[0], color=FAINT, lw=1)
            axes.plot(positions * 1e3, mode.shape, "o", ms=2.4, color=CONDITION_COLOURS[0])
            kilohertz = mode.natural_frequency.value / 1e3
            axes.set_title(f"mode {mode.label}, {kilohertz:.4g} kHz, MAC {_mac(mode.mac)}", fontsize=8)
            axes.set_ylim(-2.6, 2.6)
        for axes in panels[-1]:
            axes.set_xlabel("position [mm]")
        for index in range(PANELS_PER_ROW):
            last = max(row for row in range(n_rows) if row * PANELS_PER_ROW + index < max(len(modes), index + 1))
            panels[last, index].set_xlabel("position [mm]")
            panels[last, index].tick_params(labelbottom=True)
        figure.suptitle("Mode shapes of unit mean square: dots measured, lines a uniform free-free beam", fontsize=10)
    return figure


def _mac(value: float) -> str:
    """Return a likeness as it is printed: no 1 that is not one."""
    return f"{math.floor(value * 1e4) / 1e4:.4f}"


def _thinned(frequency: FloatArray, size: FloatArray) -> NDArray[np.intp]:
    """Return the bins that a curve over the logarithm of frequency needs: each stretch's extremes."""
    if frequency.size <= DRAWN_BINS:
        return np.arange(frequency.size)
    stretch = np.floor(np.log(frequency / frequency[0]) / np.log(frequency[-1] / frequency[0]) * DRAWN_BINS / 2)
    edges = np.flatnonzero(np.diff(stretch)) + 1
    kept = []
    for part in np.split(np.arange(frequency.size), edges):
        kept += sorted({int(part[size[part].argmax()]), int(part[size[part].argmin()])})
    return np.array(kept)


def _logarithmic(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    quiet_grid(axes)
    _plain_ticks(axes)
    axes.set_xlabel("frequency [kHz]")


def _plain_ticks(axes: Axes) -> None:
    """Write 0.1, 1, 10 instead of powers."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
