"""Interfaces of the answer window and the masking noise."""

from __future__ import annotations

import typing
from abc import abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from modaltouch.protocol import AnswersSection, Response, Trial

EventKind = typing.Literal[
    "key", "release", "click", "close", "focus", "blur", "expose", "lost", "pause", "continue", "answer"
]


class WindowError(Exception):
    """The answer window cannot be opened or drawn.

    Attributes
    ----------
    ending : str
        Reason in the stop record of a session ended by this error.
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
        One of ``escape`` (confirmed), ``window closed``, ``practice not passed``, ``experimenter``, ``end of block``,
        ``emergency stop``.
    """


class TrialInterrupted(_EndedEarly):
    """The trial was interrupted by a pause or a loss of focus and must be repeated.

    Attributes
    ----------
    reason : str
        One of ``escape``, ``focus lost``, ``experimenter``.
    """


@dataclass(frozen=True)
class Event:
    """An event of the window, or a request of the experimenter.

    Attributes
    ----------
    time : float
        Time of receipt, by the window's clock [s].
    kind : str
        ``key``, ``release``, ``click``, ``close``, ``focus``, ``blur``, ``expose`` or ``lost`` (the display is gone);
        or from the console ``pause``, ``continue`` or ``answer``.
    key : str
        Name of the key, for ``key``, ``release`` and ``answer``.
    digit : str
        Digit engraved on the key, if the layout needs Shift for it; the key also counts as that digit.
    answer : str or None
        The answer, for ``answer``.
    x, y : float
        Position of a click [window heights], origin in the middle of the window, y upwards.
    """

    time: float
    kind: EventKind
    key: str = ""
    x: float = 0.0
    y: float = 0.0
    digit: str = ""
    answer: str | None = None


POLL_INTERVAL = 1e-3
"""Time between two polls of the window, the resolution of reaction times [s]."""

Tick = Callable[[], Event | None]
"""Called about every millisecond while the window waits; may raise, and returns the experimenter's request."""

Log = Callable[..., None]
"""``log(event, **facts)`` appends one event to the session log."""


@dataclass(frozen=True)
class Presentation:
    """The stimulus that plays while the window asks.

    Attributes
    ----------
    onset : float
        Onset of the first burst, by the session's clock [s].
    ends : float
        End of the last burst, unless stopped earlier [s].
    end : callable
        Prevents further bursts; fast, never raises.
    stop : callable
        Switches the outputs off after the current burst; may raise `RigError` only in intervals before the last.
    interval : int
        Number of the interval in the trial, from 1; 0 for a single interval.
    """

    onset: float
    ends: float
    end: Callable[[], None]
    stop: Callable[[], None]
    interval: int = 0


