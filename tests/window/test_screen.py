"""The PsychoPy window: start-up problems, and texts that fit at every size."""

from __future__ import annotations

import os
import subprocess
import sys
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from modaltouch.protocol import AnswerList, Experiment, Texts
from modaltouch.protocol.findings import Findings
from modaltouch.protocol.trial import Condition, Trial
from modaltouch.window.controls import typesetter_of
from modaltouch.window.interface import WindowError
from modaltouch.window.layout import DARK, THEMES, Box, Picture, Words, lay_out, rectangle, triangle
from modaltouch.window.machine import virtual_display
from modaltouch.window.opening import every_picture
from modaltouch.window.pictures import Illustrator

pytestmark = pytest.mark.window
ROOT = Path(__file__).resolve().parents[2]
OPEN = """
from pathlib import Path
from modaltouch.window.interface import WindowError
from modaltouch.window.layout import Box, Picture, Words
from modaltouch.window.screen import Screen
try:
    screen = Screen(size=(400, 300))
    screen.draw(Picture("any", (Words("Bonjour", Box(0, 0, 1, 1), 0.1, "#FFFFFF"),)))
    screen.flip()
    screen.close()
except WindowError as error:
    raise SystemExit(f"WindowError: {error}")
"""


LOSE = """
import os, subprocess
from modaltouch.window.interface import WindowError
from modaltouch.window.layout import Picture
from modaltouch.window.machine import virtual_display
from modaltouch.window.screen import Screen
with virtual_display((640, 480)) as name:
    os.environ["DISPLAY"] = name
    screen = Screen(size=(400, 300))
    subprocess.run(["pkill", "-KILL", "-P", str(os.getpid()), "Xvfb"], check=True)
    kinds = []
    while "lost" not in kinds:
        kinds += [event.kind for event in screen.poll()]
    for use in (lambda: screen.draw(Picture("any", ())), screen.flip):
        try:
            use()
        except WindowError as error:
            print(error)
    screen.close()
"""


