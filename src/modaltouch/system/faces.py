"""Faces of rooms that load what they offer when it is first asked for: some of it costs seconds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazily(package: str, places: Mapping[str, str]) -> Callable[[str], Any]:
    """Module ``__getattr__`` (PEP 562) of a face.

    Parameters
    ----------
    package : str
        Dotted name of the room.
    places : mapping of str to str
        Names that each module offers, separated by spaces; a module in a folder has a dotted name.

    Examples
    --------
    >>> lazily("modaltouch.system", {"provenance": "commit version"})("version").__name__
    'version'
    """
    module_of = {name: module for module, names in places.items() for name in names.split()}

    def load(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}; it offers {', '.join(module_of)}")
        return getattr(import_module(f"{package}.{module_of[name]}"), name)

    return load
