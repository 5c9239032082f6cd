"""Mistakes that people make in a protocol: each is reported once, at its own place, with a remedy that works."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from modaltouch.preflight import examine
from modaltouch.protocol import Findings

Edit = Callable[..., Path]
FILE = "differentiated_stimulation.yaml"
BEAM = "apparatus/beam_100x6x2.yaml"
ENGLISH = "texts/english.yaml"
LEVELS = "peak_velocities_mm_s: [80, 100, 150, 200]"
PAIRS = "zone_pairs: [[A, C], [B, D], [C, E]]"


def found(file: Path) -> list[tuple[int, str, str]]:
    """Return line, path and remedy of each problem."""
    return [(each.line, each.path, each.remedy) for each in Findings.read(file).problems]


def line_of(file: Path, words: str) -> int:
    """Return the line of a file in which the words first occur."""
    return next(n for n, line in enumerate(file.read_text(encoding="utf-8").split("\n"), 1) if words in line)


@pytest.mark.parametrize(
    ("old", "new", "path", "remedy"),
    [
        (LEVELS, "peak_velocities_mm_s: ['80; 160']", "conditions.peak_velocities_mm_s[0]",
         "write each number by itself, as in 80, 160"),
        (LEVELS, "peak_velocities_mm_s: 80, 160", "conditions.peak_velocities_mm_s", "write [80, 160]"),
        (LEVELS, "peak_velocities_mm_s: 80", "conditions.peak_velocities_mm_s", "write [80]"),
        ("left: [left, num_4]", "left: LEFT", "answers.keys.left", "write names in brackets, as in [left, num_4]"),
        (LEVELS, "peak_velocities_mm_s: 80 mm/s", "conditions.peak_velocities_mm_s",
         "write only the number: 80; the unit is part of the key"),
        (LEVELS, "peak_velocities_mm_s: [80 -5]", "conditions.peak_velocities_mm_s[0]", ""),
        ("repetitions: 1\n", "repetitions: 50%\n", "schedule.repetitions", "write only the number: 50"),
        ("repetitions: 1\n", "repetitions: 1 000\n", "schedule.repetitions", ""),
        ("pause_s: 1.5", "pause_s: 1;5", "answers.pause_s", ""),
        ("duration_ms: 50\n", "duration_ms: 50%\n", "stimulus.duration_ms", "write the number in ms, without the unit"),
        ("left: [left, num_4]", "left: [arrow_left]", "answers.keys.left[0]", "write one of these"),
        ("focus: C", "focus: *centre", "", ""),
        ("focus: C", "focus: !!str C", "", "remove the tag"),
        ("  keys:\n", "  key:\n", "answers.key", "did you mean 'keys'?"),
        ("duration_ms: 50\n", "duration_ms: 500\n", "stimulus.duration_ms",
         "shorten the burst or repeat it less often, or set generator.repetition to continuous"),
        ("repetition_rate_Hz: 7", "repetition_rate_Hz: 50", "stimulus.repetition_rate_Hz",
         "shorten the burst or repeat it less often, or set generator.repetition to continuous"),
    ],
)  # fmt: skip
def test_a_mistake_in_a_protocol_is_reported_once(edit: Edit, old: str, new: str, path: str, remedy: str) -> None:
    """Neither the missing key that is only misspelt nor the value behind a tag is a second fault."""
    changes = [(old, new)] if "500" not in new else [(old, new), ("n_samples: 125000", "n_samples: 130000")]
    file = edit(FILE, *changes)
    assert found(file) == [(line_of(file, new.strip()), path, remedy)]


def test_a_condition_misspelt_under_ways_is_reported_once(edit: Edit) -> None:
    """Not that the condition has no way to answer as well; another one that has none is still found."""
    own = (
        "finger_conditions: [mine, other]\n  fingers: {mine: [left index, right index], other: [left ring, right ring]}"
    )
    file = edit(
        FILE, ("finger_conditions: [one_hand, two_hands]", own), ("  keys:\n", "  ways: {mne: lifting}\n  keys:\n")
    )
    problems = Findings.read(file).problems
    assert [(each.path, each.remedy) for each in problems if "answers" in each.path] == [
        ("answers", "write `ways: {other: lifting}` under answers"),
        ("answers.ways.mne", "did you mean 'mine'?"),
    ]


def test_a_misspelt_key_elsewhere_does_not_hide_a_missing_one(edit: Edit) -> None:
    """Both are reported in one run."""
    paths = [path for _, path, _ in found(edit(FILE, (f"  {PAIRS}\n", ""), ("duration_ms:", "durations_ms:")))]
    assert paths == ["stimulus.durations_ms", "conditions"]


@pytest.mark.parametrize(
    ("name", "old", "new", "path", "remedy"),
    [
        (
            BEAM,
            "damping_ratio: 0.0437",
            "damping_ratio: 4.37 %",
            "modes[0].damping_ratio",
            "write it as a share: 0.0437",
        ),
        (ENGLISH, "  - while you see one of the numbers\n", "", "vibrates", ""),
        (ENGLISH, "feel: Feel the beam", "feel: Feel the {beam}", "feel", "leave the others out"),
    ],
)
def test_a_mistake_in_a_named_file_is_reported_once(
    edit: Edit, name: str, old: str, new: str, path: str, remedy: str
) -> None:
    """A percentage becomes a share; a list that is too short does not invalidate the text that uses it."""
    edit(name, (old, new))
    assert [(own, told) for _, own, told in found(edit(FILE))] == [(path, remedy)]


def test_a_beam_without_modes_is_not_a_fault_of_the_selection(edit: Edit) -> None:
    """The empty list alone is reported, not that 6 is more than its 0 modes."""
    text = edit(BEAM).read_text(encoding="utf-8")
    begin, end = text.index("modes:\n"), text.index("\namplifier:")
    edit(BEAM, (text[begin:end], "modes: []\n"))
    assert [path for _, path, _ in found(edit(FILE))] == ["modes"]


@pytest.mark.parametrize(
    ("selected", "given"),
    [
        ("60", "60, more than the 9 modelled modes"),
        ("[1, 99]", "99, which is not a modelled mode"),
        ("8\n  decomposed_modes: 7", "8, more than the 7 decomposed modes"),
        ("[1, 9]\n  decomposed_modes: 7", "9, which is beyond the 7 decomposed modes"),
    ],
)
def test_a_mode_that_cannot_be_selected_has_one_reason(edit: Edit, selected: str, given: str) -> None:
    """The beam's table has nine modes up to label 17; raising `decomposed_modes` would not help beyond them."""
    text = edit(FILE).read_text(encoding="utf-8")
    line = next(each for each in text.split("\n") if "selected_modes" in each)
    other = next(each for each in text.split("\n") if "decomposed_modes" in each)
    file = edit(FILE, (other + "\n", ""), (line, f"  selected_modes: {selected}"))
    assert [each.given for each in Findings.read(file).problems] == [given]


