"""Trials of several intervals: place of the comparison, right answers, and faults."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from modaltouch.preflight import estimated_duration
from modaltouch.preflight.results import interval_warnings
from modaltouch.protocol import Findings, Protocol, Schedule, Trial
from modaltouch.protocol.intervals import draw_intervals
from modaltouch.protocol.stimulus_sections import IntervalsSection, StandardSection
from modaltouch.protocol.streams import Stream
from modaltouch.protocol.trial import Condition

Edit = Callable[..., Path]

FILE = "comparison_2ifc.yaml"


def protocol_of(path: Path) -> Protocol:
    """Return a valid protocol."""
    return Findings.read(path).experiment().protocol


@pytest.mark.parametrize(
    ("number", "places", "repetitions"), [(2, None, 3), (3, None, 4), (3, (2, 3), 5), (2, (2,), 3)]
)
def test_the_comparison_is_balanced_over_intervals(
    number: int, places: tuple[int, ...] | None, repetitions: int
) -> None:
    """Within each condition and each block, the counts of two intervals differ by at most one."""
    section = IntervalsSection(number=number, standard=StandardSection(velocity_mm_s=100), comparison_in=places)
    conditions = [Condition("one_hand", "A", "C", level) for level in (60.0, 90.0, 140.0)] * repetitions
    firsts = Counter[int]()
    for participant in range(60):
        drawn = draw_intervals(section, conditions, Stream(1, f"p{participant}", 1, "intervals"))
        assert set(drawn) == set(section.places)
        for taken in (drawn, *(drawn[first::3] for first in range(3))):
            counts = [taken.count(place) for place in section.places]
            assert max(counts) - min(counts) <= 1
        firsts[drawn[0]] += 1
    # Uniform: 60 participants, at least 10 for each place with all but 1e-3 of chance.
    assert min(firsts.values()) >= 10 and len(firsts) == len(section.places)


def test_intervals_have_their_own_random_stream(shipped: Path) -> None:
    """The order of conditions is the same without the section; the record has purpose and interval."""
    protocol = protocol_of(shipped / FILE)
    schedule = Schedule.draw(protocol, "p01", 7)
    single = Schedule.draw(protocol.model_copy(update={"intervals": None}), "p01", 7)
    assert [trial.condition for trial in schedule.trials] == [trial.condition for trial in single.trials]
    assert {"intervals within one_hand", "intervals within practice"} <= schedule.seeds["purposes"].keys()
    assert "intervals within one_hand" not in single.seeds["purposes"]
    assert [brief[-1] for brief in schedule.as_dict()["order"]] == [trial.interval for trial in schedule.trials]
    assert "interval" not in single.trials[0].as_dict()


def test_the_other_intervals_have_the_standard(shipped: Path) -> None:
    """With a comparison of 140 mm/s in the second of three, the first and third have 100 mm/s."""
    protocol = protocol_of(shipped / FILE)
    section = IntervalsSection(number=3, standard=StandardSection(velocity_mm_s=100))
    trial = Trial(1, 1, Condition("one_hand", "A", "C", 140.0), interval=2)
    parts = protocol.model_copy(update={"intervals": section}).presented(trial)
    assert [part.condition.velocity_mm_s for part in parts] == [100.0, 140.0, 100.0]


@pytest.mark.parametrize(
    ("asked", "level", "interval", "right"),
    [
        ("stronger", 140.0, 2, 2),
        ("stronger", 70.0, 2, 1),
        ("stronger", 70.0, 1, 2),
        ("stronger", 100.0, 1, None),
        ("comparison", 70.0, 1, 1),
        ("comparison", 100.0, 1, None),
    ],
)
def test_the_right_answer_names_the_stronger_or_the_comparison_interval(
    asked: str, level: float, interval: int, right: int | None
) -> None:
    """If standard and comparison are equal, no answer is right or wrong."""
    section = IntervalsSection(asked=asked, standard=StandardSection(velocity_mm_s=100))
    condition = Condition("one_hand", "A", "C", level)
    found = [section.is_correct(meaning, condition, interval) for meaning in (1, 2)]
    assert found == ([None, None] if right is None else [right == 1, right == 2])


def test_same_is_right_if_level_and_stimulus_are_equal() -> None:
    """Other answers are neither right nor wrong."""
    section = IntervalsSection(standard=StandardSection(velocity_mm_s=100, stimulus="sharp"))
    cases = ((100.0, "sharp", "same"), (100.0, "blunt", "different"), (120.0, "sharp", "different"))
    for level, stimulus, right in cases:
        condition = Condition("one_hand", "A", "C", level, stimulus=stimulus)
        for meaning in ("same", "different"):
            assert section.is_correct(meaning, condition, 1) is (meaning == right)
        assert section.is_correct(None, condition, 1) is None


def test_the_duration_includes_every_interval_and_gap(edit: Edit) -> None:
    """52 trials with another 5 bursts at 7 Hz and a gap: 52 (5/7 + 0.5) s = 1.05 min; with 3 s, 3.2 min."""
    two = protocol_of(edit(FILE))
    single = estimated_duration(two.model_copy(update={"intervals": None}))
    assert estimated_duration(two) - single == pytest.approx(52 * (5 / 7 + 0.5) / 60, abs=0.11)
    longer = protocol_of(edit(FILE, ("gap_s: 0.5", "gap_s: 3.0")))
    assert estimated_duration(longer) - single == pytest.approx(52 * (5 / 7 + 3.0) / 60, abs=0.11)


LEVELS = "peak_velocities_mm_s: [70, 80, 90, 110, 125, 140]"
STANDARD = "standard: {velocity_mm_s: 100}"
MEANINGS = "intervals: {first: 1, second: 2}"
ADAPTIVE = "adaptive: {method: staircase, trials: 8, start_mm_s: 130, success: correct"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            [(STANDARD, "standard: {}")],
            "intervals.standard: given neither a level nor a stimulus; allowed: velocity_mm_s",
        ),
        (
            [(STANDARD, "standard: {stimulus: blunt}")],
            "'blunt', but there is no section stimuli; allowed: null",
        ),
        ([("\n  number: 2\n", "\n  number: 4\n")], "given 4; allowed: a whole number of at least 2, at most 3"),
        (
            [
                (
                    LEVELS,
                    "peak_velocities_mm_s: [10, 140]\n  sensation_levels: {thresholds_from: t, multiples: [1.5, 3]}",
                )
            ],
            "given 100 mm/s, where levels are multiples of each participant's own threshold; allowed: null or 0",
        ),
        ([("stimulus_until: question", "stimulus_until: answer")], "given answer, but a trial has several intervals"),
        ([("practice_trials: 4", "catch_trials: 4")], "given 4, but a trial has several intervals; allowed: 0"),
        ([(MEANINGS, "intervals: {first: 1, second: 3}")], "given 3, but a trial has 2 intervals; allowed: 1 to 2"),
        ([(MEANINGS, "intervals: {first: 1, second: 1}")], "answers.intervals.second: given 1 again"),
        (
            [(MEANINGS, "intervals: {first: 1}")],
            "answers.intervals: given no answer for interval 2, which may hold the comparison; allowed: an answer for",
        ),
        (
            [(MEANINGS, "intervals: {first: same}")],
            "answers.intervals: given same alone, so that the other answer is never right; allowed: same and different",
        ),
        (
            [(MEANINGS, "intervals: {first: 1, second: different}")],
            "answers.intervals.second: given different together with the number of an interval; allowed: only",
        ),
        (
            [("schedule:", ADAPTIVE.replace("correct", "felt") + "}\nschedule:")],
            "no answer says that nothing was felt; allowed: correct; count `correct`",
        ),
        ([(MEANINGS, "intervals: {frist: 1, second: 2}")], "given 'frist', which has no keys"),
        ([("asked: stronger ", "comparison_in: [2] ")], "but levels lie both below and above the standard of 100 mm/s"),
        (
            [(STANDARD, "standard: {velocity_mm_s: 100000}")],
            "intervals.standard.velocity_mm_s: given 100000 mm/s, above",
        ),
        (
            [("intervals:\n  number: 2", "speech:\n  number: 2")],
            "answers.intervals: given meanings of answers, but a",
        ),
        (
            [("schedule:", ADAPTIVE + ", guess_rate: 0.1}\nschedule:")],
            "but one of 2 intervals is named; allowed: 0.5",
        ),
        (
            [("schedule:", ADAPTIVE + ", guess_rate: 0.5}\nschedule:")],
            "a staircase that converges to 0.5, the rate of guessing",
        ),
        (
            [("schedule:", ADAPTIVE.replace("correct", "corect") + "}\nschedule:")],
            "'corect', which is not a rule or an",
        ),
        (
            [("schedule:", ADAPTIVE.replace("correct", "first") + ", guess_rate: 0.5}\nschedule:")],
            "given first, but the comparison is not always in that interval; allowed: correct",
        ),
        (
            [
                ("asked: stronger ", "comparison_in: [2]\n  asked: stronger "),
                ("schedule:", ADAPTIVE.replace("correct", "first") + ", guess_rate: 0.5}\nschedule:"),
            ],
            "given first, but the comparison is not always in that interval; allowed: correct",
        ),
    ],
)
def test_incompatible_settings_are_refused(edit: Edit, changes: list[tuple[str, str]], said: str) -> None:
    """With the given and the allowed values."""
    found = [str(problem) for problem in Findings.read(edit(FILE, *changes)).problems]
    assert any(said in problem for problem in found), found


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ([], None),
        ([(MEANINGS, "pause_s: 1")], "no answer refers to an interval, so none is right"),
        ([(LEVELS, LEVELS.replace("90", "100"))], None),
        (
            [(LEVELS, LEVELS.replace("90", "100")), ("asked: stronger ", "asked: comparison ")],
            "in 1 of 6 cells: all intervals",
        ),
        ([(MEANINGS, "intervals: {first: same, second: different}")], "0 of 6 cells: `same` is right in no trial"),
    ],
)
def test_trials_without_a_right_answer_cause_a_warning(
    edit: Edit, changes: list[tuple[str, str]], said: str | None
) -> None:
    """Three equal intervals have no odd one; two equal levels in a comparison are usual."""
    found = interval_warnings(protocol_of(edit(FILE, *changes)))
    assert [said] == [said for each in found if said and said in each] if said else found == []


def test_a_silent_standard_needs_single_bursts(edit: Edit) -> None:
    """As catch trials do."""
    file = edit(FILE, (STANDARD, "standard: {velocity_mm_s: 0}"))
    assert Findings.read(file).problems == ()
    edit("apparatus/beam_100x6x2.yaml", ("\ngenerator:\n", "\ngenerator:\n  repetition: continuous\n"))
    said = [str(problem) for problem in Findings.read(file).problems]
    assert any("intervals.standard.velocity_mm_s: given silence, but the generator's" in each for each in said), said
