"""What the participant reads, examined without a window: every screen, and its smallest type."""

from __future__ import annotations

from modaltouch.protocol import Protocol, Texts, Trial
from modaltouch.window.buttons import typesetter_of
from modaltouch.window.interface import Progress
from modaltouch.window.layout import Spans, lay_out
from modaltouch.window.pictures import Illustrator
from modaltouch.window.shapes import Picture, Words
from modaltouch.window.theme import DARK

_CAPITAL = 0.714
"""Height of a capital of Noto Sans, which Noto's other fonts are designed to match [em]."""
_PAGES = ("practice", "start", "practice_again", "rest", "stalled", "hands_off", "measuring", "measure_again")
_LAST_PAGES = ("session_ended", "goodbye")


def every_picture(pictures: Illustrator, trial: Trial) -> list[Picture]:
    """Return each kind of screen that a session may show around one trial.

    Parameters
    ----------
    pictures : Illustrator
        Draws them.
    trial : Trial
        Which fingers lie where.
    """
    progress, texts = Progress(trial.index, max(trial.index, 99)), pictures.texts
    names = pictures.answers.offered.names
    chosen = names[0] if pictures.answers.scale is None else f"{pictures.answers.scale.at(0.5):g}"
    expected = [answer.name for answer in pictures.answers.offered if answer.fingers or answer.interval]
    return [
        pictures.welcome(trial),
        pictures.answering(trial),
        pictures.placement(trial),
        pictures.ready(trial, progress),
        pictures.ready(trial, progress, 3),
        pictures.feel(trial, progress),
        pictures.question(trial, progress),
        pictures.question(trial, progress, chosen=chosen, confirmed=False),
        *(pictures.feedback(trial, progress, given, name) for name in expected for given in names[:2]),
        *(pictures.page(name, str(getattr(texts, name)), progress) for name in _PAGES),
        *(pictures.page(name, str(getattr(texts, name)), waits=False) for name in _LAST_PAGES),
        pictures.pause(trial),
        pictures.pause(None),
    ]


def smallest_type(
    protocol: Protocol,
    texts: Texts,
    zones: Spans,
    trials: list[Trial],
    size: tuple[int, int],
) -> tuple[float, str]:
    """Return the height of a capital where the type is smallest [pixels], and the text that is set in it.

    Parameters
    ----------
    protocol, texts, zones
        What is asked, in which words, of fingers on which zones.
    trials : list of Trial
        One of each placement.
    size : (width, height) of int
        Size of the window [pixels].
    """
    design = protocol.conditions
    asked = [protocol.answers, *protocol.answers.further.values(), *protocol.closing.values()]
    pictures, *others = (
        Illustrator(lay_out(*size, zones, each.offered, each.scale), DARK, texts, each, design.hand, design.fingers)
        for each in asked
    )
    every = [picture for trial in trials for picture in every_picture(pictures, trial)]
    every += [picture.question(trials[0], Progress(1, 1)) for picture in others]
    words = {mark for picture in every for mark in picture.marks if isinstance(mark, Words)}
    set_type = typesetter_of(texts).set_type
    return min((_CAPITAL * set_type(mark, size[1]).size, mark.text) for mark in words)
