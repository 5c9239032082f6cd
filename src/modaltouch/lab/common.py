"""Array types, plausible ranges, colours, rounding and YAML files common to the lab's commands."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.record import prepare_file, replace_file
from modaltouch.system import version

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import Collection
    from matplotlib.figure import Figure

    from modaltouch.preflight import Preflight

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

NORMAL_95 = 1.959963984540054
"""Half-width of a 95 % interval of a normal distribution, in standard deviations."""

GAINS = (0.67, 1.5)
"""Plausible range of measured over commanded drive [1]; outside, a probe or a switch differs from the file."""

COMMON_FACTORS = (0.85, 1.15)
"""Range of a common factor between measured and predicted speeds within an amplifier's tolerance [1]."""

DARK, MIDDLE, LIGHT = "#0b3c8c", "#5bb8e8", "#dbe3ee"
"""Colours of measured, predicted and target values, distinct in lightness so that they also differ in greyscale."""

SIGNED = "cividis"
"""Colour map of signed values; perceptually uniform for all types of colour vision."""


def low_pass(frequency: NDArray[np.floating[Any]], corner: float | None) -> ComplexArray:
    """Return the frequency response of a first-order low-pass [1]; ones if its `corner` [Hz] is None."""
    return np.asarray(1 / (1 + 1j * frequency / (np.inf if corner is None else corner)))


def draw_map(axes: Axes, along: FloatArray, across: FloatArray, values: FloatArray, highest: float) -> Collection:
    """Draw values at points of the beam [m] over its length and width [mm], and return the artist for a colour bar."""
    look: dict[str, Any] = {"cmap": SIGNED, "vmin": -highest, "vmax": highest, "rasterized": True}
    drawn = axes.tripcolor(along * 1e3, across * 1e3, values, shading="gouraud", **look)
    axes.set(xlim=(along.min() * 1e3, along.max() * 1e3), ylim=(across.min() * 1e3, across.max() * 1e3))
    return drawn


def title_of(preflight: Preflight) -> str:
    """Return a protocol's title or name, with the name of its first stimulus, the one used, if it has several."""
    protocol, name = preflight.experiment.protocol, next(iter(preflight.designs), "")
    return (protocol.title or protocol.protocol) + (f", stimulus {name}" if name else "")


def write_page(
    folder: Path,
    command: str,
    name: str,
    figures: Mapping[str, tuple[Figure, str]],
    values: dict[str, Any],
    tables: dict[str, Any],
    /,
    **shown: Any,
) -> dict[str, Any]:
    """Write a page from a template with the plain values as JSON, and return them with the path of each file.

    Parameters
    ----------
    folder, command : Path and str
        Folder for the results, and the command that owns it.
    name : str
        Name of page, template and JSON file.
    figures : mapping of str to (Figure, str)
        Figures with their captions, by file name.
    values, tables : dict
        Plain values, and tables by file name.
    **shown
        Further variables of the template.

    Raises
    ------
    RecordError
        If the folder holds something else or cannot be written.
    """
    from modaltouch.report import ReportFigure, page_files, write_files

    pictures = [ReportFigure(each, *drawn) for each, drawn in figures.items()]
    files = page_files("modaltouch.lab", name, pictures, values=values, **shown)
    written = write_files(folder, files | {f"{name}.json": values} | tables, {"version": version()}, command)
    return {**values, "files": {each: str(path) for each, path in written.items()}}


def rounded(value: Any, digits: int) -> Any:
    """Round every float in plain values to a number of decimals."""
    if isinstance(value, dict):
        return {key: rounded(each, digits) for key, each in value.items()}
    if isinstance(value, list):
        return [rounded(each, digits) for each in value]
    return round(value, digits) if isinstance(value, float) else value


def write_yaml(path: Path, head: str, values: dict[str, Any]) -> None:
    """Write plain values as YAML below a comment, with innermost lists and mappings on one line; never overwrite.

    Raises
    ------
    RecordError
        If the file exists or cannot be written.
    """
    import io

    from ruamel.yaml import YAML

    prepare_file(path)
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 200
    yaml.allow_unicode = True
    stream = io.StringIO()
    yaml.dump(values, stream)
    text = head + stream.getvalue()
    replace_file(path, text.encode(), "move it away, or give another file with --out")
