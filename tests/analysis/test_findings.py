from __future__ import annotations

import gc
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from statsmodels.stats.multitest import multipletests

from modaltouch.analysis.exact import ExactTest
from modaltouch.analysis.findings import COLUMNS, Finding, correct, finding_of, holm, plain_row, to_frame
from modaltouch.analysis.intervals import Interval
from modaltouch.analysis.permutation import by_ranks


def finding(p: float, p_min: float = 0.001, family: str = "a") -> Finding:
    """Return a test with the given p values."""
    return finding_of("a", "test", "scope", ExactTest(1, p, p_min, 10), "x", Interval(0, -1, 1, 10), 10, family=family)


@given(st.lists(st.floats(0.0001, 1.0), min_size=1, max_size=24))
@settings(max_examples=50, deadline=None)
def test_holm_agrees_with_statsmodels(p_values) -> None:
    """Reference: multipletests(method="holm")."""
    gc.freeze()  # statsmodels collects garbage at every call, which is slow with all that a test run keeps
    try:
        reference = multipletests(p_values, method="holm")[1].tolist()
    finally:
        gc.unfreeze()
    assert holm(p_values).tolist() == pytest.approx(reference, rel=1e-12)


def test_families_are_corrected_separately() -> None:
    """Holm applies within families only; a test outside any family has no corrected p."""
    rows = correct([finding(0.01), finding(0.04), finding(0.03, family="b"), finding(0.02, family="")])
    assert [r.p_holm for r in rows[:3]] == pytest.approx([0.02, 0.04, 0.03])
    assert math.isnan(rows[3].p_holm)


def test_a_test_that_cannot_pass_holm_has_a_note() -> None:
    """The smallest p of 0.02 times three tests is above 0.05."""
    rows = correct([finding(0.02, 0.02), finding(0.5), finding(0.5)])
    assert "cannot pass Holm's correction" in rows[0].note
    assert rows[1].note == ""


def test_a_significant_test_has_no_note_on_holm() -> None:
    """Holm steps down: beside a p of 0.001, one of 0.02 is corrected for two of three tests."""
    rows = correct([finding(0.001, 0.001), finding(0.02, 0.02), finding(0.9)])
    assert (rows[1].p_holm, rows[1].note) == (pytest.approx(0.04), "")


def test_a_test_that_cannot_be_significant_has_no_information() -> None:
    """The smallest p is above 0.05."""
    assert finding(0.25, 0.25).note.startswith("no information")


def test_a_smallest_p_equal_to_the_level_has_information() -> None:
    """With p <= 0.05 significant, 0.05 alone, and 0.025 as the smallest of two, can be reached."""
    assert finding(0.05, 0.05).note == ""
    assert correct([finding(0.025, 0.025), finding(0.5)])[0].note == ""
    assert "cannot pass Holm's correction, even as the smallest of 3" in correct([finding(0.02, 0.02)] * 3)[0].note


def test_no_information_is_the_first_note() -> None:
    """The given notes follow, without empty ones."""
    notes = ("first", "", "second")
    test, interval = ExactTest(2, 0.25, 0.25, 3), Interval(0.5, 0.1, 0.9, 10)
    row = finding_of("b", "a test", "everywhere", test, "share", interval, 10, family="f", notes=notes)
    assert row.note == (
        "no information: only 3 participants can affect the statistic, so p cannot be below 0.25; first; second"
    )
    expected = Finding("b", "a test", "everywhere", "share", 0.5, 0.1, 0.9, 10, 2.0, 0.25, 0.25, "f", row.note)
    assert repr(row) == repr(expected)  # compared by repr, since p_holm is NaN
    assert math.isnan(row.p_holm)


def test_an_interval_of_one_value_is_not_shown_as_certain() -> None:
    """Ten equal differences of ratings: the signed ranks reject every other centre, but the note warns."""
    test, interval = by_ranks(np.ones(10))
    assert (interval.low, interval.high) == (1, 1)
    row = finding_of("rating", "test", "scope", test, "x", interval, 10)
    assert row.note.startswith("one value as interval, since hardly any values differ")
    assert finding(0.01).note == ""


def test_the_table_has_every_column_and_row() -> None:
    """The columns and rows of a table of findings."""
    frame = to_frame([finding(0.01), finding(0.02)])
    assert tuple(frame.columns) == COLUMNS
    assert frame["p"].tolist() == [0.01, 0.02]


def test_every_row_has_its_role() -> None:
    """A test of a family is confirmatory, another test exploratory, and a row without a test an estimate."""
    estimate = finding_of("f", "share", "all", None, "P(C)", Interval(0.9, 0.5, 1.0, 10), 10)
    assert [finding(0.01).role, finding(0.01, family="").role] == ["confirmatory", "exploratory"]
    assert (estimate.role, estimate.estimate, estimate.low, estimate.high) == ("estimate", 0.9, 0.5, 1.0)
    assert math.isnan(estimate.p)


def test_infinite_and_undefined_numbers_become_text() -> None:
    """RFC 8259 has neither infinity nor NaN; an undefined estimate differs from one that was not requested."""
    row = {"quantity": "odds ratio", "estimate": math.nan, "low": -math.inf, "high": math.inf, "p": math.nan}
    plain = {"quantity": "odds ratio", "estimate": "undefined", "low": "-infinity", "high": "infinity", "p": None}
    assert plain_row(row | {"n": np.int64(3)}) == plain | {"n": 3}
    assert plain_row({"quantity": "", "estimate": math.nan, "low": 0.5}) == {
        "quantity": "",
        "estimate": None,
        "low": 0.5,
    }
