"""Analysis of adaptive sessions: thresholds, figures and report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from modaltouch.analysis.columns import scale_of
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.findings import Finding, plain_row, to_frame
from modaltouch.analysis.preregistration import RegisteredAnalysis, term_in_words
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.thresholds.runs import Run, compare_runs, find_runs, in_words, is_forced, over_participants
from modaltouch.analysis.words import certificates_in_words, format_interval
from modaltouch.report import ReportFigure, page_files

MOST_FIGURES = 60
"""Maximum number of sessions with figures of runs; with more, the report is too large for a browser."""


@dataclass(frozen=True, eq=False)
class ThresholdAnalysis(RegisteredAnalysis):
    """Results of adaptive sessions, and the files written.

    Attributes
    ----------
    runs : tuple of Run
        All runs with their fits.
    """

    runs: tuple[Run, ...]

    @property
    def confirmatory(self) -> list[tuple[str, AnswerCounts, Finding]]:
        """Empty, since comparisons of thresholds are exploratory."""
        return []

    def terms(self, tests: Mapping[str, int]) -> dict[str, Any]:
        """Return the terms fixed by a preregistration, by name."""
        adaptive = self.responses.start["design"]["adaptive"]
        return {
            "participants": len({run.participant for run in self.runs}),
            "runs": sorted({run.kind for run in self.runs}),
            "levels [mm/s]": list(self.bounds),
            "method": adaptive["method"],
            "trials a run": adaptive["trials"],
            "answers": list(self.responses.answers.names),
        }

    def design_in_words(self) -> list[tuple[str, str]]:
        """Describe the runs, levels and method in words, by name."""
        terms = self.terms({})
        return [(name, term_in_words(terms[name])) for name in ("runs", "levels [mm/s]", "method", "trials a run")]

    @property
    def thresholds(self) -> list[dict[str, Any]]:
        """Mean thresholds over participants, one row per kind of run."""
        return over_participants(self.runs)

    @cached_property
    def comparisons(self) -> list[Finding]:
        """Comparisons of thresholds between kinds of run."""
        return compare_runs(self.runs)

    @property
    def tests(self) -> list[dict[str, Any]]:
        """The comparisons, one row each."""
        return [
            {str(key): value for key, value in row.items()} for row in to_frame(self.comparisons).to_dict("records")
        ]

    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest possible level of a run [mm/s]."""
        levels = self.responses.start["design"]["conditions"]["peak_velocities_mm_s"]
        return min(levels), max(levels)

    def as_dict(self) -> dict[str, Any]:
        """Return all results as plain values for ``--json``; undetermined values are null."""
        return {
            "thresholds": [run.as_dict() for run in self.runs],
            "over_participants": self.thresholds,
            "tests": [plain_row(row) for row in self.tests],
            "files": {name: str(path) for name, path in self.files.items()},
            "n_participants": len({run.participant for run in self.runs}),
            "n_responses": int(self.responses.frame["response"].count()),
            "n_missing": sum(run.n_missing for run in self.runs),
            "missing": [
                {"participant": run.participant, "cell": f"session {run.session}, {run.kind}", "n": run.n_missing}
                for run in self.runs
                if run.n_missing
            ],
            **self.responses.as_dict(),
            **self.registration.as_dict(),
        }


def analyse_runs(responses: Responses) -> ThresholdAnalysis:
    """Analyse adaptive sessions.

    Parameters
    ----------
    responses : Responses
        Answers of adaptive sessions.
    """
    return ThresholdAnalysis(responses, find_runs(responses))


def render_runs(analysis: ThresholdAnalysis) -> dict[str, Any]:
    """Render all files of the analysis, by name, for `write_files`.

    Parameters
    ----------
    analysis : ThresholdAnalysis
        The analysis.
    """
    from modaltouch.analysis.thresholds.figures import draw_runs, draw_thresholds

    rows = [run.as_dict() for run in analysis.runs]
    together = analysis.thresholds
    pictures = [ReportFigure("thresholds", draw_thresholds(analysis.runs, analysis.bounds))]
    sessions = list(dict.fromkeys((run.participant, run.session) for run in analysis.runs))
    for participant, session in sessions[:MOST_FIGURES]:
        own = [run for run in analysis.runs if (run.participant, run.session) == (participant, session)]
        who = participant.replace("/", "-")
        pictures.append(ReportFigure(f"runs_sub-{who}_ses-{session}", draw_runs(own, analysis.bounds)))
    return {
        "thresholds.csv": rows,
        "over_participants.csv": together,
        **({"tests.csv": analysis.tests} if analysis.tests else {}),
        "thresholds.json": {"thresholds": rows, "over_participants": together},
        **_report_files(analysis, together, pictures, len(sessions)),
    }


def _report_files(
    analysis: ThresholdAnalysis, together: list[dict[str, Any]], pictures: Sequence[ReportFigure], n_sessions: int
) -> dict[str, Any]:
    from modaltouch.analysis.provenance import describe_record

    responses = analysis.responses
    design = responses.start["design"]
    both, nothing = responses.answers.naming("left", "right"), responses.answers.naming()
    task = "forced choice" if is_forced(responses) else "felt"
    return page_files(
        "modaltouch.analysis.thresholds",
        "report",
        pictures,
        title=f"Thresholds: {design.get('title') or responses.start.get('protocol', '')}",
        source=responses.source,
        runs=[{"run": run, "words": in_words(run.fitted.threshold) if run.fitted.threshold else None}
              for run in analysis.runs],
        together=together,
        tests=[(row.scope.replace("_", " "), format_interval(row), row.p, row.n, row.note)
               for row in analysis.comparisons],
        registration=analysis.registration,
        bounds=analysis.bounds,
        adaptive=design["adaptive"],
        both="" if both is None else both.name,
        nothing="" if nothing is None else nothing.name,
        named=() if nothing and design["adaptive"]["success"] == "felt" else responses.answers.names,
        task=responses.task,
        is_forced=is_forced(responses),
        certified=[certificates_in_words([f"{of}, {task}{kind}" for kind in kinds])
                   for of, kinds in (("mean of runs", (", as estimated", "")), ("run of one", ("",)))],
        rule=responses.start.get("adaptive", {}),
        scale=scale_of(responses.frame.columns),
        focus=" or ".join(sorted(set(responses.foci.values()) or {responses.focus})),
        n_participants=len({run.participant for run in analysis.runs}),
        n_sessions=n_sessions,
        n_missing=sum(run.n_missing for run in analysis.runs),
        left_out=responses.left_out,
        notes=responses.notes,
        command=responses.command,
        record=describe_record(responses.sessions),
    )  # fmt: skip
