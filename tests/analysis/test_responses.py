"""What a table of answers says of itself: cells, groups, catch trials, speeds, the command to repeat its analysis."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from modaltouch.analysis.responses import (
    AnswerSource,
    ExcludedSource,
    Responses,
    answers_per_cell,
    are_crossed,
    describe_cell,
    kinds_of,
    missing_answer_notes,
    refuse_unequal,
    sum_catches,
    unmirror,
)
from modaltouch.protocol import AnswerList, InputError

SOURCE = AnswerSource("answers.csv", "csv", "")


def table(*rows: tuple[Any, ...], **columns: Any) -> pd.DataFrame:
    """Return a tidy table of (participant, finger condition, left, right, level, response, n)."""
    names = ["participant", "finger_condition", "zone_left", "zone_right", "velocity_mm_s", "response", "n"]
    return pd.DataFrame(list(rows), columns=names).assign(**columns)


TWO = table(
    ("p1", "one_hand", "A", "C", 80.0, "left", 2),
    ("p1", "one_hand", "A", "C", 200.0, "both", 1),
    ("p2", "one_hand", "A", "C", 80.0, "right", 3),
)


def test_cells_are_those_of_the_crossed_design() -> None:
    """Counts by participant; a cell that somebody did not answer has none."""
    counted = answers_per_cell(TWO)
    assert counted.columns.tolist() == [("one_hand", "A", "C", 80.0), ("one_hand", "A", "C", 200.0)]
    assert counted.loc["p1"].tolist() == [2, 1]
    assert counted.loc["p2"].tolist() == [3, 0]
    assert describe_cell(("one_hand", "A", "C", 80.0)) == "one_hand A-C 80 mm/s"
    assert describe_cell(("one_hand", "A", "", 80.0)) == "one_hand A 80 mm/s"


def test_participants_of_other_conditions_are_refused() -> None:
    """The first of them and a cell, of how many; those who answered equally often are not."""
    with pytest.raises(InputError) as refused:
        refuse_unequal(Path("results"), TWO)
    assert "(2 of 2; p1 has 2 in one_hand A-C 80 mm/s, others up to 3)" in str(refused.value)
    refuse_unequal(Path("results"), TWO.assign(velocity_mm_s=80.0, n=[1, 2, 3]))


def test_whoever_and_whatever_has_no_answer_is_named() -> None:
    """Participants, pairs and levels that would be in no table; nothing where each has one."""
    given = TWO[TWO["response"] == "left"]
    asked = pd.concat([TWO, table(("p1", "two_hands", "B", "D", 80.0, "left", 1))])
    note = "Left out, since there is no answer at all: participant p2, two_hands B-D, 200 mm/s"
    assert missing_answer_notes(asked, given) == (note,)
    assert missing_answer_notes(asked, asked) == ()


def test_catch_trials_are_summed_by_who_how_and_when() -> None:
    """Over all finger conditions and kinds of session, or one of them; never over participants."""
    counted = [
        ("p1", "one_hand", "day_1", "none", 3), ("p1", "one_hand", "day_1", "none", 1),
        ("p1", "two_hands", "day_2", "left", 2), ("p2", "one_hand", "day_1", "none", 5),
    ]  # fmt: skip
    catches = sum_catches(counted)
    assert catches["p1", "one_hand", "day_1"] == {"none": 4}
    answers = Responses(TWO, (), (), SOURCE, catches=catches)
    assert answers.caught("p1") == Counter(none=4, left=2)
    assert answers.caught("p1", "two_hands") == Counter(left=2)
    assert answers.caught("p1", "two_hands", "day_1") == Counter()
    assert answers.caught("p1", kind="day_1") == Counter(none=4)


def test_groups_are_those_of_the_participants() -> None:
    """None where all are of one group; their common cells are those that each group has."""
    assert Responses(TWO, (), (), SOURCE).groups == {}
    assert Responses(TWO.assign(group="young"), (), (), SOURCE).groups == {}
    grouped = Responses(TWO.assign(group=["young", "young", "old"]), (), (), SOURCE)
    assert grouped.groups == {"p2": "old", "p1": "young"}
    common = grouped.of_groups(["young", "old"]).frame
    assert common["velocity_mm_s"].tolist() == [80.0, 80.0]
    assert grouped.of_groups(["young"]).frame["participant"].tolist() == ["p1", "p1"]


def test_stimuli_and_kinds_are_named_where_there_are_several() -> None:
    """In a design that is not crossed."""
    frame = TWO.assign(stimulus=["sharp", "sharp", "broad"], session_kind="day_1")
    crossed = Responses(frame, (), (), SOURCE)
    assert (crossed.stimuli, crossed.kinds) == ((), ())
    several = replace(crossed, scheduled=frame)
    assert (several.stimuli, several.kinds) == (("broad", "sharp"), ())


@pytest.mark.parametrize(
    ("given", "has"),
    [
        ({}, False),
        ({"catches": {("p1", "one_hand", ""): Counter(none=1)}}, True),
        ({"answers": AnswerList.of_words(("none",))}, True),
        ({"answers": AnswerList.of({"keys": {"left": ["a"], "right": ["b"]}})}, True),
        ({"frame": TWO.assign(value=3.0)}, True),
        ({"frame": TWO.assign(group=["young", "young", "old"])}, True),
        ({"design": {"answers": {"then": {"sure": {}}}}}, True),
        ({"design": {"intervals": {"number": 2}}}, True),
    ],
)
def test_there_are_results_of_each_participant(given: dict[str, Any], has: bool) -> None:
    """Where there is more than a count of three answers: each of these alone is enough."""
    assert replace(Responses(TWO, (), (), SOURCE), **given).has_individual_results is has


def test_the_command_repeats_the_analysis() -> None:
    """What was given, with the folders of several labs, the stimulus, and the protocol of a table."""
    answers = Responses(TWO, (), (), AnswerSource("my answers.csv", "csv", ""))
    assert answers.command == "modaltouch analyse 'my answers.csv'"
    assert replace(answers, design={"answers": {}}).command == "modaltouch analyse 'my answers.csv' --protocol PROTOCOL"
    labs = AnswerSource("a, b", "results", "", mode="pilot", labs=("a", "b"))
    recorded = replace(answers, source=labs, stimulus="sharp", sessions=(object(),))  # type: ignore[arg-type]
    assert recorded.command == "modaltouch analyse a b --out FOLDER --stimulus sharp --mode pilot"


def test_what_was_read_is_told_as_plain_values() -> None:
    """For ``--json``: notes of the reading before others; no mode where none is known."""
    left_out = (ExcludedSource("ses-2", "not complete"),)
    answers = Responses(TWO, (), left_out, SOURCE, notes=("read",))
    assert answers.as_dict("further") == {
        "notes": ["read", "further"],
        "mode": None,
        "source": "answers.csv",
        "left_out": [{"source": "ses-2", "reason": "not complete"}],
        "form": [],
    }
    assert replace(answers, source=replace(SOURCE, mode="pilot")).as_dict()["mode"] == "pilot"


def test_answers_on_intervals_are_recoded_by_what_was_chosen() -> None:
    """The first of two intervals was the comparison, then the standard; other answers stay, as do other designs."""
    section = {"keys": {"first": ["a"], "second": ["b"]}, "intervals": {"first": 1, "second": 2}}
    asked = {"number": 2, "standard": {"velocity_mm_s": 100}, "asked": "stronger"}
    frame = TWO.assign(response="first", interval=[1, 2, 1])
    answers = Responses(frame, (), (), SOURCE, answers=AnswerList.of(section), scheduled=frame.iloc[:2])
    compared = replace(answers, design={"answers": section, "intervals": asked})
    chosen = compared.by_choice()
    assert chosen.frame["response"].tolist() == ["comparison", "standard", "comparison"]
    assert chosen.scheduled is not None
    assert chosen.scheduled["response"].tolist() == ["comparison", "standard"]
    assert chosen.answers.names == ("comparison", "standard")
    assert replace(compared, scheduled=None).by_choice().scheduled is None
    assert answers.by_choice() is answers
    felt = replace(compared, answers=AnswerList.of({"keys": {"left": ["a"], "right": ["b"]}}))
    assert felt.by_choice() is felt


def test_levels_may_be_multiples_of_a_threshold() -> None:
    """By the column that they have."""
    own = TWO.rename(columns={"velocity_mm_s": "multiple_of_threshold"})
    assert Responses(own, (), (), SOURCE).in_multiples is True
    assert Responses(TWO, (), (), SOURCE).in_multiples is False


def test_speeds_are_those_under_the_faster_finger() -> None:
    """The mean of a level's trials; of each trial in an adaptive run; as delivered where that was measured."""
    frame = TWO.assign(
        speed_left_mm_s=[50.0, 120.0, 90.0], speed_right_mm_s=[80.0, 100.0, 85.0], delivered_mm_s=[70.0, np.nan, 80.0]
    )
    answers = Responses(frame, (), (), SOURCE)
    assert answers.by_speed("predicted").frame["speed_mm_s"].tolist() == [85.0, 120.0, 85.0]
    assert answers.by_speed("delivered").frame["speed_delivered_mm_s"].tolist() == [75.0, 120.0, 75.0]
    assert "velocity_mm_s" not in answers.by_speed("predicted").frame
    run = replace(answers, start={"design": {"adaptive": {"algorithm": "staircase"}}})
    assert run.by_speed("predicted").frame["speed_mm_s"].tolist() == [80.0, 120.0, 90.0]
    alone = replace(answers, frame=frame.assign(zone_right="").drop(columns="speed_right_mm_s"))
    assert alone.by_speed("predicted").frame["speed_mm_s"].tolist() == [70.0, 120.0, 70.0]


