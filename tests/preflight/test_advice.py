"""`check` warns of what a design cannot show, before a participant arrives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from modaltouch.analysis import ALPHA
from modaltouch.analysis.statistics import STATISTICS
from modaltouch.planning import Observer, designs_for
from modaltouch.planning.power import find_floor
from modaltouch.preflight import examine, results
from modaltouch.preflight.results import answer_warnings, design_warnings
from modaltouch.protocol import Protocol

Edit = Callable[..., Path]
PAPER = "differentiated_stimulation.yaml"
PAIRS = "[[A, C], [B, D], [C, E]]"
ONE_PAIR = (PAIRS, "[[A, C]]"), ("  max_same_pair_running: 2\n", "")
FINGERS, LEVELS = "[one_hand, two_hands]", "[80, 100, 150, 200]"


def read(edit: Edit, *changes: tuple[str, str]) -> Protocol:
    """Return the paper's protocol with changes."""
    return examine(edit(PAPER, *changes)).experiment.protocol


def test_pairs_without_a_finger_on_the_focus_are_listed(edit: Edit) -> None:
    """B-D of the paper has none; "any pair" is written if none has one; a second focus counts."""
    assert "no finger touches the focus C on B-D" in examine(edit(PAPER)).as_dict()["warnings"]
    far = edit("demo.yaml", (PAIRS, "[[A, B], [D, E]]"))
    assert "no finger touches the focus C on any pair" in examine(far).as_dict()["warnings"]
    two = edit(PAPER, ("  focus: C  ", "  focus: C\n  further_foci: [B]  "))
    assert not any("no finger" in each for each in design_warnings(examine(two).findings.experiment().protocol))
    fields = far.with_name("two_fields.yaml")
    fields.write_text(fields.read_text().replace("[[A, C], [C, E]]", "[[A, B], [B, C]]"))
    several = list(design_warnings(examine(fields).experiment.protocol))
    assert [each for each in several if "no finger" in each] == [
        "stimuli sharp, blunt: no finger touches the focus C on A-B"
    ]


@pytest.mark.parametrize(
    ("changes", "silent"),
    [
        ((), set()),
        (((LEVELS, "[200]"),), {"b"}),
        (((FINGERS, "[one_hand]"),), {"c"}),
        (ONE_PAIR, {"d"}),
        ((*ONE_PAIR, (FINGERS, "[two_hands]"), (LEVELS, "[200]")), {"b", "c", "d"}),
    ],
    ids=["paper", "one level", "one finger condition", "one pair", "one cell"],
)
def test_families_without_power_agree_with_the_analysis(
    edit: Edit, changes: tuple[tuple[str, str], ...], silent: set[str]
) -> None:
    """Families whose smallest p stays above 0.05 at any group size, and the fewest participants for dominance."""
    preflight = examine(edit(PAPER, *changes)).require()
    said = " ".join(design_warnings(preflight.experiment.protocol))
    design = designs_for(preflight, Observer.read("paper"))[""]
    floors = {name: find_floor(design, name, 1) for name in STATISTICS}
    reached = {STATISTICS[name].question for name, each in floors.items() if each.n_tests and each.least_participants}
    assert {"b", "c", "d"} - reached == silent
    named = {"b": "one level", "c": "one finger condition", "d": "one pair of zones"}
    assert {name for name, words in named.items() if words in said} == silent
    assert f"with fewer than {floors['a2'].least_participants} participants no test" in said
    assert results._ALPHA == ALPHA


def test_a_session_longer_than_an_hour_is_warned_of(edit: Edit) -> None:
    """Twenty repetitions of the paper's 24 trials take an hour and a quarter."""
    assert not any(" min" in each for each in design_warnings(read(edit)))
    (said,) = [each for each in design_warnings(read(edit, ("repetitions: 1", "repetitions: 20"))) if " min" in each]
    assert said.endswith("longer than an hour: use fewer repetitions, or several sessions")


def test_a_practice_criterion_without_practice_is_warned_of(edit: Edit) -> None:
    """A criterion without practice trials passes every participant."""
    judged = ("practice_trials: 3", "practice_trials: 3\n  practice_criterion: 0.5")
    assert not any("no effect" in each for each in design_warnings(read(edit, judged)))
    none = ("practice_trials: 3", "practice_trials: 0")  # in the file that was just changed
    (said,) = [each for each in design_warnings(read(edit, none)) if "no effect" in each]
    assert said == "schedule.practice_criterion has no effect, since practice_trials is 0: there is no practice"


