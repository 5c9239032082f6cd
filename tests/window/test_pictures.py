"""Contents of each screen, read from the pictures as data."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from modaltouch.protocol import AnswerList, Experiment, Texts
from modaltouch.protocol.trial import FINGERS, Condition, Trial
from modaltouch.window.layout import DARK, Mark, Picture, Shape, Theme, Words, lay_out
from modaltouch.window.pictures import Illustrator, draw_hands
from modaltouch.window.typesetting import Typesetter

PROGRESS = (5, 12)
CASES = list(itertools.product(["AC", "BD", "CE", "AB", "DE"], FINGERS))


def make_trial(pair: str = "AC", finger_condition: str = "one_hand", velocity: float = 100.0, **kwargs: Any) -> Trial:
    """Return a trial on a pair of zones."""
    return Trial(5, 1, Condition(finger_condition, pair[0], pair[1], velocity), **kwargs)


def illustrate(experiment: Experiment, hand: str = "right", **changes: Any) -> Illustrator:
    """Return the pictures of the demonstration in a window of 1280 x 800 pixels."""
    answers = experiment.protocol.answers.model_copy(update=changes)
    layout = lay_out(1280, 800, experiment.apparatus.zone_spans, AnswerList.of({}))
    return Illustrator(layout, DARK, experiment.texts, answers, hand)


def find_words(picture: Picture, text: str) -> Words:
    """Return the only text of a picture with these words."""
    (found,) = [mark for mark in picture.marks if isinstance(mark, Words) and mark.text == text]
    return found


def tips(marks: tuple[Mark, ...], theme: Theme) -> dict[str, tuple[float, float]]:
    """Return the position of the fingertip of each colour: the highest point, and the centre of the finger."""
    ends = {}
    for side, colour in (("left", theme.left), ("right", theme.right)):
        (finger,) = [mark for mark in marks if isinstance(mark, Shape) and mark.fill == colour]
        highest = max(y for _, y in finger.corners)
        top = [x for x, y in finger.corners if y > highest - 0.012]
        ends[side] = ((min(top) + max(top)) / 2, highest)
    return ends


def test_names_of_fingers_at_both_ends_have_their_full_size(experiment: Experiment) -> None:
    """At 800 x 600, within the window; they once had three quarters of it, though nothing was in their way."""
    layout = lay_out(800, 600, experiment.apparatus.zone_spans, AnswerList.of({}))
    names = ("left index finger", "right index finger")
    marks = draw_hands(layout, DARK, ("A", "E"), ("left index", "right index"), names, Typesetter())
    for mark in marks[-2:]:
        assert isinstance(mark, Words)
        assert mark.size == pytest.approx(0.031 * layout.type_scale)
        assert Typesetter().set_type(mark, 600).share == 1
        assert abs(mark.box.x) + mark.box.width / 2 <= layout.width / 2


@pytest.mark.parametrize(("pair", "condition"), CASES)
def test_each_finger_lies_on_its_zone(experiment: Experiment, pair: str, condition: tuple[str, str]) -> None:
    """The left colour's tip is in the left zone and the right colour's in the right zone."""
    finger_condition, hand = condition
    pictures = illustrate(experiment, hand)
    trial = make_trial(pair, finger_condition)
    layout = pictures.layout
    marks = draw_hands(layout, DARK, trial.condition.zones, FINGERS[condition], ("one", "other"), Typesetter())
    for side, zone in zip(("left", "right"), pair, strict=True):
        x, y = tips(marks, DARK)[side]
        assert layout.zones[zone].contains(x, y)


@pytest.mark.parametrize(
    ("fingers", "zones"),
    [
        (("right index",), "C"),
        (("left thumb",), "A"),
        (("right index", "right middle", "right ring"), "ABC"),
        (("right index", "right middle", "right little"), "ABE"),
        (("left index", "left thumb", "right little"), "ADE"),
        (("left index", "right index", "right middle"), "CDE"),
    ],
)
def test_one_finger_and_three_lie_on_their_zones_under_their_names(
    experiment: Experiment, fingers: tuple[str, ...], zones: str
) -> None:
    """By colour, each tip is in its zone below its name, and each finger starts at its palm."""
    pictures = replace(illustrate(experiment), fingers={"own": fingers})
    trial = Trial(5, 1, Condition.on(tuple(zones), "own", 100.0))
    picture = pictures.feel(trial, PROGRESS)
    colours = {1: (DARK.left,), 3: (DARK.left, DARK.between, DARK.right)}[len(zones)]
    palms = [mark for mark in picture.marks if isinstance(mark, Shape) and mark.fill == DARK.hand]
    for finger, zone, colour in zip(fingers, zones, colours, strict=True):
        (tip,) = (
            mark for mark in picture.marks if isinstance(mark, Shape) and mark.fill == colour and len(mark.corners) > 3
        )
        highest = max(tip.corners, key=lambda corner: corner[1])
        assert pictures.layout.zones[zone].contains(*highest)
        assert find_words(picture, experiment.texts.finger(finger)).fill == colour
        x, y = min(tip.corners, key=lambda corner: corner[1])
        assert any(min(a for a, _ in p.corners) <= x <= max(a for a, _ in p.corners) for p in palms)
    words = pictures.placement(trial).texts
    assert any(all(experiment.texts.finger(finger) in text for finger in fingers) for text in words)


@pytest.mark.parametrize("size", [(800, 600), (1280, 800), (1920, 1080)])
@pytest.mark.parametrize("language", ["arabic", "chinese", "english", "french", "german"])
@pytest.mark.parametrize(
    ("fingers", "zones"),
    [
        (("right index", "right middle"), "BC"),
        (("left index", "right index"), "DE"),
        (("right index", "right middle", "right ring"), "CDE"),
        (("left little", "left ring", "left middle"), "ABC"),
    ],
)
def test_names_of_neighbouring_fingers_are_legible(
    experiment: Experiment, fingers: tuple[str, ...], zones: str, language: str, size: tuple[int, int]
) -> None:
    """Apart, in order and within the window; at 800 x 600 three long names shrink by at most a seventh."""
    texts = Texts.model_validate(YAML(typ="safe").load(Path(f"protocols/texts/{language}.yaml")))
    layout = lay_out(*size, experiment.apparatus.zone_spans, AnswerList.of({}))
    typesetter, names = Typesetter(texts.font), tuple(map(texts.finger, fingers))
    marks = draw_hands(layout, DARK, tuple(zones), fingers, names, typesetter)
    words = [mark for mark in marks if isinstance(mark, Words)]
    assert [word.text for word in words] == list(names)
    widths = [typesetter.measure(word.text, bold=True) * word.size for word in words]
    lefts, rights = (
        [word.box.x + sign * width / 2 for word, width in zip(words, widths, strict=True)] for sign in (-1, 1)
    )
    assert all(before < after for before, after in zip(rights, lefts[1:], strict=False))
    assert -layout.width / 2 < lefts[0] and rights[-1] < layout.width / 2
    assert words[0].size >= 0.85 * 0.031 * layout.type_scale


@pytest.mark.parametrize("condition", FINGERS)
def test_the_finger_named_above_a_zone_is_the_one_recorded(experiment: Experiment, condition: tuple[str, str]) -> None:
    """The names are those of trial.FINGERS, which the record uses, in the words of the English texts."""
    finger_condition, hand = condition
    pictures = illustrate(experiment, hand)
    picture = pictures.question(make_trial("BD", finger_condition), PROGRESS)
    for finger, zone, colour in zip(FINGERS[condition], "BD", (DARK.left, DARK.right), strict=True):
        named = find_words(picture, f"{finger} finger")
        assert named.box.x == pytest.approx(pictures.layout.zones[zone].x)
        assert named.fill == colour


@pytest.mark.parametrize(("finger_condition", "n_hands"), [("one_hand", 1), ("two_hands", 2)])
def test_as_many_hands_are_drawn_as_touch_the_beam(experiment: Experiment, finger_condition: str, n_hands: int) -> None:
    """One palm per hand; thumb, palm and resting fingers have one colour."""
    marks = illustrate(experiment).feel(make_trial("AC", finger_condition), PROGRESS).marks
    n_parts = sum(isinstance(mark, Shape) and mark.fill == DARK.hand for mark in marks)
    # A palm, a thumb, and the fingers that do not touch: two of them, or three on each of two hands.
    assert n_parts == {1: 1 + 1 + 2, 2: 2 * (1 + 1 + 3)}[n_hands]


@pytest.mark.parametrize(("hand", "side"), [("right", -1), ("left", 1)])
def test_the_thumb_is_on_the_inner_side(experiment: Experiment, hand: str, side: int) -> None:
    """Palm down, a right hand's thumb is left of its index finger, a left hand's right of it."""
    marks = illustrate(experiment, hand).feel(make_trial("BD"), PROGRESS).marks
    parts = [mark for mark in marks if isinstance(mark, Shape) and mark.fill == DARK.hand]
    thumb = max(parts, key=lambda part: side * sum(x for x, _ in part.corners) / len(part.corners))
    fingers = [mark for mark in marks if isinstance(mark, Shape) and mark.fill in (DARK.left, DARK.right)]
    lowest = [min(finger.corners, key=lambda corner: corner[1])[0] for finger in fingers]
    middle = sum(x for x, _ in thumb.corners) / len(thumb.corners)
    assert all(side * middle > side * x for x in lowest)


@pytest.mark.parametrize("screen", ["feel", "question", "placement", "ready"])
def test_pictures_do_not_depend_on_the_level(experiment: Experiment, screen: str) -> None:
    """The picture is the same for 80 and 200 mm/s on the same zones."""
    pictures = illustrate(experiment)
    quiet, loud = (make_trial("AC", velocity=velocity) for velocity in (80.0, 200.0))
    draw = getattr(pictures, screen)
    if screen == "placement":
        assert draw(quiet) == draw(loud)
    else:
        assert draw(quiet, PROGRESS) == draw(loud, PROGRESS)


def test_both_touched_zones_look_the_same(experiment: Experiment) -> None:
    """Shifted onto each other, the marks of the two zones are equal."""
    pictures = illustrate(experiment)
    marks = pictures.feel(make_trial("AC"), PROGRESS).marks
    frames = [mark for mark in marks if isinstance(mark, Shape) and mark.fill == DARK.zone]
    first, second = sorted(frames, key=lambda frame: frame.corners[0][0])
    shift = pictures.layout.zones["C"].x - pictures.layout.zones["A"].x
    np.testing.assert_allclose(first.corners, np.array(second.corners) - (shift, 0), atol=1e-12)


def test_the_question_shows_words_keys_and_progress(experiment: Experiment) -> None:
    """The texts of english.yaml, and one triangle for each arrow key."""
    picture = illustrate(experiment).question(make_trial(), PROGRESS)
    texts = experiment.texts
    assert {texts.question, texts.left, texts.both, texts.right, "5 of 12"} <= set(picture.texts)
    triangles = [mark for mark in picture.marks if isinstance(mark, Shape) and len(mark.corners) == 3]
    # Beside the words: one, two and one; on the keys: left, up, down and right.
    assert len(triangles) == 8


def test_keys_without_an_arrow_are_labelled(experiment: Experiment) -> None:
    """A foot switch that types 1, 2 and 3 has these digits on the buttons."""
    pictures = illustrate(experiment, keys={"left": ("1",), "both": ("2",), "right": ("3", "num_3", "c")})
    texts = pictures.question(make_trial(), PROGRESS).texts
    assert [text for text in texts if text in ("1", "2", "3")] == ["1", "2", "3"], "a digit of the keypad looks alike"


@pytest.mark.parametrize("n_answers", [2, 3, 4, 5, 6, 7])
def test_the_arrow_of_a_finger_lies_within_the_frame_of_its_button(experiment: Experiment, n_answers: int) -> None:
    """For two to seven buttons whose outer ones name a finger."""
    names = [f"answer_{number}" for number in range(n_answers)]
    keys = {name: (f"f{number}",) for number, name in enumerate(names, 1)}
    changes = {"keys": keys, "fingers": {names[0]: ("left",), names[-1]: ("right",)}}
    answers = experiment.protocol.answers.model_copy(update=changes)
    texts = experiment.texts.model_copy(update={"answers": dict.fromkeys(names, "Word")})
    layout = lay_out(800, 600, experiment.apparatus.zone_spans, answers.offered)
    marks = Illustrator(layout, DARK, texts, answers, "right").question(make_trial(), PROGRESS).marks
    frame = 0.006 * layout.unit
    for colour, box in ((DARK.left, layout.buttons[names[0]]), (DARK.right, layout.buttons[names[-1]])):
        (arrow,) = (m for m in marks if isinstance(m, Shape) and m.fill == colour and len(m.corners) == 3)
        xs = [x for x, _ in arrow.corners]
        assert box.left + frame <= min(xs) and max(xs) <= box.right - frame


@pytest.mark.parametrize("finger", ["thumb", "index", "middle", "ring", "little"])
@pytest.mark.parametrize("hand", ["left", "right"])
def test_no_hand_exceeds_the_narrowest_window(experiment: Experiment, hand: str, finger: str) -> None:
    """At 800 x 600 the whole hand is visible for any finger at the end of the beam."""
    layout = lay_out(800, 600, experiment.apparatus.zone_spans, AnswerList.of({}))
    for zone in "AE":
        marks = draw_hands(layout, DARK, (zone,), (f"{hand} {finger}",), ("one",), Typesetter())
        xs = [x for mark in marks if isinstance(mark, Shape) for x, _ in mark.corners]
        assert max(map(abs, xs)) < layout.width / 2


def test_answers_by_the_experimenter_are_announced(experiment: Experiment) -> None:
    """The participant is asked to speak, and no keys are shown."""
    pictures = illustrate(experiment, given_by="experimenter")
    picture = pictures.question(make_trial(), PROGRESS)
    assert experiment.texts.experimenter_answers in picture.texts
    triangles = [mark for mark in picture.marks if isinstance(mark, Shape) and len(mark.corners) == 3]
    assert len(triangles) == 4
    left = next(mark for mark in picture.marks if isinstance(mark, Words) and mark.text == experiment.texts.left)
    assert left.box.y == pictures.layout.buttons["left"].y, "in the middle of its button, which has nothing else"


def test_practice_has_its_own_progress(experiment: Experiment) -> None:
    """As "Practice 1 of 3"."""
    trial = make_trial(practice=True)
    assert "Practice 1 of 3" in illustrate(experiment).feel(trial, (1, 3)).texts


@pytest.mark.parametrize(("number", "share"), [(1, 0.0), (7, 0.5), (12, 11 / 12)])
def test_the_progress_bar_excludes_the_current_trial(experiment: Experiment, number: int, share: float) -> None:
    """Before the first of 12 trials it is empty, in the seventh half full."""
    pictures = illustrate(experiment)
    marks = pictures.feel(make_trial(), (number, 12)).marks
    low = pictures.layout.bar.bottom
    bars = [mark for mark in marks if isinstance(mark, Shape) and min(y for _, y in mark.corners) == pytest.approx(low)]
    widths = [max(x for x, _ in bar.corners) - min(x for x, _ in bar.corners) for bar in bars]
    assert widths == pytest.approx([pictures.layout.bar.width, *([share * pictures.layout.bar.width] if share else [])])


def test_the_placement_names_fingers_and_zones(experiment: Experiment) -> None:
    """The text of english.yaml, filled in for the paper's test 2."""
    words = illustrate(experiment).placement(make_trial("CE", "two_hands")).texts[0]
    assert words == "Rest your left index finger on zone\u00a0C\nand your right index finger on zone\u00a0E"


