"""How the answer window is opened: for a person, or for a robot that types into it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from modaltouch.system import SYSTEM_CLOCK, Clock

if TYPE_CHECKING:
    from modaltouch.protocol import Findings, Problem, Protocol, Texts
    from modaltouch.window.interface import AnswerWindow, Log, Tick
    from modaltouch.window.layout import Spans
    from modaltouch.window.screen import Screen
    from modaltouch.window.simulated import Answerer


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

    def open(
        self,
        protocol: Protocol,
        texts: Texts,
        *,
        zones: Spans,
        tick: Tick,
        log: Log,
        answerer: Answerer | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> AnswerWindow:
        """Return the open window.

        Parameters
        ----------
        protocol, texts, zones, tick, log, clock
            As for `participant.ParticipantWindow`.
        answerer : Answerer, optional
            The observer that types into the window in place of a person.

        Raises
        ------
        WindowError
            If the window cannot be opened.
        """
        from modaltouch.window.buttons import typesetter_of
        from modaltouch.window.participant import ParticipantWindow
        from modaltouch.window.robot import Robot

        robot = None if answerer is None else Robot(answerer, protocol, texts=texts)
        display = self._screen(title=protocol.title, typesetter=typesetter_of(texts), clock=clock)
        try:
            return ParticipantWindow(
                display, protocol, texts, zones=zones, theme=self.theme, tick=tick, log=log,
                screenshots=self.screenshots, robot=robot, clock=clock,
            )  # fmt: skip
        except BaseException:
            display.close()
            raise

    def _screen(self, **options: Any) -> Screen:
        from modaltouch.window.screen import Screen
        from modaltouch.window.theme import THEMES

        ground = THEMES[self.theme].ground
        return Screen(size=self.size, fullscreen=self.fullscreen, monitor=self.screen, ground=ground, **options)

    def measure_timing(self) -> tuple[dict[str, Any], str]:
        """Return how accurately the window times pictures and keys (`machine.time_window`); takes some seconds.

        Raises
        ------
        WindowError
            If no window can be opened.
        """
        from modaltouch.window.environment import some_display
        from modaltouch.window.machine import time_window

        with some_display() as display, closing(self._screen(title="modaltouch doctor")) as screen:
            return time_window(screen, display=display)

    def check_texts(self, findings: Findings, *, letters_only: bool = False) -> Iterator[Problem]:
        """Yield what the participant cannot read in the window (`legibility.check_texts`).

        Parameters
        ----------
        findings : Findings
            The protocol's files.
        letters_only : bool
            Whether only to look for letters that no font has: type is measured only on sound files.
        """
        from modaltouch.window.legibility import check_texts

        return check_texts(findings, None if self.fullscreen else self.size, letters_only=letters_only)
