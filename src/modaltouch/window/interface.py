"""What the session asks of the answer window."""

from __future__ import annotations

import typing
from abc import abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from modaltouch.protocol import AnswersSection, Response, Trial

EventKind = typing.Literal["key", "release", "click", "close", "focus", "blur", "expose", "pause", "continue", "answer"]


class WindowError(Exception):
    """The answer window cannot be opened or was lost.

    Attributes
    ----------
    ending : str
        Reason in the stop record of a session that this ended.
    """

    ending = "window lost"


class _EndedEarly(Exception):  # noqa: N818
    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class SessionStopped(_EndedEarly):
    """The participant or experimenter ended the session.

    Attributes
    ----------
    reason : str
        One of ``escape`` (and confirmed), ``window closed``, ``practice not passed``, ``experimenter``, ``end of
        block``, ``emergency stop``.
    """


class TrialInterrupted(_EndedEarly):
    """The trial was cut by a pause or a lost focus: offer it again.

    Attributes
    ----------
    reason : str
        One of ``escape``, ``focus lost``, ``experimenter``.
    """


@dataclass(frozen=True)
class Event:
    """One thing that happened to the window.

    Attributes
    ----------
    time : float
        When it was received, by the window's clock [s].
    kind : str
        ``key``, ``release``, ``click``, ``close``, ``focus``, ``blur`` or ``expose``; or what the experimenter asks
        for: ``pause``, ``continue`` or ``answer``, typed at the console.
    key : str
        Name of the key, for ``key``, ``release`` and ``answer``.
    digit : str
        Digit engraved on the key, if the layout needs Shift for it: the window takes the key for that digit, too.
    answer : str or None
        What is answered, for ``answer``.
    x, y : float
        Place of a click [window heights], origin in the middle of the window, y upwards.
    """

    time: float
    kind: EventKind
    key: str = ""
    x: float = 0.0
    y: float = 0.0
    digit: str = ""
    answer: str | None = None


Tick = Callable[[], Event | None]
"""Called about every millisecond while the window waits; may raise, and returns what the experimenter asks for."""

Log = Callable[..., None]
"""``log(event, **facts)`` appends one event to the session log."""


@dataclass(frozen=True)
class Presentation:
    """The stimulus that plays while the window asks.

    Attributes
    ----------
    onset : float
        When its first burst began, by the clock of the session [s].
    ends : float
        When the last of its bursts is over, if nothing ends it earlier [s].
    end : callable
        Prevents further bursts; cheap, never raises.
    stop : callable
        Switches the outputs off after the burst that plays; may raise `RigError` only in intervals before the last.
    interval : int
        Which of several intervals of the trial it is, from 1; 0 if there is only one.
    """

    onset: float
    ends: float
    end: Callable[[], None]
    stop: Callable[[], None]
    interval: int = 0


class Progress(typing.NamedTuple):
    """Where the session stands, as the participant may see it: trial `number` of `total`."""

    number: int
    total: int


