"""Opens the generator at an address."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from modaltouch.protocol import Apparatus
    from modaltouch.rig.generator import Generator


def open_rig(address: str, apparatus: Apparatus, **options: Any) -> Generator:
    """Return the generator at a VISA address, a `Rig` whose outputs are off.

    Parameters
    ----------
    address : str
        VISA address, of an instrument or of a simulator; ``@ivi`` after it takes the vendor's VISA library.
    apparatus : Apparatus
        What is on the table.
    **options
        ``log(event, **facts)``, which takes every exchange and event, and further arguments of the driver; before a
        simulator its `Simulator.driver_options`.

    Raises
    ------
    RigError
        If there is no such instrument at the address.
    """
    from modaltouch.rig.generator import Generator

    return Generator(address, apparatus, **options)
