"""What the answer window asks of speech, and what stands in its place where there is none."""

from __future__ import annotations

import typing
from dataclasses import dataclass
from typing import Any


class SpeechError(Exception):
    """The prompts that a protocol demands cannot be spoken."""


class Speech(typing.Protocol):
    """Says one prompt at a time, into a stream that runs already; nothing here waits or writes but `write_down`."""

    def describe(self) -> dict[str, Any] | None:
        """Return voice, library and prompts for the start record; None where the protocol wants no speech."""

    def say(self, words: str) -> None:
        """Begin to say the words, in place of what is being said; hush where they are empty."""

    def hush(self) -> None:
        """Let what is being said fade out."""

    @property
    def is_speaking(self) -> bool:
        """Whether something is being said or about to be."""

    def write_down(self) -> None:
        """Write what was said since the last call into the record."""


@dataclass(frozen=True)
class Silence:
    """Nothing is said.

    Attributes
    ----------
    reason : str
        Why, where the protocol wants speech; empty where it does not.
    """

    reason: str = ""

    def describe(self) -> dict[str, Any] | None:
        """Return that nothing was said, and why; None where the protocol wants no speech."""
        return {"state": "silent", "reason": self.reason} if self.reason else None

    def say(self, words: str) -> None:
        """Stay silent."""

    def hush(self) -> None:
        """Stay silent."""

    @property
    def is_speaking(self) -> bool:
        """It is not."""
        return False

    def write_down(self) -> None:
        """There is nothing to write."""
