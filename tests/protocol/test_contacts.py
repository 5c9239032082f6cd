"""One to three fingers: which finger of which hand is on which zone; faults with positions."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from modaltouch.protocol import Findings, Source, Texts
from modaltouch.protocol.reading import read
from modaltouch.protocol.schedule import Schedule
from modaltouch.protocol.trial import AnswerList, Condition, Trial

Edit = Callable[..., Path]
SHIPPED = Path(__file__).parents[2] / "protocols"
FINGERS = "finger_conditions: [one_hand, two_hands]"
PAIRS = "zone_pairs: [[A, C], [B, D], [C, E]]"
KEYS = "    left: [left, num_4]\n    both: [up, down, num_8]\n    right: [right, num_6]\n"
THREE = (FINGERS, "finger_conditions: [three]\n  fingers: {three: [left index, right index, right middle]}")
ONE = (FINGERS, "finger_conditions: [tip]\n  fingers: {tip: [right index]}")
YES = (KEYS, "    none: [n]\n    left: [y]\n")
NAMED = (KEYS, "    left: [left]\n    both: [up]\n    right: [right]\n  fingers: {both: [left, right]}\n")


def faults(file: Path) -> list[str]:
    """Return the faults of a protocol and its files, with bare file names."""
    return [str(problem).replace(str(file.parent) + "/", "") for problem in Findings.read(file).problems]


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        (
            [(PAIRS, "zone_pairs: [[A, C]]\n  zones: [[A, C]]")],
            "demo.yaml:24:10: conditions.zones: given both zones and zone_pairs; allowed: one of the two",
        ),
        (
            [(PAIRS, "")],
            "conditions: given neither zones nor zone_pairs; allowed: one of the two; add `zone_pairs: [[A, C]]`",
        ),
        (
            [(PAIRS, "zone_pairs: [[A, C, E]]")],
            "conditions.zone_pairs[0]: given a list of 3; allowed: a list of exactly 2, each the name of a zone of the "
            "beam; for one finger or three, conditions.zones and conditions.fingers",
        ),
        (
            [(PAIRS, "zones: [[A, C], [C]]")],
            "conditions.zones[1]: given [C] for the two fingers of one_hand and two_hands; allowed: as many ",
        ),
        (
            [THREE],
            "conditions.zone_pairs[0]: given [A, C] for the three fingers of three; allowed: as many zones as fingers",
        ),
        (
            [(PAIRS, "zones: [[C, A, E]]"), THREE],
            "conditions.zones[0]: given [C, A, E], whose left zone C lies right of A; allowed: the left zone first; "
            "write [A, C, E]",
        ),
        (
            [(PAIRS, "zones: [[A, C, A]]"), THREE],
            "given [A, C, A], the same zone for several fingers; allowed: three different zones",
        ),
        (
            [(PAIRS, "zones: [[A, C, F]]"), THREE],
            "conditions.zones[0][2]: given 'F', which is not a zone of this beam; allowed: A, B, C, D, E",
        ),
        (
            [(FINGERS, f"{FINGERS}\n  fingers: {{two_hands: [left index, right index]}}")],
            "conditions.fingers.two_hands: given two_hands, a built-in condition; allowed: a new name",
        ),
        (
            [(FINGERS, f"{FINGERS}\n  fingers: {{own: [right middle, right index]}}")],
            "conditions.fingers.own: given [right middle, right index]; allowed: the fingers of a hand as they lie, "
            "palms down, from the left: right index, right middle; put them in that order",
        ),
        (
            [(FINGERS, f"{FINGERS}\n  fingers: {{own: [right index, right index]}}")],
            "conditions.fingers.own: given [right index, right index]; allowed: each finger once",
        ),
        (
            [(FINGERS, f"{FINGERS}\n  fingers: {{own: [right pinkie]}}")],
            "conditions.fingers.own[0]: given 'right pinkie'; allowed: left little, left ring",
        ),
        (
            [(KEYS, f"{KEYS}  ways: {{twohands: lifting}}\n")],
            "answers.ways.twohands: given 'twohands', which is not a finger condition here; allowed: one_hand, two",
        ),
        (
            [THREE, (PAIRS, "zones: [[A, C, E]]")],
            "answers: given no way to answer in three, but both hands are on the beam; allowed: lifting, foot_switch",
        ),
        (
            [ONE, (PAIRS, "zones: [[C]]"), YES],
            "answers.keys.left: given 'left' for the one finger of tip; allowed: answers that name no finger",
        ),
        (
            [ONE, (PAIRS, "zones: [[C]]"), (KEYS, "    felt: [y]\n    no: [n]\n  fingers: {felt: [left]}\n")],
            "answers.fingers.felt: given 'felt' for the one finger of tip; allowed: answers that name no finger, such "
            "as `yes` and `none`; there is only one finger; remove its entry under fingers",
        ),
        (
            [(KEYS, f"{KEYS}    middle: [m]\n  fingers: {{middle: [between]}}\n")],
            "answers.fingers.middle: given 'middle' for the two fingers of one_hand and two_hands; allowed: left",
        ),
        (
            [THREE, (PAIRS, "zones: [[A, C, E]]")],
            "answers.keys.left: given 'left' for the three fingers of three; allowed: an answer for each of the ",
        ),
        (
            [
                (FINGERS, "finger_conditions: [own]\n  fingers: {own: [right index, right ring]}"),
                ("english", "bare"),
            ],
            "conditions.finger_conditions: given no text `fingers.right ring` in bare.yaml, which this needs; allowed: "
            "a text there; add it",
        ),
        (
            [ONE, (PAIRS, "zones: [[C]]"), ("english", "bare")],
            "conditions.zones: given no text `place_each_finger` in bare.yaml, which this needs; allowed: a text there",
        ),
    ],
)
def test_faults_of_fingers_zones_and_answers_have_their_position(
    edit: Edit, changes: list[tuple[str, str]], fault: str
) -> None:
    """Lines and columns of the shipped demonstration."""
    file = edit("demo.yaml", *changes)
    english = (file.parent / "texts" / "english.yaml").read_text(encoding="utf-8")
    bare = re.sub(r"place_each_finger: .*\n|fingers:\n(  .*\n)+", "", english)
    (file.parent / "texts" / "bare.yaml").write_text(bare, encoding="utf-8")
    found = faults(file)
    assert any(fault in each for each in found), found


@pytest.mark.parametrize(
    ("language", "line"),
    [
        ("english", "Rest your right index finger on zone A"),
        ("german", "Rechter Zeigefinger auf Zone A"),
        ("french", "Index droit : zone A"),
        ("arabic", "ضع السبابة اليمنى على المنطقة A"),
        ("chinese", "请把右手食指放在 A 区"),
    ],
)
def test_a_line_that_begins_with_a_finger_begins_with_a_capital(language: str, line: str) -> None:
    """The name of a finger alone, as above its tip, does not."""
    texts = read(Source.load(SHIPPED / "texts" / f"{language}.yaml"), Texts).require()
    name = texts.finger("right index")
    assert name == name.lower() or language == "german"
    assert texts.placing((name, name, name), ("A", "A", "A")).replace("\u00a0", " ").split("\n") == [line] * 3


def test_a_misspelt_finger_of_an_answer_is_reported_once(edit: Edit) -> None:
    """Not also as a finger without an answer."""
    keys = "    a: [left]\n    b: [up]\n    c: [right]\n  ways: {three: lifting}\n"
    fingers = "  fingers: {a: [left], b: [center], c: [right]}\n"
    found = faults(edit("demo.yaml", THREE, (PAIRS, "zones: [[A, C, E]]"), (KEYS, keys + fingers)))
    (said,) = (each for each in found if "no text" not in each)
    assert "answers.fingers.b[0]: given 'center'; allowed: left, between, right" in said


def test_trials_have_one_zone_per_finger(edit: Edit) -> None:
    """A single finger has its zone on the left; a turned beam reverses three zones."""
    labels = (KEYS, "    yes: [y]\n    none: [n]\n  ways: {three: lifting}\n")
    file = edit("demo.yaml", ONE, (PAIRS, "placements: [mirrored]\n  zones: [[A], [C]]"), labels)
    one = Schedule.draw(Findings.read(file).protocol.value, "p01", 1)  # type: ignore[union-attr, arg-type]
    assert {trial.condition.zones for trial in one.trials} == {("A",), ("C",)}
    assert {trial.condition.zone_right for trial in one.trials} == {""}
    text = file.read_text(encoding="utf-8").replace("[tip]", "[three]").replace("tip:", "three:")
    text = text.replace("[right index]", "[left index, right index, right middle]")
    file.write_text(text.replace("[[A], [C]]", "[[A, C, E]]"), encoding="utf-8")
    three = Schedule.draw(Findings.read(file).protocol.value, "p01", 1)  # type: ignore[union-attr, arg-type]
    trial = three.trials[0]
    assert (trial.condition.zone_left, trial.condition.zone_between, trial.condition.zone_right) == ("E", "C", "A")
    assert Trial.from_dict(trial.as_dict()) == trial
    assert three.as_dict()["order"][0][2:5] == ["E", "C", "A"]


def test_records_of_two_fingers_are_unchanged() -> None:
    """They have no key for a third finger, so hashes stay the same."""
    values = Trial(1, 1, Condition("one_hand", "A", "C", 80.0)).as_dict()["condition"]
    assert values.keys() == {"finger_condition", "zone_left", "zone_right", "velocity_mm_s", "placement"}


@pytest.mark.parametrize(
    ("fingers", "swapped"),
    [
        (("right index",), ("left index",)),
        (("right index", "right middle", "right ring"), ("left ring", "left middle", "left index")),
        (("left index", "right index", "right middle"), ("right index", "right middle", "left index")),
    ],
)
def test_swapped_is_the_other_hand_or_crossed_hands(fingers: tuple[str, ...], swapped: tuple[str, ...]) -> None:
    """One hand is mirrored; of two hands, each keeps the order of its fingers."""
    zones = ("A", "C", "E")[: len(fingers)]
    assert Condition.on(zones, "own", 80.0).fingers("right", {"own": fingers}) == fingers
    assert Condition.on(zones, "own", 80.0, "swapped").fingers("right", {"own": fingers}) == swapped


@pytest.mark.parametrize(
    ("speeds", "answer"),
    [
        ((0.2, 0.1, 0.1), "L"),
        ((0.1, 0.2, 0.15), "M"),
        ((0.19, 0.2, 0.1), None),
        ((0.1, 0.1, 0.1), "all"),
        ((0.1,), None),
    ],
)
def test_practice_expects_the_finger_that_is_clearly_fastest(speeds: tuple[float, ...], answer: str | None) -> None:
    """A ratio of 1.25 to the next is clear (Craig 1972); within 1.1 all are equal."""
    fingers = {"L": ["left"], "M": ["between"], "R": ["right"], "all": ["left", "between", "right"]}
    answers = AnswerList.of({"keys": dict.fromkeys(fingers), "fingers": fingers})
    if len(speeds) == 1:
        answers = AnswerList.of({"keys": ("yes", "none")})
    else:
        assert not answers.compares
    assert answers.expected(*speeds) == answer
