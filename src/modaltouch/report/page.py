"""One HTML page with everything inside: it needs no network, prints, and is legible without colour.

Numbers are written as a reader sees them, in a page, a table or a sentence.
"""

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
    """A figure of a page.

    Attributes
    ----------
    name : str
        File name without ending.
    figure : Figure
        The figure.
    caption : str
        What the reader sees and must know.
    section : str
        Where on the page it stands; empty where the page has one place for all.
    finger_condition : str
        Whose bars it shows; empty for other figures.
    """

    name: str
    figure: Figure
    caption: str = ""
    section: str = ""
    finger_condition: str = ""


def page_files(package: str, name: str, pictures: Sequence[ReportFigure], /, **values: Any) -> dict[str, Any]:
    """Return a page and the figures that it shows, by file name, as `write_files` takes them.

    Parameters
    ----------
    package : str
        Dotted name of the package whose folder ``templates`` holds the template; what it extends or includes may
        also be one of the report, such as ``base.html.j2``.
    name : str
        Of the page and of its template.
    pictures : sequence of ReportFigure
        Figures, which the template has as ``pictures``, each with its SVG as ``svg``.
    **values
        What the template names besides; one that is missing is an error.
    """
    from modaltouch.report.style import figure_files

    figures = {picture.name: picture.figure for picture in pictures}
    files = figure_files(figures)
    shown = [{**vars(picture), "svg": files[f"{picture.name}.svg"]} for picture in pictures]
    libraries = {library: number for library, number in versions().items() if number != "absent"}
    made_by = {"version": version(), "commit": commit(), "versions": libraries}
    return {**files, f"{name}.html": render_page(package, f"{name}.html.j2", pictures=shown, **made_by, **values)}


def render_page(package: str, template: str, **values: Any) -> str:
    """Return a page of HTML, or of Markdown, as its template is named; `page_files` says of what."""
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
        data_uri=lambda svg: "data:image/svg+xml;base64," + base64.b64encode(svg).decode("ascii"), number=say_number
    )
    return environment.get_template(template).render(**values)


def say_number(value: float | None, digits: int = 3, *, decimals: int | None = None) -> str:
    """Return a number in words for readers; a dash where there is none.

    Parameters
    ----------
    value : float or None
        The number.
    digits : int
        Significant digits.
    decimals : int, optional
        Digits behind the point, in place of significant ones.

    Examples
    --------
    >>> say_number(0.97512), say_number(float("nan")), say_number(float("inf")), say_number(39.0)
    ('0.975', '–', '∞', '39')
    >>> say_number(12.0, decimals=1), say_number(None)
    ('12.0', '–')
    """
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if decimals is None and abs(value) <= 2 * sys.float_info.min and value != 0:
        return "< 1e-300"
    text = f"{value:.{digits}g}" if decimals is None else f"{value:.{decimals}f}"
    # Zero has no sign, also where rounding makes it zero.
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−", 1) if value < 0 else text
