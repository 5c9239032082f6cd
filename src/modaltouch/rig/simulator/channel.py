"""One output of a simulated AFG3022B: its settings, and what it sends."""

from __future__ import annotations

import math
from dataclasses import dataclass

MID_CODE = 8191
"""Code of zero volts."""

OPEN = math.inf
"""Load impedance of an open circuit [ohm]."""

SOURCE_IMPEDANCE = 50.0
"""Output impedance of every channel [ohm]."""


@dataclass
class Channel:
    """Settings of one output; levels are kept as open-circuit volts, whatever load is configured."""

    function: str = "SIN"
    frequency: float = 1e6
    phase: float = 0.0
    amplitude: float = 2.0
    offset: float = 0.0
    unit: str = "VPP"
    limit_high: float = 10.0
    limit_low: float = -10.0
    load: float = SOURCE_IMPEDANCE
    polarity: str = "NORM"
    output: bool = False
    burst: bool = False
    burst_mode: str = "TRIG"
    n_cycles: float = 5.0
    delay: float = 0.0
    range_switches: int = 0

    @property
    def load_factor(self) -> float:
        """Volts at the configured load per open-circuit volt [1]."""
        return 1.0 if math.isinf(self.load) else self.load / (self.load + SOURCE_IMPEDANCE)

    @property
    def burst_length(self) -> float:
        """Time from a trigger to the end of its burst [s]."""
        return self.delay + self.n_cycles / self.frequency


@dataclass(frozen=True)
class Playback:
    """What one output is sending.

    Attributes
    ----------
    record : bytes
        Codes of one cycle, two bytes each, big-endian.
    amplitude, offset : float
        Of the record's full scale, open circuit [V peak to peak, V].
    duration : float
        Length of one cycle [s].
    period : float
        Time from one trigger to the next [s], or one cycle without; infinite for a single trigger.
    idle_code : int
        Code at which the output rests between bursts.
    n_cycles : int
        Cycles of one burst.
    delay : float
        From a trigger to its burst [s].
    """

    record: bytes
    amplitude: float
    offset: float
    duration: float
    period: float
    idle_code: int
    n_cycles: int = 1
    delay: float = 0.0
