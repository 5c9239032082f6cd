"""What the screens say: the very words they show, from a list known beforehand; nothing waits for their end."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from modaltouch.clock import Clock, VirtualClock
from modaltouch.protocol import Experiment, Protocol, SpeechSection, read_protocol
from modaltouch.schedule import draw_schedule
from modaltouch.trial import ANSWERS, Trial
from modaltouch.window.events import Event
from modaltouch.window.interface import Progress, SessionStopped, TrialInterrupted
from modaltouch.window.layout import lay_out
from modaltouch.window.pictures import Illustrator
from modaltouch.window.spoken import PAGES, spoken_texts
from modaltouch.window.theme import DARK

PROGRESS = Progress(5, 12)
ALL = SpeechSection().screens


class Mouth:
    """Notes when it was told to say what, and takes some time to say it."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.said: list[tuple[str, float]] = []
        self.n_written = 0
        self.lasts = 0.0

    @property
    def is_speaking(self) -> bool:
        return bool(self.said and self.said[-1][0]) and self.clock.now() < self.said[-1][1] + self.lasts

    def describe(self) -> None:
        return None

    def say(self, words: str) -> None:
        self.said.append((words, self.clock.now()))

    def hush(self) -> None:
        self.say("")

    def write_down(self) -> None:
        self.n_written += 1

    @property
    def words(self) -> list[str]:
        return [words for words, _ in self.said if words]


def speaking(experiment: Experiment, *screens: str, **conditions: Any) -> Experiment:
    """Return an experiment some of whose screens are spoken."""
    changed = experiment.protocol.model_copy(
        update={
            "speech": SpeechSection(screens=screens or ALL),
            "conditions": experiment.protocol.conditions.model_copy(update=conditions),
        }
    )
    return Experiment(changed, experiment.apparatus, experiment.texts, experiment.sources)


def press(room: Any, key: str) -> Callable[[], None]:
    """Return a step that presses a key now."""
    return lambda: room.display.events.append(Event(room.clock.now(), "key", key))


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    """Give the shipped demonstration, all of it spoken."""
    return speaking(read_protocol(Path(__file__).parents[2] / "protocols" / "demo.yaml"))


@pytest.fixture
def spoken_room(paper_room: Callable[..., Any]) -> Any:
    """Give a window without a display, and what it says."""
    clock = VirtualClock()
    mouth = Mouth(clock)
    room = paper_room(speech=mouth, clock=clock)
    room.mouth = mouth
    return room


@pytest.mark.parametrize("language", ["english", "french"])
@pytest.mark.parametrize("offers_none", [False, True])
@pytest.mark.parametrize("file", ["demo.yaml", "two_fields.yaml"])
def test_every_picture_s_words_are_known_beforehand(
    edit: Callable[..., Any],
    file: str,
    language: str,
    offers_none: bool,
) -> None:
    """Whatever trial of whatever participant: what a picture says is in the list, and stands on the picture itself."""
    changes = [("english.yaml", f"{language}.yaml")] if language == "french" else []
    experiment = speaking(read_protocol(edit(file, *changes)), placements=("normal", "mirrored", "swapped"))
    protocol, texts = experiment.protocol, experiment.texts
    if offers_none:
        keys = {**protocol.answers.keys, "none": ("down",)}
        protocol = protocol.model_copy(update={"answers": protocol.answers.model_copy(update={"keys": keys})})
    known = spoken_texts(protocol, experiment.apparatus.zones, texts)
    layout = lay_out(1024, 768, tuple(experiment.apparatus.zones), offers_none=offers_none)
    draw = Illustrator(layout, DARK, texts, protocol.answers, protocol.conditions.hand, ALL)
    pictures = [draw.page(name, getattr(texts, name)) for name in PAGES]
    pictures += [draw.page("goodbye", texts.goodbye, waits=False), draw.pause(None)]
    for number in range(1, 7):
        schedule = draw_schedule(protocol, f"p{number:02}", 3)
        for trial in (*schedule.practice, *schedule.trials):
            pictures += [draw.welcome(trial), draw.answering(trial), draw.placement(trial), draw.pause(trial)]
            pictures += [draw.question(trial, PROGRESS), draw.feedback(trial, PROGRESS, ANSWERS[0], ANSWERS[1])]
    said = {picture.spoken for picture in pictures}
    assert "" not in said
    assert said <= set(known)
    for picture in pictures:
        shown = " ".join(" ".join(picture.texts).split())
        assert all(" ".join(part.split()) in shown for part in picture.spoken.split("\n\n"))


