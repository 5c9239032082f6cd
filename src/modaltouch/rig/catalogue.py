"""The generators that the driver knows; another one is a file such as `afg3022b`, and a name here."""

from __future__ import annotations

from modaltouch.protocol import Apparatus
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.instrument import Instrument


def instruments() -> tuple[Instrument, ...]:
    """Return all, the usual one first; any other model is taken for that one, if the apparatus file names it."""
    from modaltouch.rig.keysight33500b import KEYSIGHT_33500B

    return (AFG3022B, KEYSIGHT_33500B)


def instrument_of(apparatus: Apparatus) -> Instrument:
    """Return the generator that an apparatus names."""
    model = apparatus.generator.model
    if model in AFG3022B.models:
        return AFG3022B
    return next((each for each in instruments() if model in each.models), AFG3022B)
