"""How an identification is printed."""

from __future__ import annotations

import math
from typing import Any

WIDE = 88
"""Columns of a terminal from which the picked peaks are shown too."""


def show(result: dict[str, Any]) -> None:
    """Print what was identified: Table I, what half-power cannot say, what else was seen, where it was written."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    wanted = result.get("table_modes")
    listed = [mode for mode in result["modes"] if wanted is None or mode["label"] in wanted]
    gains = [name for name in result["sets"] if any(name in mode["gain_mm_s2_per_V"] for mode in result["modes"])]
    console.print(_table(Table, listed, gains, wide=console.width >= WIDE))
    if gains:
        console.print("[dim]Gains in mm/s^2 per V at the beam[/]")
    for reason, names in _unresolved(listed).items():
        console.print(f"[yellow]No half-power damping of {', '.join(names)}: {reason}[/]")
    others = [f"{mode['natural_frequency_Hz']['value']:.0f}" for mode in result["modes"] if mode not in listed]
    if others:
        console.print(f"[dim]Also seen, and kept out of the table: {', '.join(others)} Hz[/]")
    beam = result["free_free"]
    if beam is not None:
        verdict = "are" if beam["recognised"] else "are not"
        modes = ", ".join(str(mode) if mode else "-" for mode in beam["bending_modes"])
        console.print(
            f"The natural frequencies {verdict} those of a free-free beam: bending modes {modes}, within "
            f"{beam['deviation']:.2%}"
        )
    if result["apparatus_file"]:
        console.print(f"Written: {result['apparatus_file']}, with table and figures beside it", markup=False)
    else:
        console.print(
            "[dim]No apparatus file: without positions along the beam there are no shapes, without them no gains[/]"
        )


def _table(table_kind: Any, modes: list[dict[str, Any]], gains: list[str], *, wide: bool) -> Any:
    """Return Table I; in a wide terminal with the picked peaks too."""
    table = table_kind(
        title="Table I by joint fit, in brackets the half-width of the 95 % interval in the last digits; half-power "
        "beside it",
        title_justify="left",
        box=None,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    peak = ["f peak"] if wide else []
    for heading in ("mode", "f [Hz]", "xi", *(f"G {name}" for name in gains), "MAC", *peak, "xi half"):
        table.add_column(heading, justify="right", no_wrap=True)
    for mode in modes:
        half = mode["half_power"]
        table.add_row(
            str(mode["label"] or ""),
            _with_interval(mode["natural_frequency_Hz"]),
            _with_interval(mode["damping_ratio"]),
            *(_with_interval(mode["gain_mm_s2_per_V"].get(name)) for name in gains),
            _plain(mode["mac"], ".4f"),
            *([_plain(half["peak_frequency_Hz"], ".6g")] if wide else []),
            _plain(half["damping_ratio"], ".4f") if half["resolved"] else "-",
        )
    return table


def _unresolved(modes: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Return why half-power says no damping, each reason with the names of its modes."""
    reasons: dict[str, list[str]] = {}
    for mode in modes:
        if reason := mode["half_power"]["warning"]:
            name = f"mode {mode['label']}" if mode["label"] else f"{mode['natural_frequency_Hz']['value']:.6g} Hz"
            reasons.setdefault(reason, []).append(name)
    return reasons


def _with_interval(pair: dict[str, float | None] | None) -> str:
    """Return a value with its interval's half-width in the last digits, as 228.855(11)."""
    if pair is None or pair["value"] is None or pair["low"] is None or pair["high"] is None:
        return "-"
    half = (pair["high"] - pair["low"]) / 2
    if not half > 0:
        return f"{pair['value']:.6g}"
    digits = max(0, 1 - math.floor(math.log10(half)))
    shown = f"{half:.0f}" if digits == 0 else f"{half * 10**digits:.0f}"
    return f"{pair['value']:.{digits}f}({shown})"


def _plain(value: float | None, form: str) -> str:
    return "-" if value is None else f"{value:{form}}"
