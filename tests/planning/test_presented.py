"""The design of a protocol file, with the speeds that the observer feels."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modaltouch.analysis.responses import are_crossed
from modaltouch.planning.design import designs_for
from modaltouch.planning.fitting import fit_answers
from modaltouch.planning.observer import Observer
from modaltouch.planning.preregistration import preregister
from modaltouch.preflight import examine
from modaltouch.protocol import InputError


def test_the_papers_design_agrees_with_the_analysis(shipped: Path) -> None:
    """The cells are in the analysis' order, with the speeds that the preflight predicts."""
    preflight = examine(shipped / "differentiated_stimulation.yaml").require()
    design = designs_for(preflight, Observer())[""]
    assert design.finger_conditions == ("one_hand", "two_hands")
    assert [pair.label for pair in design.pairs] == ["A-C", "B-D", "C-E"]
    assert [pair.dominant for pair in design.pairs] == ["C", "B", "C"]
    assert design.levels == (80.0, 100.0, 150.0, 200.0)
    for place, stimulus in enumerate(preflight.stimuli):
        peaks = stimulus["zone_peak_mm_s"]
        expected = [[peaks[pair.left] * 1e-3, peaks[pair.right] * 1e-3] for pair in design.pairs]
        assert design.speeds[0, :, place] == pytest.approx(np.array(expected), rel=1e-3)


def test_placements_follow_the_schedule(edit: Callable[..., Path]) -> None:
    """Placements change after every order of the finger conditions has been used, every two participants."""
    fingers = "finger_conditions: [one_hand, two_hands]\n"
    file = edit("demo.yaml", (fingers, fingers + "  placements: [normal, mirrored]\n"))
    design = designs_for(examine(file).require(), Observer())[""]
    assert design.facing(9).tolist() == [1, 1, -1, -1, 1, 1, -1, -1, 1]


@pytest.mark.parametrize(
    ("listed", "weight", "is_crossed"),
    [
        ("cells: [{pair: [A, C], peak_velocities_mm_s: [100, 80], weight: 3}, "
         "{pair: [C, E], peak_velocities_mm_s: [80, 100], weight: 3}]", 3, True),
        ("zone_pairs: [[A, C], [B, D], [C, E]]\n  peak_velocities_mm_s: [80, 100, 200]\n"
         "  exclude: [{pair: [B, D]}, {peak_velocity_mm_s: 200}]", 1, True),
        ("cells: [{pair: [A, C], peak_velocities_mm_s: [80]}, {pair: [C, E], peak_velocities_mm_s: [80, 100]}]", 1,
         False),
    ],
)  # fmt: skip
def test_a_crossed_design_is_planned_however_its_cells_are_given(
    edit: Callable[..., Path], listed: str, weight: int, is_crossed: bool
) -> None:
    """The analysis takes it as crossed, too; a weight counts as repetitions."""
    usual = (
        "zone_pairs: [[A, C], [B, D], [C, E]]\n  peak_velocities_mm_s: [80, 200]",
        "zone_pairs: [[A, C], [C, E]]\n  peak_velocities_mm_s: [80, 100]",
    )
    expected = examine(edit("demo.yaml", usual)).require()
    found = examine(edit("demo.yaml", (usual[1], listed))).require()
    assert are_crossed(found.experiment.protocol.model_dump(mode="json")) == is_crossed
    if not is_crossed:
        with pytest.raises(InputError, match="conditions.cells: given cells that are not every pair at every level"):
            designs_for(found, Observer())
        return
    (one,), (other,) = (designs_for(each, Observer()).values() for each in (expected, found))
    assert np.array_equal(one.speeds, other.speeds) and one.tests == other.tests and one.pairs == other.pairs
    assert other.n_repetitions == weight * one.n_repetitions


def test_groups_with_the_same_cells_are_refused(edit: Callable[..., Path]) -> None:
    """The design is crossed, but one observer cannot represent differences between groups."""
    file = edit("demo.yaml", ("schedule:\n", "groups: {low: {}, high: {}}\nschedule:\n"))
    said = "groups: given groups of participants, which one observer cannot represent; allowed: no groups; simulate"
    with pytest.raises(InputError, match=said):
        designs_for(examine(file).require(), Observer())


def test_a_protocol_whose_sessions_are_not_analysed_is_neither_planned_nor_fitted(edit, tmp_path: Path) -> None:
    """Only training: nothing will be tested, whichever command asks."""
    kinds = "schedule:\n  sessions: [{name: training, analysed: false}]\n"
    preflight = examine(edit("demo.yaml", ("schedule:\n", kinds))).require()
    said = r"schedule.sessions: given no kind of session that is analysed \(only training\); allowed: at least one kind"
    with pytest.raises(InputError, match=said):
        designs_for(preflight, Observer())
    with pytest.raises(InputError, match=said):
        fit_answers(preflight, tmp_path, Observer())
    with pytest.raises(InputError, match=said):
        preregister(preflight, Observer(), 2, study=lambda seed: pytest.fail("simulated a study"))


def test_a_fit_is_not_told_to_simulate(edit, tmp_path: Path) -> None:
    """Sessions are recorded already."""
    file = edit("demo.yaml", ("schedule:\n", "schedule:\n  sessions: [{name: before}, {name: after}]\n"))
    with pytest.raises(InputError, match="several analysed kinds of session.*; see these answers with `modaltouch ana"):
        fit_answers(examine(file).require(), tmp_path, Observer())
