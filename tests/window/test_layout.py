"""Geometry of the layout: sizes, hits and overlaps; no window is opened."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modaltouch.protocol import AnswerList
from modaltouch.window.layout import Box, Layout, Words, lay_out
from modaltouch.window.typesetting import Typesetter

SIZES = [(800, 600), (1280, 800), (1920, 1080), (768, 1024), (3840, 2160)]


def evenly(names: str) -> dict[str, tuple[float, float]]:
    """Return zones of equal width that fill the beam."""
    n = len(names)
    return {name: (place / n - 0.5, (place + 1) / n - 0.5) for place, name in enumerate(names)}


ZONES = evenly("ABCDE")
PAPER = AnswerList.of({})
WITH_NONE = AnswerList.of({"keys": ["left", "both", "right", "none"]})
GRADES = AnswerList.of({"keys": ["a", "b", "c", "d", "e", "unsure", "nowhere"], "below": ["unsure", "nowhere"]})


def boxes(layout: Layout) -> dict[str, Box]:
    """Return all parts of the question screen that must not overlap."""
    return {
        "headline": layout.headline,
        "beam": layout.beam,
        **{f"button {answer}": box for answer, box in layout.buttons.items()},
        "note": layout.note,
        "label": layout.label,
        "bar": layout.bar,
    }


def overlap(first: Box, second: Box) -> bool:
    """Return whether two boxes share more than an edge."""
    gap_x = abs(first.x - second.x) - (first.width + second.width) / 2
    gap_y = abs(first.y - second.y) - (first.height + second.height) / 2
    return gap_x < -1e-9 and gap_y < -1e-9


@given(st.integers(320, 8000), st.integers(320, 8000), st.integers(2, 9))
def test_everything_lies_inside_any_window(width_px: int, height_px: int, n_zones: int) -> None:
    """Bounds: half the window's width and height, in units of its height."""
    layout = lay_out(width_px, height_px, evenly("ABCDEFGHI"[:n_zones]), PAPER)
    half_width = width_px / height_px / 2
    everything = [*boxes(layout).values(), *layout.zones.values(), layout.body, layout.page, layout.go_on]
    for box in everything:
        assert -half_width <= box.left
        assert box.right <= half_width
        assert box.bottom >= -0.5
        assert box.top <= 0.5


@pytest.mark.parametrize(
    "answers",
    [PAPER, WITH_NONE, GRADES, AnswerList.of({"keys": list("abcdefg")})],
    ids=["paper", "none", "grades", "seven"],
)
@pytest.mark.parametrize("size", [*SIZES, (1080, 1920)])
def test_nothing_on_the_question_screen_overlaps(size: tuple[int, int], answers: AnswerList) -> None:
    """At all sizes of the list, each part has its own place."""
    layout = lay_out(*size, ZONES, answers)
    for (name, first), (other, second) in itertools.combinations(boxes(layout).items(), 2):
        assert not overlap(first, second), (name, other)
    assert layout.go_on.top < min(box.bottom for box in layout.buttons.values())


@pytest.mark.parametrize("size", SIZES)
def test_the_answer_none_is_centred_below_the_others(size: tuple[int, int]) -> None:
    """It has at least the 44 pixels of touch guidelines, and is hit where it is drawn."""
    layout = lay_out(*size, ZONES, WITH_NONE)
    none = layout.buttons["none"]
    assert none.x == 0
    assert none.top < min(box.bottom for answer, box in layout.buttons.items() if answer != "none")
    assert none.height * size[1] >= 44
    assert layout.answer_at(none.left + 0.01, none.y) == "none"
    assert "none" not in lay_out(*size, ZONES, PAPER).buttons


@pytest.mark.parametrize("size", SIZES)
def test_the_continue_hint_is_below_the_answers(size: tuple[int, int]) -> None:
    """On the screen that explains the answers."""
    layout = lay_out(*size, ZONES, PAPER)
    assert layout.go_on.top < min(box.bottom for box in layout.buttons.values())


@pytest.mark.parametrize("size", SIZES)
def test_buttons_are_large(size: tuple[int, int]) -> None:
    """Over twice the 44 pixels of touch guidelines at every size."""
    for box in lay_out(*size, ZONES, PAPER).buttons.values():
        assert min(box.width, box.height) * size[1] > 88


def test_seven_words_of_nine_letters_are_legible_in_a_small_window() -> None:
    """At 800 x 600 pixels, capitals of 10 pixels: 20 arcmin on a screen of 300 mm at 640 mm."""
    seven = AnswerList.of({"keys": list("abcdefg")})
    button = min(lay_out(800, 600, ZONES, seven).buttons.values(), key=lambda box: box.x)
    assert button.left == pytest.approx(0.025 - 800 / 600 / 2)
    label = Words("Hammering", Box(0, 0, 0.91 * button.width, 0.1), 0.062, "", bold=True)
    assert 0.714 * Typesetter().set_type(label, 600).size > 10


@pytest.mark.parametrize("size", SIZES)
def test_a_click_in_the_middle_of_a_button_gives_its_answer(size: tuple[int, int]) -> None:
    """Left, both and right are in this order."""
    layout = lay_out(*size, ZONES, PAPER)
    middles = sorted((box.x, box.y, answer) for answer, box in layout.buttons.items())
    assert [answer for _, _, answer in middles] == ["left", "both", "right"]
    assert [layout.answer_at(x, y) for x, y, _ in middles] == ["left", "both", "right"]


@given(st.floats(-1, 1), st.floats(-0.5, 0.5))
def test_a_click_hits_a_button_exactly_where_it_is_drawn(x: float, y: float) -> None:
    """By the inequalities of a rectangle, edges included."""
    layout = lay_out(1280, 800, ZONES, PAPER)
    hit = [
        answer
        for answer, box in layout.buttons.items()
        if box.x - box.width / 2 <= x <= box.x + box.width / 2 and box.y - box.height / 2 <= y <= box.y + box.height / 2
    ]
    assert layout.answer_at(x, y) == (hit[0] if hit else None)


def test_zones_are_drawn_to_scale_and_turn_with_the_beam() -> None:
    """By hand: a zone of a tenth of the beam at its left end, and one of a fifth right of the middle."""
    layout = lay_out(1280, 800, {"X": (-0.5, -0.4), "Y": (0.1, 0.3)}, PAPER)
    left, right = layout.zones.values()
    assert left.left == pytest.approx(layout.beam.left)
    assert (left.width, right.width) == pytest.approx((layout.beam.width / 10, layout.beam.width / 5))
    assert right.x == pytest.approx(layout.beam.width / 5)
    turned = layout.turned().zones
    assert list(turned) == ["Y", "X"]
    assert turned["X"].right == pytest.approx(layout.beam.right)


@pytest.mark.parametrize("n_zones", [2, 3, 5, 8])
def test_equal_zones_are_adjacent_and_in_order(n_zones: int) -> None:
    """For any number of zones, centred on the screen."""
    layout = lay_out(1280, 800, evenly("ABCDEFGH"[:n_zones]), PAPER)
    places = list(layout.zones.values())
    assert layout.beam.x == pytest.approx(0)
    for left, right in itertools.pairwise(places):
        assert left.right == pytest.approx(right.left)
