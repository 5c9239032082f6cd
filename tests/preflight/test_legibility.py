"""Legibility for the participant: every letter has a font, and the smallest type is large enough at the eye."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from modaltouch.preflight import Preflight, check_legibility, examine
from modaltouch.protocol import Findings, Schedule
from modaltouch.window import WindowOptions
from modaltouch.window.opening import smallest_type
from modaltouch.window.typesetting import Typesetter

Edit = Callable[..., Path]
TEXTS, BEAM = "texts/english.yaml", "apparatus/beam_100x6x2.yaml"


def faults(preflight: Preflight, file: Path, window: WindowOptions | None = None) -> list[str]:
    """Return what is illegible, with its place."""
    problems = check_legibility(preflight, window).problems
    return [str(problem).replace(f"{file.parent}/", "") for problem in problems]


@pytest.mark.parametrize(
    ("written", "told"),
    [("\U0010fffd", "'\\U0010fffd' (a control or unnamed character)"), ("\t", "'\\t' (a tab)")],
)
def test_a_letter_without_a_font_is_reported_at_its_place(edit: Edit, written: str, told: str) -> None:
    """The fault has line and column of the text; a private-use character is in no font."""
    texts = edit(TEXTS, ("question: Where did", f"question: Where {written} did"))
    file = texts.parents[1] / "demo.yaml"
    (fault,) = faults(examine(file), file)
    line = [row.startswith("question:") for row in texts.read_text(encoding="utf-8").splitlines()].index(True) + 1
    assert fault.startswith(f"{TEXTS}:{line}:11: question: given {told}, which no installed font")
    assert "modaltouch doctor" in fault


def test_a_missing_font_file_is_reported_at_its_place(edit: Edit) -> None:
    """The fault gives the file as written, and that the key is optional."""
    file = edit(TEXTS, ("language_code: en", "language_code: en\nfont: Nowhere.ttf")).parents[1] / "demo.yaml"
    assert faults(examine(file), file)[0] == (
        f"{TEXTS}:6:7: font: given Nowhere.ttf, which is not installed; allowed: the file of an installed font; "
        "install it, or leave the key out"
    )


@pytest.mark.parametrize("language", ["english", "french", "german", "arabic", "chinese"])
def test_every_letter_of_the_shipped_texts_has_a_font(language: str) -> None:
    """No letter is missing where the packages that `doctor` lists are installed."""
    text = (Path(__file__).parents[2] / "protocols" / "texts" / f"{language}.yaml").read_text(encoding="utf-8")
    assert Typesetter().lacking(text) == ""


def test_the_smallest_type_is_20_arcmin_at_the_stated_distance(edit: Edit) -> None:
    """Progress text, 2.8 % of the height, capitals of 0.714 em: by the tangent, just under 21 and 20 arcmin."""
    height = 0.028 * 1080 * 0.714 * 531 / 1920
    near = height / (2 * math.tan(math.radians(20.5 / 60) / 2))
    screen = f"\nscreen: {{width_mm: 531, width_px: 1920, height_px: 1080, distance_mm: {near:.1f}}}\n\ntwin:"
    file = edit(BEAM, ("\ntwin:", screen)).parents[1] / "demo.yaml"
    preflight = examine(file)
    assert faults(preflight, file) == []
    (fault,) = faults(preflight, file, WindowOptions((1280, 800)))
    assert fault.endswith(
        f"in which a capital of '11 of 99' is {20.5 * 800 / 1080:.1f} arcmin high; allowed: at least 20 arcmin; "
        "shorten the text, take a larger window (--fullscreen), or sit nearer"
    )
    assert " screen: given a window of 1280 x 800 pixels" in fault


def test_the_labels_of_three_adjacent_fingers_are_measured() -> None:
    """A finger name is as large on adjacent zones as on separate ones, since adjacent labels move outwards."""
    experiment = Findings.read(Path(__file__).parents[2] / "docs/examples/protocol_three_fingers.yaml").experiment()
    trials = {trial.condition.zones: trial for trial in Schedule.draw(experiment.protocol, "p01", 1).trials}
    zones = experiment.apparatus.zone_spans
    near, far = (
        smallest_type(experiment.protocol, experiment.texts, zones, [trials[tuple(own)]], (1280, 800))
        for own in ("BCD", "ACE")
    )
    assert near[1].endswith("index finger")
    assert near[0] == far[0]


def test_every_question_of_a_session_is_checked(edit: Edit) -> None:
    """The labels of a scale in the final form are checked, where they are the smallest text of all screens."""
    words = f"very low {'and lower ' * 12}"
    texts = edit(TEXTS, ("very_low: not at all", f"very_low: {words}"))
    file = texts.parents[1] / "magnitude.yaml"
    beam = texts.parents[1] / BEAM
    screen = "screen: {width_mm: 531, width_px: 1920, height_px: 1080, distance_mm: 700}\n"
    beam.write_text(beam.read_text(encoding="utf-8") + screen, encoding="utf-8")
    (fault,) = faults(examine(file), file)
    assert f"in which a capital of '{words.strip()}' is" in fault
