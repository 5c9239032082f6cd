"""What the evidence says, in words and in one table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

Figures = dict[str, Any]


def summary(figures: Sequence[Figures]) -> list[dict[str, Any]]:
    """Return the rows of the table that sets the laws side by side: a quantity, its unit, a cell to each law.

    Parameters
    ----------
    figures : sequence of dict
        As `key_figures` returns them, one to each law.
    """
    rows: list[tuple[str, str, Callable[[Figures], str]]] = [
        ("velocity at the focus, at the focusing instant", "mm/s", lambda f: f"{f['velocity_at_focus_mm_s']:.1f}"),
        (
            "highest velocity at the focus, and when",
            "mm/s, ms",
            lambda f: f"{f['highest_velocity_at_focus_mm_s']:.1f} at {f['highest_velocity_instant_ms']:.3f}",
        ),
        (
            "worst modal error (its mode)",
            "mm/s",
            lambda f: f"{f['worst_modal_error_mm_s']:.2f} ({f['worst_mode']})",
        ),
        ("modal error, root mean square", "mm/s", lambda f: f"{f['rms_modal_error_mm_s']:.2f}"),
        ("largest coefficient of a mode not modelled", "mm/s", lambda f: f"{f['unmodelled_motion_mm_s']:.2f}"),
        ("field less wish: rms, largest", "mm/s", lambda f: _error(f, "measured_from_wished")),
        (
            "field less that of the selected modes: rms, largest",
            "mm/s",
            lambda f: _error(f, "measured_from_selected_modes"),
        ),
        ("field less prediction: rms, largest", "mm/s", lambda f: _error(f, "measured_from_predicted")),
        ("spot width at 50 %: measured, predicted, wished", "mm", lambda f: _widths(f["width_50_mm"])),
        ("spot width at 80 %: measured, predicted, wished", "mm", lambda f: _widths(f["width_80_mm"])),
        ("time above 90 % of the peak: measured, predicted", "µs", lambda f: _widths(f["time_above_90_us"])),
    ]
    table = [{"quantity": name, "unit": unit, "cells": [cell(f) for f in figures]} for name, unit, cell in rows]
    for zone in figures[0]["zone_peak_mm_s"]:
        cells = [_widths(f["zone_peak_mm_s"][zone], 0) for f in figures]
        table.append({"quantity": f"peak speed at {zone}: measured, predicted", "unit": "mm/s", "cells": cells})
    for i, pair in enumerate(figures[0]["contrasts"]):
        name = f"contrast of ({pair['zone_left']}, {pair['zone_right']}): measured, predicted"
        cells = [_widths({key: f["contrasts"][i][key] for key in ("measured", "predicted")}, 2) for f in figures]
        table.append({"quantity": name, "unit": "1", "cells": cells})
    for output in figures[0]["peak_drive_V"]:
        cells = [_widths(f["peak_drive_V"][output], 0) for f in figures]
        table.append({"quantity": f"peak drive of output {output}: measured, predicted", "unit": "V", "cells": cells})
    return table


def findings(figures: Sequence[Figures]) -> list[str]:
    """Return what the numbers say, in sentences made from them.

    Parameters
    ----------
    figures : sequence of dict
        As `key_figures` returns them, one to each law.
    """
    said = [_reached(f) for f in figures]
    if len(figures) > 1:
        said.append(_compared(figures))
    said += [_limits(f) for f in figures[:1]]
    return said


def _reached(f: Figures) -> str:
    width = f["width_80_mm"]["measured"]
    above = f["time_above_90_us"]["measured"]
    return (
        f"Law “{f['law']}”: {f['velocity_at_focus_mm_s']:.1f} mm/s were measured at the focus, where "
        f"{f['velocity_mm_s']:g} mm/s were wished; the spot is {_number(width)} mm wide at 80 % (the paper: roughly "
        f"15 mm) and stays above 90 % of its peak for {_number(above)} µs (the paper: roughly 20 µs). The worst "
        f"modal error is {f['worst_modal_error_mm_s']:.2f} mm/s, of mode {f['worst_mode']} (the paper: 6 mm/s)."
    )


def _compared(figures: Sequence[Figures]) -> str:
    best = min(figures, key=lambda f: float(f["worst_modal_error_mm_s"]))
    others = [f for f in figures if f is not best]
    parts = [
        f"that of law “{f['law']}” is {f['worst_modal_error_mm_s'] / best['worst_modal_error_mm_s']:.1f} times as large"
        for f in others
    ]
    field = min(figures, key=lambda f: float(f["field_error"]["measured_from_selected_modes"]["rms_mm_s"]))
    return (
        f"Law “{best['law']}” has the smaller worst modal error: {', '.join(parts)}. "
        f"The measured field is closest to that of the selected modes by law “{field['law']}”, "
        f"{field['field_error']['measured_from_selected_modes']['rms_mm_s']:.2f} mm/s rms."
    )


def _limits(f: Figures) -> str:
    reachable = f["field_error"]["predicted_from_wished"]
    return (
        f"No drive of these modes can make the wished field itself: the prediction of law “{f['law']}” is "
        f"{reachable['rms_mm_s']:.1f} mm/s rms and at most {reachable['max_mm_s']:.1f} mm/s away from it."
    )


def _error(f: Figures, key: str) -> str:
    return f"{f['field_error'][key]['rms_mm_s']:.2f}, {f['field_error'][key]['max_mm_s']:.2f}"


def _widths(values: dict[str, float | None], digits: int = 1) -> str:
    return ", ".join(_number(value, digits) for value in values.values())


def _number(value: float | None, digits: int = 1) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
