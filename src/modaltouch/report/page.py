"""One HTML page with everything inside: it needs no network, prints, and is legible without colour."""

from __future__ import annotations

import base64
from typing import Any

from modaltouch.report.numbers import say_number


def render_page(package: str, template: str, **values: Any) -> str:
    """Return a page as HTML.

    Parameters
    ----------
    package : str
        Dotted name of the package whose folder ``templates`` holds the template; what it extends or includes may
        also be one of the report, such as ``base.html.j2``.
    template : str
        File name of the template.
    **values
        What the template names; one that is missing is an error.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    places = dict.fromkeys((package, "modaltouch.report"))
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(place) for place in places]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(data_uri=_data_uri, number=say_number)
    return environment.get_template(template).render(**values)


def _data_uri(svg: bytes) -> str:
    """Return an address that holds the picture itself."""
    return "data:image/svg+xml;base64," + base64.b64encode(svg).decode("ascii")
