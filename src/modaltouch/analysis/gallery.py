"""Figures of an analysis with their file names, captions and descriptions."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING

from modaltouch.report import ReportFigure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from modaltouch.analysis.counts import AnswerCounts
    from modaltouch.analysis.responses import Responses

FIGURES = {
    "fields": (
        "Left: the target velocity field along the beam, and the field predicted at the focusing instant from the "
        "codes that were played, on the identified modes. Right: predicted peak speed over time at the centre of each "
        "zone.",
        "stimulus",
    ),
    "order": ("Share of the dominant zone over the course of the session.", "further"),
    "reaction_times": (
        "An answer may wait for the next burst, so reaction times are quantised and small differences mean little. "
        "Answers that come too early to be genuine are left out.",
        "further",
    ),
    "speed_ratio": (
        "Predicted peak speeds come from the identified modes of the beam, not from a measurement.",
        "further",
    ),
}
"""Captions and report sections of the optional figures."""

INTERVALS = "Error bars: exact 95 % intervals (Clopper-Pearson) over participants."
OF_SEVERAL = "Error bars: Clopper and Pearson's 95 % intervals, as if each participant had given one answer."


def draw_all(answers: AnswerCounts, responses: Responses, asked: Collection[str] = ()) -> tuple[ReportFigure, ...]:
    """Draw Fig. 10 and Fig. 11, and the requested optional figures as far as the answers allow.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers.
    responses : Responses
        The answers.
    asked : collection of str
        Requested figures, keys of `FIGURES`.
    """
    drawn = {name: _draw(name, answers, responses) for name in FIGURES if name in asked}
    known = (ReportFigure(name, figure, *FIGURES[name]) for name, figure in drawn.items() if figure is not None)
    return (*_bars(answers), *known)


def _draw(name: str, answers: AnswerCounts, responses: Responses) -> Figure | None:
    from modaltouch.analysis.covariate_figures import draw_order, draw_speeds, draw_times
    from modaltouch.analysis.fields import draw_fields

    frame = responses.frame
    ways: dict[str, Callable[[], Figure | None]] = {
        "fields": lambda: draw_fields(responses.start, responses.stimulus),
        "reaction_times": lambda: draw_times(answers, frame),
    }
    if answers.compares:
        ways |= {"order": lambda: draw_order(answers, frame), "speed_ratio": lambda: draw_speeds(answers, frame)}
    return ways[name]() if name in ways else None


def _bars(answers: AnswerCounts) -> list[ReportFigure]:
    from modaltouch.analysis.crossed import figure_names, zone_table
    from modaltouch.analysis.figures import draw_counts

    pictures = []
    chosen = len(answers.answers) > 1
    for condition, name in figure_names(answers.finger_conditions if chosen else ()).items():
        table = zone_table(answers, condition)
        n = answers.n_participants
        figure = draw_counts(table, condition, n if answers.n_repetitions > 1 else None)
        number = {"fig_10": "Fig. 10. ", "fig_11": "Fig. 11. "}.get(name, "")
        several = f", {answers.n_repetitions} answers each" if answers.n_repetitions > 1 else ""
        whose = f"{condition.replace('_', ' ')}, {n} participant{'s' * (n != 1)}"
        caption = f"{number}Answers with {whose}{several}. {OF_SEVERAL if several else INTERVALS}"
        pictures.append(ReportFigure(name, figure, caption, "answers", condition))
    return pictures
