"""Asks the participant: the PsychoPy window, and a simulated participant behind the same interface."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from modaltouch.window.interface import AnswerWindow, Log, Tick

if TYPE_CHECKING:
    from modaltouch.protocol import Protocol, Texts
    from modaltouch.window.screen import Screen
    from modaltouch.window.simulated import Answerer

AnswersBy = Literal["window", "simulated", "robot"]
"""A person at the window; an observer model without a window; an observer model typing into the real window."""


def open_window(
    answers: AnswersBy,
    protocol: Protocol,
    texts: Texts,
    *,
    zones: tuple[str, ...],
    tick: Tick,
    log: Log,
    answerer: Answerer | None = None,
    size: tuple[int, int] = (1280, 800),
    fullscreen: bool = False,
    theme: str = "dark",
    screen: int = 0,
    screenshots: Path | None = None,
) -> AnswerWindow:
    """Return an open answer window.

    Parameters
    ----------
    answers : str
        ``window`` (a person), ``robot`` (an observer typing into the real window) or ``simulated`` (an observer
        without a window).
    protocol : Protocol
        What is asked, and by which keys it is answered.
    texts : Texts
        Every word on the screen.
    zones : tuple of str
        Names of the beam's zones, from the participant's left.
    tick : callable
        Called about every millisecond while the window waits; may raise, and returns what the experimenter wishes.
    log : callable
        Takes the window's events for the record, as ``log(event, **facts)``.
    answerer : Answerer, optional
        The observer, for ``robot`` and ``simulated``.
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

    Raises
    ------
    WindowError
        If the window cannot be opened.
    ValueError
        If the theme is unknown, or an observer is missing.
    """
    if answers != "window" and answerer is None:
        raise ValueError(f"given answers by {answers!r} and no observer; give `answerer`, or answers by 'window'")
    if answers == "simulated" and answerer is not None:
        from modaltouch.window.simulated import SimulatedParticipant

        return SimulatedParticipant(answerer, tick=tick, log=log, stimulus_until=protocol.answers.stimulus_until)
    from modaltouch.window.participant import ParticipantWindow
    from modaltouch.window.robot import Robot
    from modaltouch.window.theme import THEMES

    display = _open_screen(protocol.title, size=size, fullscreen=fullscreen, monitor=screen, theme=theme)
    try:
        return ParticipantWindow(
            display,
            protocol,
            texts,
            zones=zones,
            theme=THEMES[theme],
            tick=tick,
            log=log,
            screenshots=screenshots,
            robot=Robot(answerer, protocol.answers) if answers == "robot" and answerer is not None else None,
        )
    except BaseException:
        display.close()
        raise


def _open_screen(title: str, *, theme: str, **options: Any) -> Screen:
    """Return an open window, its ground that of the theme."""
    from modaltouch.window.screen import Screen
    from modaltouch.window.theme import THEMES

    if theme not in THEMES:
        raise ValueError(f"given the theme {theme!r}; allowed: {', '.join(THEMES)}")
    return Screen(title=title, ground=THEMES[theme].ground, **options)
