"""By which keys of a terminal the experimenter types a participant's answer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from modaltouch.console.dialogue import OWN_KEYS
from modaltouch.window.events import canonical_key

_ORDER = ("left", "both", "right", "none")
"""Answers as they stand on the screen, which numbers them from 1."""


def typed_keys(keys: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    """Return the keys of each answer at a console, those of the protocol first.

    The console's own keys keep their meaning at every moment, so an answer never has one of them. A terminal sends the
    keypad's digits as any others. Each answer also has the number of its place on the screen, unless that is a key of
    another answer; one that would be left without a key has the first free digit.

    Examples
    --------
    >>> typed_keys({"left": ["left", "num_4"], "both": ["n"], "right": ["right", "2"]})
    {'left': ['left', '4', '1'], 'both': ['5'], 'right': ['right', '2', '3']}
    """
    answers = [answer for answer in _ORDER if answer in keys]
    taken: dict[str, str] = {}
    for answer in answers:
        for name in map(canonical_key, keys[answer]):
            if name not in OWN_KEYS and not name.startswith("num_"):
                taken.setdefault(name, answer)
    for answer in answers:
        for name in map(canonical_key, keys[answer]):
            if name[:4] == "num_" and name[4:].isdecimal():
                taken.setdefault(name[4:], answer)
    for place, answer in enumerate(answers, start=1):
        taken.setdefault(str(place), answer)
    for answer in answers:
        if answer not in taken.values():
            taken[next(digit for digit in "123456789" if digit not in taken)] = answer
    return {answer: [key for key, whose in taken.items() if whose == answer] for answer in answers}
