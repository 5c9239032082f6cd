"""What no public source tells of the real instrument: a field each, so that every possibility can be tried."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from modaltouch.rig.simulator.timeline import Retrigger


@dataclass(frozen=True)
class Behaviour:
    """What is not publicly known of the real instrument, or differs between units.

    Attributes
    ----------
    identity : str
        Reply to ``*IDN?``.
    idle_level : str
        Where the output rests between bursts: at the ``first`` or ``last`` point, or at the ``offset``.
    timer_digits : int
        Significant digits that the trigger timer keeps.
    copy_time : float
        How long storing a record in a USER memory takes [s].
    amplitude_ranges : tuple of float
        Amplitudes at which a range relay switches [V peak to peak, open circuit].
    limit_violation : str
        Whether a level beyond VOLTage:LIMit is refused (``error``) or cut (``clip``).
    block_end : bytes
        What follows a block reply.
    max_sessions : int
        Links accepted at the same time.
    queue_depth : int
        Errors kept.
    retrigger : str
        Whether a trigger inside a running burst is ``ignored``, without an error, or ``restarts`` the burst.
    """

    identity: str = "TEKTRONIX,AFG3022B,SIMULATED,SCPI:99.0 FV:3.2.2"
    idle_level: Literal["first", "last", "offset"] = "first"
    timer_digits: int = 9
    copy_time: float = 0.0
    amplitude_ranges: tuple[float, ...] = (0.2, 2.0)
    limit_violation: Literal["error", "clip"] = "error"
    block_end: bytes = b"\n"
    max_sessions: int = 16
    queue_depth: int = 32
    retrigger: Retrigger = "ignored"
