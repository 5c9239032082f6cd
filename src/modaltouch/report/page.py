"""Figures, pages and numbers in one style, and the folders into which they are written.

Figures have the paper's colours, are legible in greyscale, and become reproducible SVG and PNG files. Pages are
self-contained HTML that needs no network and prints well. Folders get all files or none, never over files of another
origin.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import json
import math
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modaltouch.record import RecordError, move, replace_file
from modaltouch.system import commit, version, versions

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

PAIR_COLOURS = ("#0b3c8c", "#5bb8e8", "#f4c518", "#9a5b9f", "#2f9e77", "#c4c4c4")
"""Dark blue, light blue and yellow as in Fig. 10 and Fig. 11, then colours for further pairs."""

CONDITION_COLOURS = ("#0b3c8c", "#c2541b", "#2f9e77", "#9a5b9f")
INK = "#1d2530"
FAINT = "#5d6775"
"""Legible on white: contrast 5.7."""

_RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "figure.constrained_layout.use": True,
    # The default height; unless it is set, Matplotlib looks for ticks above every axes at each draw.
    "axes.titley": 1.0,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "hatch.linewidth": 0.6,
    "svg.hashsalt": "modaltouch",
    "svg.fonttype": "path",
}

PNG_DPI = 200


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
    files = figure_files({picture.name: picture.figure for picture in pictures})
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


@contextmanager
def house_style(
    width: float = 7.6, height: float = 3.0, n_rows: int = 1, n_columns: int = 1, **panels: Any
) -> Iterator[tuple[Figure, NDArray[Any]]]:
    """Create a figure in the project's style without changing matplotlib's global settings.

    Parameters
    ----------
    width, height : float
        Size of the figure [inch].
    n_rows, n_columns : int
        Number of panels.
    **panels
        Further arguments of `matplotlib.figure.Figure.subplots`.

    Yields
    ------
    figure : Figure
        The figure.
    panels : (n_rows, n_columns) array
        The axes.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(_RC):
        figure = Figure(figsize=(width, height))
        yield figure, figure.subplots(n_rows, n_columns, squeeze=False, **panels)


def render(figure: Figure, kind: str) -> bytes:
    """Render a figure as ``svg`` or ``png``; the same figure always gives the same bytes."""
    import matplotlib as mpl

    buffer = io.BytesIO()
    with mpl.rc_context(_RC):
        # Lay out once for both formats, since layout takes as long as drawing. With the rcParam on, None would select
        # constrained layout again.
        engine = figure.get_layout_engine()
        with mpl.rc_context({"figure.constrained_layout.use": False}):
            if engine is not None:
                engine.execute(figure)
                figure.set_layout_engine(None)
            metadata = {"svg": {"Date": None, "Creator": "modaltouch"}, "png": {"Software": "modaltouch"}}
            figure.savefig(buffer, format=kind, dpi=PNG_DPI, metadata=metadata[kind])
    return buffer.getvalue()


def figure_files(figures: Mapping[str, Figure]) -> dict[str, bytes]:
    """Return figures as SVG and PNG, by file name.

    Parameters
    ----------
    figures : mapping of str to Figure
        Figures by name.
    """
    return {f"{name}.{kind}": render(figure, kind) for name, figure in figures.items() for kind in ("svg", "png")}


def quiet_grid(axes: Axes) -> None:
    """Draw faint horizontal lines behind the data."""
    axes.set_axisbelow(True)
    axes.grid(axis="y", color="#e3e7ec", linewidth=0.7)


MANIFEST = "manifest.json"

_MAKER = "modaltouch "
"""Prefix of ``generated_by`` in each manifest."""
_REMEDY = "give a folder you may write to with --out"


