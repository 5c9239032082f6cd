"""Groups of participants and kinds of session: protocols that differ in a few keys; faults with positions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from modaltouch.preflight import examine
from modaltouch.protocol import Findings, InputError, Schedule, Sources, Turn

LEVELS = "  peak_velocities_mm_s: [80, 200]\n"
GROUPS = (
    "groups:\n  low: {conditions: {peak_velocities_mm_s: [80, 100]}}\n  high: {conditions: {zone_pairs: [[A, C]]}}\n"
)
KINDS = """schedule:
  sessions:
    - {name: training, analysed: false, schedule: {practice_trials: 3}, conditions: {finger_conditions: [one_hand]}}
    - {name: test, min_gap_days: 1, times: 2}
"""


@pytest.fixture
def read(edit: Callable[..., Path]) -> Callable[..., Findings]:
    """Return a function that reads the demonstration with groups and kinds of session."""

    def findings(*changes: tuple[str, str]) -> Findings:
        return Findings.read(edit("demo.yaml", ("schedule:\n", GROUPS + KINDS), *changes))

    return findings


def test_each_group_and_kind_of_session_has_its_protocol(read: Callable[..., Findings]) -> None:
    """Keys that a group or kind does not set have the common values."""
    first = read()
    every = {tuple(each.occasion): each.experiment().protocol for each in (first, *first.others)}
    assert list(every) == [("low", "training"), ("low", "test"), ("high", "training"), ("high", "test")]
    assert {name: protocol.n_trials for name, protocol in every.items()} == {
        ("low", "training"): 6, ("low", "test"): 12, ("high", "training"): 2, ("high", "test"): 4,
    }  # fmt: skip
    assert every["low", "test"].conditions.peak_velocities_mm_s == (80.0, 100.0)
    assert every["high", "training"].schedule.practice_trials == 3
    assert [every["low", "test"].schedule.kind_of(n).name for n in (1, 2, 3, 4)] == ["training", "test", "test", "test"]


@pytest.mark.parametrize(
    ("change", "path"),
    [
        (("high: {conditions: {zone_pairs: [[A, C]]}", "high: {conditions: {zone_pairs: [[A, Q]]}"),
         "groups.high.conditions.zone_pairs[0][1]"),
        (("practice_trials: 3}", "practice_trails: 3}"), "schedule.sessions[0].schedule.practice_trails"),
        (("finger_conditions: [one_hand]", "finger_conditions: [one_hnd]"),
         "schedule.sessions[0].conditions.finger_conditions[0]"),
    ],
)  # fmt: skip
def test_a_fault_has_the_path_of_its_group_or_kind(
    read: Callable[..., Findings], change: tuple[str, str], path: str
) -> None:
    """Not that of the common section."""
    assert {each.as_dict()["path"] for each in read(change).problems} == {path}


def test_a_record_restores_the_protocol_of_its_group_and_kind(read: Callable[..., Findings]) -> None:
    """From the single recorded text."""
    first = read()
    kept = Sources.from_dict(first.experiment().sources.as_dict())
    for each in first.others:
        assert Findings.restored(kept, each.occasion).experiment().protocol == each.experiment().protocol


def test_levels_may_be_given_by_group_only(read: Callable[..., Findings]) -> None:
    """The common section then needs none."""
    both = GROUPS.replace("{zone_pairs: [[A, C]]}", "{peak_velocities_mm_s: [150]}")
    assert read((LEVELS, ""), (GROUPS, both)).problems == ()


def test_a_group_without_levels_is_a_fault(read: Callable[..., Findings]) -> None:
    """Even if the other group has its own."""
    assert ["missing key" in each.message for each in read((LEVELS, "")).problems] == [True]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("[80, 100]", "[80, 9000]"), "given 9000 mm/s, above the safety limit"),
        (("practice_trials: 3", "practice_trial: 3"), "did you mean 'practice_trials'?"),
        (("high: {cond", "high: {schedule: {sessions: 3}, cond"), "given sessions of one group; allowed: the same"),
        (("times: 2", "times: 0"), "given 0; allowed: a whole number of at least 1"),
        (("name: test", "nam: test"), "did you mean 'name'?"),
        (("name: test", "name: training"), "given 'training' again; allowed: each name once; choose another, or"),
        (("name: test", "name: test, conditions: {}, schedule: {sessions: 2}"), "given sessions of one kind; allowed"),
    ],
)
def test_a_fault_of_one_group_or_kind_is_reported_at_its_line(
    read: Callable[..., Findings], change: tuple[str, str], told: str
) -> None:
    """Once, even if several occasions share it."""
    findings = read(change)
    with pytest.raises(InputError, match="given"):
        findings.experiment()
    fitting = [each for each in findings.problems if told in each.message]
    assert len(fitting) == 1
    text = Path(fitting[0].file).read_text("utf-8").splitlines()
    assert change[1].split()[-1] in text[fitting[0].line - 1] or change[1].split(":")[0] in text[fitting[0].line - 1]


UNLIKE = "given other answers or questions for {}; allowed: the same ones for all that is analysed together"


@pytest.mark.parametrize(
    ("changes", "path", "told"),
    [
        ([("high: {cond", "high: {answers: {keys: {none: [down]}}, cond")], "groups.high", "high than for low"),
        ([("high: {cond", "high: {answers: {then: {sure: {question: Sure?, scale: {kind: vas}}}}, cond")],
         "groups.high", "high than for low"),
        ([("times: 2", "answers: {keys: {none: [down]}}"), ("analysed: false", "analysed: true")],
         "schedule.sessions", "test than for training"),
        ([("high: {cond", "high: {answers: {keys: {left: [f1]}, time_out_s: 3, question: And now?}, cond"),
          ("times: 2", "answers: {keys: {none: [down]}}")], "", ""),
    ],
)  # fmt: skip
def test_sessions_analysed_together_need_the_same_questions(read: Callable[..., Findings], changes, path, told) -> None:
    """Other answers, scales or further questions in one group could not be pooled."""
    found = read(("[up, down, num_8]", "[up, num_8]"), *changes).problems
    assert [each.path for each in found] == [path] * bool(path)
    assert all(UNLIKE.format(told) in each.message for each in found)


def test_the_check_covers_the_levels_of_every_group(edit: Callable[..., Path]) -> None:
    """A level beyond the amplifier's limit in the second group is refused."""
    own = GROUPS.replace("{zone_pairs: [[A, C]]}", "{peak_velocities_mm_s: [400]}")
    problems = examine(edit("demo.yaml", ("schedule:\n", own + KINDS))).problems
    assert ["400 mm/s, which needs" in each.given for each in problems] == [True]


