"""Self-contained HTML pages that need no network, print well and are legible without colour; number formatting."""

from __future__ import annotations

import base64
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from modaltouch.system import commit, version, versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class ReportFigure:
    """A figure on a page.

    Attributes
    ----------
    name : str
        File name without extension.
    figure : Figure
        The figure.
    caption : str
        Caption.
    section : str
        Section of the page; empty if the page has one place for all figures.
    finger_condition : str
        Finger condition whose bars it shows; empty for other figures.
    """

    name: str
    figure: Figure
    caption: str = ""
    section: str = ""
    finger_condition: str = ""


def page_files(package: str, name: str, pictures: Sequence[ReportFigure], /, **values: Any) -> dict[str, Any]:
    """Return a page and its figures by file name, for `write_files`.

    Parameters
    ----------
    package : str
        Dotted name of the package with the template in its folder ``templates``; it may extend or include templates of
        `modaltouch.report`, such as ``base.html.j2``.
    name : str
        Name of the page and of its template.
    pictures : sequence of ReportFigure
        Figures, passed to the template as ``pictures``, each with its SVG as ``svg``.
    **values
        Other variables of the template; a missing one is an error.
    """
    from modaltouch.report.style import figure_files

    figures = {picture.name: picture.figure for picture in pictures}
    files = figure_files(figures)
    shown = [{**vars(picture), "svg": files[f"{picture.name}.svg"]} for picture in pictures]
    libraries = {library: number for library, number in versions().items() if number != "absent"}
    made_by = {"version": version(), "commit": commit(), "versions": libraries}
    return {**files, f"{name}.html": render_page(package, f"{name}.html.j2", pictures=shown, **made_by, **values)}


def render_page(package: str, template: str, **values: Any) -> str:
    """Render a page of HTML or Markdown from a template; arguments as for `page_files`."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    places = dict.fromkeys((package, "modaltouch.report"))
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(place) for place in places]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        data_uri=lambda svg: "data:image/svg+xml;base64," + base64.b64encode(svg).decode("ascii"), number=format_number
    )
    return environment.get_template(template).render(**values)


def format_number(value: float | None, digits: int = 3, *, decimals: int | None = None) -> str:
    """Format a number for display, with a dash for a missing value.

    Parameters
    ----------
    value : float or None
        The number.
    digits : int
        Significant digits.
    decimals : int, optional
        Decimal places, used instead of significant digits.

    Examples
    --------
    >>> format_number(0.97512), format_number(float("nan")), format_number(float("inf")), format_number(39.0)
    ('0.975', '–', '∞', '39')
    >>> format_number(12.0, decimals=1), format_number(None)
    ('12.0', '–')
    """
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if decimals is None and abs(value) <= 2 * sys.float_info.min and value != 0:
        return "< 1e-300"
    text = f"{value:.{digits}g}" if decimals is None else f"{value:.{decimals}f}"
    # No sign for zero, including values rounded to zero.
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−", 1) if value < 0 else text
