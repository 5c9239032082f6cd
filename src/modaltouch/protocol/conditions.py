"""The sections ``conditions`` and ``adaptive`` of a protocol: fingers, zones, and levels given or found."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal, get_args

from pydantic import ConfigDict, Field

from modaltouch.protocol.reading import Reading
from modaltouch.protocol.section import Count, FileName, Positive, Section, Text, Word, described
from modaltouch.protocol.source import Problem, suggest
from modaltouch.protocol.stimulus_sections import ZoneName
from modaltouch.protocol.trial import FINGERS, SIDES, AnswerList, Condition

FingerCondition = Annotated[Word, Field(json_schema_extra={"x-allowed": "one_hand, two_hands or a name of your own"})]
FingerName = Literal[
    "left little", "left ring", "left middle", "left index", "left thumb",
    "right thumb", "right index", "right middle", "right ring", "right little",
]  # fmt: skip
"""Fingers from left to right, palms down."""
Placement = Literal["normal", "mirrored", "swapped", "mirrored_swapped"]

_UNIQUE = {"uniqueItems": True}

Cell = tuple[tuple[str, ...], float, str]
"""The zones under the fingers, a peak velocity [mm/s], and the name of a stimulus."""

_TWO = (
    "a list of exactly 2, each the name of a zone of the beam; for one finger or three, conditions.zones and "
    "conditions.fingers"
)
ZonePair = Annotated[tuple[ZoneName, ZoneName], Field(json_schema_extra={"x-allowed": _TWO})]
Contacts = Annotated[tuple[ZoneName, ...], Field(min_length=1, max_length=3)]
Decibels = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=40)]
GuessRate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=0.6)]
LapseRate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=0.2)]
Multiple = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1000)]


class StaircaseSection(Section):
    """Weighted, transformed up-down staircase: down after a number of consecutive successes, up after each failure."""

    down_after: Annotated[Count, Field(le=6)] = described(
        "Number of successes in a row that lowers the level; each failure raises it.", default=1
    )
    steps_dB: tuple[Decibels, ...] = described(  # noqa: N815
        "Sizes of the steps down: the next size after each reversal, the last one for the rest of the run [dB, 20 per "
        "decade].",
        default=(8.0, 4.0, 2.0),
        min_length=1,
        max_length=20,
    )
    up_over_down: Annotated[float, Field(strict=True, gt=0, le=10)] = described(
        "Size of a step up relative to a step down.", default=1.0
    )

    @property
    def target(self) -> float:
        """Probability of success to which the staircase converges [1].

        At this p the expected steps down and up balance: p^n / (1 - p^n) = up / down (Kaernbach, Perception &
        Psychophysics 49 (1991) 227-229, for n = 1; Levitt, J. Acoust. Soc. Am. 49 (1971) 467-477, for equal steps).
        """
        return float((self.up_over_down / (1 + self.up_over_down)) ** (1 / self.down_after))


class AdaptiveSection(Section):
    """An adaptive run of the level for each finger condition, pair of zones and stimulus, instead of fixed levels."""

    method: Literal["staircase", "quest_plus"] = described(
        "staircase: up and down according to the latest answers; quest_plus: the level expected to be most "
        "informative.",
        default="quest_plus",
    )
    trials: Annotated[int, Field(strict=True, ge=8, le=1000)] = described(
        "Trials in each run; there is one run for each finger condition, pair and stimulus.", default=40
    )
    start_mm_s: Positive = described("Level of the first trial of each run [mm/s].")
    success: Literal["focus_named", "felt", "correct"] | Word = described(
        "Which answers count as success: focus_named, only the finger on the focus; felt, any but none; correct, the "
        "right one if a trial has several intervals; or the name of one answer, such as stronger.",
        default="focus_named",
    )
    guess_rate: GuessRate = described(
        "Share of successes where nothing is felt [1]; fitted instead if there are catch trials.", default=0.0
    )
    lapse_rate: LapseRate = described(
        "Share of failures where everything is felt: the value that quest_plus assumes, and the largest that a fit may "
        "find [1].",
        default=0.06,
    )
    staircase: StaircaseSection = described("Rule of the staircase.", default=StaircaseSection())

    @property
    def algorithm(self) -> dict[str, Any]:
        """Algorithm that sets the levels, as written to the record."""
        if self.method == "staircase":
            return {"algorithm": "modaltouch staircase 2", "target": round(self.staircase.target, 4)}
        from importlib.metadata import version

        return {"algorithm": "modaltouch quest_plus 2", "questplus": version("questplus")}


class SensationLevelsSection(Section):
    """Levels as multiples of the participant's threshold: sensation levels, as ratios rather than in dB."""

    thresholds_from: FileName = described(
        "Name of the adaptive protocol whose latest complete session gives the participant's threshold: the geometric "
        "mean over its runs."
    )
    multiples: tuple[Multiple, ...] = described(
        "Levels as multiples of that threshold [1].",
        min_length=1,
        max_length=100,
        json_schema_extra={"uniqueItems": True},
    )

    def levels(self, threshold_mm_s: float) -> tuple[float, ...]:
        """Return the levels of a participant [mm/s], to four digits, the resolution of the generator's amplitude."""
        return tuple(float(f"{multiple * threshold_mm_s:.4g}") for multiple in self.multiples)

    def thresholds(self, lowest_mm_s: float, highest_mm_s: float) -> tuple[float, float]:
        """Return the lowest and highest thresholds for which all levels lie within bounds [mm/s]."""
        return lowest_mm_s / min(self.multiples), highest_mm_s / max(self.multiples)