def test_the_check_shows_every_group_and_kind(edit: Callable[..., Path]) -> None:
    """Each with its number of trials."""
    shown = examine(edit("demo.yaml", ("schedule:\n", GROUPS + KINDS))).require().as_dict()["occasions"]
    assert [(each["group"], each["session_kind"], each["n_trials"]) for each in shown] == [
        ("low", "training", 6), ("low", "test", 12), ("high", "training", 2), ("high", "test", 4),
    ]  # fmt: skip


def test_groups_alternate_and_are_crossed_with_orders(read: Callable[..., Findings]) -> None:
    """Eight participants: four in each group, two with each order of two finger conditions."""
    first = read()
    every = {tuple(each.occasion): each.experiment().protocol for each in (first, *first.others)}
    met = Counter()
    for number in range(1, 9):
        turn = Turn.of(f"p{number:02}", 1, 2, ("low", "high"))
        schedule = Schedule.draw(every[turn.group, "test"], f"p{number:02}", 1, 2)
        assert (schedule.group, schedule.session_kind) == (turn.group, "test")
        met[schedule.group, schedule.blocks[0].finger_condition] += 1
    assert set(met.values()) == {2}
    assert len(met) == 4


def test_kinds_of_adaptive_sessions_ignore_repetitions(edit: Callable[..., Path]) -> None:
    """The number of catch trials is compared with the trials of the run."""
    kinds = "schedule:\n  sessions: [{name: pre}, {name: post}]\n"
    assert Findings.read(edit("threshold.yaml", ("schedule:\n", kinds))).problems == ()
