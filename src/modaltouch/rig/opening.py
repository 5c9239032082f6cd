"""Opens the generator at an address, or a simulated rig."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from modaltouch.system import SYSTEM_CLOCK, Clock, VirtualClock

if TYPE_CHECKING:
    from modaltouch.protocol import Apparatus
    from modaltouch.rig.interface import Rig
    from modaltouch.rig.link import Log
    from modaltouch.rig.simulator import Simulator
    from modaltouch.rig.watchdog_client import BurstPlayer


def open_rig(address: str, apparatus: Apparatus, *, log: Log, **options: Any) -> Rig:
    """Return the generator at a VISA address, outputs off.

    Parameters
    ----------
    address : str
        VISA address, of an instrument or of a simulator.
    apparatus : Apparatus
        What is on the table.
    log : callable
        ``log(event, **facts)`` takes every exchange and event.
    **options
        Further arguments of `modaltouch.rig.generator.Generator`.

    Raises
    ------
    RigError
        If there is no such instrument at the address.
    """
    from modaltouch.rig.generator import Generator

    return Generator(address, apparatus, log=log, **options)


def same_process(clock: VirtualClock) -> Callable[[str], BurstPlayer]:
    """Return what stands in a watchdog's place for a session in virtual time, as `open_rig`'s ``start_guard``."""
    from modaltouch.rig.local_client import LocalClient
    from modaltouch.rig.visa import VisaSession

    return lambda address: LocalClient(VisaSession(address), clock)


def start_simulator(apparatus: Apparatus, seed: int | None = None, *, clock: Clock = SYSTEM_CLOCK) -> Simulator:
    """Return a running simulator of a rig, with its address.

    Parameters
    ----------
    apparatus : Apparatus
        What is on the table, and in its section ``twin`` how the true beam differs from the identified one.
    seed : int, optional
        Instead of the seed in ``twin``.
    clock : Clock
        By which it plays.
    """
    from modaltouch.rig.simulator import Simulator

    return Simulator(apparatus, seed, clock=clock)
