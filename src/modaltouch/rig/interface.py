"""What the session asks of a rig: load, fire, stop, close."""

from __future__ import annotations

import typing
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from modaltouch.stimulus.burst import Burst


class RigError(Exception):
    """The rig failed; its outputs are off, or everything possible was done to switch them off."""


@dataclass(frozen=True)
class Firing:
    """What was commanded of the instrument, and what it confirmed.

    Attributes
    ----------
    commanded_amplitude, confirmed_amplitude : tuple of float
        Generator amplitude of each channel, sent and read back [V peak to peak].
    confirmed : bool
        Whether every setting was read back within tolerance with an empty error queue.
    onset : float
        When the trigger was armed, by `time.perf_counter` [s]; the first burst follows within
        `onset_uncertainty`.
    onset_uncertainty : float
        Longest time from `onset` to the first burst [s].
    reason : str
        Why it is not confirmed.
    """

    commanded_amplitude: tuple[float, ...]
    confirmed_amplitude: tuple[float, ...]
    confirmed: bool
    onset: float
    onset_uncertainty: float
    reason: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the firing as plain values for the record."""
        return asdict(self)


class Rig(typing.Protocol):
    """A generator with a beam behind it, real or simulated."""

    @property
    def identity(self) -> str:
        """Reply to ``*IDN?``."""

    @property
    def address(self) -> str:
        """VISA address."""

    @property
    def firing(self) -> Firing | None:
        """The latest firing; `stop` makes it unconfirmed if the settings or outputs were no longer as set."""

    def load(self, burst: Burst, *further: Burst) -> None:
        """Upload both channels' records of each burst and verify them, outputs off."""

    def fire(self, velocity: float, *, silent: bool = False, which: int = 0) -> Firing:
        """Set the level [m/s], switch the outputs on and repeat the burst until `stop`.

        With `silent` everything is the same but that no burst is let go: the outputs are on at rest.
        """

    def stop(self) -> None:
        """Switch both outputs off and confirm it."""

    def heartbeat(self) -> None:
        """Tell the watchdog that the session is alive; called about every millisecond, cheap."""

    def close(self) -> None:
        """Switch the outputs off and release the instrument; never raises."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...
