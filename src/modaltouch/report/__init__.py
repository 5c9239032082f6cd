"""Figures, pages and files in one style, for the results of analysis, planning and lab.

`page_files` makes pages from Matplotlib figures drawn within `house_style`, values and rows; `format_number` formats
numbers. `write_files` writes them to a folder, rows as CSV, values as JSON, figures as SVG and PNG: all of them or
none, and never over files of another origin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.report.output import refuse_other, write_files
    from modaltouch.report.page import ReportFigure, format_number, page_files, render_page
    from modaltouch.report.style import (
        CONDITION_COLOURS,
        FAINT,
        INK,
        PAIR_COLOURS,
        house_style,
        quiet_grid,
    )
else:
    __getattr__ = lazily(
        __name__,
        {
            "output": "refuse_other write_files",
            "page": "ReportFigure page_files render_page format_number",
            "style": "CONDITION_COLOURS FAINT INK PAIR_COLOURS house_style quiet_grid",
        },
    )

__all__ = [
    "CONDITION_COLOURS",
    "FAINT",
    "INK",
    "PAIR_COLOURS",
    "ReportFigure",
    "house_style",
    "page_files",
    "quiet_grid",
    "refuse_other",
    "render_page",
    "format_number",
    "write_files",
]