def test_the_pause_screen_shows_its_keys(experiment: Experiment) -> None:
    """The keys to continue and to end, and the places of the fingers."""
    picture = illustrate(experiment).pause(make_trial())
    words = " ".join(picture.texts)
    assert "the space bar" in words
    assert "Q" in words
    assert any(isinstance(mark, Shape) and mark.fill == DARK.left for mark in picture.marks)


def test_a_pause_between_trials_announces_no_repetition(experiment: Experiment) -> None:
    """It shows the keys, but no fingers and no repeated vibration."""
    picture = illustrate(experiment).pause(None)
    words = " ".join(picture.texts)
    assert "the space bar" in words
    assert "Q" in words
    assert "again" not in words
    assert not any(isinstance(mark, Shape) for mark in picture.marks)


def test_no_break_spaces_are_kept(experiment: Experiment) -> None:
    """French has one before a question mark."""
    page = illustrate(experiment).page("rest", "Prêt\u00a0?\nOui.\n\nAllons\n  y")
    assert page.texts == ("Prêt\u00a0? Oui.", "Allons y", "Press the space bar or click to go on")


@pytest.mark.parametrize(
    ("placement", "finger_condition", "hand", "fingers"),
    [
        ("normal", "one_hand", "right", ("right index", "right middle")),
        ("mirrored", "one_hand", "right", ("right index", "right middle")),
        ("swapped", "one_hand", "right", ("left middle", "left index")),
        ("swapped", "one_hand", "left", ("right index", "right middle")),
        ("swapped", "two_hands", "right", ("right index", "left index")),
        ("mirrored_swapped", "two_hands", "right", ("right index", "left index")),
    ],
)
def test_mirrored_and_swapped_placements_are_drawn(
    experiment: Experiment, placement: str, finger_condition: str, hand: str, fingers: tuple[str, str]
) -> None:
    """A mirrored beam has E on the left; swapped is the other hand or crossed hands."""
    pair = "CA" if placement.startswith("mirrored") else "AC"
    trial = Trial(1, 1, Condition(finger_condition, pair[0], pair[1], 100.0, placement))
    assert trial.condition.fingers(hand) == fingers
    pictures = illustrate(experiment, hand)
    picture = pictures.feel(trial, PROGRESS)
    places = {zone: find_words(picture, zone).box.x for zone in "ABCDE"}
    in_order = sorted(places, key=places.__getitem__)
    assert in_order == (list("EDCBA") if pair == "CA" else list("ABCDE"))
    for side, zone, finger in zip(("left", "right"), pair, fingers, strict=True):
        assert tips(picture.marks, DARK)[side][0] == pytest.approx(places[zone], abs=0.02)
        named = find_words(picture, f"{finger} finger")
        assert named.box.x == pytest.approx(places[zone])