@pytest.mark.parametrize(
    ("frame", "speed", "given"),
    [
        (TWO.assign(speed_left_mm_s=1.0), "predicted", "answers without the speeds predicted"),
        (TWO.assign(speed_left_mm_s=1.0, speed_right_mm_s=[1.0, 2.0, np.nan]), "predicted", "without the speeds pred"),
        (TWO.assign(speed_left_mm_s=1.0, speed_right_mm_s=1.0), "delivered", "answers without a delivered speed"),
        (
            TWO.rename(columns={"velocity_mm_s": "multiple_of_threshold"}).assign(
                speed_left_mm_s=1.0, speed_right_mm_s=1.0
            ),
            "predicted",
            "answers without the speeds predicted under the fingers in mm/s",
        ),
    ],
)
def test_speeds_that_are_not_known_are_refused(frame: pd.DataFrame, speed: Any, given: str) -> None:
    """One trial without is enough, and so are levels in multiples of a threshold."""
    with pytest.raises(InputError, match=given):
        Responses(frame, (), (), SOURCE).by_speed(speed)


def test_a_turned_beam_exchanges_zones_speeds_and_answers() -> None:
    """Two fingers of a turned beam alone: a single finger has no other side, an answer without an opposite stays."""
    rows = table(
        ("p1", "one_hand", "C", "A", 80.0, "left", 1),
        ("p1", "one_hand", "C", "A", 80.0, "both", 1),
        ("p1", "one_hand", "A", "C", 80.0, "left", 1),
        ("p1", "one_finger", "C", "", 80.0, "left", 1),
        placement=["mirrored", "mirrored, thumb", "normal", "mirrored"],
        speed_left_mm_s=[1.0, 2.0, 3.0, 4.0],
        speed_right_mm_s=[5.0, 6.0, 7.0, np.nan],
    )
    found = unmirror(rows, AnswerList.of({}))
    assert found["zone_left"].tolist() == ["A", "A", "A", "C"]
    assert found["zone_right"].tolist() == ["C", "C", "C", ""]
    assert found["response"].tolist() == ["right", "both", "left", "left"]
    assert found["speed_left_mm_s"].tolist() == [5.0, 6.0, 3.0, 4.0]
    assert found["speed_right_mm_s"].tolist()[:3] == [1.0, 2.0, 7.0]
    assert found["placement"].tolist() == rows["placement"].tolist()
    one_sided = AnswerList.of({"keys": {"left": ["a"], "none": ["b"]}})
    assert unmirror(rows, one_sided)["response"].tolist() == ["left", "both", "left", "left"]
    assert unmirror(TWO, AnswerList.of({})) is TWO


