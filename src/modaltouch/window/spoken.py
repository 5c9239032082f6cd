"""All that the screens of a protocol may say, found from the very pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from modaltouch.protocol import Protocol, Texts
from modaltouch.trial import ANSWERS, Condition, Trial
from modaltouch.window.interface import Progress
from modaltouch.window.layout import lay_out
from modaltouch.window.marks import Picture
from modaltouch.window.pictures import Illustrator
from modaltouch.window.theme import DARK

PAGES = ("practice", "practice_again", "start", "rest")
"""Pages of words that wait for the participant."""


def spoken_texts(protocol: Protocol, zones: Iterable[str], texts: Texts) -> tuple[str, ...]:
    """Return everything that can be said in a session, each once, in the order of a session.

    Parameters
    ----------
    protocol : Protocol
        Which screens are spoken, and what they show.
    zones : iterable of str
        Names of the beam's zones.
    texts : Texts
        The words.
    """
    if protocol.speech is None:
        return ()
    layout = lay_out(1280, 800, tuple(zones), offers_none=protocol.answers.offers_none)
    conditions = protocol.conditions
    illustrator = Illustrator(layout, DARK, texts, protocol.answers, conditions.hand, protocol.speech.screens)
    return tuple(dict.fromkeys(each.spoken for each in _pictures(illustrator, protocol, texts) if each.spoken))


def _seen(pair: tuple[str, str], placement: str) -> tuple[str, str]:
    """Return a pair of zones from the participant's left: a beam turned end to end has its last zone there."""
    return (pair[1], pair[0]) if placement.startswith("mirrored") else pair


def _pictures(draw: Illustrator, protocol: Protocol, texts: Texts) -> Iterator[Picture]:
    progress, conditions = Progress(1, 1), protocol.conditions
    trials = [
        Trial(1, 1, Condition(fingers, *_seen(pair, placement), 1.0, placement))
        for fingers in conditions.finger_conditions
        for pair in conditions.zone_pairs
        for placement in conditions.placements
    ]
    yield draw.welcome(trials[0])
    yield draw.answering(trials[0])
    for name in PAGES:
        yield draw.page(name, str(getattr(texts, name)))
    yield from (draw.placement(trial) for trial in trials)
    yield draw.question(trials[0], progress)
    for expected in ANSWERS:
        yield from (draw.feedback(trials[0], progress, answer, expected) for answer in ANSWERS)
    yield from (draw.pause(trial) for trial in (trials[0], None))
    yield draw.page("goodbye", texts.goodbye, waits=False)
