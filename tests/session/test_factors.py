"""Rate, number of bursts, law and masking as factors: stimuli that differ in them, recorded as played."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from modaltouch.preflight import examine
from modaltouch.record import audit_session
from modaltouch.session import simulate_session

UNTIL_QUESTION = ("  stimulus_until: answer\n  presentation_s: 1.0", "  stimulus_until: question")
STIMULI = """stimuli:
  usual: {}
  slow: {repetition_rate_Hz: 3.5}
  few: {presentation_bursts: 3}
  quiet: {masked: false}

masking: {noise: pink, level_dB_FS: -30}

conditions:
"""


def test_each_stimulus_has_its_own_rate_and_number_of_bursts(edit: Callable[..., Path], tmp_path: Path) -> None:
    """2 s at 7 and at 3.5 Hz, and three bursts; `verify` expects the same."""
    preflight = examine(edit("demo.yaml", ("conditions:\n", STIMULI), UNTIL_QUESTION)).require()
    session = simulate_session(preflight, "p01", tmp_path)
    assert session.start["schedule"]["n_trials"] == 48
    played = {row["stimulus"]: row["n_bursts"] for row in session.table() if not row["practice"]}
    assert played == {"usual": 14, "slow": 7, "few": 3, "quiet": 14}
    assert audit_session(session).problems == ()


def test_the_law_may_differ_between_stimuli(edit: Callable[..., Path], tmp_path: Path) -> None:
    """Each of the two has its own codes."""
    laws = "stimuli: {exact: {law: exact}, paper: {law: paper}}\n\nconditions:\n"
    session = simulate_session(examine(edit("demo.yaml", ("conditions:\n", laws))), "p01", tmp_path)
    assert len(set(session.start["stimulus"]["content_hashes"].values())) == 2
    assert audit_session(session).problems == ()


@pytest.mark.parametrize(
    ("stimuli", "told"),
    [
        ("few: {presentation_bursts: 3}", "given 3, but the stimulus plays until the answer"),
        ("quiet: {masked: false}", "but there is no noise; allowed: only with a section masking"),
    ],
)
def test_unusable_keys_of_a_stimulus_are_refused(edit: Callable[..., Path], stimuli: str, told: str) -> None:
    """At the stimulus that has them."""
    problems = examine(edit("demo.yaml", ("conditions:\n", f"stimuli:\n  {stimuli}\n\nconditions:\n"))).problems
    assert [told in each.message for each in problems] == [True]
    assert problems[0].path.startswith("stimuli.")
