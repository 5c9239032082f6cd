"""Opens the answer window: for a person, for a robot that types into it, or none for a simulated participant."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from modaltouch.system import SYSTEM_CLOCK, Clock
from modaltouch.window.interface import AnswerWindow, Log, Tick

if TYPE_CHECKING:
    from modaltouch.protocol import Protocol, Texts
    from modaltouch.window.layout import Spans
    from modaltouch.window.simulated import Answerer

AnswersBy = Literal["window", "simulated", "robot"]
"""A person at the window; an observer model without a window; an observer model typing into the real window."""


@dataclass(frozen=True)
class WindowOptions:
    """How the window is opened.

    Attributes
    ----------
    size : (width, height) of int
        Size of the window [pixels].
    fullscreen : bool
        Whether the window covers the monitor.
    theme : str
        ``dark`` or ``light``.
    screen : int
        Which monitor, from 0.
    screenshots : Path, optional
        Folder for one PNG of each kind of screen.
    """

    size: tuple[int, int] = (1280, 800)
    fullscreen: bool = False
    theme: str = "dark"
    screen: int = 0
    screenshots: Path | None = None

    @classmethod
    def recorded(cls, window: Mapping[str, Any]) -> Self:
        """Return how the window of a record was opened; what older records do not say is set to the default.

        Parameters
        ----------
        window : mapping
            What the record's line `start` or `resume` says about the window.
        """
        from modaltouch.window.theme import THEMES

        usual, size = cls(), window.get("size_px")
        fullscreen, theme = bool(window.get("fullscreen", False)), window.get("theme")
        return cls(
            # The recorded size of a full screen is the monitor's.
            size=(int(size[0]), int(size[1])) if size and not fullscreen else usual.size,
            fullscreen=fullscreen,
            theme=theme if theme in THEMES else usual.theme,
            screen=int(window.get("monitor", usual.screen)),
        )


def open_window(
    answers: AnswersBy,
    protocol: Protocol,
    texts: Texts,
    *,
    zones: Spans,
    tick: Tick,
    log: Log,
    answerer: Answerer | None = None,
    options: WindowOptions | None = None,
    clock: Clock = SYSTEM_CLOCK,
) -> AnswerWindow:
    """Return an open answer window.

    Parameters
    ----------
    answers : str
        As `AnswersBy`: ``window``, ``robot`` or ``simulated``.
    protocol, texts, zones, tick, log, clock
        As for `participant.ParticipantWindow`.
    answerer, options
        The observer, for ``robot`` and ``simulated``; how the window is opened, if there is one.

    Raises
    ------
    WindowError, ValueError
        If the window cannot be opened, or an observer is missing.
    """
    if answers == "window":
        answerer = None
    elif answerer is None:
        raise ValueError(f"given answers by {answers!r} and no observer; give `answerer`, or answers by 'window'")
    elif answers == "simulated":
        from modaltouch.window.simulated import SimulatedParticipant

        section = protocol.answers
        before = section.question_delay_s if section.stimulus_until == "answer" else 0.0
        return SimulatedParticipant(
            answerer, tick=tick, log=log, stimulus_until=section.stimulus_until, after_longest=section.after_longest,
            time_out=before + (section.time_out_s or math.inf), clock=clock,
        )  # fmt: skip
    from modaltouch.window.buttons import typesetter_of
    from modaltouch.window.participant import ParticipantWindow
    from modaltouch.window.robot import Robot
    from modaltouch.window.screen import Screen
    from modaltouch.window.theme import THEMES

    options, robot = options or WindowOptions(), None if answerer is None else Robot(answerer, protocol, texts=texts)
    display = Screen(
        size=options.size, fullscreen=options.fullscreen, monitor=options.screen, ground=THEMES[options.theme].ground,
        title=protocol.title, typesetter=typesetter_of(texts), clock=clock,
    )  # fmt: skip
    try:
        return ParticipantWindow(
            display, protocol, texts, zones=zones, theme=options.theme, tick=tick, log=log,
            screenshots=options.screenshots, robot=robot, clock=clock,
        )  # fmt: skip
    except BaseException:
        display.close()
        raise