class CellsSection(Section):
    """Cells of an uncrossed design: one pair of zones at one or more levels."""

    pair: Contacts = described(
        "Zones under the fingers, from left to right as the participant sees the beam: usually two; one or three for "
        "finger conditions with that many fingers."
    )
    peak_velocities_mm_s: Annotated[tuple[Positive, ...], Field(min_length=1)] = described(
        "Peak velocities of this pair at the centre of the focus zone at the focusing instant [mm/s]."
    )
    finger_conditions: tuple[Word, ...] = described(
        "Finger conditions that contain these cells; all if omitted.", default=()
    )
    stimuli: tuple[Word, ...] = described("Names of the stimuli presented in these cells; all if omitted.", default=())
    weight: Annotated[Count, Field(le=10_000)] = described(
        "Number of trials of each of these cells per repetition (schedule.repetitions), such as 2 for twice as many.",
        default=1,
    )


class ExcludedCells(Section):
    """Cells excluded from the crossed design: those that match all given keys."""

    pair: Contacts | None = described("Zones as in zone_pairs or zones; null for any.", default=None)
    peak_velocity_mm_s: Positive | None = described("Peak velocity [mm/s]; null for any.", default=None)
    finger_condition: Word | None = described("Finger condition; null for any.", default=None)
    stimulus: Word | None = described("Name of a stimulus; null for any.", default=None)

    def holds(self, finger_condition: str, cell: Cell) -> bool:
        """Test whether a cell of a finger condition is excluded."""
        wanted = (self.finger_condition, self.pair, self.peak_velocity_mm_s, self.stimulus)
        return all(want in (None, own) for want, own in zip(wanted, (finger_condition, *cell), strict=True))


