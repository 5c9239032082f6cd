"""Analysis of the answers in recorded sessions or a CSV file: counts, exact statistics, figures and a report.

`read_responses` reads the answers into a tidy table, and `Responses.count` counts them. `analyse` writes all results to
a folder, including the thresholds of adaptive runs; `analyse_responses` returns them without writing files. Tests are
exact, or Monte Carlo with a fixed seed; planning runs those in `STATISTICS` on batches of simulated experiments. No
instrument or screen is needed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.analysis.counts import AnswerCounts, Pair
    from modaltouch.analysis.csv_table import TableFormat
    from modaltouch.analysis.findings import ALPHA
    from modaltouch.analysis.intervals import wilson
    from modaltouch.analysis.pipeline import analyse, analyse_responses, read_responses
    from modaltouch.analysis.preregistration import terms_of
    from modaltouch.analysis.responses import Responses
    from modaltouch.analysis.statistics import STATISTICS
    from modaltouch.analysis.words import scope_in_words
else:
    __getattr__ = lazily(
        __name__,
        {
            "counts": "AnswerCounts Pair",
            "csv_table": "TableFormat",
            "findings": "ALPHA",
            "intervals": "wilson",
            "pipeline": "analyse analyse_responses read_responses",
            "preregistration": "terms_of",
            "responses": "Responses",
            "statistics": "STATISTICS",
            "words": "scope_in_words",
        },
    )

__all__ = [
    "ALPHA",
    "AnswerCounts",
    "Pair",
    "TableFormat",
    "Responses",
    "STATISTICS",
    "analyse",
    "analyse_responses",
    "read_responses",
    "scope_in_words",
    "terms_of",
    "wilson",
]
