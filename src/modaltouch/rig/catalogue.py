"""The supported generators; to add one, write a module such as `afg3022b` and list it here."""

from __future__ import annotations

from modaltouch.protocol import Apparatus
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.instrument import Instrument


def instruments() -> tuple[Instrument, ...]:
    """Return all supported generators; the first is used for any other model named in an apparatus file."""
    from modaltouch.rig.keysight33500b import KEYSIGHT_33500B

    return (
        AFG3022B,
        KEYSIGHT_33500B,
    )


def instrument_of(apparatus: Apparatus) -> Instrument:
    """Return the generator of an apparatus."""
    model = apparatus.generator.model
    if model in AFG3022B.models:
        return AFG3022B
    return next((each for each in instruments() if model in each.models), AFG3022B)
