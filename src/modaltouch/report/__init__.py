"""Figures, pages and files in one style, for whatever analysis, planning and lab have to show.

Figures of matplotlib drawn within `house_style` go in, with values and rows; out come the bytes of files (`render`,
`render_page`, `csv_bytes`, `json_bytes`). `write_files` puts them into a folder, whole or not at all, and never over
what something else made.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.report.output import csv_bytes, json_bytes, refuse_other, write_files
    from modaltouch.report.page import render_page
    from modaltouch.report.style import CONDITION_COLOURS, FAINT, INK, PAIR_COLOURS, house_style, quiet_grid, render
else:
    __getattr__ = lazily(
        __name__,
        {
            "output": "csv_bytes json_bytes refuse_other write_files",
            "page": "render_page",
            "style": "CONDITION_COLOURS FAINT INK PAIR_COLOURS house_style quiet_grid render",
        },
    )

__all__ = [
    "CONDITION_COLOURS",
    "FAINT",
    "INK",
    "PAIR_COLOURS",
    "csv_bytes",
    "house_style",
    "json_bytes",
    "quiet_grid",
    "refuse_other",
    "render",
    "render_page",
    "write_files",
]
