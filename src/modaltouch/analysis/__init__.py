"""From records to tables, statistics, figures and the report; needs neither instrument nor screen.

``reading``      answers from a tidy CSV (``csv_table``, ``balance``) or a tree of sessions (``results_tree``)
``responses``    what they are, once read
``counts``       answers as one array; ``tables``: as tables, in the form of Fig. 10 and Fig. 11
``exact``        exact tests by convolution (``convolution``, ``trend``); ``shuffles``: Monte Carlo ones
``intervals``    intervals that hold when every answer is the same; ``agreement``: Gwet's AC1
``statistics``   the questions of the plan (``consistency``, ``secondary``), as rows of ``findings``
``figures``      bars, overview, participants (``courses``, ``gallery``, ``style``)
``report``       one HTML file; ``record_facts``: what the session logs add to it
``analyse``      the whole of it (``outcome``), written to a folder (``output``)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.analysis.counts import LEFT, NONE, PAPER_CONDITIONS, AnswerCounts, Pair, count_answers, orient
    from modaltouch.analysis.exact import multinomial_test, multinomial_tests
    from modaltouch.analysis.findings import ALPHA
    from modaltouch.analysis.intervals import CONFIDENCE, wilson
    from modaltouch.analysis.pipeline import analyse
    from modaltouch.analysis.reading import read_responses
    from modaltouch.analysis.responses import Responses
    from modaltouch.analysis.scale import OWN_THRESHOLD, scale_of
    from modaltouch.analysis.thresholds.analysis import analyse_runs
    from modaltouch.analysis.trend import draws_without_replacement, level_scores
else:
    __getattr__ = lazily(
        __name__,
        {
            "counts": "AnswerCounts LEFT NONE PAPER_CONDITIONS Pair count_answers orient",
            "exact": "multinomial_test multinomial_tests",
            "findings": "ALPHA",
            "intervals": "CONFIDENCE wilson",
            "pipeline": "analyse",
            "reading": "read_responses",
            "responses": "Responses",
            "scale": "OWN_THRESHOLD scale_of",
            "thresholds.analysis": "analyse_runs",
            "trend": "draws_without_replacement level_scores",
        },
    )

__all__ = [
    "ALPHA",
    "AnswerCounts",
    "CONFIDENCE",
    "LEFT",
    "NONE",
    "OWN_THRESHOLD",
    "PAPER_CONDITIONS",
    "Pair",
    "Responses",
    "analyse",
    "analyse_runs",
    "count_answers",
    "draws_without_replacement",
    "level_scores",
    "multinomial_test",
    "multinomial_tests",
    "orient",
    "read_responses",
    "scale_of",
    "wilson",
]
