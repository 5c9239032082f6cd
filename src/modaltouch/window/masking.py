"""Noise that masks the sound of the beam, without a break from before the first trial until after the last.

The noise has random phases over a spectrum that is exact, so that one period repeats without a seam; it is played
through PortAudio. A device that is lost in mid-session (unplugged, taken away by the system) leaves the trial that is
on alone: its answer is recorded as not masked. Before the next trial the device is opened again; where that fails, a
protocol that demands masking ends the session in order, and `modaltouch resume` goes on once the device is back; any
other goes on without, every trial recorded as such.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self

from modaltouch.window.interface import Log, WindowError

if TYPE_CHECKING:
    from modaltouch.protocol import Apparatus, MaskingSection
    from modaltouch.window.noise import Kind


class MaskingError(WindowError):
    """The masking noise that a protocol demands cannot be played."""

    ending = "masking lost"


class Masking:
    """What the session asks of masking noise; this one plays nothing.

    Parameters
    ----------
    reason : str
        Why, where the protocol wants masking; empty where it does not.
    """

    def __init__(self, reason: str = "") -> None:
        self._reason = reason

    @staticmethod
    def open(section: MaskingSection | None, apparatus: Apparatus, log: Log, *, is_heard: bool = True) -> Masking:
        """Return the masking that a protocol wants, silent until `start`.

        Parameters
        ----------
        section : MaskingSection or None
            What the protocol wants.
        apparatus : Apparatus
            What plays it.
        log : callable
            Takes what happens to it for the record.
        is_heard : bool
            Whether a person answers; a simulated participant hears nothing.

        Raises
        ------
        MaskingError
            If it cannot be played and the protocol demands it.
        """
        if section is None or not is_heard:
            return Masking("" if section is None else "a simulated participant hears nothing")
        try:
            from modaltouch.window.noise_masking import NoiseMasking

            return NoiseMasking(section, apparatus, log)
        except MaskingError as error:
            if section.required:
                raise
            log("masking_lost", reason=str(error))
            return Masking(str(error))

    @staticmethod
    def highest_level(kind: Kind, sampling_rate: float) -> float:
        """Return the level at which the highest peak of a noise just reaches full scale [dB FS]."""
        from modaltouch.window.noise import SINE_DB, make_noise

        return SINE_DB - 20 * math.log10(float(abs(make_noise(kind, sampling_rate)).max()))

    def describe(self) -> dict[str, Any] | None:
        """Return noise, level and device for the start record; None where the protocol wants no masking."""
        return {"state": "not masked", "reason": self._reason} if self._reason else None

    def start(self) -> None:
        """Begin to fade in."""

    def ensure(self, tick: Callable[[], object]) -> None:
        """See before a trial that the noise is on and at its level; open the device again where it was lost.

        Calls `tick` while it waits.

        Raises
        ------
        MaskingError
            If it is lost and the protocol demands it.
        """

    @property
    def is_on(self) -> bool | None:
        """Whether the noise has been on since `ensure`; None where the protocol wants no masking."""
        return False if self._reason else None

    def stop(self, *, hurry: bool) -> None:
        """Fade out, in an instant where something went wrong, and let the device go; a second call does nothing.

        How often the device got no samples in time, a click each, goes into the record.
        """

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        """Let the device go, whatever happened."""
