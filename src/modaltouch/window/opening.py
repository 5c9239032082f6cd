"""Options and opening of the answer window, for a person or a robot."""

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
    """Options of the answer window.

    Attributes
    ----------
    size : (width, height) of int
        Size of the window [pixels].
    fullscreen : bool
        Whether the window covers the monitor.
    theme : str
        ``dark`` or ``light``.
    screen : int
        Number of the monitor, from 0.
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
        """Return the options of a recorded window, with defaults for facts missing from older records.

        Parameters
        ----------
        window : mapping
            Facts of the window in the record's line `start` or `resume`.
        """
        from modaltouch.window.layout import THEMES

        usual, size = cls(), window.get("size_px")
        fullscreen, theme = bool(window.get("fullscreen", False)), window.get("theme")
        return cls(
            # The recorded size of a full screen is that of the monitor.
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
        """Open the window.

        Parameters
        ----------
        protocol, texts, zones, tick, log, clock
            As for `participant.ParticipantWindow`.
        answerer : Answerer, optional
            Observer that types into the window in place of a person.

        Raises
        ------
        WindowError
            If the window cannot be opened.
        """
        from modaltouch.window.controls import typesetter_of
        from modaltouch.window.display_loop import Robot
        from modaltouch.window.participant import ParticipantWindow

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
        from modaltouch.window.layout import THEMES
        from modaltouch.window.screen import Screen

        ground = THEMES[self.theme].ground
        return Screen(size=self.size, fullscreen=self.fullscreen, monitor=self.screen, ground=ground, **options)

    def measure_timing(self) -> tuple[dict[str, Any], str]:
        """Measure the timing of pictures and keys in the window (`machine.time_window`); takes some seconds.

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
        """Yield the problems of texts that are illegible in the window (`legibility.check_texts`).

        Parameters
        ----------
        findings : Findings
            The protocol's files.
        letters_only : bool
            Whether to check only for missing glyphs; the type size requires valid files.
        """
        from modaltouch.window.legibility import check_texts

        return check_texts(findings, None if self.fullscreen else self.size, letters_only=letters_only)
