"""Designs that are not crossed: the tests of each crossed part, corrected together, tables, figures and report.

``analysis``  analyse_parts, render_parts
"""

from modaltouch.analysis.parts.analysis import PartsAnalysis, analyse_parts, render_parts

__all__ = ["PartsAnalysis", "analyse_parts", "render_parts"]