def test_no_palm_hides_the_finger_of_crossed_hands(experiment: Experiment) -> None:
    """On adjacent zones the hands overlap, but both fingers are visible."""
    crossed = Trial(1, 1, Condition("two_hands", "C", "D", 100.0, "swapped"))
    fills = [mark.fill for mark in illustrate(experiment).feel(crossed, PROGRESS).marks if isinstance(mark, Shape)]
    last_palm = max(place for place, fill in enumerate(fills) if fill in (DARK.hand, DARK.hand_edge))
    assert last_palm < min(fills.index(DARK.left), fills.index(DARK.right))


def test_pictures_of_mirrored_and_normal_placements_have_different_names(experiment: Experiment) -> None:
    """So that screenshots of both are kept."""
    pictures = illustrate(experiment)
    turned = Trial(1, 1, Condition("one_hand", "C", "A", 100.0, "mirrored"))
    assert pictures.feel(turned, PROGRESS).name != pictures.feel(make_trial("AC"), PROGRESS).name


@pytest.mark.parametrize(
    ("fingers", "ways", "placed", "answered"),
    [
        ("one_hand", {}, "with your left hand", "Answer with your left hand"),
        (
            "one_hand",
            {"one_hand": "lifting"},
            "with your right hand, then put it back",
            "Press the answer with your right hand",
        ),
        ("two_hands", {}, "with your right hand, then put it back", "lifting does not count"),
        ("two_hands", {"two_hands": "free_hand"}, "then put it back", "Press the answer with your right hand"),
        ("two_hands", {"two_hands": "foot_switch"}, "or click to go on", "Answer with your foot"),
        ("two_hands", {"two_hands": "experimenter"}, "Tell the experimenter", "Say your answer aloud"),
    ],
)
def test_the_screens_show_which_hand_answers(
    experiment: Experiment, fingers: str, ways: dict[str, str], placed: str, answered: str
) -> None:
    """The free hand; if both are on the beam, always the same one, which then returns."""
    pictures, trial = illustrate(experiment, ways=ways), make_trial("AC", fingers)
    assert placed in pictures.placement(trial).texts[-1]
    assert any(answered in text for text in pictures.question(trial, PROGRESS).texts)