def test_a_screen_that_the_protocol_leaves_out_stays_silent(experiment: Experiment) -> None:
    """Only the question: one prompt; without the section none."""
    zones, texts = experiment.apparatus.zones, experiment.texts
    only: Protocol = speaking(experiment, "question").protocol
    assert spoken_texts(only, zones, texts) == (texts.question,)
    assert spoken_texts(only.model_copy(update={"speech": None}), zones, texts) == ()


def test_the_question_is_spoken_when_it_is_shown_and_an_answer_ends_it(spoken_room: Any, trial: Trial) -> None:
    """Said with the picture, hushed at the answer, before the record is written; the answer waits for no prompt."""
    room = spoken_room
    room.script = [("question", 0.1, press(room, "left"))]
    response = room.window.ask(trial, PROGRESS, room.present())
    assert response.answer == "left"
    (words, said_at), (end, hushed_at) = [each for each in room.mouth.said if each[1] >= room.shown[1][1] - 1e-3][-2:]
    assert words == "Where did you feel the vibration?"
    assert end == ""
    asked = next(shown for name, shown in room.shown if name.startswith("question"))
    assert said_at - asked < 0.02
    assert 0.1 <= hushed_at - asked < 0.2
    written = room.mouth.n_written
    room.window.confirm(response)
    assert room.mouth.n_written == written + 1


def test_a_pause_ends_the_question_and_says_how_to_go_on(spoken_room: Any, trial: Trial) -> None:
    """What is said is always what is on the screen."""
    room = spoken_room
    room.script = [
        ("question", 0.05, press(room, "escape")),
        ("pause", 0.3, press(room, "space")),
    ]
    with pytest.raises(TrialInterrupted):
        room.window.ask(trial, PROGRESS, room.present())
    question, pause = room.mouth.words
    assert question == "Where did you feel the vibration?"
    assert pause.startswith("Paused. The beam is still.")
    assert room.mouth.said[-1][0] == ""


def test_a_person_is_led_by_ear_from_welcome_to_goodbye(spoken_room: Any, trial: Trial) -> None:
    """Each screen's own words, once, in order; the farewell is not cut while it is still being said."""
    room = spoken_room
    steps = ("welcome", "answers", "place_fingers", "practice", "rest")
    room.script = [(name, 0.3, press(room, "space")) for name in steps]
    room.window.welcome(trial)
    room.window.place_fingers(trial.__class__(1, 1, trial.condition))
    room.window.announce("practice")
    room.window.rest(PROGRESS)
    room.script = [("goodbye", 0.3, press(room, "space"))]
    room.window.goodbye()
    begins = (
        "Welcome",
        "Each time, choose",
        "Rest your right index",
        "Let us practise",
        "Time for a break",
        "That is all",
    )
    assert len(room.mouth.words) == len(begins)
    assert all(words.startswith(begin) for words, begin in zip(room.mouth.words, begins, strict=True))
    assert room.mouth.words[0].endswith("Press the space bar or click to go on")


def test_feedback_stays_until_it_is_said(spoken_room: Any, trial: Trial) -> None:
    """Its last word says where it was: 1.5 s on the screen are too short for it, so it stays as long as it takes."""
    room = spoken_room
    room.script = [("question", 0.05, press(room, "left"))]
    response = room.window.ask(trial, PROGRESS, room.present())
    room.mouth.lasts = 2.0
    began = room.clock.now()
    room.window.give_feedback(response, "right")
    assert room.mouth.words[-1] == "This time it was stronger on the right"
    assert 2.0 <= room.clock.now() - began < 2.2


def test_the_farewell_stays_until_it_is_said(spoken_room: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Longer than it would stay on the screen alone; without an end where nothing takes the samples."""
    room = spoken_room
    monkeypatch.setattr("modaltouch.window.participant._FAREWELL", 0.1)
    monkeypatch.setattr("modaltouch.window.participant._LONGEST_SPOKEN", 1.0)
    for lasts, stays in ((0.5, 0.5), (100.0, 1.0)):
        room.mouth.lasts = lasts
        room.window._stage._picture = None
        began = room.clock.now()
        room.window.goodbye()
        assert room.clock.now() - began == pytest.approx(stays, abs=0.002)


def test_the_end_of_a_session_in_a_pause_is_told_with_what_was_said(spoken_room: Any, trial: Trial) -> None:
    """Escape, then q: the session ends as without speech."""
    room = spoken_room
    room.script = [("question", 0.05, press(room, "escape")), ("pause", 0.3, press(room, "q"))]
    with pytest.raises(SessionStopped, match="escape"):
        room.window.ask(trial, PROGRESS, room.present())
