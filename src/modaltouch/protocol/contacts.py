"""Checks between fingers, zones and answers: as many zones as fingers, and answers that match these fingers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, get_args

from modaltouch.protocol.adaptive import contacts, offered_answers
from modaltouch.protocol.conditions import FingerName
from modaltouch.protocol.problems import Problem
from modaltouch.protocol.reading import Reading
from modaltouch.protocol.trial import FINGERS, SIDES

if TYPE_CHECKING:
    from modaltouch.protocol.sections import Protocol

_SAID = {1: "one finger", 2: "two fingers", 3: "three fingers"}
_SHIPPED = tuple(dict.fromkeys(name for name, _ in FINGERS))
_FROM_LEFT: tuple[str, ...] = get_args(FingerName)


def check_contacts(reading: Reading[Protocol]) -> Iterator[Problem]:
    """Yield repeated zones, zones that do not match the fingers, and problems of finger conditions and answers."""
    yield from _check_zones(reading)
    known = {name: FINGERS[name, "right"] for name in _SHIPPED} | dict(reading.items("conditions", "fingers"))
    named = [*_SHIPPED, *(reading.keys("conditions", "fingers") or ())]
    for name in named[len(_SHIPPED) :]:
        yield from _check_fingers(reading, name)
    used: dict[str, int] = {}
    for index, name in reading.items("conditions", "finger_conditions"):
        if name not in named:
            yield reading.unknown(("conditions", "finger_conditions", index), "a finger condition here", named)
        elif name in known:
            used[name] = len(known[name])
    yield from _check_number(reading, used)
    for number in dict.fromkeys(used.values()):
        yield from _check_answers(reading, [name for name, own in used.items() if own == number], number)
    for name in used:
        if name not in _SHIPPED and len({finger.split()[0] for finger in known[name]}) == 2:
            yield from check_way(reading, name)
    yield from reading.unlisted(("answers", "ways"), "a finger condition here", named, at_key=True)


def _check_zones(reading: Reading[Protocol]) -> Iterator[Problem]:
    given = [key for key in ("zones", "zone_pairs") if reading.find(("conditions", key)) is not None]
    is_listed = any(reading.find(("conditions", key)) is not None for key in ("cells", "table"))
    if len(given) != 1 and not is_listed and reading.find(("conditions",)) is not None:
        said = "both zones and zone_pairs" if given else "neither zones nor zone_pairs"
        remedy = "remove one" if given else "add `zone_pairs: [[A, C]]`, or `zones` for one finger or three"
        yield reading.problem(("conditions", *given[:1]), said, "one of the two", remedy)
    seen: dict[tuple[str, frozenset[str]], int] = {}
    for path, listed in contacts(reading):
        zones, said, n = (path[1], frozenset(listed)), f"[{', '.join(listed)}]", len(listed)
        if len(zones[1]) < n:
            who = "both fingers" if n == 2 else "several fingers"
            yield reading.problem(path, f"{said}, the same zone for {who}", f"{_SAID[n].split()[0]} different zones")
        elif zones in seen and not is_listed:
            noun = "pair" if path[1] == "zone_pairs" else "zones"
            said += f", the same {noun} as {path[1]}[{seen[zones]}]"
            yield reading.problem(path, said, f"each {noun} once", "remove it; for more trials raise repetitions")
        seen.setdefault(zones, path[2])


def _check_fingers(reading: Reading[Protocol], name: str) -> Iterator[Problem]:
    """Yield a problem for a reserved name, a repeated finger, or fingers of a hand out of anatomical order."""
    path, fingers = ("conditions", "fingers", name), reading.sound("conditions", "fingers", name) or ()
    said = f"[{', '.join(fingers)}]"
    in_order = {hand: [each for each in _FROM_LEFT if each in fingers and each.startswith(hand)] for hand in ("l", "r")}
    if name in _SHIPPED:
        yield reading.problem(path, f"{name}, a built-in condition", "a new name", "choose another", at_key=True)
    elif len(set(fingers)) < len(fingers):
        yield reading.problem(path, said, "each finger once", "remove the second")
    elif any([each for each in fingers if each.startswith(hand)] != own for hand, own in in_order.items()):
        allowed = (
            f"the fingers of a hand as they lie, palms down, from the left: {', '.join(sum(in_order.values(), []))}"
        )
        yield reading.problem(path, said, allowed, "put them in that order")


def _check_number(reading: Reading[Protocol], used: dict[str, int]) -> Iterator[Problem]:
    """Yield zones whose number differs from that of the fingers of a finger condition."""
    own = [
        (("conditions", "cells", index, "pair"), each.pair, each.finger_conditions or used)
        for index, each in reading.items("conditions", "cells")
    ]
    # Each of several stimuli is checked as a crossed design, although the file lists cells.
    is_listed = reading.find(("conditions", "cells")) is not None
    for path, zones, names in own if is_listed else [(*each, used) for each in contacts(reading)]:
        for number in dict.fromkeys(used[name] for name in names if used.get(name, len(zones)) != len(zones)):
            like = " and ".join(name for name in names if used.get(name) == number)
            given = f"[{', '.join(zones)}] for the {_SAID[number]} of {like}"
            remedy = "change the number of zones, or of fingers under conditions.fingers"
            yield reading.problem(path, given, "as many zones as fingers", remedy)


def _check_answers(reading: Reading[Protocol], names: list[str], number: int) -> Iterator[Problem]:
    """Yield a problem for an answer that names an absent finger, or answers that name only some of three fingers."""
    offered = offered_answers(reading)
    if number == 1:
        odd = next((answer.name for answer in offered if answer.fingers), None)
        allowed, remedy = "answers that name no finger, such as `yes` and `none`", "there is only one finger"
    else:
        odd = next((answer.name for answer in offered if not set(answer.fingers or ()) <= set(SIDES[number])), None)
        allowed, remedy = "left, right or both of them", "leave `between` out"
        alone = [side for side in SIDES[3] if offered.naming(side) is not None]
        # An invalid side of a finger is reported at its own key.
        is_sound = len(reading.items("answers", "fingers")) == len(reading.keys("answers", "fingers") or ())
        if number == 3 and 0 < len(alone) < 3 and is_sound:
            odd = next(answer.name for answer in offered if answer.fingers)
            allowed, remedy = (
                "an answer for each of the three fingers",
                "name left, between and right under answers.fingers",
            )
    if odd is not None:
        at = ("answers", "fingers" if reading.find(("answers", "fingers", odd)) else "keys", odd)
        remedy += f"; remove its entry under {at[1]}" if number == 1 else ""
        given = f"'{odd}' for the {_SAID[number]} of {' and '.join(names)}"
        yield reading.problem(at, given, allowed, remedy, at_key=True)


def check_way(reading: Reading[Protocol], name: str) -> Iterator[Problem]:
    """Yield a problem if the way to answer needs a free hand while both hands are on the beam."""
    way, is_misspelt = reading.sound("answers", "ways", name), reading.is_misspelt("answers", "ways")
    if reading.sound("answers", "given_by") != "experimenter" and way in (None, "free_hand") and not is_misspelt:
        path = ("answers", "ways", name) if way else ("answers",)
        given = f"{way or 'no way to answer'} in {name}, but both hands are on the beam"
        allowed = "lifting, foot_switch or experimenter"
        yield reading.problem(path, given, allowed, f"write `ways: {{{name}: lifting}}` under answers")
