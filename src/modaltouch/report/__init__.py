"""Figures, pages and files in one style, for whatever analysis, planning and lab have to show."""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.report.output import csv_bytes, json_bytes, refuse_other, write_files
    from modaltouch.report.page import embed_svg, render_page
    from modaltouch.report.style import (
        ANSWER_COLOURS,
        CONDITION_COLOURS,
        FAINT,
        INK,
        PAIR_COLOURS,
        house_style,
        level_label,
        new_figure,
        pair_colours,
        quiet_grid,
        render,
    )
else:
    __getattr__ = lazily(
        __name__,
        {
            "output": "csv_bytes json_bytes refuse_other write_files",
            "page": "embed_svg render_page",
            "style": (
                "ANSWER_COLOURS CONDITION_COLOURS FAINT INK PAIR_COLOURS house_style level_label "
                "new_figure pair_colours quiet_grid render"
            ),
        },
    )

__all__ = [
    "ANSWER_COLOURS",
    "CONDITION_COLOURS",
    "FAINT",
    "INK",
    "PAIR_COLOURS",
    "csv_bytes",
    "embed_svg",
    "house_style",
    "json_bytes",
    "level_label",
    "new_figure",
    "pair_colours",
    "quiet_grid",
    "refuse_other",
    "render",
    "render_page",
    "write_files",
]