def test_swapped_placements_free_the_other_hand(experiment: Experiment) -> None:
    """With the left hand on the beam the right one answers."""
    swapped = Trial(1, 1, Condition("one_hand", "A", "C", 100.0, "swapped"))
    assert "Answer with your right hand" in illustrate(experiment).question(swapped, PROGRESS).texts


def test_older_texts_without_hands_are_readable(experiment: Experiment) -> None:
    """Missing texts are left out or replaced by the former ones."""
    missing = ("placed_by_free_hand", "placed_by_hand_on_beam", "placed_by_experimenter", "free_hand_answers")
    texts = experiment.texts.model_copy(update=dict.fromkeys(missing) | {"lift_to_answer": "Lift a finger to answer"})
    pictures = replace(illustrate(experiment), texts=texts)
    assert pictures.placement(make_trial()).texts[-1] == "Press the space bar or click to go on"
    assert "Lift a finger to answer" in pictures.question(make_trial("AC", "two_hands"), PROGRESS).texts


def test_the_countdown_shows_a_text_and_a_number(experiment: Experiment) -> None:
    """In addition to beam and hands."""
    pictures, trial = illustrate(experiment), make_trial("AC", "two_hands")
    alone, counted = pictures.ready(trial, PROGRESS), pictures.ready(trial, PROGRESS, 3)
    assert set(counted.texts) - set(alone.texts) == {experiment.texts.fingers_back, "3"}
    assert set(alone.marks) < set(counted.marks)


