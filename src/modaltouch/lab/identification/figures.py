"""Figures of an identification: responses and fit, stability diagram, mode complexity, shapes (Fig. 4)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from numpy.typing import NDArray

from modaltouch.lab.common import DARK, LIGHT, MIDDLE, ComplexArray, FloatArray, draw_map
from modaltouch.lab.identification.modal_parameters import Identification
from modaltouch.lab.identification.responses import FrequencyResponses
from modaltouch.lab.identification.shapes import phase_collinearity, straightened
from modaltouch.report import FAINT, INK, house_style, quiet_grid
from modaltouch.stimulus import mode_shapes

FROM = 0.2
"""Lowest drawn frequency, relative to that of the lowest mode: the responses below would fill half of the axis [1]."""

STABILITIES: tuple[tuple[str, dict[str, Any]], ...] = (
    ("new", {"marker": "x", "ms": 3, "color": FAINT}),
    ("frequency within 1 % of the previous order", {"marker": "o", "mfc": "white"}),
    ("and damping ratio within 5 %", {"marker": "o"}),
)
"""Labels and markers for the stability of a pole."""


def draw_all(identification: Identification) -> dict[str, Figure]:
    """Draw all figures for which the responses suffice, by file name."""
    drawn = {
        "fits": draw_fits(identification),
        "stability": draw_stability(identification),
    }
    if any(mode.residue.size > 1 for mode in identification.modes):
        drawn["complexity"] = draw_complexity(identification)
    if identification.shaped:
        drawn["fig_4"] = draw_shapes(identification)
    if identification.shaped and np.any(identification.responses.across):
        drawn["fig_4_map"] = draw_shape_maps(identification)
    return drawn


def draw_fits(identification: Identification) -> Figure:
    """Draw the responses with the worst, median and best fit: magnitude, residual and phase."""
    responses = identification.responses
    flat = responses.response.reshape(-1, responses.frequency.size)
    fitted = identification.fitted.reshape(flat.shape)
    known = np.isfinite(fitted[0])
    left = np.linalg.norm((flat - fitted)[:, known], axis=1) / np.linalg.norm(flat[:, known], axis=1)
    order = np.argsort(-left)
    shown = {int(order[0]): "worst: ", int(order[len(order) // 2]): "median: ", int(order[-1]): "best: "}
    if len(order) == 1:
        shown = {0: ""}
    with house_style(7.6, 4.4, 2, len(shown), sharex=True, sharey="row", height_ratios=(3, 2)) as (figure, panels):
        for column, (index, rank) in zip(panels.T, shown.items(), strict=True):
            _draw_fit(column, identification, flat[index], fitted[index])
            s, p = divmod(index, responses.n_points)
            place = f" at {responses.places[p]}" if responses.places else ""
            words = f"{rank}{responses.sets[s]}{place},\n{left[index]:.2%} residual"
            column[0].set_title(words, fontsize=8.5)
            _frequency_axis(column[1], identification)
        panels[0, 0].set_ylabel(_unit(identification))
        quiet = float(np.nanmedian(np.abs((flat - fitted)[list(shown)])))
        panels[0, 0].set_ylim(200 * quiet, 2e3 * float(np.abs(flat[list(shown)]).max()))
        panels[1, 0].set(ylabel="phase [degrees]", yticks=range(-180, 181, 90))
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def _draw_fit(
    column: NDArray[Any], identification: Identification, measured: ComplexArray, fitted: ComplexArray
) -> None:
    """Draw one measured and fitted response; a known delay is removed from the phase."""
    frequency = identification.responses.frequency
    delay = identification.delay.value - identification.responses.offset
    turn = np.exp(2j * np.pi * frequency * (0.0 if math.isnan(delay) else delay))
    place = frequency / 1e3
    for values, label, look in (
        (measured - fitted, "measured minus fitted", {"color": FAINT, "lw": 0.4}),
        (measured, "measured", {"color": MIDDLE, "lw": 1.5}),
        (fitted, "fitted", {"color": INK, "lw": 0.8}),
    ):
        column[0].plot(place, np.abs(values) * 1e3, label=label, **look)
    _velocity_axis(column[0])
    for values, look in ((measured, {"color": MIDDLE, "lw": 1.5}), (fitted, {"color": INK, "lw": 0.8})):
        phase = np.degrees(np.angle(values * turn))
        phase[1:][np.abs(np.diff(phase)) > 180] = np.nan
        column[1].plot(place, phase, **look)
    column[1].set_ylim(-185, 185)
    quiet_grid(column[1])


def draw_stability(identification: Identification) -> Figure:
    """Draw the stability diagram of a common-denominator model over the responses and the identified modes."""
    responses = identification.responses
    size = np.sqrt((np.abs(responses.response) ** 2).mean(axis=(0, 1)))
    order, frequency, _, stability = poles_by_order(responses)
    with house_style(7.6, 4.2) as (figure, [[axes]]):
        behind = axes.twinx()
        behind.plot(responses.frequency / 1e3, size, color=LIGHT, lw=1.6)
        _velocity_axis(behind)
        behind.set_axis_off()
        axes.set_zorder(1)
        axes.patch.set_visible(False)
        for kind, (label, look) in enumerate(STABILITIES):
            given: dict[str, Any] = {"color": DARK, "ms": 3.4, "mew": 0.7, "ls": "", **look}
            axes.plot(frequency[stability == kind] / 1e3, order[stability == kind], label=label, **given)
        axes.set(ylabel="model order, in each band", ylim=(0, HIGHEST_ORDER + 1))
        _mark_modes(axes, identification)
        _frequency_axis(axes, identification)
        figure.legend(loc="outside lower center", ncols=3, frameon=False)
        figure.suptitle("Poles of the least squares complex frequency domain; grey line: responses", fontsize=10)
    return figure


def draw_complexity(identification: Identification) -> Figure:
    """Draw the residues of every mode in the complex plane, rotated so that their common line is real."""
    modes = [mode for mode in identification.modes if mode.residue.size > 1]
    n_rows = math.ceil(len(modes) / 6)
    with house_style(7.6, 0.5 + 1.05 * n_rows, n_rows, 6, subplot_kw={"aspect": "equal"}) as (figure, panels):
        for axes, mode in zip_longest(panels.ravel(), modes):
            axes.set_axis_off()
            if mode is None:
                continue
            straight = straightened(mode.residue) / np.abs(mode.residue).max()
            axes.axhline(0, color=LIGHT, lw=0.8)
            axes.axvline(0, color=LIGHT, lw=0.8)
            # Draw all with one line: each from the origin, followed by a gap.
            spokes = np.outer(straight, [0, 1, np.nan]).ravel()
            axes.plot(spokes.real, spokes.imag, color=DARK, lw=0.7)
            axes.plot(straight.real, straight.imag, "o", ms=2.2, color=DARK)
            name = f"mode {mode.name}" if mode.label or mode.torsion else mode.name
            axes.set_title(f"{name}\n{_rounded_down(phase_collinearity(mode.residue))}", fontsize=7.5)
            axes.set(xlim=(-1.1, 1.1), ylim=(-0.6, 0.6))
        figure.suptitle("Residues in the complex plane; phase collinearity", fontsize=10)
    return figure


def draw_shapes(identification: Identification) -> Figure:
    """Draw the measured shapes with those of a uniform free-free beam, as in Fig. 4."""
    modes = [mode for mode in identification.modes if mode.label is not None and mode.shape is not None]
    positions, length = identification.responses.positions, identification.length
    n_rows = math.ceil(len(modes) / 3)
    with house_style(7.6, 0.5 + 1.5 * n_rows, n_rows, 3, sharex=True, sharey=True) as (figure, panels):
        for axes, mode in zip_longest(panels.ravel(), modes):
            if mode is None or mode.label is None or positions is None or length is None:
                axes.set_axis_off()
                continue
            fine = np.linspace(-length / 2, length / 2, 401)
            axes.axhline(0, color=LIGHT, lw=0.8)
            axes.plot(fine * 1e3, mode_shapes([mode.label], fine, length)[0], color=FAINT, lw=1)
            axes.plot(positions * 1e3, mode.shape, "o", ms=2.4, color=DARK, clip_on=False)
            kilohertz = mode.natural_frequency.value / 1e3
            axes.set_title(f"mode {mode.label}, {kilohertz:.4g} kHz, MAC {_rounded_down(mode.mac)}", fontsize=8)
            axes.set(xlim=(-length * 5e2, length * 5e2), ylim=(-2.6, 2.6))
        for axes in panels.ravel()[: len(modes)][-3:]:
            axes.tick_params(labelbottom=True)
        figure.supxlabel("position along the beam [mm]", fontsize=9)
        figure.suptitle("Mode shapes of unit mean square: dots measured, lines a uniform free-free beam", fontsize=10)
    return figure


def draw_shape_maps(identification: Identification) -> Figure:
    """Draw the measured shapes over length and width, including torsion, as in Fig. 4."""
    n_rows = math.ceil(len(identification.shaped) / 3)
    x, y = np.array(identification.responses.places).T
    with house_style(7.6, 0.7 + 0.95 * n_rows, n_rows, 3, sharex=True, sharey=True) as (figure, panels):
        for axes in panels.ravel()[len(identification.shaped) :]:
            axes.set_axis_off()
        for axes, (mode, shape) in zip(panels.ravel(), identification.shaped, strict=False):
            drawn = draw_map(axes, x, y, shape, 2.0)
            axes.set_title(f"mode {mode.name}, {mode.natural_frequency.value / 1e3:.4g} kHz", fontsize=8)
        figure.colorbar(drawn, ax=panels, label="shape", shrink=0.9, pad=0.02)
        figure.supxlabel("position along the beam [mm]", fontsize=9)
        figure.supylabel("across it [mm]", fontsize=9)
        figure.suptitle("Measured mode shapes; T: torsion", fontsize=10)
    return figure


def _mark_modes(axes: Axes, identification: Identification) -> None:
    """Draw a line at each identified mode, with its label above, in two staggered rows."""
    for mode in identification.modes:
        place = mode.natural_frequency.value / 1e3
        axes.axvline(place, color=FAINT, lw=0.5, alpha=0.5, ls="-" if mode.label else ":", zorder=0.9)
        if mode.label:
            axes.annotate(
                str(mode.label), (place, 1), xytext=(0, 2 + 8 * (mode.label % 2)), xycoords=axes.get_xaxis_transform(),
                textcoords="offset points", ha="center", fontsize=7.5,
            )  # fmt: skip


def _unit(identification: Identification) -> str:
    return f"velocity [mm/s per {identification.responses.per or 'unit of excitation'}]"


def _rounded_down(value: float) -> str:
    """Format a MAC with four decimals, rounded down so that only an exact 1 is printed as 1."""
    return f"{math.floor(value * 1e4) / 1e4:.4f}"


def _frequency_axis(axes: Axes, identification: Identification) -> None:
    """Make the frequency axis logarithmic, from a little below the lowest mode to the end of the measured band."""
    lowest = FROM * min(mode.natural_frequency.value for mode in identification.modes)
    first, last = identification.responses.frequency[[0, -1]].tolist()
    low, high = max(first, min(lowest, last / 2)) / 1e3, last / 1e3
    axes.set_xscale("log", subs=(1, 2, 5))
    _plain_ticks(axes.xaxis, (1.0,) if high > 100 * low else (1.0, 2.0, 5.0))
    axes.set(xlabel="frequency [kHz]", xlim=(low, high))


def _velocity_axis(axes: Axes) -> None:
    axes.set_yscale("log", subs=())
    _plain_ticks(axes.yaxis, (1.0,))
    quiet_grid(axes)


def _plain_ticks(axis: Axis, digits: tuple[float, ...]) -> None:
    """Label ticks as 0.1, 1, 10 instead of powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=digits))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