@pytest.mark.parametrize(
    ("other", "is_told"),
    [
        ("{}", True),
        ("{repetition_rate_Hz: 7, field: {shape: triangle, base_mm: 56}}", True),
        ("{repetition_rate_Hz: 6}", False),
        ("{presentation_bursts: 3}", False),
    ],
)
def test_stimuli_that_are_the_same_are_told(edit: Edit, other: str, is_told: bool) -> None:
    """Whether a variant says nothing or what the shared section says; a number of bursts is a difference, too."""
    variants = ("\nconditions:\n", f"\nstimuli: {{usual: {{}}, other: {other}}}\n\nconditions:\n")
    said = list(design_warnings(read(edit, variants, ("stimulus_until: answer ", "stimulus_until: question "))))
    assert ("the stimuli usual and other are the same: no answer can tell them apart" in said) is is_told


def test_a_length_without_effect_is_told(edit: Edit) -> None:
    """A stimulus of 2 s is meant, one of up to a minute would be played; written out, it is what is meant."""
    idle = "answers.presentation_s has no effect, since stimulus_until is `answer` if it is not given; write "
    assert not any("no effect" in each for each in answer_warnings(read(edit)))
    (said,) = [
        each for each in answer_warnings(read(edit, ("  stimulus_until: answer ", "  #"))) if "no effect" in each
    ]
    assert said == f"{idle}`stimulus_until: question` for a stimulus of that length"


def test_a_single_group_and_sessions_that_nobody_analyses_are_told(edit: Edit) -> None:
    """Each passes, as each can be run; neither can answer what it is for."""
    kinds = "groups: {low: {}}\nschedule:\n  sessions: [{name: training, analysed: false}]\n"
    said = list(design_warnings(read(edit, ("schedule:\n", kinds))))
    assert any("no kind of session is analysed" in each for each in said)
    assert any("there is only one group" in each for each in said)


@pytest.mark.parametrize(("analysed", "is_told"), [("false", False), ("true", True)])
def test_training_that_is_not_analysed_leaves_a_design_crossed(edit: Edit, analysed: str, is_told: bool) -> None:
    """The analysis applies the tests of a crossed design to the test sessions alone, however many there are."""
    kinds = f"schedule:\n  sessions: [{{name: training, analysed: {analysed}}}, {{name: test, times: 2}}]\n"
    said = list(design_warnings(read(edit, ("schedule:\n", kinds))))
    assert any("each kind of session is tested separately" in each for each in said) == is_told


@pytest.mark.parametrize(
    ("listed", "is_crossed"),
    [
        (f"zone_pairs: {PAIRS}\n  peak_velocities_mm_s: [80, 100]\n  exclude: [{{peak_velocity_mm_s: 80}}]", True),
        (f"zone_pairs: {PAIRS}\n  peak_velocities_mm_s: [80, 100]\n  exclude: [{{pair: [B, D]}}]", True),
        (f"zone_pairs: {PAIRS}\n  peak_velocities_mm_s: [80, 100]\n  exclude: [{{finger_condition: one_hand, "
         "peak_velocity_mm_s: 80}]", False),
        ("cells: [{pair: [A, C], peak_velocities_mm_s: [80]}, {pair: [C, E], peak_velocities_mm_s: [80]}]", True),
        ("cells: [{pair: [A, C], peak_velocities_mm_s: [80, 90]}, {pair: [C, E], peak_velocities_mm_s: [80]}]", False),
        ("cells: [{pair: [A, C], peak_velocities_mm_s: [80]}, {pair: [C, E], peak_velocities_mm_s: [80], weight: 2}]",
         False),
    ],
)  # fmt: skip
def test_a_design_is_judged_by_its_cells_not_by_its_keys(edit: Edit, listed: str, is_crossed: bool) -> None:
    """Crossed means every remaining pair at every remaining level, equally often, in every finger condition."""
    given = f"zone_pairs: {PAIRS}\n  peak_velocities_mm_s: {LEVELS}"
    said = list(design_warnings(read(edit, (given, listed))))
    assert any("the design is not crossed" in each for each in said) != is_crossed
    assert any("no test can tell which zone" in each for each in said) == is_crossed
    assert any("there is only one level" in each for each in said) == ("80]" in listed or "80}" in listed) & is_crossed


def test_the_levels_of_training_are_not_those_of_the_tests(edit: Edit) -> None:
    """One level is enough for training; the tests have four."""
    training = "{name: training, analysed: false, conditions: {peak_velocities_mm_s: [200]}}"
    protocol = read(edit, ("schedule:\n", f"schedule:\n  sessions: [{training}, {{name: test}}]\n"))
    assert protocol.scheduled_levels == (200,)
    assert not any("only one level" in each for each in design_warnings(protocol))


def test_groups_alone_do_not_make_a_design_uncrossed(edit: Edit) -> None:
    """Groups may have the same cells; each is tested separately."""
    said = list(design_warnings(read(edit, ("schedule:\n", "groups: {low: {}, high: {}}\nschedule:\n"))))
    assert any(each.startswith("each group is tested separately") for each in said)
    assert not any("not crossed" in each for each in said)
