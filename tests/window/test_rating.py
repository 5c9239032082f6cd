"""Numbers on a scale and further questions: by keys, clicks, a foot switch, the console or the robot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from modaltouch.planning.participant import Participant
from modaltouch.protocol.questions import QuestionSection, ScaleSection
from modaltouch.protocol.trial import AnswerList, Response, Trial
from modaltouch.window.controls import Entry, draw_scale, typesetter_of
from modaltouch.window.display_loop import Robot
from modaltouch.window.interface import Event, SessionStopped
from modaltouch.window.layout import DARK, Words, lay_out
from modaltouch.window.simulated import Answerer

PROGRESS = (5, 12)
VAS = {"kind": "vas", "words": ["not at all", "extremely"]}
LIKERT = {"kind": "likert", "highest": 5, "words": ["weak", "strong"]}
NUMBER = {"kind": "number"}
PEDALS = {"lower": ["f1"], "confirm": ["f2"], "higher": ["f3"]}


def press(room: Any, *keys: str, kind: str = "key") -> Callable[[], None]:
    """Return a step in which keys are pressed and released."""

    def act() -> None:
        for key in keys:
            room.display.events += [Event(room.clock.now(), each, key) for each in (kind, "release")]

    return act


def rate(room: Any, trial: Trial) -> Response:
    """Ask one trial whose stimulus begins now."""
    response: Response = room.window.ask(trial, PROGRESS, room.present())
    return response


def scale(given: dict[str, Any]) -> dict[str, Any]:
    """Return the section of a scale in place of the answers."""
    return {"keys": {}, "scale": ScaleSection.model_validate(given)}


@pytest.mark.parametrize(
    ("given", "keys", "value"),
    [
        (VAS, ["right", "right", "down", "enter"], 50),
        (VAS, ["end", "pagedown", "left", "space"], 89),
        (VAS, ["home", "left", "enter"], 0),
        (VAS | {"keys": PEDALS}, ["f3", "f3", "f3", "f1", "f2"], 51),
        (VAS | {"lowest": -1, "highest": 1, "step": 0.5}, ["end", "left", "enter"], 0.5),
        (LIKERT, ["4", "enter"], 4),
        (LIKERT, ["num_2", "right", "right", "9", "enter"], 4),
        (NUMBER, ["1", "2", "backspace", "comma", "5", "num_enter"], 1.5),
        (NUMBER, ["0", "enter", "period", "3", "enter"], 0.3),
        (NUMBER | {"lowest": 2e8, "highest": 1e9}, [*"1000000000", "enter"], 1e9),
        (NUMBER | {"lowest": -9, "highest": 9}, ["1", "0", "enter", "backspace", "minus", "enter"], -1),
    ],
)
def test_a_number_is_entered_by_keys_and_counts_once_confirmed(
    paper_room: Callable[..., Any], trial: Trial, given: dict[str, Any], keys: list[str], value: float
) -> None:
    """By hand; a number off the scale cannot be confirmed, and the first press shows a marker."""
    room = paper_room(answers=scale(given))
    room.script = [("question", 0.5, press(room, *keys))]
    onset = room.clock.now()
    response = rate(room, trial)
    assert (response.answer, response.value) == ("rated", value)
    assert (response.device, response.key) == ("key", keys[-1])
    assert response.reaction_time == pytest.approx(room.shown[1][1] + 0.5 - onset, abs=0.01)
    assert len(room.ended) == 1


def test_the_marker_moves_while_its_key_is_held(paper_room: Callable[..., Any], trial: Trial) -> None:
    """After 0.4 s one step each 0.03 s: a second of holding is about twenty steps."""
    room = paper_room(answers=scale(VAS))

    def hold() -> None:
        room.display.events.append(Event(room.clock.now(), "key", "right"))

    def let_go() -> None:
        room.display.events += [Event(room.clock.now(), "release", "right"), Event(room.clock.now(), "key", "enter")]

    start = room.clock.now()
    room.script = [("question", 0.1, hold), ("rating", 0.0, lambda: None)]
    tick = room.tick

    def watch() -> Any:
        if room.clock.now() > start + 1.4 and not room.ended and room.display.typed == []:
            room.display.typed.append(("let go", False))
            let_go()
        return tick()

    room.window._loop._tick = watch
    assert rate(room, trial).value == pytest.approx(50 + (1.4 - 0.4 - 0.4) / 0.03, abs=2)


@pytest.mark.parametrize(
    ("given", "places", "value"),
    [(VAS, [("line", 0.25)], 25), (LIKERT, [("5", 0.5)], 5), (NUMBER, [("7", 0.5)] * 2, 77)],
)
def test_a_number_is_entered_by_clicks(
    paper_room: Callable[..., Any], trial: Trial, given: dict[str, Any], places: list[tuple[str, float]], value: float
) -> None:
    """By the position of the click; the button confirms."""
    room = paper_room(answers=scale(given))
    boxes = room.window._first.pictures.layout.buttons

    def click() -> None:
        for name, share in [*places, ("confirm", 0.5)]:
            box = boxes[name]
            at = box.left + share * box.width, box.y
            room.display.events.append(Event(room.clock.now(), "click", "", *at))

    room.script = [("question", 0.5, click)]
    response = rate(room, trial)
    assert (response.value, response.device) == (value, "mouse")


def test_a_scale_times_out_without_a_number(paper_room: Callable[..., Any], trial: Trial) -> None:
    """An unconfirmed entry is not an answer, but is logged."""
    room = paper_room(answers=scale(VAS) | {"time_out_s": 1.0})
    room.script = [("question", 0.2, press(room, "right"))]
    response = rate(room, trial)
    room.window.confirm(response)
    assert (response.answer, response.value, response.device) == ("time_out", None, "none")
    assert room.events("discarded") == [{"when": "not confirmed in time", "trial": trial.index, "entered": "50"}]
    assert "value" not in response.as_dict()


def test_a_number_is_typed_at_the_console(paper_room: Callable[..., Any], trial: Trial) -> None:
    """Its keys arrive as answers, "continue" confirms, and the device is the console."""
    room = paper_room(answers=scale(NUMBER) | {"given_by": "experimenter"})

    def type_it() -> None:
        now = room.clock.now()
        room.requests = [Event(now, "answer", sign, answer=sign) for sign in "42"] + [Event(0.0, "continue")]

    room.script = [("question", 0.3, type_it)]
    response = rate(room, trial)
    assert (response.value, response.device, response.answered_by) == (42, "console", "experimenter")


@pytest.fixture
def sure(paper_room: Callable[..., Any], trial: Trial) -> tuple[Any, Any, float]:
    """Return a window in which a trial was answered, its further question, and the onset."""
    section = QuestionSection.model_validate({"question": "How sure?", "keys": {"no": ["left"], "yes": ["right"]}})
    room = paper_room(answers={"then": {"sure": section}})
    room.script = [("question_one", 0.1, press(room, "left"))]
    onset = room.clock.now()
    room.window.confirm(rate(room, trial))
    return room, room.window._answers.further["sure"], onset


def test_a_further_question_has_its_own_reaction_time(sure: tuple[Any, Any, float], trial: Trial) -> None:
    """The first answer stays visible briefly; presses meanwhile are discarded."""
    room, asked, onset = sure
    room.script = [("answered", 0.1, press(room, "right")), ("question_sure", 0.4, press(room, "right"))]
    response = room.window.ask_further("sure", asked, trial)
    assert (response.answer, response.onset) == ("yes", "question")
    assert response.reaction_time == pytest.approx(0.4, abs=0.01)
    shown = next(at for name, at in room.shown if name.startswith("question_sure"))
    assert response.question_after == pytest.approx(shown - onset)
    assert [name.split("_one")[0] for name in room.names[-2:]] == ["question_sure", "answered_sure_yes"]
    assert "How sure?" in room.display.drawn.texts


def test_a_further_question_is_asked_again_after_a_pause(sure: tuple[Any, Any, float], trial: Trial) -> None:
    """The stimulus is over, so the trial is not repeated; the reaction time restarts."""
    room, asked, _ = sure
    room.script = [
        ("question_sure", 0.3, press(room, "escape")),
        ("pause_between", 5.0, press(room, "space")),
        ("question_sure", 0.2, press(room, "left")),
    ]
    response = room.window.ask_further("sure", asked, trial)
    assert (response.answer, response.reaction_time) == ("no", pytest.approx(0.2, abs=0.01))


def test_the_emergency_key_ends_a_further_question(sure: tuple[Any, Any, float], trial: Trial) -> None:
    """As on every other screen."""
    room, asked, _ = sure
    room.script = [("question_sure", 0.1, press(room, "f12"))]
    with pytest.raises(SessionStopped, match="emergency stop"):
        room.window.ask_further("sure", asked, trial)


def test_a_question_of_the_form_needs_no_trial(paper_room: Callable[..., Any], experiment: Any) -> None:
    """It shows its text and its scale, but no beam."""
    room = paper_room()
    section = QuestionSection.model_validate({"question": "How tired?", "scale": LIKERT})
    room.script = [("form_tired", 0.3, press(room, "2", "enter"))]
    asked = experiment.protocol.answers.asking({"tired": section})["tired"]
    assert room.window.ask_further("tired", asked).value == 2
    assert room.display.drawn.texts[0] == "How tired?"


@pytest.mark.parametrize("question", ["Where?", "أين؟"])
@pytest.mark.parametrize("given", [VAS, LIKERT, NUMBER, VAS | {"step": 0.1}])
def test_the_robot_enters_the_number_of_its_observer(
    paper_room: Callable[..., Any], experiment: Any, trial: Trial, given: dict[str, Any], question: str
) -> None:
    """By keys, for either direction of the script, also in the form."""
    section = scale(given)
    answers = AnswerList.of({"scale": given})
    answerer = Answerer(Participant(), lambda trial: (0.08, 0.05), np.random.default_rng(4), answers, section["scale"])
    form = {"tired": QuestionSection.model_validate({"question": question, "scale": given})}
    protocol = experiment.protocol
    protocol = protocol.model_copy(update={"answers": protocol.answers.model_copy(update=section), "form": form})
    texts = experiment.texts.model_copy(update={"question": question})
    robot = Robot(answerer, protocol, patience=0.1, texts=texts)
    room = paper_room(answers=section, robot=robot, seconds=60, texts=texts)
    response = rate(room, trial)
    assert response.value == pytest.approx(answerer.first(trial)[1])
    assert response.answered_by == "simulated"
    assert protocol.closing["tired"].takes("rated", room.window.ask_further("tired", protocol.closing["tired"]).value)
    assert room.window._first.pictures.answers.scale.is_from_right is (question != "Where?")


def test_an_entry_gives_the_next_action_towards_a_number() -> None:
    """The last action is to confirm it."""
    given = ScaleSection.model_validate(NUMBER)
    entry, steps = Entry(given), list[str]()
    while (action := entry.towards(30.5)) != "confirm":
        entry.take(action, Event(0.0, "key"))
        steps.append(action)
    assert steps == ["3", "0", ".", "5"]


@pytest.mark.parametrize("size", [(800, 600), (1280, 800), (1920, 1080)])
@pytest.mark.parametrize("given", [VAS, LIKERT | {"words": list("abcde")}, LIKERT | {"highest": 11}, NUMBER])
def test_no_part_of_a_scale_covers_another(experiment: Any, size: tuple[int, int], given: dict[str, Any]) -> None:
    """Including its words and the lines below the question."""
    layout = lay_out(*size, {"A": (-0.5, 0.0), "B": (0.0, 0.5)}, AnswerList.of({}), ScaleSection.model_validate(given))
    boxes = [*layout.buttons.values(), layout.note, layout.label]
    for place, box in enumerate(boxes):
        assert box.left >= -layout.width / 2 and box.right <= layout.width / 2
        for other in boxes[place + 1 :]:
            apart = box.right <= other.left or other.right <= box.left or box.bottom >= other.top
            assert apart or other.bottom >= box.top


def test_the_bounds_of_a_number_are_written_out(experiment: Any) -> None:
    """Seven digits, as a person writes them, where six significant ones would be 1.23457e+06."""
    number = ScaleSection.model_validate(NUMBER | {"lowest": 0.5, "highest": 1234567})
    layout = lay_out(1280, 800, {"A": (-0.5, 0.0), "B": (0.0, 0.5)}, AnswerList.of({}), number)
    marks = draw_scale(layout, DARK, experiment.texts, number, "", confirmed=False, keys=True)
    assert "0.5 – 1234567" in [mark.text for mark in marks if isinstance(mark, Words)]
    assert number.allowed == "a number of at least 0.5, at most 1234567"


@pytest.mark.parametrize("size", [(800, 600), (1280, 800)])
def test_the_words_of_all_points_have_one_size_and_are_legible(experiment: Any, size: tuple[int, int]) -> None:
    """Seven points with long words: two lines, capitals of at least 1.3 % of the window's height."""
    words = ["very unpleasant indeed", "unpleasant", "rather unpleasant", "neither", "rather pleasant", "pleasant"]
    points = ScaleSection.model_validate({"kind": "likert", "words": [*words, "very pleasant indeed"]})
    layout = lay_out(*size, {"A": (-0.5, 0.0), "B": (0.0, 0.5)}, AnswerList.of({}), points)
    marks = draw_scale(layout, DARK, experiment.texts, points, "", confirmed=False, keys=True)
    drawn = [mark for mark in marks if isinstance(mark, Words) and mark.text in points.words]
    (height,) = {typesetter_of(experiment.texts).set_type(mark, size[1]).size / size[1] for mark in drawn}
    assert len(drawn) == 7
    assert 0.714 * height >= 0.013


