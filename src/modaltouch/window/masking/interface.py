"""What the session asks of masking noise, and what stands in its place where there is none."""

from __future__ import annotations

import typing
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self


class MaskingError(Exception):
    """The masking noise that a protocol demands cannot be played."""


class Masking(typing.Protocol):
    """Noise in the participant's ears."""

    def describe(self) -> dict[str, Any] | None:
        """Return noise, level and device for the start record; None where the protocol wants no masking."""

    def start(self) -> None:
        """Begin to fade in."""

    def ensure(self, tick: Callable[[], object]) -> None:
        """See before a trial that the noise is on and at its level; mend it where that can be.

        Calls `tick` while it waits.

        Raises
        ------
        MaskingError
            If it is lost and the protocol demands it.
        """

    @property
    def is_on(self) -> bool | None:
        """Whether it has been on since `ensure`; None where the protocol wants no masking."""

    def stop(self, *, hurry: bool) -> None:
        """Fade out, in an instant where something went wrong, and let the device go; a second call does nothing."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


@dataclass(frozen=True)
class NoMasking:
    """Nothing is played.

    Attributes
    ----------
    reason : str
        Why, where the protocol wants masking; empty where it does not.
    """

    reason: str = ""

    def describe(self) -> dict[str, Any] | None:
        """Return that the participant was not masked, and why; None where the protocol wants no masking."""
        return {"state": "not masked", "reason": self.reason} if self.reason else None

    def start(self) -> None:
        """Stay silent."""

    def ensure(self, tick: Callable[[], object]) -> None:
        """Stay silent."""

    @property
    def is_on(self) -> bool | None:
        """It is not."""
        return False if self.reason else None

    def stop(self, *, hurry: bool) -> None:
        """There is nothing to stop."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None