class AnswerWindow(AbstractContextManager["AnswerWindow"]):
    """Shows the session to the participant and collects the answers; `progress` is a trial's number and their total.

    Every method that waits calls the `tick` given at opening about every millisecond. `tick` may raise, and what it
    returns is carried out: ``pause`` holds the session until ``continue`` or a press to go on; an answer is taken as
    if it had been given at the window.

    Attributes
    ----------
    on_question : callable
        Called for each question with its trial and when it appeared on the screen [s].
    """

    on_question: Callable[[Trial, float], None] = staticmethod(lambda trial, instant: None)

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return size, backend and versions for the start record."""

    def welcome(self, trial: Trial) -> None:
        """Show the instructions until the participant goes on, with the fingers where the first trial wants them."""

    def place_fingers(self, trial: Trial) -> None:
        """Show which finger goes on which zone until it is confirmed."""

    @abstractmethod
    def settle(self, trial: Trial, progress: tuple[int, int], lead: float = 0.0) -> float:
        """Let hands and fingers come to rest before a stimulus: the pause since the last answer or key to go on.

        If a finger was lifted from the beam to press, a countdown is shown. Called before every stimulus.

        Parameters
        ----------
        trial, progress
            As for `ask`.
        lead : float
            How long before the end of the pause to return [s].

        Returns
        -------
        float
            When the pause ends, by the session's clock [s].
        """

    def show_stall(self) -> None:
        """Show briefly that the computer was held up, and that the last stimulus comes again."""

    def show_measuring(self, seconds: float) -> None:
        """Show for some time [s] that the beam is being measured and fingers must keep still; the screen then stays."""

    def announce(self, text: str) -> None:
        """Show one text of the protocol, such as ``practice``, ``start`` or ``hands_off``, until somebody goes on."""

    @abstractmethod
    def feel(self, trial: Trial, progress: tuple[int, int], presentation: Presentation, until: float) -> None:
        """Show which interval before the last is on, call `presentation.stop` when it is over, and wait.

        Parameters
        ----------
        trial : Trial
            Its condition is what this interval presents, and in `ask` what the last one does.
        progress, presentation
            As for `ask`.
        until : float
            When to return, by the session's clock [s].

        Raises
        ------
        TrialInterrupted, SessionStopped
            As `ask` does.
        """

    @abstractmethod
    def ask(self, trial: Trial, progress: tuple[int, int], presentation: Presentation) -> Response:
        """Show the trial and return the answer, as soon as it is known and without confirming it on screen.

        The session writes the answer to the disk first and calls `confirm` then, so that an answer the
        participant saw confirmed is never lost. From the accepted answer to the return nothing may raise,
        `tick` included.

        `presentation.end` is called at the answer, `presentation.stop` at any interruption and when the last burst
        is over.

        Raises
        ------
        TrialInterrupted
            If the trial was cut and must be offered again.
        SessionStopped
            If the session was ended.
        """

    def confirm(self, response: Response) -> None:
        """Show which answer was taken; it is on the disk."""

    @abstractmethod
    def ask_further(self, name: str, asked: AnswersSection, trial: Trial | None = None) -> Response:
        """Ask a further question, and return its answer; after a pause it is asked once more.

        Parameters
        ----------
        name : str
            Its name in the protocol.
        asked : AnswersSection
            How it is asked.
        trial : Trial, optional
            The trial whose stimulus is over; None for a question of the closing form.

        Raises
        ------
        SessionStopped
            If the session was ended.
        """

    def give_feedback(self, response: Response, expected: str) -> None:
        """Show for a moment where the vibration was stronger, after a practice trial."""

    def wait(self, seconds: float) -> None:
        """Let the pause between two trials pass, counted from the answer; a simulated participant does not wait."""

    def rest(self, progress: tuple[int, int]) -> None:
        """Show the break until the participant goes on."""

    def goodbye(self) -> None:
        """Thank the participant."""

    def dismiss(self) -> None:
        """Show briefly that the session ends early; never raises, and does not tick."""

    def close(self) -> None:
        """Close the window; never raises."""

    def __exit__(self, *exc: object) -> None:
        self.close()


class MaskingError(WindowError):
    """The masking noise that a protocol demands cannot be played."""

    ending = "masking lost"


class Masking(AbstractContextManager["Masking"]):
    """The masking noise as the session uses it; this one plays nothing.

    Parameters
    ----------
    reason : str
        Why it plays nothing although the protocol wants masking; empty if the protocol does not.
    """

    def __init__(self, reason: str = "") -> None:
        self._reason = reason

    def describe(self) -> dict[str, Any] | None:
        """Return noise, level and device for the start record; None if the protocol wants no masking."""
        return {"state": "not masked", "reason": self._reason} if self._reason else None

    def start(self) -> None:
        """Begin to fade in."""

    def ensure(self, tick: Callable[[], object], *, on: bool = True) -> None:
        """Make sure before a trial that the noise is at its level, or silent; reopen a device that was lost.

        Calls `tick` while it waits.

        Raises
        ------
        MaskingError
            If it is lost and the protocol demands it.
        """

    @property
    def is_on(self) -> bool | None:
        """Whether the noise has been on since `ensure`; None if the protocol wants no masking."""
        return False if self._reason else None

    def stop(self, *, hurry: bool) -> None:
        """Fade out, quickly if in a `hurry`, and release the device; a second call does nothing.

        The number of times that the device got no samples in time, each heard as a click, goes into the record.
        """

    def __exit__(self, *exc: object) -> None:
        """Release the device, whatever happened."""