@pytest.mark.parametrize(
    ("old", "new"), [("", ""), ("modes:\n", "modez:\n"), ("label: 1,", "label: one,")], ids=["file", "modes", "label"]
)
@pytest.mark.parametrize(
    ("selected", "path"), [("8", "stimulus.selected_modes"), ("[1, 3, 15]", "stimulus.selected_modes[2]")]
)
def test_modes_that_are_not_decomposed_are_reported_beside_a_fault_of_the_beam(
    edit: Edit, selected: str, path: str, old: str, new: str
) -> None:
    """The number of decomposed modes is in the protocol itself."""
    if old:
        edit(BEAM, (old, new))
    changes = ("selected_modes: 6", f"selected_modes: {selected}"), ("decomposed_modes: 50", "decomposed_modes: 6")
    file = edit(FILE, *changes, *([] if old else [("apparatus/beam", "apparatus/nobeam")]))
    problems = Findings.read(file).problems
    assert len(problems) == 2
    assert path in [each.path for each in problems if "6 decomposed modes" in each.given]


def test_the_faults_of_every_stimulus_come_with_all_others(edit: Edit) -> None:
    """An unknown focus of one stimulus does not wait until a faulty key and another stimulus are corrected."""
    stimuli = "\nstimuli: {one: {}, two: {focus: Q}, three: {repetition_rate_Hz: 300}}\n\nconditions:"
    file = edit(FILE, ("\nconditions:", stimuli), ("left: [left, num_4]", "left: [lft]"))
    paths = [problem.path for problem in examine(file).problems]
    assert paths == ["stimuli.two.focus", "stimuli.three.repetition_rate_Hz", "answers.keys.left[0]"]


def test_the_faults_of_every_stimulus_are_found_beside_those_of_the_beam(edit: Edit) -> None:
    """A wrong number in the apparatus file hides neither, and nothing is computed from it."""
    edit(BEAM, ("length_mm: 100", "length_mm: ten"))
    file = edit(FILE, ("\nconditions:", "\nstimuli: {one: {}, two: {focus: Q}}\n\nconditions:"))
    assert [problem.path for problem in examine(file).problems] == ["beam.length_mm", "stimuli.two.focus"]
