"""The figure of a plan, checked by the numbers drawn."""

from __future__ import annotations

import pytest

from modaltouch.analysis.statistics import STATISTICS
from modaltouch.planning.design import Design
from modaltouch.planning.experiments import Study
from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import Participant
from modaltouch.planning.power import Power, draw_power, plan

UNSURE = Observer(Participant(noise=0.5, criterion=0.4))


def planned(design: Design, sizes: list[tuple[int, int]], families: tuple[str, ...] = tuple(STATISTICS)) -> Power:
    """Return a small plan."""
    return plan(Study(design, UNSURE, families, null=False, seed=1), sizes, 20)


def test_each_number_of_repetitions_has_its_curve(design: Design) -> None:
    """Each family has a panel, with one curve for each number of repetitions over the simulated sizes."""
    figure = draw_power(planned(design, [(n, r) for r in (1, 2) for n in (6, 10, 16)]))
    panels = [axes for axes in figure.axes if axes.axison]
    assert len(panels) == len(STATISTICS)
    for axes in panels:
        assert [line.get_xdata().tolist() for line in axes.get_lines()[:-1]] == [[6, 10, 16], [6, 10, 16]]


def test_one_number_of_repetitions_is_drawn_as_curves(design: Design) -> None:
    """The curve has the power of every size at its number of participants."""
    power = planned(design, [(n, 1) for n in (6, 10, 16)], ("a2",))
    axes = draw_power(power).axes[0]
    line = axes.get_lines()[0]
    assert line.get_xdata().tolist() == [6, 10, 16]
    assert line.get_ydata().tolist() == pytest.approx([row["power"] for row in power.families])


@pytest.mark.parametrize("sizes", [[(8, 1)], [(8, 1), (8, 2)], [(8, 1), (10, 2)]])
def test_any_sizes_can_be_drawn(design: Design, sizes: list[tuple[int, int]]) -> None:
    """Curves are drawn even if sizes form no grid, as after an interruption."""
    axes = draw_power(planned(design, sizes, ("d",))).axes[0]
    assert axes.get_ylabel() == "power"
    assert sum(len(line.get_xdata()) for line in axes.get_lines()[:-1]) == len(sizes)
