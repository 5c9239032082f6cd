"""Interfaces of a rig: to a session (`Rig`), and from its driver to the instrument (`Transport`)."""

from __future__ import annotations

import math
import typing
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from modaltouch.stimulus import Burst


Repetition = typing.Literal["single", "timer", "continuous", "wired"]
"""Source of the repetition. ``single``: a trigger command per burst; ``timer``: the generator's free-running timer;
``wired``: pulses at the trigger input; ``continuous``: repetition of one record of a whole period."""


class RigError(Exception):
    """The rig failed; its outputs are off, or all attempts to switch them off have been made."""


class LinkError(Exception):
    """An exchange failed; the state of the instrument and its next reply are unknown."""


class Unconfirmed(Exception):  # noqa: N818
    """The instrument replied, but its reply does not confirm the command; `read_back` holds the values it returned."""

    def __init__(self, reason: str, read_back: tuple[str, ...] = ()) -> None:
        super().__init__(reason)
        self.read_back = read_back


class InUse(LinkError):  # noqa: N818
    """The instrument is in use by another program."""


class StimulusLost(RigError):  # noqa: N818
    """The stimulus ended before `Rig.end` or `Rig.stop` was called: stop, and present it again."""


MANY = 1_000_000
"""Number of bursts for an unlimited stimulus, which lasts until `Rig.end` or `Rig.stop`."""


@dataclass(frozen=True)
class Bursts:
    """Burst counts of one stimulus; None if unknown."""

    asked: int | None = None  # number of bursts due by the end of the stimulus
    played: int | None = None  # number of bursts with a trigger accepted by the instrument
    whole: int | None = None  # number of bursts played to the end
    dropped: int | None = None  # number of bursts dropped because they would have been too late
    # instant at which the first sample of the first burst left the generator, on the clock of the session log [s]
    first_s: float | None = None
    uncertainty_s: float | None = None  # uncertainty of `first_s`, in either direction [s]

    def as_dict(self) -> dict[str, Any]:
        """Return the counts as a JSON-serialisable dict for the log."""
        return {name: round(value, 6) if isinstance(value, float) else value for name, value in asdict(self).items()}


@dataclass(frozen=True)
class Firing:
    """One stimulus, as commanded, as confirmed by the instrument, and as played.

    Attributes
    ----------
    commanded_amplitude, confirmed_amplitude : tuple of float
        Generator amplitude of each channel, as sent and as read back [V peak to peak].
    onset : float
        Start of the first burst, on the clock of the session log [s]; the centre of the interval of uncertainty.
    onset_uncertainty : float
        Half-width of that interval [s].
    started : bool
        Whether every setting was read back within tolerance with an empty error queue, and the first burst played.
    confirmed : bool
        Whether, at the end of the stimulus, settings and outputs were unchanged and every trigger had been accepted;
        False until then.
    reason : str
        Reason why it did not start or is not confirmed.
    stalled : bool
        Whether the reason is a stall of this computer rather than a failure of the instrument.
    repetition : str
        ``single``, ``timer``, ``continuous`` or ``wired``.
    trigger_latency : str
        ``measured``, or ``unknown``, in which case `onset_uncertainty` is at least 1 ms.
    bursts : Bursts
        Burst counts, as far as known.
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
        """Return the firing as logged before its end: without counts, and unconfirmed for this `reason`."""
        return replace(self, reason=reason, bursts=Bursts())

    def as_dict(self) -> dict[str, Any]:
        """Return the firing as a JSON-serialisable dict for the log, without the bursts."""
        values = asdict(self)
        del values["bursts"], values["started"]
        for name in ("onset", "onset_uncertainty"):
            values[name] = round(values[name], 6) if math.isfinite(values[name]) else None
        return values


class Rig(typing.Protocol):
    """A generator with a beam behind it, real or simulated."""

    identity: str  # reply to ``*IDN?``
    address: str  # VISA address
    firing: Firing | None  # the latest stimulus; `stop` confirms it or states why not
    lead: float  # time by which `fire` should precede a stimulus that is to begin on time [s]

    def load(self, burst: Burst, *further: Burst, repetition: Repetition | None = None) -> None:
        """Upload and verify the records of each burst, outputs off; `repetition` replaces the usual one."""

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
        """Set the level, switch the outputs on and play bursts; return after the first.

        Parameters
        ----------
        velocity : float
            Peak velocity at the focus [m/s].
        n_bursts : int
            Maximum number of bursts, if they are triggered one by one.
        exactly : bool
            Whether a single dropped burst invalidates the stimulus.
        silent : bool
            Whether to play nothing, as in a catch trial: the outputs are on, with the amplitudes of the level, but at
            rest.
        which : int
            Index of the burst among those loaded, from 0.
        due : float
            Earliest instant of the first burst, on the clock of the session log [s].
        """

    def end(self) -> None:
        """Trigger no further burst; a burst in progress is completed. Never raises."""

    def stop(self, *, at_once: bool = False) -> None:
        """Switch both outputs off, after any burst in progress unless `at_once`, and confirm the stimulus."""

    def heartbeat(self) -> None:
        """Signal to the watchdog that the session is alive; cheap, to be called about every millisecond.

        Raises
        ------
        StimulusLost
            If the bursts ended before `end` or `stop` was called.
        """

    def close(self) -> None:
        """Switch the outputs off and release the instrument; never raises."""


class Transport(typing.Protocol):
    """A transport to one instrument; every failure raises, and the transport must then be closed and reopened."""

    def open(self) -> str:
        """Reopen the transport; return a sentence on how other programs are locked out.

        Raises InUse if another program has the instrument.
        """

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> bytes:
        """Send a message and return the reply, if one is expected; each may take up to `timeout` [s]."""

    def close(self, *, broken: bool) -> None:
        """Close the transport; if broken, without notifying the other end."""


def block_bounds(reply: bytes) -> tuple[int, int]:
    """Return start and end of the content of a definite-length block (IEEE 488.2, 8.7.9).

    Raises ValueError if the reply does not begin with a block header.
    """
    n_digits = reply[1:2]
    length = reply[2 : 2 + int(n_digits)] if n_digits.isdigit() else b""
    if not (reply[:1] == b"#" and length.isdigit()):
        raise ValueError(f"reply {reply[:20]!r} is not a block")
    start = 2 + int(n_digits)
    return start, start + int(length)


def describe_error(error: BaseException) -> str:
    """Return type and text of an error in one line; for a LinkError, the text alone."""
    text = " ".join(str(error).split())[:200]
    if isinstance(error, LinkError):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