class AnswerWindow(AbstractContextManager["AnswerWindow"]):
    """Interface that presents the session to the participant and collects the answers.

    `progress` is the number of a trial and the total. Methods that wait call `tick`, given at opening, about every
    millisecond. `tick` may raise, and its result is acted on: ``pause`` holds the session until ``continue`` or a key
    to continue; an answer counts as if given at the window.

    Attributes
    ----------
    on_question : callable
        Called for the question of each trial with the time of its appearance on the screen [s].
    """

    on_question: Callable[[float], None] = staticmethod(lambda instant: None)

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return size, backend and versions for the start record."""

    def welcome(self, trial: Trial) -> None:
        """Show the instructions until the participant continues, with the fingers as in the first trial."""

    def place_fingers(self, trial: Trial) -> None:
        """Show which finger goes on which zone until confirmed."""

    @abstractmethod
    def settle(self, trial: Trial, progress: tuple[int, int], lead: float = 0.0) -> float:
        """Let hands and fingers come to rest before each stimulus: the pause since the last answer or key.

        A countdown is shown if a finger was lifted from the beam to press.

        Parameters
        ----------
        trial, progress
            As for `ask`.
        lead : float
            Time before the end of the pause at which to return [s].

        Returns
        -------
        float
            End of the pause, by the session's clock [s].
        """

    def show_stall(self) -> None:
        """Show briefly that the computer was busy and that the last stimulus will be repeated."""

    def show_measuring(self, seconds: float) -> None:
        """Show for a time [s] that the beam is being measured and fingers must keep still; the screen then stays."""

    def announce(self, text: str, progress: tuple[int, int] | None = None) -> None:
        """Show a text of the protocol, such as ``practice`` or ``rest``, until the participant continues."""

    @abstractmethod
    def feel(self, trial: Trial, progress: tuple[int, int], presentation: Presentation, until: float) -> None:
        """Show an interval before the last one, call `presentation.stop` at its end, and wait.

        Parameters
        ----------
        trial : Trial
            Trial with the condition of this interval; `ask` gets that of the last interval.
        progress, presentation
            As for `ask`.
        until : float
            Time at which to return, by the session's clock [s].

        Raises
        ------
        TrialInterrupted, SessionStopped
            As for `ask`.
        """

    @abstractmethod
    def ask(self, trial: Trial, progress: tuple[int, int], presentation: Presentation) -> Response:
        """Show the trial and return the answer as soon as it is known, without confirming it on screen.

        The session writes the answer to disk before it calls `confirm`, so that an answer shown as confirmed is never
        lost. Between the accepted answer and the return, nothing may raise, including `tick`.

        `presentation.end` is called at the answer, and `presentation.stop` at an interruption or after the last burst.

        Raises
        ------
        TrialInterrupted
            If the trial was interrupted and must be repeated.
        SessionStopped
            If the session was ended.
        """

    def confirm(self, response: Response) -> None:
        """Show the accepted answer, which is on disk."""

    @abstractmethod
    def ask_further(self, name: str, asked: AnswersSection, trial: Trial | None = None) -> Response:
        """Ask a further question and return its answer; ask again after a pause.

        Parameters
        ----------
        name : str
            Name of the question in the protocol.
        asked : AnswersSection
            The question.
        trial : Trial, optional
            The completed trial; None for a question of the closing form.

        Raises
        ------
        SessionStopped
            If the session was ended.
        """

    def give_feedback(self, response: Response, expected: str) -> None:
        """Show briefly where the vibration was stronger, after a practice trial."""

    def wait(self, seconds: float) -> None:
        """Wait for the pause between two trials, counted from the answer; no wait for a simulated participant."""

    def goodbye(self) -> None:
        """Thank the participant."""

    def dismiss(self) -> None:
        """Show briefly that the session ends early; never raises, and does not tick."""

    def close(self) -> None:
        """Close the window; never raises."""

    def __exit__(self, *exc: object) -> None:
        self.close()


class MaskingError(WindowError):
    """The masking noise required by a protocol cannot be played."""

    ending = "masking lost"


class Masking(AbstractContextManager["Masking"]):
    """Interface of the masking noise; this base class plays nothing.

    Parameters
    ----------
    reason : str
        Why no noise is played although the protocol has masking; empty if it has none.
    """

    def __init__(self, reason: str = "") -> None:
        self._reason = reason

    def describe(self) -> dict[str, Any] | None:
        """Return noise, level and device for the start record; None if the protocol has no masking."""
        return {"state": "not masked", "reason": self._reason} if self._reason else None

    def start(self) -> None:
        """Start the fade-in."""

    def ensure(self, tick: Callable[[], object], *, on: bool = True) -> None:
        """Ensure before a trial that the noise is at its level, or silent.

        Calls `tick` while waiting.

        Raises
        ------
        MaskingError
            If the device is lost and the protocol requires the noise.
        """

    @property
    def is_on(self) -> bool | None:
        """Whether the noise has been on since `ensure`; None if the protocol has no masking."""
        return False if self._reason else None

    def stop(self, *, hurry: bool) -> None:
        """Fade out, quickly if `hurry`, and release the device; a second call does nothing.

        The number of underflows of the device, each audible as a click, is recorded.
        """

    def __exit__(self, *exc: object) -> None:
        """Release the device."""