def open_in_a_process(program: str = OPEN, **environment: str) -> subprocess.CompletedProcess[str]:
    """Open a window in a new interpreter and return its output and exit status."""
    plain = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    return subprocess.run(
        [sys.executable, "-c", program],
        env=plain | environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def set_type(screen: Any, words: Words) -> Any:
    """Return the words as typeset by the window."""
    return screen._typesetter.set_type(words, screen.size[1])


def fits(screen: Any, words: Words) -> bool:
    """Return whether the typeset words lie inside their box."""
    height = screen.size[1]
    return bool(set_type(screen, words).fits(words.box.width * height, words.box.height * height))


def shrinks(screen: Any, words: Words) -> float:
    """Return the fraction of its intended size at which a text is drawn."""
    return float(set_type(screen, words).share)


def test_without_a_display_the_error_has_a_remedy() -> None:
    """PsychoPy's own message is 'Cannot connect to "None"'."""
    done = open_in_a_process()
    assert done.returncode == 1
    assert "WindowError: the answer window needs a display, but DISPLAY is not set" in done.stderr
    assert "--answers simulated" in done.stderr


def test_an_unreachable_display_is_reported() -> None:
    """By its name."""
    done = open_in_a_process(DISPLAY=":987")
    assert done.returncode == 1
    assert "WindowError: the answer window cannot reach the display ':987'" in done.stderr


def test_a_display_without_opengl_is_reported() -> None:
    """A virtual display without GLX."""
    with virtual_display((640, 480), "-extension", "GLX") as name:
        done = open_in_a_process(DISPLAY=name)
    assert done.returncode == 1
    assert f"WindowError: the display '{name}' cannot draw with OpenGL" in done.stderr


def test_a_display_with_few_colours_is_reported() -> None:
    """At 16 bits pyglet would wait forever for a window that X refuses."""
    with virtual_display((640, 480), "-screen", "0", "640x480x16") as name:
        done = open_in_a_process(DISPLAY=name)
    assert done.returncode == 1
    assert f"WindowError: the display '{name}' has colours of 16 bits, but 24 are needed" in done.stderr


def test_a_lost_display_is_an_error_and_does_not_end_the_process() -> None:
    """Xlib's own handler ends it with status 1; PsychoPy's, at exit, with a segmentation fault."""
    done = open_in_a_process(LOSE)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("is gone: its X server ended or closed the connection; start it again") == 2


def test_an_unwritable_home_causes_no_error_or_output(display: str) -> None:
    """PsychoPy alone raises PermissionError there, and prints a warning about monitors elsewhere."""
    done = open_in_a_process(DISPLAY=display, HOME="/dev/null")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def make_experiment_texts(language: str) -> Texts:
    """Return the shipped texts of a language."""
    from ruamel.yaml import YAML

    with (ROOT / "protocols" / "texts" / f"{language}.yaml").open(encoding="utf-8") as file:
        return Texts(**YAML(typ="safe", pure=True).load(file))


@pytest.mark.parametrize("language", sorted(path.stem for path in (ROOT / "protocols" / "texts").glob("*.yaml")))
@pytest.mark.parametrize("size", [(800, 600), (768, 1024), (3840, 2160)])
def test_every_text_fits_its_place(experiment: Experiment, language: str, size: tuple[int, int]) -> None:
    """No text of a shipped language leaves its box or shrinks below 60 % of its size."""
    layout = lay_out(*size, experiment.apparatus.zone_spans, AnswerList.of({}))
    texts = make_experiment_texts(language)
    pictures = Illustrator(layout, DARK, texts, experiment.protocol.answers, "right")
    trials = [Trial(5, 1, Condition(fingers, "B", "D", 100.0)) for fingers in ("one_hand", "two_hands")]
    every = (picture for trial in trials for picture in every_picture(pictures, trial))
    for words in {mark for picture in every for mark in picture.marks if isinstance(mark, Words)}:
        block = typesetter_of(texts).set_type(words, size[1])
        assert block.fits(words.box.width * size[1], words.box.height * size[1]), words.text
        assert block.share >= 0.6, words.text


GRADES = ("Much weaker", "Weaker", "A bit weaker", "About the same", "A bit stronger", "Stronger", "Much stronger")


@pytest.mark.parametrize("labels", [GRADES, ("Clearly stronger under the left", "Clearly stronger under the right")])
@pytest.mark.parametrize("size", [(800, 600), (1280, 800), (3840, 2160)])
def test_long_labels_are_legible_on_their_buttons(
    screen: Any, experiment: Experiment, size: tuple[int, int], labels: tuple[str, ...]
) -> None:
    """Every label fits in type of at least 2 % of the window's height: 5 mm on a screen of 27 cm."""
    keys = {f"grade_{number}": (str(number),) for number in range(len(labels))}
    answers = experiment.protocol.answers.model_copy(update={"keys": keys})
    texts = experiment.texts.model_copy(update={"answers": dict(zip(keys, labels, strict=True))})
    layout = lay_out(*size, experiment.apparatus.zone_spans, answers.offered)
    picture = Illustrator(layout, DARK, texts, answers, "right").question(
        Trial(5, 1, Condition("one_hand", "B", "D", 100.0)), (5, 24)
    )
    for mark in picture.marks:
        if isinstance(mark, Words) and mark.text in labels:
            assert fits(screen, mark), mark.text
            assert shrinks(screen, mark) * mark.size >= 0.02, mark.text


def test_a_text_too_long_is_made_smaller(screen: Any) -> None:
    """It shrinks until it fits, unless the box is too small."""
    assert fits(screen, Words("A text that is far too long for its box", Box(0, 0, 0.4, 0.2), 0.08, "#FFFFFF"))
    assert not fits(screen, Words("A text that is far too long for its box", Box(0, 0, 0.05, 0.03), 0.08, "#FFFFFF"))


def test_pixels_agree_with_the_picture(screen: Any, tmp_path: Path) -> None:
    """Colours of the marks at pixels given by the geometry, 1280 x 800."""
    from PIL import Image

    marks = (
        rectangle(Box(-0.5, 0.25, 0.2, 0.1), "#56B4E9"),
        triangle("up", 0.4, -0.2, 0.1, "#E69F00"),
    )
    screen.draw(Picture("marks", marks))
    screen.flip(tmp_path / "marks.png")
    with Image.open(tmp_path / "marks.png") as image:
        assert image.getpixel((640 - 400, 400 - 200)) == (0x56, 0xB4, 0xE9)
        assert image.getpixel((640 - 400 - 79, 400 - 200)) == (0x56, 0xB4, 0xE9)
        assert image.getpixel((640 - 400 - 82, 400 - 200)) == (0x12, 0x17, 0x1C)
        assert image.getpixel((640 + 320, 400 + 160 - 70)) == (0xE6, 0x9F, 0x00)
        assert image.getpixel((640 + 320 - 25, 400 + 160 - 70)) == (0x12, 0x17, 0x1C)


def test_a_screenshot_that_cannot_be_written_is_a_window_error(screen: Any, tmp_path: Path) -> None:
    """The message has the file."""
    with pytest.raises(WindowError, match="absent/x.png cannot be written"):
        screen.flip(tmp_path / "absent" / "x.png")


def test_a_missing_monitor_is_refused(screen: Any) -> None:
    """PsychoPy alone would silently use another one."""
    from modaltouch.window.screen import Screen

    with pytest.raises(WindowError, match="given screen 3, but this display has 1; allowed: 0 to 0"):
        Screen(monitor=3)


def test_a_window_larger_than_the_monitor_is_cut_to_it(screen: Any) -> None:
    """To the virtual monitor's 3840 x 2160 pixels, so that all buttons are visible."""
    from modaltouch.window.screen import Screen

    large = Screen(size=(5000, 3000))
    assert large.size == (3840, 2160)
    large.close()


def test_the_start_record_describes_the_window(screen: Any) -> None:
    """Backend, versions, renderer and size."""
    about = screen.describe()
    assert about["backend"] == "psychopy"
    assert about["size_px"] == [1280, 800]
    assert about["detectable_key_repeat"] is True
    assert about["renderer"]


@pytest.mark.parametrize("theme", THEMES)
def test_a_session_opens_in_either_theme(display: str, experiment: Experiment, theme: str, tmp_path: Path) -> None:
    """The first screen has the theme's background, and the record can reopen the window."""
    from PIL import Image

    from modaltouch.window import WindowOptions

    class LeaveError(Exception):
        """Ends the first screen."""

    def tick() -> None:
        if (tmp_path / "welcome.png").exists():
            raise LeaveError

    window = WindowOptions(size=(800, 600), theme=theme, screenshots=tmp_path).open(
        experiment.protocol,
        experiment.texts,
        zones=experiment.apparatus.zone_spans,
        tick=tick,
        log=lambda event, **facts: None,
    )
    assert WindowOptions.recorded(window.describe()) == WindowOptions(size=(800, 600), theme=theme)
    with window, pytest.raises(LeaveError):
        window.welcome(Trial(1, 0, Condition("one_hand", "A", "C", 80.0), practice=True))
    with Image.open(tmp_path / "welcome.png") as image:
        assert image.size == (800, 600)
        ground = THEMES[theme].ground
        assert image.getpixel((3, 3)) == tuple(int(ground[place : place + 2], 16) for place in (1, 3, 5))


def test_the_screens_of_the_site_are_those_of_the_window(screen: Any, tmp_path: Path, monkeypatch: Any) -> None:
    """All pixels agree with the real window, within the rounding of eight bits."""
    from generator import screens

    experiment = Findings.read(ROOT / "protocols" / "detection_with_confidence.yaml").experiment()
    monkeypatch.setattr(screens, "SIZE", screen.size)
    pictures = screens.screens(experiment)
    assert [picture.name.partition("_one_hand")[0] for picture in pictures] == [
        "welcome", "answers", "place_fingers", "question", "question_confidence", "rest",
    ]  # fmt: skip
    for picture in pictures:
        screen.draw(picture)
        screen.flip(tmp_path / "window.png")
        shown, drawn = (
            np.asarray(Image.open(file).convert("RGB"), dtype=int)
            for file in (tmp_path / "window.png", BytesIO(screens.png(picture, experiment.texts)))
        )
        assert np.abs(shown - drawn).max() <= 2, picture.name
