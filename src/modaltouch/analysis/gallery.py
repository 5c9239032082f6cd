"""Every figure of an analysis with its file name, caption and description."""

from __future__ import annotations

from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.covariate_figures import draw_order, draw_side, draw_speeds, draw_times
from modaltouch.analysis.fields import draw_fields
from modaltouch.analysis.figures import draw_counts, draw_overview, draw_participants
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.tables import figure_names, zone_table
from modaltouch.report import ReportFigure

FIELDS = (
    "Left: the target velocity field along the beam, and the field predicted at the focusing instant from the codes "
    "that were played, on the identified modes. Right: predicted peak speed over time at the centre of each zone."
)
INTERVALS = "Error bars: exact 95 % intervals (Clopper-Pearson) over participants."


def draw_all(answers: AnswerCounts, responses: Responses) -> tuple[ReportFigure, ...]:
    """Return every figure that the answers allow."""
    frame = responses.frame
    drawn = (
        (
            "overview",
            draw_overview(answers),
            "Share of every answer but the last over the level. Error bars: 95 % intervals over participants.",
            "answers",
        ),
        ("participants", draw_participants(answers), "Every participant's answer in every cell.", "answers"),
        ("fields", draw_fields(responses.start, responses.stimulus), FIELDS, "stimulus"),
        (
            "side_bias",
            draw_side(answers) if answers.compares else None,
            "Each point is a participant, shaken a little so that equal ones show.",
            "further",
        ),
        (
            "order",
            draw_order(answers, frame) if answers.compares else None,
            "Share of the dominant zone against the place in the session.",
            "further",
        ),
        (
            "reaction_times",
            draw_times(answers, frame),
            "An answer may wait for the next burst, so reaction times are quantised and small differences mean little. "
            "Answers too early to be answers are left out.",
            "further",
        ),
        (
            "speed_ratio",
            draw_speeds(answers, frame) if answers.compares else None,
            "Predicted peak speeds come from the identified modes of the beam, not from a measurement.",
            "further",
        ),
    )
    known = (ReportFigure(name, figure, *said) for name, figure, *said in drawn if figure is not None)
    return (*_bars(answers), *known)


def _bars(answers: AnswerCounts) -> list[ReportFigure]:
    pictures = []
    for condition, name in figure_names(answers.finger_conditions).items():
        table = zone_table(answers, condition)
        n = answers.n_participants
        figure = draw_counts(table, condition, n if answers.n_repetitions > 1 else None)
        number = {"fig_10": "Fig. 10. ", "fig_11": "Fig. 11. "}.get(name, "")
        several = f", {answers.n_repetitions} answers each" if answers.n_repetitions > 1 else ""
        caption = f"{number}Answers under {condition}, {n} participant{'s' * (n != 1)}{several}. {INTERVALS}"
        pictures.append(ReportFigure(name, figure, caption, "answers", condition))
    return pictures