@pytest.mark.parametrize("expected", ["left", "both", "right"])
def test_feedback_shows_where_it_was_stronger(experiment: Experiment, expected: str) -> None:
    """Agreement, or the text for the predicted side."""
    pictures, texts = illustrate(experiment), experiment.texts
    for answer in ("left", "both", "right"):
        words = pictures.feedback(make_trial(practice=True), (1, 3), answer, expected).texts[0]
        assert words == (texts.practice_agreed if answer == expected else getattr(texts, f"practice_was_{expected}"))


def test_a_beam_of_three_zones_is_drawn(experiment: Experiment, trial: Trial) -> None:
    """Its pictures have the names of its zones."""
    layout = lay_out(1280, 800, {"X": (-0.5, -0.2), "Y": (-0.2, 0.2), "Z": (0.2, 0.5)}, AnswerList.of({}))
    pictures = Illustrator(layout, DARK, experiment.texts, experiment.protocol.answers, "right")
    assert pictures.feel(make_trial("XZ"), PROGRESS).name == "feel_one_hand_XZ"


def test_four_answers_are_shown_with_their_words_and_keys(experiment: Experiment) -> None:
    """The labels of the texts, the instruction for four answers, and a key on each button."""
    keys = {**experiment.protocol.answers.keys, "both": ("up",), "none": ("down",)}
    answers = experiment.protocol.answers.model_copy(update={"keys": keys})
    layout = lay_out(800, 600, experiment.apparatus.zone_spans, answers.offered)
    pictures = Illustrator(layout, DARK, experiment.texts, answers, "right")
    question = pictures.question(make_trial(), PROGRESS)
    for answer, word in (("left", "Left"), ("both", "Both"), ("right", "Right"), ("none", "Nowhere")):
        words = find_words(question, word)
        box = layout.buttons[answer]  # type: ignore[index]
        assert box.contains(words.box.left, words.box.bottom)
        assert box.contains(words.box.right, words.box.top)
    texts = [mark.text for mark in pictures.answering(make_trial()).marks if isinstance(mark, Words)]
    assert texts[0] == "Each time, choose one of these four answers."
    assert "then choose “Nowhere”" in texts[1]
    chosen = pictures.question(make_trial(), PROGRESS, chosen="none")
    assert find_words(chosen, "Nowhere").fill == DARK.ground


