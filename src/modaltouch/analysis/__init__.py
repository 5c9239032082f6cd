"""Answers of sessions or of a CSV go in; counts, exact statistics, figures and a report come out.

`read_responses` gives the answers as one tidy table, `Responses.count` their counts; `analyse` writes everything to a
folder, for adaptive sessions the thresholds of their runs (`analyse_runs`). The tests are exact, or Monte Carlo with a
stated seed; planning asks the same questions of simulated experiments. Needs neither instrument nor screen.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.analysis.counts import AnswerCounts, Pair
    from modaltouch.analysis.exact import multinomial_tests
    from modaltouch.analysis.findings import ALPHA
    from modaltouch.analysis.intervals import CONFIDENCE, wilson
    from modaltouch.analysis.pipeline import analyse
    from modaltouch.analysis.reading import read_responses
    from modaltouch.analysis.responses import Responses
    from modaltouch.analysis.thresholds.analysis import analyse_runs
    from modaltouch.analysis.trend import draws_without_replacement, level_scores
else:
    __getattr__ = lazily(
        __name__,
        {
            "counts": "AnswerCounts Pair",
            "exact": "multinomial_tests",
            "findings": "ALPHA",
            "intervals": "CONFIDENCE wilson",
            "pipeline": "analyse",
            "reading": "read_responses",
            "responses": "Responses",
            "thresholds.analysis": "analyse_runs",
            "trend": "draws_without_replacement level_scores",
        },
    )

__all__ = [
    "ALPHA",
    "AnswerCounts",
    "CONFIDENCE",
    "Pair",
    "Responses",
    "analyse",
    "analyse_runs",
    "draws_without_replacement",
    "level_scores",
    "multinomial_tests",
    "read_responses",
    "wilson",
]
