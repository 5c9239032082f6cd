"""System services shared by all subpackages: clocks, locks between processes, signals, and build provenance.

`lazily` gives the ``__init__`` of every subpackage lazy imports, since some modules take seconds to import.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any


def lazily(package: str, places: Mapping[str, str]) -> Callable[[str], Any]:
    """Return a package's ``__getattr__`` (PEP 562), which imports a module when one of its names is first used.

    Parameters
    ----------
    package : str
        Dotted name of the package.
    places : mapping of str to str
        Public names of each module, separated by spaces; a module in a folder has a dotted name.

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


if TYPE_CHECKING:
    from modaltouch.system.clock import SYSTEM_CLOCK, Clock, VirtualClock
    from modaltouch.system.operating_system import Interrupted, Interruption, lock, sync_file
    from modaltouch.system.provenance import commit, version, versions
else:
    __getattr__ = lazily(
        __name__,
        {
            "clock": "Clock SYSTEM_CLOCK VirtualClock",
            "operating_system": "Interrupted Interruption lock sync_file",
            "provenance": "commit version versions",
        },
    )

__all__ = [
    "lazily",
    "Clock",
    "Interrupted",
    "Interruption",
    "SYSTEM_CLOCK",
    "VirtualClock",
    "commit",
    "lock",
    "sync_file",
    "version",
    "versions",
]