HIGHEST_ORDER = 50
"""Highest order of the denominator in each band."""

STABLE_FREQUENCY, STABLE_DAMPING = 0.01, 0.05
"""Largest relative changes of a stable pole from one order to the next [1]."""


def poles_by_order(responses: FrequencyResponses) -> FloatArray:
    """Return the poles of every model order, fitted to all responses weighted by their noise.

    Returns
    -------
    (4, n_poles) array
        Order, natural frequency [Hz], damping ratio, and stability: 0 for a new pole, 1 if the previous order has a
        pole of the same frequency, 2 if it has one of the same frequency and damping ratio.
    """
    frequency, white = responses.frequency, responses.response / np.sqrt(responses.noise)[:, None]
    # A band of more than four octaves is beyond the conditioning of the polynomial basis.
    n_bands = max(1, math.ceil(math.log(frequency[-1] / frequency[0]) / math.log(16)))
    edges = np.geomspace(frequency[0], frequency[-1], n_bands + 1)
    found = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        near = (frequency >= low / 1.2) & (frequency <= high * 1.2)
        before = np.full((4, 1), np.inf)
        for poles in _poles(frequency[near], white[..., near].reshape(-1, int(near.sum()))):
            _, own, ratio, stable = poles = poles[:, (poles[1] >= low) & (poles[1] <= high)]
            same = np.abs(before[1] / own[:, None] - 1) <= STABLE_FREQUENCY
            alike = same & (np.abs(before[2] / ratio[:, None] - 1) <= STABLE_DAMPING)
            stable[:] = same.any(axis=1) * 1.0 + alike.any(axis=1)
            before = poles
            found.append(poles)
    return np.concatenate(found, axis=1)


