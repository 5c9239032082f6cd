"""Figures, pages and files in one style, for whatever analysis, planning and lab have to show."""
