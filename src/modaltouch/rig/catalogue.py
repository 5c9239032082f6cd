"""The generators that the driver knows; another one is a file such as `afg3022b`, and a name here."""

from __future__ import annotations

from modaltouch.protocol import Apparatus
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.instrument import Instrument
from modaltouch.rig.keysight33500b import KEYSIGHT_33500B

INSTRUMENTS = (AFG3022B, KEYSIGHT_33500B)
KNOWN_MODELS = tuple(model for instrument in INSTRUMENTS for model in instrument.models)
"""Any other model is taken only if the apparatus file names it."""


def instrument_of(apparatus: Apparatus) -> Instrument:
    """Return the generator that an apparatus names; the first one for a model that is not known."""
    model = apparatus.generator.model
    return next((each for each in INSTRUMENTS if model in each.models), INSTRUMENTS[0])
