"""Whole bursts: durations, bursts too long for single triggers, and limits of the kinds of repetition."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modaltouch.preflight import examine
from modaltouch.protocol import Findings
from modaltouch.protocol.sections import AnswersSection, whole_bursts

Edit = Callable[..., Path]
FILE = "differentiated_stimulation.yaml"
BEAM = "apparatus/beam_100x6x2.yaml"
LENGTH = "presentation_s: 2.0 "
SLOW = ("\nconditions:", "\nstimuli:\n  fast: {law: exact}\n  slow: {repetition_rate_Hz: 5}\n\nconditions:")


def faults(file: Path) -> list[str]:
    """Return the faults of a protocol and its files."""
    return [str(problem).replace(str(file.parent) + "/", "") for problem in Findings.read(file).problems]


def repeating(edit: Edit, repetition: str) -> None:
    """Set `generator.repetition` of the shipped apparatus."""
    edit(BEAM, ("load: high_impedance", f"repetition: {repetition}\n  load: high_impedance"))


@pytest.mark.parametrize(
    ("seconds", "given", "allowed"),
    [
        ("0.1", "0.1 s, which is 0.7 bursts at 7 per second", "0.14286 s (1 burst), or more"),
        ("0.142", "0.142 s, which is 0.994 bursts", "0.14286 s (1 burst), or more"),
        ("1.9", "1.9 s, which is 13.3 bursts at 7 per second", "1.8571 s (13 bursts) or 2 s (14 bursts)"),
        ("2.001", "2.001 s, which is 14.01 bursts", "2 s (14 bursts) or 2.1429 s (15 bursts)"),
        ("0.15", "0.15 s, which is 1.05 bursts", "0.14286 s (1 burst) or 0.28571 s (2 bursts)"),
    ],
)
def test_a_duration_must_be_whole_bursts(edit: Edit, seconds: str, given: str, allowed: str) -> None:
    """At 7 Hz a burst and its silence last 142.857 ms; the message has the nearest allowed durations."""
    assert faults(edit(FILE, (LENGTH, f"presentation_s: {seconds} "))) == [
        f"{FILE}:37:19: answers.presentation_s: given {given}"
        f"{'' if 'per' in given else ' at 7 per second'}; allowed: whole bursts: {allowed}; "
        "or give `presentation_bursts`"
    ]


@pytest.mark.parametrize("seconds", ["2.0", "0.142857", "0.143", "1.8571", "1.857"])
def test_rounded_durations_are_accepted(edit: Edit, seconds: str) -> None:
    """Within half a hundredth of a burst: 0.143 s are 1.001 bursts."""
    assert faults(edit(FILE, (LENGTH, f"presentation_s: {seconds} "))) == []


@given(st.integers(1, 200), st.sampled_from([0.5, 3.0, 5.0, 7.0, 12.5]))
def test_suggested_durations_are_accepted(n_bursts: int, rate: float) -> None:
    """A number of bursts, as a duration of five digits, gives that number again."""
    assert whole_bursts(float(f"{n_bursts / rate:.5g}"), rate) == n_bursts


@pytest.mark.parametrize(
    ("seconds", "fault"),
    [
        ("2.0", ""),
        ("1.0", ""),
        ("1.857143", "9.286 bursts at 5 per second; allowed: whole bursts: 1.8 s (9 bursts) or 2 s (10 bursts)"),
        ("1.8", "12.6 bursts at 7 per second; allowed: whole bursts: 1.7143 s (12 bursts) or 1.8571 s (13 bursts)"),
    ],
)
def test_a_duration_must_be_whole_bursts_of_every_stimulus(edit: Edit, seconds: str, fault: str) -> None:
    """At 7 and 5 Hz: whole seconds fit both; any other duration is one fault."""
    found = faults(edit(FILE, SLOW, (LENGTH, f"presentation_s: {seconds} ")))
    assert len(found) == bool(fault)
    assert fault in "".join(found)


def test_a_stimulus_with_its_own_number_of_bursts_may_have_any_rate(edit: Edit) -> None:
    """1.8 s are 9 bursts at 5 Hz and no whole number at 7 Hz, where each stimulus has its own number."""
    own = SLOW[0], SLOW[1].replace("law: exact", "presentation_bursts: 4")
    until = "stimulus_until: answer", "stimulus_until: question"
    assert faults(edit(FILE, own, until, (LENGTH, "presentation_s: 1.8 "))) == []


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ([(LENGTH, "presentation_bursts: 3 ")], ""),
        ([(LENGTH, "presentation_bursts: 14\n  presentation_s: 2.0 ")], "given 14 bursts beside presentation_s, 2 s; "),
        ([(LENGTH, "presentation_bursts: 0 ")], "given 0; allowed: a whole number of at least 1"),
        ([(LENGTH, "presentation_bursts: 2.5 ")], "given 2.5; allowed: a whole number of at least 1"),
    ],
)
def test_the_length_of_a_stimulus_is_given_once(edit: Edit, changes: list[tuple[str, str]], fault: str) -> None:
    """As a whole number of bursts or as a duration."""
    found = faults(edit(FILE, *changes))
    assert len(found) == bool(fault)
    assert fault in "".join(found)
    if fault:
        assert found[0].startswith(f"{FILE}:37:24: answers.presentation_bursts: ")


@pytest.mark.parametrize(
    ("seconds", "fault"),
    [
        ("60", ""),
        ("10.142857", ""),
        (
            "10.1",
            "given 10.1 s, which is 70.7 bursts at 7 per second; allowed: whole bursts: 10 s (70 bursts) or 10.143",
        ),
        ("0.05", "given 0.05 s, which is 0.35 bursts at 7 per second; allowed: whole bursts: 0.14286 s (1 burst), or"),
    ],
)
def test_the_longest_presentation_must_be_whole_bursts(edit: Edit, seconds: str, fault: str) -> None:
    """It limits a stimulus that lasts until the answer, and is optional."""
    found = faults(edit(FILE, (LENGTH, f"longest_presentation_s: {seconds}\n  {LENGTH}")))
    assert len(found) == bool(fault)
    assert fault in "".join(found)
    assert all(each.endswith("; or leave it out") and ":37:27: answers.longest_" in each for each in found)


LONG = [
    (
        [("duration_ms: 50", "duration_ms: 138")],
        "16:16: stimulus.duration_ms: given 138 ms",
        "135.714 ms",
    ),
    (
        [("repetition_rate_Hz: 7", "repetition_rate_Hz: 19.5")],
        "19:23: stimulus.repetition_rate_Hz",
        "19 bursts per second",
    ),
    (
        [("\nconditions:", "\nstimuli:\n  a: {law: exact}\n  b: {repetition_rate_Hz: 19.5}\n\nconditions:")],
        "23:27: stimuli.b.repetition_rate_Hz: given 50 ms at 19.5 bursts per second",
        "19 bursts per second",
    ),
    (
        [("\nconditions:", "\ngroups:\n  a: {}\n  b: {stimulus: {repetition_rate_Hz: 19.5}}\n\nconditions:")],
        "23:38: groups.b.stimulus.repetition_rate_Hz: given 50 ms at 19.5 bursts per second",
        "19 bursts per second",
    ),
]


@pytest.mark.parametrize(("changes", "place", "longest"), LONG)
def test_bursts_too_long_for_single_triggers_are_refused(
    edit: Edit, changes: list[tuple[str, str]], place: str, longest: str
) -> None:
    """At most 95 % of the period if each burst is triggered separately; other repetitions have no such limit."""
    file = edit(FILE, *changes, (LENGTH, "presentation_bursts: 14 "))
    (found,) = faults(file)
    assert f".yaml:{place}" in found
    assert f"allowed: at most {longest}, so that a burst is over before the next is triggered; shorten" in found
    repeating(edit, "continuous")
    assert faults(file) == []


@pytest.mark.parametrize("rate", ["19", "18.9"])
def test_a_burst_of_95_percent_of_its_period_is_accepted(edit: Edit, rate: str) -> None:
    """50 ms at 19 Hz are 95.0 %."""
    changes = ("repetition_rate_Hz: 7", f"repetition_rate_Hz: {rate}"), (LENGTH, "presentation_bursts: 14 ")
    assert faults(edit(FILE, *changes)) == []


@pytest.mark.parametrize(("low", "high", "sound"), [(0.1, 0.3, True), (0.3, 0.3, True), (0.31, 0.3, False)])
def test_bounds_of_the_latency_must_be_in_order(edit: Edit, low: float, high: float, sound: bool) -> None:
    """As measured by `rig check`, the lower one first."""
    bounds = f"trigger_latency_ms: {{low: {low}, high: {high}}}"
    edit(BEAM, ("load: high_impedance", f"{bounds}\n  load: high_impedance"))
    found = faults(edit(FILE))
    assert len(found) == (not sound)
    place = f"{BEAM}:48:3: generator.trigger_latency_ms"
    said = "given low: 0.31, which is above high: 0.3; allowed: low below high; exchange them"
    assert all(each == f"{place}: {said}" for each in found)


@pytest.mark.parametrize(
    ("repetition", "refused"), [("single", False), ("timer", False), ("continuous", True), ("wired", True)]
)
def test_catch_trials_need_single_or_timed_bursts(edit: Edit, repetition: str, refused: bool) -> None:
    """External triggers or continuous playing move the beam as soon as the outputs are on."""
    repeating(edit, repetition)
    assert faults(edit(FILE)) == []
    found = faults(edit(FILE, ("practice_trials: 3", "catch_trials: 2\n  practice_trials: 3")))
    assert len(found) == refused
    given = f"{FILE}:31:17: schedule.catch_trials: given 2, but the generator's repetition is {repetition}; allowed: 0"
    assert all(each.startswith(given) and each.endswith("; set generator.repetition to single") for each in found)


@pytest.mark.parametrize(
    ("repetition", "read", "words"),
    [
        ("single", "single", []),
        ("timer", "timer", ["is timer: with the generator's free timer, the first burst is known to within a period"]),
        ("burst", "timer", ["is timer (`burst` is its former name): with the generator's free timer"]),
        (
            "continuous",
            "continuous",
            ["is continuous: with a continuous record, the first burst is known by its command"],
        ),
        ("wired", "wired", ["is wired: the pulse source at the trigger input counts the bursts; this program"]),
    ],
)
def test_the_check_warns_of_other_repetitions(edit: Edit, repetition: str, read: str, words: list[str]) -> None:
    """Each except `single` cannot promise something; the former name is read as `timer`."""
    repeating(edit, repetition)
    file = edit(FILE)
    assert Findings.read(file).experiment().apparatus.generator.repeats == read
    warned = [each for each in examine(file).as_dict()["warnings"] if "generator.repetition" in each]
    assert len(warned) == len(words)
    assert all(word in each for word, each in zip(words, warned, strict=True))
    assert all(each.endswith("; `single` promises all three") for each in warned)


@pytest.mark.parametrize(
    ("seconds", "rate", "n_bursts"),
    [(2.0, 7.0, 14), (0.143, 7.0, 1), (0.01, 7.0, 1), (1.93, 7.0, 14), (60.0, 5.0, 300)],
)
def test_bursts_nearest_to_a_time(seconds: float, rate: float, n_bursts: int) -> None:
    """At least one; 1.93 s are 13.51 periods."""
    assert whole_bursts(seconds, rate) == n_bursts


@pytest.mark.parametrize(
    ("given", "n_bursts"),
    [
        ({"stimulus_until": "question"}, 14),
        ({"stimulus_until": "question", "presentation_s": 1.0}, 7),
        ({"stimulus_until": "question", "presentation_bursts": 3}, 3),
        ({"stimulus_until": "question", "presentation_bursts": 7, "presentation_s": 1.0}, 7),
        ({"stimulus_until": "question", "longest_presentation_s": 9.0}, 14),
        ({"stimulus_until": "answer"}, 420),
        ({"stimulus_until": "answer", "longest_presentation_s": 10.0}, 70),
        ({"stimulus_until": "answer", "presentation_s": 1.0, "presentation_bursts": 7}, 420),
    ],
)
def test_bursts_of_a_stimulus(given: dict[str, object], n_bursts: int) -> None:
    """At 7 Hz: by default 2 s before a question, and at most 60 s until an answer."""
    answers = AnswersSection.model_validate({"keys": {"left": ["left"], "both": ["up"], "right": ["right"]}, **given})
    assert answers.n_bursts(7.0) == n_bursts