def write_files(
    folder: Path, contents: Mapping[str, Any], about: dict[str, Any], command: str = "analyse", **figures: Figure
) -> dict[str, Path]:
    """Write files into a folder, with a manifest of their names and hashes.

    Files are first written to a temporary folder beside it, so that a full disk or a kill leaves earlier files intact.

    Parameters
    ----------
    folder : Path
        Output folder; created if needed. Other files in it are left alone.
    contents : mapping
        Contents by file name: bytes or text, table rows for ``.csv``, plain values for other names, written as JSON.
    about : dict
        Provenance recorded in the manifest; plain values.
    command : str
        Command that made them; a folder belongs to one command.
    **figures : Figure
        Figures by name, each written as SVG and PNG.

    Returns
    -------
    dict of str to Path
        Path of each file.

    Raises
    ------
    RecordError
        If the folder belongs to another command, or an existing file is not from modaltouch, was changed since, or
        cannot be replaced.
    """
    refuse_other(folder, command)
    files = {name: _encode(name, content) for name, content in contents.items()} | figure_files(figures)
    about = {"generated_by": _MAKER + command, **about}
    _, known = _read_manifest(folder)
    for name in files:
        _refuse_foreign_file(folder / name, known.get(name, []))
    if not known:
        _refuse_foreign_file(folder / MANIFEST, [])
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    temporary = _new_folder(folder, folder.parent)
    try:
        for name, data in files.items():
            (temporary / name).write_bytes(data)
        # While files are replaced one by one, the manifest lists the hashes of both old and new ones.
        either = {name: sorted({*known.get(name, []), new}) for name, new in hashes.items()}
        folder.mkdir(exist_ok=True)
        replace_file(folder / MANIFEST, _manifest(about, {**known, **either}), _REMEDY)
        for name in files:
            move((temporary / name).replace, folder / name)
        for name in known.keys() - hashes.keys():
            (folder / name).unlink(missing_ok=True)
        replace_file(folder / MANIFEST, _manifest(about, {name: [value] for name, value in hashes.items()}), _REMEDY)
    except OSError as error:
        raise _cannot(folder, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return {name: folder / name for name in files}


def _encode(name: str, content: Any) -> bytes:
    if isinstance(content, bytes):
        return content
    if isinstance(content, str):
        return content.encode()
    if not name.endswith(".csv"):
        return (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(content[0]) if content else [], lineterminator="\n")
    writer.writeheader()
    for row in content:
        # None and NaN become empty fields.
        writer.writerow({key: value if value == value else None for key, value in row.items()})
    return buffer.getvalue().encode()


def refuse_other(folder: Path, command: str) -> None:
    """Refuse an output folder that cannot be written or belongs to another command, before long computations.

    Parameters
    ----------
    folder : Path
        Output folder.
    command : str
        Command that will write to it.

    Raises
    ------
    RecordError
        If the folder contains another command's output, is a file, or cannot be written.
    """
    standing = next(path for path in (folder, *folder.parents) if path.exists())
    if not standing.is_dir():
        raise RecordError(f"{standing}: is a file, but a folder is needed; give another one with --out")
    maker, _ = _read_manifest(folder)
    if maker not in ("", _MAKER + command):
        raise RecordError(
            f"{folder}: contains output of `{maker}`, which would be replaced; give another folder with --out"
        )
    for place in {standing, folder.parent}:
        if place.exists():
            # Permissions are not conclusive: root may write to /proc but cannot create a folder there.
            _new_folder(folder, place).rmdir()


def _new_folder(folder: Path, place: Path) -> Path:
    try:
        place.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".tmp", dir=place))
    except OSError as error:
        raise _cannot(folder, error) from error


def _manifest(about: dict[str, Any], hashes: dict[str, list[str]]) -> bytes:
    values = {**about, "files": dict(sorted(hashes.items()))}
    return (json.dumps(values, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _read_manifest(folder: Path) -> tuple[str, dict[str, list[str]]]:
    """Return the command that made a folder and the hashes of its files; empty without a manifest of this program."""
    try:
        values = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        maker, files = str(values["generated_by"]), values["files"].items()
        hashes = {name: [str(each) for each in known] for name, known in files if Path(name).name == name}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return "", {}
    return (maker, hashes) if maker.startswith(_MAKER) else ("", {})


def _refuse_foreign_file(path: Path, own: list[str]) -> None:
    if not path.exists():
        return
    try:
        found = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise _cannot(path, error) from error
    if found not in own:
        kind = "was changed since it was written" if own else "exists already and is not from modaltouch"
        raise RecordError(f"{path}: {kind} and is not overwritten; move it away, or give another folder with --out")


def _cannot(path: Path, error: OSError) -> RecordError:
    return RecordError(f"{path}: cannot be written ({error.strerror}); {_REMEDY}")
