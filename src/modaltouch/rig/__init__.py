"""Instrument drivers that play bursts (`Burst` and level in, `Firing` out) and measure the beam (`Recording`).

A session opens the driver at a VISA address; the simulator has one, too::

    with Simulator(apparatus) as simulator, Generator(simulator.address, apparatus, log=log) as rig:
        rig.load(burst)
        rig.fire(velocity)
        speeds = simulator.felt_velocity(["A", "C"])

`instrument_of` an apparatus returns the specifications of its generator. The beam is measured by a separate instrument:
``simulator.scope()`` or ``Scope.open(apparatus)``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.protocol import Apparatus
    from modaltouch.rig.checklist import check_rig
    from modaltouch.rig.generator import Generator
    from modaltouch.rig.instrument import Instrument
    from modaltouch.rig.interface import Firing, Rig, RigError, StimulusLost
    from modaltouch.rig.scope import Acquisition, Recording, Scope
    from modaltouch.rig.simulator import Simulator
    from modaltouch.rig.visa import find_instruments
else:
    __getattr__ = lazily(
        __name__,
        {
            "checklist": "check_rig",
            "generator": "Generator",
            "interface": "Firing Rig RigError StimulusLost",
            "scope": "Acquisition Recording Scope",
            "simulator": "Simulator",
            "visa": "find_instruments",
        },
    )

__all__ = [
    "Acquisition",
    "Firing",
    "Generator",
    "Recording",
    "Rig",
    "RigError",
    "Scope",
    "Simulator",
    "StimulusLost",
    "check_rig",
    "find_instruments",
    "instrument_of",
]


def instruments() -> tuple[Instrument, ...]:
    """Return all supported generators; the first is used for any other model named in an apparatus file."""
    from modaltouch.rig.afg3022b import AFG3022B
    from modaltouch.rig.keysight33500b import KEYSIGHT_33500B

    return (
        AFG3022B,
        KEYSIGHT_33500B,
    )


def instrument_of(apparatus: Apparatus) -> Instrument:
    """Return the generator of an apparatus."""
    from modaltouch.rig.afg3022b import AFG3022B

    model = apparatus.generator.model
    if model in AFG3022B.models:
        return AFG3022B
    return next((each for each in instruments() if model in each.models), AFG3022B)