def test_kinds_of_session_are_analysed_unless_they_say_otherwise() -> None:
    """As the key `schedule.sessions` lists them; a number of sessions lists none."""
    listed = [{"name": "training", "analysed": False}, {"name": "test"}]
    assert kinds_of({"schedule": {"sessions": listed}}) == {"training": False, "test": True}
    assert kinds_of({"schedule": {"sessions": 3}}) == kinds_of({"schedule": None}) == kinds_of({}) == {}


def test_a_heading_names_the_protocol_if_it_is_known() -> None:
    """A protocol may have no title, and a table no protocol."""
    designs = ({"title": "Focused"}, {"title": ""})
    headings = [Responses(TWO, (), (), SOURCE, design=design).heading("Analysis") for design in designs]
    assert headings == ["Analysis: Focused", "Analysis of answers"]


def test_a_third_interval_is_not_guessed_evenly() -> None:
    """Of two alternatives either is as likely by chance."""
    frame = TWO.assign(response=pd.Categorical(TWO["response"], ["left", "both", "right"]))
    for number, evenly in ((1, True), (2, True), (3, False)):
        design = {"intervals": {"number": number, "standard": {"velocity_mm_s": 100}}}
        answers = Responses(frame, (), (), SOURCE, design=design)
        assert answers.task.n_intervals == number
        assert answers.count().guesses_evenly is evenly
    assert Responses(frame, (), (), SOURCE).task.n_intervals == 1


