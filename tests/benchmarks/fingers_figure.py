"""The figure of the beam with fingers: the field with and without them, and the level by placement."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from modaltouch.report.page import FAINT, INK, house_style
from modaltouch.stimulus import Finger, ModalModel, Stimulus

COLOURS = {"free": "#c2541b", "typical": "#5bb8e8", "known": "#0b3c8c"}
LABELS = {
    "free": "designed for the untouched beam",
    "typical": "designed for typical fingers",
    "known": "designed for these fingers",
}
FINGERS = (-0.04, 0.0)
TYPICAL = (0.08e-3, 0.5, 500.0)
LEVEL = 0.2


def draw(stimulus: Stimulus, table: ModalModel, rows: dict[str, dict[str, list[dict[str, float]]]], file: Path) -> None:
    """Write the figure: left the field at the focusing instant, right the level at C in forty placements per pair."""
    with house_style():
        figure = Figure(figsize=(9.6, 3.9))
        field, level = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        place = np.linspace(-0.05, 0.05, 401)
        fingers = tuple(Finger(each, *TYPICAL) for each in FINGERS)
        loaded = replace(stimulus, model=table.touched(fingers))
        unit = stimulus.volts_per_code(LEVEL)
        untouched = stimulus.touched(()).velocity_at_focus(place, unit)
        touched = stimulus.touched(fingers).velocity_at_focus(place, unit)
        mended = loaded.touched(fingers).velocity_at_focus(place, loaded.volts_per_code(LEVEL))
        field.plot(place * 1e3, untouched * 1e3, color=FAINT, lw=4.0, label="untouched beam")
        field.plot(place * 1e3, touched * 1e3, color=COLOURS["free"], label="the same drive under two fingers")
        field.plot(place * 1e3, mended * 1e3, color=COLOURS["known"], ls="--", label="drive designed for them")
        for each in FINGERS:
            field.axvspan(each * 1e3 - 5, each * 1e3 + 5, ymax=0.04, color="#e0a88c", lw=0)
            field.text(each * 1e3, 0.05, "finger", transform=field.get_xaxis_transform(), ha="center")
        field.set(
            xlabel="position on the beam [mm]",
            ylabel="velocity at the focusing instant [mm/s]",
            title="200 mm/s at C, and what two typical fingers leave of it",
            xlim=(-50, 50),
        )
        field.set_ylim(-60, 290)
        field.legend(loc="upper left", frameon=False)
        rng = np.random.default_rng(1)
        for column, by_name in enumerate(rows.values()):
            for shift, name in enumerate(COLOURS):
                values = 100 * np.array([row["at_C"] for row in by_name[name]])
                x = column + 0.27 * (shift - 1) + 0.05 * rng.standard_normal(values.size)
                level.scatter(x, values, s=9, color=COLOURS[name], lw=0, label=LABELS[name] if column == 0 else None)
        level.axhline(100, color=INK, lw=0.8, zorder=0)
        level.set_xticks(range(len(rows)), [f"fingers on {pair.replace('-', ', ')}" for pair in rows])
        level.set(ylabel="level at C, of the level asked [%]", title="Forty placements on each pair", ylim=(0, 185))
        level.legend(loc="upper left", frameon=False)
        file.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(file, dpi=110, metadata={"Software": None})
