"""A page for the package and for each room but the command line: what its face offers, from the docstrings."""

import inspect
from importlib import import_module
from pathlib import Path

from generator.pages import page, table, toctree, write

ROOMS = (
    "stimulus", "protocol", "rig", "window", "preflight", "record", "report", "analysis", "planning", "session", "lab",
    "system",
)  # fmt: skip


def _directive(module: str, name: str) -> str:
    found = getattr(import_module(module), name)
    if inspect.isclass(found):
        options = ["   :members:", *(["   :show-inheritance:"] if issubclass(found, BaseException) else [])]
        return "\n".join((f".. autoclass:: {module}.{name}", *options))
    kind = "autofunction" if callable(found) and hasattr(found, "__code__") else "autodata"
    return f".. {kind}:: {module}.{name}"


def _first_line(module: str) -> str:
    return (import_module(module).__doc__ or "").strip().partition("\n")[0]


def write_api(folder: Path) -> None:
    """Write a page for the package and for each room, and the page that leads to them."""
    import modaltouch

    public = [name for name in modaltouch.__all__ if not name.startswith("__")]
    for name, names in (
        ("modaltouch", public),
        *((room, import_module(f"modaltouch.{room}").__all__) for room in ROOMS),
    ):
        module = "modaltouch" if name == "modaltouch" else f"modaltouch.{name}"
        directives = [f".. automodule:: {module}\n   :no-members:", *(_directive(module, each) for each in names)]
        write(folder / f"{name}.md", page(module, "```{eval-rst}\n" + "\n\n".join(directives) + "\n```"))
    lead = (
        "Only the names in `modaltouch` itself are public. The other pages list the interfaces of its packages, "
        "which may change from one version to the next. Units are SI: metres, seconds, volts. The test suite "
        "runs every example."
    )
    rows = [(f"[`modaltouch.{room}`]({room}.md)", _first_line(f"modaltouch.{room}")) for room in ROOMS]
    rows = [("[`modaltouch`](modaltouch.md)", "The public functions."), *rows]
    write(folder / "index.md", page("Python", lead, table(("module", "holds"), rows), toctree("modaltouch", *ROOMS)))