def test_a_group_lists_crossed_cells_with_few_keys() -> None:
    """The section of a group has only the keys that it gives: neither stimuli nor finger conditions nor weights."""
    cells = [{"pair": [*pair], "peak_velocities_mm_s": [80, 200]} for pair in ("AC", "BD")]
    assert are_crossed({"groups": {"low": {"conditions": {"cells": cells}}}})
    cells[0]["peak_velocities_mm_s"] = [80]
    assert not are_crossed({"groups": {"low": {"conditions": {"cells": cells}}}})
    assert not are_crossed({"groups": {"low": {"conditions": {"exclude": [{"pair": ["A", "C"]}]}}}})


@pytest.mark.parametrize("place", ["groups", "kinds", "training"])
def test_cells_left_out_are_those_of_each_group_and_kind(place: str) -> None:
    """A level of its own keeps a pair that is left out at all other levels; a training is not analysed."""
    left_out = [{"pair": ["A", "C"], "peak_velocity_mm_s": level} for level in (80, 200)]
    whole = {"zone_pairs": [["A", "C"], ["B", "D"]], "peak_velocities_mm_s": [80, 200], "exclude": left_out}
    own = {"conditions": {"peak_velocities_mm_s": [80, 200, 300]}}
    kind = {"name": "long", "analysed": place != "training", **own}
    assert are_crossed({"conditions": whole})
    more = {"groups": {"low": {}, "high": own}} if place == "groups" else {"schedule": {"sessions": [kind]}}
    assert are_crossed({"conditions": whole, **more}) == (place == "training")