@pytest.mark.parametrize("size", [(800, 600), (1280, 800), (1920, 1080)])
@pytest.mark.parametrize(
    "given",
    [
        LIKERT | {"words": ["not at all natural", "slightly", "moderately natural", "very", "extremely natural"]},
        LIKERT | {"words": ["weak", "the strongest vibration that anybody could ever think of, on any beam"]},
        {"kind": "vas", "words": ["weak", "the strongest vibration that anybody could ever think of, on any beam"]},
    ],
)
def test_words_of_one_and_two_lines_are_aligned_at_the_top(
    experiment: Any, size: tuple[int, int], given: dict[str, Any]
) -> None:
    """Between their points or line and the button."""
    scale = ScaleSection.model_validate(given)
    layout = lay_out(*size, {"A": (-0.5, 0.0), "B": (0.0, 0.5)}, AnswerList.of({}), scale)
    marks = draw_scale(layout, DARK, experiment.texts, scale, "", confirmed=False, keys=True)
    drawn = [mark for mark in marks if isinstance(mark, Words) and mark.text in scale.words]
    blocks = [typesetter_of(experiment.texts).set_type(mark, size[1]) for mark in drawn]
    assert {len(block.lines) for block in blocks} == {1, 2}
    tops = [mark.box.y + block.height / size[1] / 2 for mark, block in zip(drawn, blocks, strict=True)]
    assert max(tops) - min(tops) < 1.5 / size[1]
    bottoms = [mark.box.y - block.height / size[1] / 2 for mark, block in zip(drawn, blocks, strict=True)]
    points = [box.bottom for name, box in layout.buttons.items() if name != "confirm"]
    assert min(bottoms) > layout.buttons["confirm"].top and max(tops) < min(points)