@pytest.mark.parametrize(
    ("language", "n_answers", "words"),
    [
        ("english", 2, "one of these two answers"),
        ("english", 7, "one of these seven answers"),
        ("french", 2, "l’une de ces deux réponses"),
        ("french", 7, "l’une de ces sept réponses"),
    ],
)
def test_the_instructions_state_the_number_of_answers(
    experiment: Experiment, language: str, n_answers: int, words: str
) -> None:
    """In words in every shipped language, and as a digit in a file without number words."""
    keys = {f"grade_{number}": (str(number),) for number in range(n_answers)}
    answers = experiment.protocol.answers.model_copy(update={"keys": keys})
    file = Path(__file__).parents[2] / "protocols" / "texts" / f"{language}.yaml"
    texts = Texts(**YAML(typ="safe", pure=True).load(file.read_text(encoding="utf-8")))
    texts = texts.model_copy(update={"answers": dict.fromkeys(keys, "Label")})
    layout = lay_out(800, 600, experiment.apparatus.zone_spans, answers.offered)
    pictures = Illustrator(layout, DARK, texts, answers, "right")
    assert words in pictures.answering(make_trial()).texts[0]
    wordless = replace(pictures, texts=texts.model_copy(update={"numbers": ()}))
    assert f" {n_answers} " in wordless.answering(make_trial()).texts[0]


