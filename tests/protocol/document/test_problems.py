"""Messages of problems, and suggestions for misspelt words."""

from __future__ import annotations

import pytest

from modaltouch.protocol.source import InputError, Problem, suggest

ZONE = Problem(
    "protocols/x.yaml",
    12,
    9,
    "conditions.zone_pairs[1]",
    "'F', which is not a zone of this beam",
    "A, B, C, D, E",
)


def test_a_problem_prints_as_compilers_do() -> None:
    """The form file:line:column, which editors understand."""
    assert str(ZONE) == (
        "protocols/x.yaml:12:9: conditions.zone_pairs[1]: given 'F', which is not a zone of this beam; "
        "allowed: A, B, C, D, E"
    )


def test_a_problem_of_a_folder_has_no_line() -> None:
    """An editor could not go to a line of a folder."""
    assert str(Problem("results", 0, 0, "", "two protocols", "one")) == "results: given two protocols; allowed: one"


def test_a_problem_as_plain_values_keeps_its_message() -> None:
    """It has the keys documented for `check --json`."""
    values = ZONE.as_dict()
    assert {"file", "line", "column", "path", "given", "allowed", "message"} <= set(values)
    assert str(ZONE).endswith(values["message"])


def test_an_input_error_sorts_its_problems_without_duplicates() -> None:
    """Sorted by file, then by line as a number, then by column."""
    early, late = Problem("a", 9, 1, "", "x", ""), Problem("a", 10, 1, "", "x", "")
    error = InputError([late, ZONE, early, late])
    assert error.problems == (early, late, ZONE)
    assert str(error).count("\n") == 2


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("peak_velocities_cm_s", "peak_velocities_mm_s"),
        ("peak_velocities", "peak_velocities_mm_s"),
        ("peak_velocity_mm_s", "peak_velocities_mm_s"),
        ("Zone-Pairs", "zone_pairs"),
        ("zonepairs", "zone_pairs"),
        ("base_cm", "base_mm"),
        ("colour", ""),
    ],
)
def test_suggestions_for_misspelt_keys_and_wrong_units(word: str, meant: str) -> None:
    """The suggested key is the one that a person would expect."""
    assert suggest(word, ["peak_velocities_mm_s", "zone_pairs", "base_mm", "hand"]) == meant