def _poles(frequency: FloatArray, white: ComplexArray) -> Iterator[FloatArray]:
    """Yield the poles of a common denominator of each order, with numerators of the same order.

    With the highest coefficient fixed at 1, spurious poles are unstable. All matrices of sums over bins are Toeplitz.
    """
    from scipy.linalg import toeplitz

    rate = float(frequency[-1] - frequency[0])
    # For a single response the coefficients of numerator and denominator must remain fewer than the bins.
    orders = np.arange(min(HIGHEST_ORDER, frequency.size // 3) + 1)
    basis = np.exp(-2j * np.pi * np.outer(orders, (frequency - frequency[0]) / rate))
    alone, power = basis.sum(axis=1), basis @ (np.abs(white) ** 2).sum(axis=0)
    mixed = [toeplitz(column, row) for row, column in zip(white @ basis.T, white @ basis.conj().T, strict=True)]
    # The Cholesky factor of a lower order is the leading block of that of a higher one: the numerators' contribution
    # adds up row by row.
    taken = np.linalg.solve(np.linalg.cholesky(toeplitz(alone.conj(), alone)), np.array(mixed))
    left = toeplitz(power.conj(), power)
    for n in orders:
        left = left - taken[:, n].conj().T @ taken[:, n]
        if n > 1:
            coefficient = np.append(np.linalg.solve(left[:n, :n], -left[:n, n]), 1.0)
            pole = -np.log(np.roots(coefficient[::-1])) * rate / (2 * np.pi)
            damped = frequency[0] + np.mod(pole.imag, rate)
            own = np.hypot(damped, pole.real)
            # Strongly damped poles are of no structure.
            shown = (pole.real < 0) & (-pole.real < 0.2 * own)
            yield np.stack([0.0 * own + n, own, -pole.real / own, 0.0 * own])[:, shown]