def test_answers_of_any_names_are_shown_in_the_order_of_the_file(experiment: Experiment) -> None:
    """With labels from the texts, without colours or arrows of fingers; `below` is respected."""
    names = ("stronger", "alike", "weaker", "unsure")
    keys = {name: (key,) for name, key in zip(names, ("up", "space", "down", "0"), strict=True)}
    answers = experiment.protocol.answers.model_copy(update={"keys": keys, "below": ("unsure",)})
    texts = experiment.texts.model_copy(update={"answers": {name: name.title() for name in names}})
    layout = lay_out(800, 600, experiment.apparatus.zone_spans, answers.offered)
    pictures = Illustrator(layout, DARK, texts, answers, "right")
    question = pictures.question(make_trial(), PROGRESS, chosen="alike")
    row = [find_words(question, name.title()).box.x for name in names[:3]]
    assert row == sorted(row)
    assert find_words(question, "Unsure").box.top < layout.buttons["alike"].bottom
    assert find_words(question, "Alike").fill == DARK.ground
    assert layout.answer_at(layout.buttons["weaker"].x, layout.buttons["weaker"].y) == "weaker"
    side = pictures.question(make_trial(), PROGRESS).marks
    assert not {DARK.left, DARK.right} & {getattr(mark, "fill", "") for mark in side if getattr(mark, "y", 0) < 0}


def test_a_catch_trial_looks_like_any_other(experiment: Experiment) -> None:
    """The screens of a level of 0 equal those of 200 mm/s."""
    pictures = illustrate(experiment)
    catch, other = make_trial(velocity=0.0), make_trial(velocity=200.0)
    for draw in (pictures.feel, pictures.question, pictures.ready):
        assert draw(catch, PROGRESS) == draw(other, PROGRESS)


@pytest.mark.parametrize(
    ("keys", "order"),
    [
        ({"weaker": ("1",), "alike": ("2",), "stronger": ("3",)}, ["stronger", "alike", "weaker"]),
        ({"weaker": ("left",), "alike": ("2",), "stronger": ("right",)}, ["weaker", "alike", "stronger"]),
        ({"left": ("1",), "both": ("2",), "right": ("3",)}, ["left", "both", "right"]),
    ],
)
def test_arabic_answers_run_from_the_right_unless_sides_matter(
    experiment: Experiment, keys: dict[str, tuple[str, ...]], order: list[str]
) -> None:
    """As its scales do; arrow keys and fingers keep their sides."""
    asked = experiment.protocol.answers.model_copy(update={"keys": keys})
    labels = {"weaker": "أضعف", "alike": "متساوٍ", "stronger": "أقوى"}
    texts = experiment.texts.model_copy(update={"question": "أين أحسست بالاهتزاز؟", "answers": labels})
    zones, design = experiment.apparatus.zone_spans, experiment.protocol.conditions
    buttons = Illustrator.of((1280, 800), zones, "dark", texts, asked, design).layout.buttons
    assert sorted(buttons, key=lambda name: buttons[name].x) == order
