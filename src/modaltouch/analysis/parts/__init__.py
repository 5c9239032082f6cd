"""Analysis of designs that are not crossed, by crossed parts with a common correction of their tests.

``analysis``  analyse_parts, render_parts
"""

from modaltouch.analysis.parts.analysis import PartsAnalysis, analyse_parts, render_parts

__all__ = ["PartsAnalysis", "analyse_parts", "render_parts"]