class ConditionsSection(Section):
    """The cells of the design: every finger condition with every pair and peak velocity, or the cells listed."""

    model_config = ConfigDict(
        json_schema_extra={
            "required": [],
            "allOf": [{"anyOf": [{"required": [key]} for key in ("zone_pairs", "zones", "cells", "table")]}],
        }
    )

    finger_conditions: tuple[FingerCondition, ...] = described(
        "one_hand: index and middle finger of one hand; two_hands: both index fingers; or names defined under fingers.",
        min_length=1,
        json_schema_extra=_UNIQUE,
    )
    fingers: dict[FingerCondition, Annotated[tuple[FingerName, ...], Field(min_length=1, max_length=3)]] = described(
        "Your own finger conditions: a name, and one to three fingers from left to right as the participant sees "
        "them, palms down, such as `three_fingers: [left index, right index, right middle]`.",
        default={},
        exclude_if=lambda given: not given,
    )
    hand: Literal["right", "left"] = described("The hand used in one_hand.", default="right")
    placements: tuple[Placement, ...] = described(
        "Placements that alternate between participants, so that effects of zone, side and finger can be separated: "
        "normal; mirrored, with the beam turned end to end; swapped, with the other hand, or with crossed hands if "
        "both are on the beam as in two_hands; or both.",
        default=("normal",),
        min_length=1,
        json_schema_extra=_UNIQUE,
    )
    zone_pairs: tuple[ZonePair, ...] = described(
        "Zones under the two fingers, left and right as the participant sees the beam. For one finger or three, give "
        "zones instead.",
        default=(),
        min_length=1,
        max_length=100,
        json_schema_extra=_UNIQUE,
        exclude_if=lambda given: not given,
    )
    zones: tuple[Contacts, ...] = described(
        "Zones under one to three fingers, from left to right as the participant sees the beam, in place of "
        "zone_pairs: [[C], [E]] for one finger, [[A, C, E]] for three. To use a place that is not a zone yet, define "
        "it in the apparatus file (centre_mm, width_mm).",
        default=(),
        min_length=1,
        max_length=100,
        json_schema_extra=_UNIQUE,
        exclude_if=lambda given: not given,
    )
    peak_velocities_mm_s: tuple[Positive, ...] = described(
        "Peak velocities at the centre of the focus zone at the focusing instant [mm/s].",
        min_length=1,
        max_length=100,
        json_schema_extra=_UNIQUE,
    )
    cells: Annotated[tuple[CellsSection, ...], Field(max_length=10_000)] = described(
        "The cells one by one, in place of zone_pairs and peak_velocities_mm_s, for a design that is not crossed: "
        "levels of each pair, weights (as of a cell that is listed more than once), an order of your own "
        "(schedule.order: as_listed), such as "
        "{pair: [A, C], peak_velocities_mm_s: [80, 100], weight: 2}.",
        default=(),
        exclude_if=lambda given: not given,
    )
    table: Text | None = described(
        "CSV file with the cells, relative to this file, in place of zone_pairs and peak_velocities_mm_s: one line per "
        "cell or trial, with the columns zone_left, zone_right (empty for one finger), peak_velocity_mm_s and, where "
        "needed, zone_between, finger_condition, stimulus and weight (as under cells). Null for none.",
        default=None,
        exclude_if=lambda given: given is None,
    )
    exclude: tuple[ExcludedCells, ...] = described(
        "Cells left out of the design, such as {pair: [A, C], peak_velocity_mm_s: 80}: all cells that match every key "
        "given.",
        default=(),
        exclude_if=lambda given: not given,
    )
    sensation_levels: SensationLevelsSection | None = described(
        "Levels calibrated for each participant, as multiples of their own threshold; the peak velocities are then the "
        "lowest and the highest level that anyone may receive. Null for the same levels for all.",
        default=None,
    )

    @property
    def contacts(self) -> tuple[tuple[str, ...], ...]:
        """Zones under the fingers, from left to right: those of `zones`, or of `zone_pairs`."""
        return self.zones or self.zone_pairs

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The entries of `contacts` with two zones."""
        return tuple((zones[0], zones[1]) for zones in self.contacts if len(zones) == 2)

    def fingers_of(self, condition: Condition) -> tuple[str, ...]:
        """Return the fingers on the zones of a condition, from left to right."""
        return condition.fingers(self.hand, self.fingers)

    @property
    def fingers_used(self) -> list[str]:
        """All fingers that rest on the beam in any condition."""
        laid = (Condition(name, "", "", 0.0, place) for name in self.finger_conditions for place in self.placements)
        return sorted({finger for each in laid for finger in self.fingers_of(each)})


_NUMBERS_OF_FINGERS = {1: "one finger", 2: "two fingers", 3: "three fingers"}
_SHIPPED = tuple(dict.fromkeys(name for name, _ in FINGERS))
_FROM_LEFT: tuple[str, ...] = get_args(FingerName)


def check_contacts(reading: Reading[Any]) -> Iterator[Problem]:
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
    # A name misspelt under `ways` is reported there.
    misspelt = {suggest(key, named) for key in reading.keys("answers", "ways") or () if key not in named}
    for name in used.keys() - misspelt:
        if name not in _SHIPPED and len({finger.split()[0] for finger in known[name]}) == 2:
            yield from check_way(reading, name)
    yield from reading.unlisted(("answers", "ways"), "a finger condition here", named, at_key=True)


def _check_zones(reading: Reading[Any]) -> Iterator[Problem]:
    given = [key for key in ("zones", "zone_pairs") if reading.find(("conditions", key)) is not None]
    is_listed = any(reading.find(("conditions", key)) is not None for key in ("cells", "table"))
    is_absent = not given and not reading.has_unknown_key("conditions")
    if (is_absent or len(given) == 2) and not is_listed and reading.find(("conditions",)) is not None:
        what = "both zones and zone_pairs" if given else "neither zones nor zone_pairs"
        yield reading.problem(
            ("conditions", *given[:1]),
            what,
            "one of the two",
            "remove one" if given else "add `zone_pairs: [[A, C]]`, or `zones` for one finger or three",
        )
    seen: dict[tuple[str, frozenset[str]], int] = {}
    for path, listed in contacts(reading):
        zones, what, n = (path[1], frozenset(listed)), f"[{', '.join(listed)}]", len(listed)
        if len(zones[1]) < n:
            who = "both fingers" if n == 2 else "several fingers"
            yield reading.problem(
                path, f"{what}, the same zone for {who}", f"{_NUMBERS_OF_FINGERS[n].split()[0]} different zones"
            )
        elif zones in seen and not is_listed:
            noun = "pair" if path[1] == "zone_pairs" else "zones"
            what += f", the same {noun} as {path[1]}[{seen[zones]}]"
            yield reading.problem(path, what, f"each {noun} once", "remove it; for more trials raise repetitions")
        seen.setdefault(zones, path[2])


def _check_fingers(reading: Reading[Any], name: str) -> Iterator[Problem]:
    """Yield a problem for a reserved name, a repeated finger, or fingers of a hand out of anatomical order."""
    path, fingers = ("conditions", "fingers", name), reading.sound("conditions", "fingers", name) or ()
    listed = f"[{', '.join(fingers)}]"
    in_order = {hand: [each for each in _FROM_LEFT if each in fingers and each.startswith(hand)] for hand in ("l", "r")}
    if name in _SHIPPED:
        yield reading.problem(path, f"{name}, a built-in condition", "a new name", "choose another", at_key=True)
    elif len(set(fingers)) < len(fingers):
        yield reading.problem(path, listed, "each finger once", "remove the second")
    elif any([each for each in fingers if each.startswith(hand)] != own for hand, own in in_order.items()):
        yield reading.problem(
            path,
            listed,
            f"the fingers of a hand as they lie, palms down, from the left: {', '.join(sum(in_order.values(), []))}",
            "put them in that order",
        )


def _check_number(reading: Reading[Any], used: dict[str, int]) -> Iterator[Problem]:
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
            yield reading.problem(
                path,
                f"[{', '.join(zones)}] for the {_NUMBERS_OF_FINGERS[number]} of {like}",
                "as many zones as fingers",
                "change the number of zones, or of fingers under conditions.fingers",
            )


def _check_answers(reading: Reading[Any], names: list[str], number: int) -> Iterator[Problem]:
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
        yield reading.problem(
            at, f"'{odd}' for the {_NUMBERS_OF_FINGERS[number]} of {' and '.join(names)}", allowed, remedy, at_key=True
        )


def check_way(reading: Reading[Any], name: str) -> Iterator[Problem]:
    """Yield a problem if the way to answer needs a free hand while both hands are on the beam."""
    way = reading.sound("answers", "ways", name)
    is_free = way == "free_hand" or (way is None and not reading.has_unknown_key("answers"))
    if reading.sound("answers", "given_by") != "experimenter" and is_free:
        path = ("answers", "ways", name) if way else ("answers",)
        yield reading.problem(
            path,
            f"{way or 'no way to answer'} in {name}, but both hands are on the beam",
            "lifting, foot_switch or experimenter",
            f"write `ways: {{{name}: lifting}}` under answers",
        )


def is_adaptive(reading: Reading[Any]) -> bool:
    """Test whether a protocol has a section ``adaptive``, valid or not."""
    return reading.keys("adaptive") is not None


def contacts(reading: Reading[Any]) -> list[tuple[tuple[str, str, int], tuple[str, ...]]]:
    """Return the zones under the fingers with their paths, from the key that lists them."""
    return [
        (("conditions", key, index), zones)
        for key in ("zones", "zone_pairs")
        for index, zones in reading.items("conditions", key)
    ]


def offered_answers(reading: Reading[Any]) -> AnswerList:
    """Return the answers that a protocol offers, from its valid parts."""
    section = {
        "keys": reading.keys("answers", "keys"),
        "scale": reading.keys("answers", "scale"),
        "below": [name for _, name in reading.items("answers", "below")],
        "fingers": dict(reading.items("answers", "fingers")),
        "intervals": dict(reading.items("answers", "intervals")),
    }
    return AnswerList.of(section)
