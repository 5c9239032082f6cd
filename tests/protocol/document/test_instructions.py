"""The shipped instructions and question follow the design in every language: fingers, intervals and task."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from modaltouch.protocol import Findings
from modaltouch.protocol.texts import Texts

Edit = Callable[..., Path]
LANGUAGES = ("arabic", "chinese", "english", "french", "german")
ONE = ("finger_conditions: [one_hand]", "finger_conditions: [tip]\n  fingers: {tip: [right index]}")
THREE = (
    "finger_conditions: [one_hand]",
    "finger_conditions: [one_hand]\n  fingers: {one_hand: [left index, right index, right middle]}",
)
DESIGNS: dict[str, tuple[str, list[tuple[str, str]], int, int]] = {
    "where": ("demo.yaml", [], 1, 2),
    "comparison": ("comparison_2ifc.yaml", [], 2, 2),
    "which_vibrated": (
        "comparison_2ifc.yaml", [("{velocity_mm_s: 100}", "{velocity_mm_s: 0}"), ("stronger   ", "comparison ")], 4, 2
    ),
    "odd_one": (
        "comparison_2ifc.yaml",
        [
            ("number: 2", "number: 3"),
            ("second: [right, num_2]", "second: [up], third: [right]"),
            ("second: 2", "second: 2, third: 3"),
            ("stronger   ", "comparison "),
        ],
        3,
        2,
    ),
    "same_different": (
        "comparison_2ifc.yaml",
        [
            ("{first: [left, num_1], second:", "{same: [left], different:"),
            ("{first: 1, second: 2}", "{same: same, different: different}"),
        ],
        2,
        2,
    ),
    "detection": ("detection_with_confidence.yaml", [ONE, ("zone_pairs: [[A, C]]", "zones: [[C]]")], 1, 1),
    "magnitude": ("magnitude.yaml", [], 1, 2),
    "strength": ("magnitude.yaml", [("{kind: number}", "{kind: vas}")], 1, 2),
}  # fmt: skip


def fitted(file: Path, language: str) -> tuple[Texts, Texts]:
    """Return the texts of a language as written, and as shown in a session of the protocol."""
    file.write_text(file.read_text(encoding="utf-8").replace("english", language), encoding="utf-8")
    findings = Findings.read(file)
    assert findings.texts is not None
    return findings.texts.require(), findings.experiment().texts


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("task", DESIGNS)
def test_instructions_and_question_follow_the_design(task: str, language: str, edit: Edit) -> None:
    """Every placeholder of the instructions is filled with the words for the design."""
    name, changes, vibrates, n_fingers = DESIGNS[task]
    texts, shown = fitted(edit(name, *changes), language)
    assert texts.vibrates is not None and texts.n_fingers is not None
    wanted = {"vibrates": texts.vibrates[vibrates - 1], "n_fingers": texts.n_fingers[n_fingers - 1]}
    assert shown.instructions == texts.instructions.format(**wanted, asked=texts.asked[task])
    assert shown.question == (texts.question if task == "where" else texts.further[task])


@pytest.mark.parametrize("language", LANGUAGES)
def test_only_filled_in_texts_give_the_number_of_fingers(language: str) -> None:
    """A session with one finger must not mention several fingers."""
    texts = Findings.read("demo").texts
    assert texts is not None
    words = yaml.safe_load(texts.source.path.with_name(f"{language}.yaml").read_text(encoding="utf-8"))
    several = {
        "arabic": "أصابع|إصبعين", "chinese": "把手指|让手指|两根", "english": "fingers", "french": "doigts",
        "german": r"\bFinger\b",
    }  # fmt: skip
    told = {key for key, text in words.items() if re.search(several[language], re.sub("{.*?}", "", str(text)))}
    assert told - {"fingers", "place_fingers"} == {"n_fingers"}


def test_a_custom_question_is_asked_as_written(edit: Edit) -> None:
    """The instructions then describe the task only in general."""
    file = edit("magnitude.yaml", ("  scale:", "  question: How rough was it?\n  scale:"))
    texts, shown = fitted(file, "english")
    assert shown.instructions.endswith(f"each time, {texts.asked['other']}.")
    findings = Findings.read(file).experiment()
    assert findings.protocol.answers.question == "How rough was it?"


def test_a_varying_number_of_fingers_is_left_to_the_picture(edit: Edit) -> None:
    """The instructions then say "the fingers shown on it"."""
    cells = "cells: [{pair: [C], peak_velocities_mm_s: [20], finger_conditions: [tip]}, "
    cells += "{pair: [A, C], peak_velocities_mm_s: [20], finger_conditions: [one_hand]}]"
    changes = [
        ("finger_conditions: [one_hand]", "finger_conditions: [tip, one_hand]\n  fingers: {tip: [right index]}"),
        ("zone_pairs: [[A, C]]\n  peak_velocities_mm_s: [5, 10, 20, 40]", cells),
    ]
    assert (
        "the fingers shown on it" in fitted(edit("detection_with_confidence.yaml", *changes), "english")[1].instructions
    )


def test_texts_without_placeholders_are_shown_as_written(edit: Edit) -> None:
    """A placeholder without words to fill it is a fault."""
    file = edit("demo.yaml")
    words = file.parent / "texts" / "english.yaml"
    text = words.read_text(encoding="utf-8")
    words.write_text(re.sub(r"n_fingers: \[.*\n", "", text), encoding="utf-8")
    (problem,) = Findings.read(file).problems
    assert problem.path == "instructions" and "{n_fingers}" in problem.given
    words.write_text(re.sub(r"instructions: \|-\n(  .*\n)+", "instructions: Feel it.\n", text), encoding="utf-8")
    assert Findings.read(file).experiment().texts.instructions == "Feel it."
