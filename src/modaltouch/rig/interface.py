"""What the session asks of a rig: load, fire, stop, close."""

from __future__ import annotations

import math
import typing
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from modaltouch.stimulus import Burst


Repetition = typing.Literal["single", "timer", "continuous", "wired"]
"""``single``: each burst is triggered by itself; ``timer``: by the free timer of the generator; ``wired``: by pulses at
its trigger input; ``continuous``: one record of a whole period plays on and on."""


class RigError(Exception):
    """The rig failed; its outputs are off, or everything possible was done to switch them off."""


class LinkError(Exception):
    """An exchange failed; what the instrument has done is unknown, and so is what it will answer next."""


class Unconfirmed(Exception):  # noqa: N818
    """The instrument answered, but not that it does what was asked.

    Attributes
    ----------
    read_back : tuple of str
        What the settings read instead, where they were read.
    """

    def __init__(self, reason: str, read_back: tuple[str, ...] = ()) -> None:
        super().__init__(reason)
        self.read_back = read_back


class StimulusLost(RigError):  # noqa: N818
    """The stimulus ended before anybody ended it: stop, and offer it again."""


MANY = 1_000_000
"""Bursts without a number: until `Rig.end` or `Rig.stop`."""


@dataclass(frozen=True)
class Bursts:
    """The bursts of one stimulus, counted; None for what cannot be known.

    Attributes
    ----------
    asked : int or None
        Bursts that were due by the end of the stimulus.
    played : int or None
        Bursts whose trigger the instrument took.
    whole : int or None
        Those of them that played to their end.
    dropped : int or None
        Bursts left out because they would have come too late.
    first_s : float or None
        When the first sample of the first burst left the generator, by the record's clock [s].
    uncertainty_s : float or None
        How far from `first_s` it can have been, either way [s].
    """

    asked: int | None = None
    played: int | None = None
    whole: int | None = None
    dropped: int | None = None
    first_s: float | None = None
    uncertainty_s: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the counts as plain values for the record."""
        return {name: round(value, 6) if isinstance(value, float) else value for name, value in asdict(self).items()}


@dataclass(frozen=True)
class Firing:
    """One stimulus: what was commanded of the instrument, what it confirmed, what was played.

    Attributes
    ----------
    commanded_amplitude, confirmed_amplitude : tuple of float
        Generator amplitude of each channel, sent and read back [V peak to peak].
    onset : float
        When the first burst began, by the clock of the record [s]; in the middle of what is possible.
    onset_uncertainty : float
        How far from `onset` the first burst can have been, either way [s].
    started : bool
        Whether every setting was read back within tolerance with an empty error queue, and the first burst played.
    confirmed : bool
        Whether, at the end of the stimulus, settings and outputs still were as set and each trigger had been taken;
        never before that end.
    reason : str
        Why it did not start, or is not confirmed.
    stalled : bool
        Whether the reason is a stall of this computer, and no fault of the instrument.
    repetition : str
        ``single``, ``timer``, ``continuous`` or ``wired``.
    trigger_latency : str
        ``measured``, or ``unknown``: then nothing is claimed of `onset` to less than a millisecond.
    bursts : Bursts
        What was played, as far as it is known.
    """

    commanded_amplitude: tuple[float, ...]
    confirmed_amplitude: tuple[float, ...]
    onset: float
    onset_uncertainty: float
    started: bool = False
    confirmed: bool = False
    reason: str = ""
    stalled: bool = False
    repetition: str = "single"
    trigger_latency: str = "unknown"
    bursts: Bursts = Bursts()

    def pending(self, reason: str) -> Firing:
        """Return the firing as it is recorded before its end, without counts; `reason` says so."""
        return replace(self, reason=reason, bursts=Bursts())

    def as_dict(self) -> dict[str, Any]:
        """Return the firing as plain values for the record, the bursts left out."""
        values = asdict(self)
        del values["bursts"], values["started"]
        for name in ("onset", "onset_uncertainty"):
            values[name] = round(values[name], 6) if math.isfinite(values[name]) else None
        return values


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
        """The latest stimulus; `stop` confirms it, or says why not."""

    @property
    def lead(self) -> float:
        """How long before a stimulus `fire` is to be called, so that it begins in time [s]."""

    def load(self, burst: Burst, *further: Burst, repetition: Repetition | None = None) -> None:
        """Upload both channels' records of each burst and verify them, outputs off; repeated otherwise than usual."""

    def fire(
        self,
        velocity: float,
        *,
        n_bursts: int = MANY,
        exactly: bool = False,
        silent: bool = False,
        which: int = 0,
        due: float = -math.inf,
    ) -> Firing:
        """Set the level, switch the outputs on and let bursts go; return after the first.

        Parameters
        ----------
        velocity : float
            Peak velocity at the focus [m/s].
        n_bursts : int
            How many bursts at most, where they are triggered one by one.
        exactly : bool
            Whether a single burst that is left out spoils the stimulus.
        silent : bool
            Whether no burst is let go, in a catch trial: the outputs are on, at the level's amplitude, and rest.
        which : int
            Which of the bursts that were loaded, from 0.
        due : float
            When the first burst goes at the earliest, by the record's clock [s].
        """

    def end(self) -> None:
        """Let no further burst go; the one that plays comes to its end. Never raises."""

    def stop(self, *, at_once: bool = False) -> None:
        """Switch both outputs off, after the burst that plays unless `at_once`, and confirm what was played."""

    def heartbeat(self) -> None:
        """Tell the watchdog that the session is alive; called about every millisecond, cheap.

        Raises
        ------
        StimulusLost
            If the bursts ended that nobody ended.
        """

    def close(self) -> None:
        """Switch the outputs off and release the instrument; never raises."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...