@pytest.mark.parametrize(("given", "share", "clicked"), [(VAS, 0.25, 75), (LIKERT, None, 5)])
def test_a_right_to_left_scale_begins_at_the_right(
    paper_room: Callable[..., Any], trial: Trial, given: dict[str, Any], share: float | None, clicked: float
) -> None:
    """The left arrow increases the number, and the left end is the highest, with its word."""
    section = {"keys": {}, "scale": ScaleSection.model_validate(given).from_right()}
    room = paper_room(answers=section)
    room.script = [("question", 0.5, press(room, "left", "left", "right", "left", "enter"))]
    middle = 50 if share else 3
    assert rate(room, trial).value == middle + 1
    room = paper_room(answers=section)
    pictures = room.window._first.pictures
    box = pictures.layout.buttons["line" if share else "5"]
    at = box.left + (share or 0.5) * box.width, box.y
    assert share or box.x == min(button.x for button in pictures.layout.buttons.values())

    def click() -> None:
        room.display.events += [Event(room.clock.now(), "click", "", *at), Event(room.clock.now(), "key", "enter")]

    room.script = [("question", 0.5, click)]
    assert rate(room, trial).value == clicked
    words = [mark for mark in pictures.question(trial, PROGRESS).marks if isinstance(mark, Words)]
    places = {mark.text: mark.box.x for mark in words if mark.text in given["words"]}
    assert sorted(given["words"], key=places.__getitem__) == given["words"][::-1]
