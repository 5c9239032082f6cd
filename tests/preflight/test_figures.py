"""The figures that `check` prints of a protocol, against calculations by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from modaltouch.preflight.results import design_figures_of, occasion_figures
from modaltouch.preflight.single_design import by_name, estimated_duration, finger_places
from modaltouch.protocol import Findings, Protocol

PROTOCOLS = Path(__file__).parents[2] / "protocols"


def protocol_of(name: str, **sections: dict[str, Any]) -> Protocol:
    """Return a shipped protocol, some keys of its sections changed."""
    protocol = Findings.read(PROTOCOLS / f"{name}.yaml").experiment().protocol
    changed = {section: getattr(protocol, section).model_copy(update=keys) for section, keys in sections.items()}
    return protocol.model_copy(update=changed)


@pytest.mark.parametrize(
    ("schedule", "seconds"),
    [
        # 13 trials of 0.3 s to the question, 1.5 s to the answer and a pause; 1 + 12 x 2/3 placements of 5 s; a break.
        ({}, 13 * (0.3 + 1.5 + 0.5) + 9 * 5 + 30 + 90),
        ({"break_after_trials": 5}, 13 * 2.3 + 9 * 5 + 2 * 30 + 90),
        ({"break_after_trials": 12}, 13 * 2.3 + 9 * 5 + 90),
        ({"break_after_trials": None}, 13 * 2.3 + 9 * 5 + 90),
        ({"break_after_trials": None, "practice_trials": 4}, 16 * 2.3 + 11 * 5 + 90),
        ({"break_after_trials": None, "repetitions": 10}, 121 * 2.3 + 81 * 5 + 90),
    ],
)
def test_the_duration_is_that_of_its_parts(schedule: dict[str, Any], seconds: float) -> None:
    """Trials, placements, breaks between trials, and 90 s of instructions, to a tenth of a minute."""
    answers = {"pause_s": 0.5, "settling_s": 0.5}
    assert estimated_duration(protocol_of("demo", schedule=schedule, answers=answers)) == round(seconds / 60, 1)


def test_a_stimulus_before_the_question_and_further_questions_take_their_time() -> None:
    """The longer of five bursts and the delay, a pause by finger condition on average, 1.5 s for each answer."""
    until = {"stimulus_until": "question", "presentation_bursts": 14, "presentation_s": None, "question_delay_s": 0.3}
    protocol = protocol_of(
        "demo", answers=until | {"pause_s": 0.5, "settling_s": 2.5}, schedule={"break_after_trials": None}
    )
    settles = [protocol.answers.settles(name) for name in protocol.conditions.finger_conditions]
    pause = 0.5 + 2.0 * sum(settles) / len(settles)
    assert sorted(settles) == [False, True]
    assert estimated_duration(protocol) == round((13 * (2.0 + 1.5 + pause) + 9 * 5 + 90) / 60, 1)
    asked = protocol.answers.model_copy(update={"then": {"sure": object(), "near": object()}})
    longer = protocol.model_copy(update={"answers": asked, "form": {"dizzy": object()}})
    assert estimated_duration(longer) == round((13 * (2.0 + 3 * 1.5 + pause) + 1.5 + 9 * 5 + 90) / 60, 1)


def test_intervals_and_their_gaps_take_their_time() -> None:
    """52 trials of two stimuli of five bursts at 7 Hz, 0.5 s apart, at one pair; a break after 24 of 48."""
    protocol = protocol_of("comparison_2ifc", answers={"pause_s": 1.0, "settling_s": 1.0})
    seconds = 52 * (2 * 5 / 7 + 0.5 + 1.5 + 1.0) + 5 + 30 + 90
    assert estimated_duration(protocol) == round(seconds / 60, 1)


def test_an_occasion_has_its_levels_and_numbers() -> None:
    """Of a faulty protocol only its group and kind of session are known."""
    findings = Findings.read(PROTOCOLS / "demo.yaml")
    told = occasion_figures(findings)
    assert told == {
        "group": "", "session_kind": "", "peak_velocities_mm_s": [80.0, 200.0], "n_trials": 12, "n_practice_trials": 1,
        "estimated_duration_min": estimated_duration(findings.experiment().protocol),
    }  # fmt: skip
    faulty = occasion_figures(replace(findings, protocol=None))
    assert faulty == {**dict.fromkeys(told), "group": "", "session_kind": ""}


def test_fingers_replace_the_centres_of_their_zones() -> None:
    """Each finger in the zone whose centre is nearest; the other zones keep their centres."""
    zones = {name: SimpleNamespace(centre_mm=centre) for name, centre in (("A", -40.0), ("B", -20.0), ("C", 0.0))}
    fingers = (SimpleNamespace(position=-0.0385), SimpleNamespace(position=0.003))
    inputs: Any = SimpleNamespace(apparatus=SimpleNamespace(ordered_zones=zones), fingers=fingers)
    np.testing.assert_allclose(finger_places(inputs), [-0.0385, -0.02, 0.003], rtol=1e-12)


def test_numbers_that_json_lacks_are_none() -> None:
    """Infinity and NaN (RFC 8259)."""
    assert by_name("abc", [1, math.inf, math.nan]) == {"a": 1.0, "b": None, "c": None}


def test_numbers_of_trials_are_those_of_the_protocol() -> None:
    """Catch trials of both finger conditions; thresholds whose levels are all allowed."""
    found = design_figures_of(protocol_of("with_catch_trials"))
    protocol = protocol_of("with_catch_trials")
    n_trials = len(protocol.conditions.zone_pairs) * 2 * len(protocol.conditions.peak_velocities_mm_s)
    assert found["n_catch_trials"] == 2 * protocol.schedule.catch_trials > 0
    assert found["n_trials"] == n_trials * protocol.schedule.repetitions + found["n_catch_trials"]
    assert found["n_practice_trials"] == protocol.schedule.practice_trials
    assert found["sensation_levels"] is None
    own = design_figures_of(protocol_of("sensation_levels"))["sensation_levels"]
    least, most = own["thresholds_mm_s"]
    levels = protocol_of("sensation_levels").conditions.peak_velocities_mm_s
    assert least * min(own["multiples"]) == pytest.approx(min(levels), rel=1e-3)
    assert most * max(own["multiples"]) == pytest.approx(max(levels), rel=1e-3)
    nobody = protocol_of("demo", conditions={"zone_pairs": ()})
    assert design_figures_of(nobody) == {}
