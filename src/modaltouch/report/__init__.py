"""Figures, HTML pages and output files of analysis, planning and lab, in one style.

`house_style` sets the style of Matplotlib figures, `page_files` renders pages that show them, and `format_number`
formats numbers. `write_files` writes rows as CSV, values as JSON and figures as SVG and PNG into a folder: all or none,
never over files of another origin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.report.page import (
        CONDITION_COLOURS,
        FAINT,
        INK,
        PAIR_COLOURS,
        ReportFigure,
        format_number,
        house_style,
        page_files,
        quiet_grid,
        refuse_other,
        render_page,
        write_files,
    )
else:
    __getattr__ = lazily(
        __name__,
        {
            "page": "CONDITION_COLOURS FAINT INK PAIR_COLOURS ReportFigure format_number house_style page_files "
            "quiet_grid refuse_other render_page write_files",
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
