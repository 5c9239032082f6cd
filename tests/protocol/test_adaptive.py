"""Faults of adaptive protocols, with positions and allowed values."""

from __future__ import annotations

from pathlib import Path

import pytest

from modaltouch.preflight import examine

SHIPPED = Path(__file__).parents[2] / "protocols" / "threshold.yaml"


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("[2, 200]", "[2, 80, 200]", "conditions.peak_velocities_mm_s", "3 levels, but runs are adaptive"),
        ("[2, 200]", "[200, 2]", "conditions.peak_velocities_mm_s", "the lowest level first"),
        ("start_mm_s: 60", "start_mm_s: 600", "adaptive.start_mm_s", "2 to 200 mm/s"),
        (
            "[[A, C], [C, E]]",
            "[[A, C], [B, D]]",
            "conditions.zone_pairs[1]",
            "without the focus, but success is naming the focus",
        ),
        ("order: by_pair", "order: latin_square", "schedule.order", "shuffled or by_pair"),
        ("order: by_pair", "order: by_pair\n  repetitions: 3", "schedule.repetitions", "adaptive.trials sets"),
        ("    none: [down, num_2]\n", "", "adaptive.success", "no answer says that nothing was felt"),
        ("[2, 200]", "[0.5, 200]", "conditions.peak_velocities_mm_s[0]", "the generator's smallest amplitude"),
        ("method: quest_plus", "method: quest", "adaptive.method", "quest_plus"),
        ("trials: 40", "trials: 4", "adaptive.trials", "8"),
        ("lapse_rate: 0.06", "lapse_rate: 0.5", "adaptive.lapse_rate", "0.2"),
    ],
)
def test_each_fault_has_its_position(tmp_path: Path, old: str, new: str, place: str, words: str) -> None:
    """With the given and the allowed values."""
    text = SHIPPED.read_text(encoding="utf-8").replace(old, new)
    for name in ("apparatus/", "texts/"):
        text = text.replace(f": {name}", f": {SHIPPED.parent / name}/")
    if place == "adaptive.success":
        text = text.replace("success: focus_named", "success: felt")
    file = tmp_path / "threshold.yaml"
    file.write_text(text, encoding="utf-8")
    problems = [str(problem) for problem in examine(file).problems]
    assert len(problems) == 1, problems
    assert f" {place}: " in problems[0]
    assert words in problems[0]


def test_the_shipped_protocol_is_valid() -> None:
    """Two runs of 40 trials and ten catch trials."""
    preflight = examine(SHIPPED).require()
    assert preflight.experiment.protocol.n_trials == 90
    assert [each["velocity_mm_s"] for each in preflight.stimuli] == [2, 200]


def test_allowed_successes_are_listed_once(tmp_path: Path) -> None:
    """Even if an answer has the name of a rule."""
    text = SHIPPED.read_text(encoding="utf-8").replace("success: focus_named", "success: sure")
    for name in ("apparatus/", "texts/"):
        text = text.replace(f": {name}", f": {SHIPPED.parent / name}/")
    keys = "  keys: {felt: [up], not_felt: [down]}\n  fingers: {not_felt: []}\n"
    file = tmp_path / "own.yaml"
    file.write_text(text[: text.index("  keys:")] + keys, encoding="utf-8")
    (problem,) = examine(file).problems
    assert "'sure', which is not a rule or an answer; allowed: focus_named, felt, correct, not_felt" in problem.message
