"""Designs of lower peak voltage as played: codes, braking and repeated bursts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from modaltouch.preflight import examine

Edit = Callable[..., Path]
LAW = "law: exact                # exact or paper (the paper's equations 6 and 7)"


def protocol(edit: Edit, design: str, law: str = "exact") -> Path:
    """Return the paper's protocol at 100 mm/s with a design."""
    levels = ("[80, 100, 150, 200]", "[100]")
    return edit("differentiated_stimulation.yaml", (LAW, f"law: {law}\n  design: {design}"), levels)


@pytest.mark.parametrize("design", ["least_energy", "norm_4", "norm_8", "least_peak"])
def test_every_design_meets_every_mode_in_the_first_and_in_every_later_burst(edit: Edit, design: str) -> None:
    """The worst modal error of the rounded codes is below 1e-4 of the peak, from rest and after many bursts."""
    stimulus = examine(protocol(edit, design)).stimulus
    assert stimulus.worst_modal_error(0.1) < 1e-5
    first, steady = stimulus.achieved(0.1), stimulus.achieved(0.1, steady=True)
    assert np.abs(np.array(first) - np.array(steady)).max() < 1e-5


@pytest.mark.parametrize("design", ["norm_4", "norm_8", "least_peak"])
def test_every_design_begins_and_ends_at_mid_scale(edit: Edit, design: str) -> None:
    """The generator rests at the first code between bursts."""
    burst = examine(protocol(edit, design)).stimulus.burst
    assert set(burst.codes[:, [0, -1]].ravel()) == {burst.converter.mid_code}


def test_higher_norms_have_lower_peak_voltages(edit: Edit) -> None:
    """The peak falls from least energy to least peak; the fourth norm has less than 0.65 of the first."""
    shipped = examine(edit("differentiated_stimulation.yaml")).stimulus
    highest = [
        float(replace(shipped, design=design).peak_voltage.max())
        for design in ("least_energy", "norm_4", "norm_8", "least_peak")
    ]
    assert highest == sorted(highest, reverse=True)
    assert highest[1] < 0.65 * highest[0]


def test_the_papers_law_accepts_no_other_design(edit: Edit) -> None:
    """The problem is reported at the key `stimulus.design`."""
    (problem,) = examine(protocol(edit, "norm_4", law="paper")).problems
    assert "stimulus.design: given norm_4, which the paper's law does not support" in str(problem)
