"""Analysis of a design that is not crossed, by its crossed parts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any

import pandas as pd

from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.crossed import tabulate
from modaltouch.analysis.findings import ALPHA, Finding, correct, grouped, plain_row, test_files, to_frame
from modaltouch.analysis.models import model_files
from modaltouch.analysis.preregistration import ALL_PARTS, PARTS, RegisteredAnalysis, name_part, terms_of_tests
from modaltouch.analysis.provenance import describe_record
from modaltouch.analysis.responses import Responses, cell_of
from modaltouch.analysis.statistics import uncorrected
from modaltouch.analysis.words import state_families
from modaltouch.protocol import InputError
from modaltouch.report import page_files

if TYPE_CHECKING:
    from modaltouch.analysis.designs import DesignAnalysis

FACTORS = ("group", "session_kind", "stimulus")
"""Factors that distinguish parts, besides finger conditions, pairs and levels."""

MOST_FIGURES = 40
"""Maximum number of figures in a report; the tables include all parts."""


@dataclass(frozen=True, eq=False)
class CrossedPart:
    """A crossed part of a design: all of its pairs at all of its levels, equally often for each of its participants.

    Attributes
    ----------
    factors : dict of str to str
        Group, kind of session and stimulus, if there are any.
    counts : AnswerCounts
        Counts of the answers.
    frame : DataFrame
        The answers as a tidy table.
    """

    factors: dict[str, str]
    counts: AnswerCounts
    frame: pd.DataFrame

    @property
    def name(self) -> str:
        """Factors, finger conditions, pairs and levels in words."""
        return name_part(self.counts, *self.factors.values())


@dataclass(frozen=True, eq=False)
class PartsAnalysis(RegisteredAnalysis):
    """Results of a design that is not crossed, and the files written.

    Attributes
    ----------
    parts : tuple of CrossedPart
        The crossed parts of the design.
    findings : tuple of (CrossedPart, Finding)
        The statistics of each part, with Holm's correction over all parts.
    design : DesignAnalysis, optional
        Results of individual participants and groups.
    """

    parts: tuple[CrossedPart, ...]
    findings: tuple[tuple[CrossedPart, Finding], ...]
    design: DesignAnalysis | None = None

    @property
    def confirmatory(self) -> list[tuple[str, AnswerCounts, Finding]]:
        """Tests corrected in families, as in `RegisteredAnalysis`."""
        found = [(ALL_PARTS, self.parts[0].counts, row) for row in self.whole]
        numbers = {part.name: f"part {number}" for number, part in enumerate(self.parts, start=1)}
        found += [(numbers[part.name], part.counts, row) for part, row in self.findings]
        return [each for each in found if each[2].family]

    def terms(self, tests: Mapping[str, int]) -> dict[str, Any]:
        """Return the terms fixed by a preregistration, by name."""
        return {
            "participants": int(self.responses.frame["participant"].nunique()),
            PARTS: {part.name: part.counts.n_repetitions for part in self.parts},
            "answers": list(self.responses.answers.names),
            **terms_of_tests(tests),
        }

    def design_in_words(self) -> list[tuple[str, str]]:
        """Describe each part and its number of presentations per cell, by number of the part."""
        repeated = [(part.name, part.counts.n_repetitions) for part in self.parts]
        return [
            (f"part {number}", f"{name}, {'once' if n == 1 else f'{n} times'}")
            for number, (name, n) in enumerate(repeated, start=1)
        ]

    @cached_property
    def whole(self) -> list[Finding]:
        """Findings over all parts, corrected in families."""
        return correct(self.design.findings) if self.design else []

    @property
    def counts(self) -> pd.DataFrame:
        """Counts by cell, one row each: answers, their sum n, and the number scheduled."""
        tables = [
            tabulate(part.counts).assign(**part.factors, asked=part.counts.n_participants * part.counts.n_repetitions)
            for part in self.parts
        ]
        table = pd.concat(tables, ignore_index=True)
        named = [name for name in FACTORS if name in table]
        return table[[*named, *(column for column in table if column not in named)]]

    @property
    def tests(self) -> pd.DataFrame:
        """The statistics, one row each, with the part of the design."""
        table = to_frame([*self.whole, *(finding for _, finding in self.findings)])
        table.insert(0, "part", ["all"] * len(self.whole) + [part.name for part, _ in self.findings])
        return table

    def as_dict(self) -> dict[str, Any]:
        """Return all results as plain values for ``--json``."""
        missing = [
            {"participant": who, "cell": " ".join([*filter(None, part.factors.values()), cell]), "n": n}
            for part in self.parts
            for who, cell, n in part.counts.missing
        ]
        return {
            "parts": [part.name for part in self.parts],
            "counts": [plain_row(row) for row in self.counts.to_dict("records")],
            "tests": [plain_row(row) for row in self.tests.to_dict("records")],
            **({"measures": [*map(plain_row, self.design.rows)]} if self.design else {}),
            "files": {name: str(path) for name, path in self.files.items()},
            "n_participants": int(self.responses.frame["participant"].nunique()),
            "n_responses": len(self.responses.frame),
            "n_missing": sum(each["n"] for each in missing),
            "missing": missing,
            **self.responses.as_dict(
                *[f"{len(self.parts)} crossed parts of the design are analysed separately"] * (len(self.parts) > 1)
            ),
            **self.registration.as_dict(),
        }


def analyse_parts(responses: Responses) -> PartsAnalysis:
    """Analyse the answers of a design that is not crossed.

    Parameters
    ----------
    responses : Responses
        Answers with the table of scheduled trials, `Responses.scheduled`.

    Raises
    ------
    InputError
        If participants of one group have unequal numbers of trials in a cell.
    """
    responses = replace(responses, notes=(*responses.notes, *_absent(responses)))
    given, responses = responses, responses.by_choice()
    parts, found = tuple(_find_parts(responses)), list[tuple[CrossedPart, Finding]]()
    for part in parts:
        if not part.frame.empty:  # without answers, a part has no findings, but its missing answers are counted
            found += [(part, finding) for finding in uncorrected(part.counts, part.frame)]
    corrected = correct(finding for _, finding in found)
    design = None
    if given.has_individual_results or given.stimuli or given.kinds or len(parts) > 1:
        from modaltouch.analysis.designs import analyse_design

        labels = [[pair.label for pair in part.counts.pairs] for part in parts]
        places = [[*product(part.counts.finger_conditions, own)] for part, own in zip(parts, labels, strict=True)]
        design = analyse_design(given, places)
    of_parts = tuple(zip((part for part, _ in found), corrected, strict=True))
    return PartsAnalysis(responses, parts, of_parts, design)


def _absent(responses: Responses) -> Iterator[str]:
    """Yield who has no trial of a kind of session, or with a stimulus, that others of the group have."""
    scheduled = responses.scheduled
    for name, what in (("session_kind", "of the kind of session"), ("stimulus", "with the stimulus")):
        for _, own in () if scheduled is None else scheduled.groupby("group", observed=True):
            met = pd.crosstab(own["participant"], own[name])
            for value in met:
                if absent := [*map(str, met.index[met[value] == 0])]:
                    yield f"without trials {what} {value}, and left out of its results: {', '.join(absent)}"


def _find_parts(responses: Responses) -> Iterator[CrossedPart]:
    """Split a design into crossed parts: pairs and finger conditions with the same levels and repetitions."""
    scheduled = responses.scheduled
    if scheduled is None:
        return
    cell = list(cell_of(scheduled.columns))
    named = [name for name in FACTORS if scheduled[name].nunique() > 1]
    for values, own in scheduled.groupby(named, observed=True) if named else [((), scheduled)]:
        factors = dict(zip(named, map(str, values), strict=True))
        levels_of = grouped(((each[:-1], n), each[-1]) for each, n in _asked(responses, own, cell))
        alike = grouped(((tuple(levels), n), place) for (place, n), levels in levels_of.items())
        for (levels, n), places in alike.items():
            conditions, pairs = ([*dict.fromkeys(place[of] for place in places)] for of in (0, slice(1, None)))
            is_whole = len(places) == len(conditions) * len(pairs)
            for chosen in [places] if is_whole else [[each for each in places if each[1:] == pair] for pair in pairs]:
                cells = {(*place, level) for place in chosen for level in levels}
                yield _part(responses, own, cell, cells, factors, n)


def _asked(responses: Responses, own: pd.DataFrame, cell: list[str]) -> list[tuple[Any, int]]:
    """Return the cells with their number of trials per participant; refuse numbers that vary between participants."""
    wide = own.groupby(["participant", *cell], observed=True).size().unstack(cell, fill_value=0)
    if odd := [name for name in wide.columns if wide[name].nunique() > 1]:
        shown = ", ".join(f"{who} {n}" for who, n in wide[odd[0]].drop_duplicates().items())
        given = f"participants of one group who met {' '.join(map(str, odd[0]))} unequally often ({shown})"
        remedy = "give a folder with the sessions of one version of the protocol"
        if not responses.sessions:
            remedy = "give every trial a row, with an empty response where none was given"
        raise InputError.of(responses.source.path, given, "each cell equally often for all of a group", remedy)
    return [(name, int(wide[name].iloc[0])) for name in wide.columns.sort_values()]


def _part(
    responses: Responses,
    own: pd.DataFrame,
    cell: list[str],
    cells: set[tuple[Any, ...]],
    factors: dict[str, str],
    n_repetitions: int,
) -> CrossedPart:
    """Return a part with its answers; missing answers have a count of 0, to keep participants without any."""
    scheduled = own[[key in cells for key in own[cell].itertuples(index=False, name=None)]]
    answered = scheduled[scheduled["response"].isin(responses.answers.names)]
    silent = scheduled.drop(answered.index).assign(n=0, response=responses.answers.names[0])
    focus, frame = str(scheduled["focus"].iloc[0]), pd.concat([answered, silent])
    counts = replace(responses, frame=frame, focus=focus, asked=n_repetitions).count()
    return CrossedPart(factors, counts, answered.reset_index(drop=True))


def render_parts(analysis: PartsAnalysis) -> dict[str, Any]:
    """Render all files of the analysis, by name, for `write_files`."""
    from modaltouch.analysis.figures import draw_bars
    from modaltouch.analysis.report import list_questions

    pictures = [
        picture
        for number, part in enumerate(analysis.parts, start=1)
        if not part.frame.empty
        for picture in draw_bars(part.counts, " ".join(filter(None, part.factors.values())), number)
    ]
    shown, values = pictures[:MOST_FIGURES], analysis.design.rows if analysis.design else []
    if analysis.design:
        from modaltouch.analysis.measure_figures import draw_design

        shown += draw_design(analysis.design)
    responses, everywhere = analysis.responses, _everywhere(analysis.parts)
    answered = pd.concat([part.frame.assign(focus=part.counts.focus) for part in analysis.parts], ignore_index=True)
    page = page_files(
        "modaltouch.analysis",
        "parts",
        shown,
        title=responses.heading("Analysis"),
        n_participants=responses.frame["participant"].nunique(),
        n_answers=len(responses.frame),
        counts=analysis.counts.to_dict("records"),
        parts=[
            (part, list_questions([finding for own, finding in analysis.findings if own is part], part.counts))
            for part in analysis.parts
        ],
        n_pictures=len(pictures),
        most_pictures=MOST_FIGURES,
        values=values,
        certified=analysis.design.certified if analysis.design else "",
        limits=analysis.design.limits if analysis.design else (),
        responses=responses,
        registration=analysis.registration,
        whole=list_questions(analysis.whole, everywhere),
        families=state_families([*analysis.whole, *(finding for _, finding in analysis.findings)]),
        alpha=ALPHA,
        record=describe_record(responses.sessions),
    )
    return {
        "counts.csv": analysis.counts.to_dict("records"),
        **test_files(analysis.tests),
        **({"measures.csv": values} if values else {}),
        **model_files(everywhere, replace(responses, frame=answered)),
        "report.html": page.pop("parts.html"),
        **page,
    }


def _everywhere(parts: Sequence[CrossedPart]) -> AnswerCounts:
    """Return the counts of the first part with the finger conditions and pairs of all parts, for wording."""
    conditions = dict.fromkeys(name for part in parts for name in part.counts.finger_conditions)
    pairs = {pair.label: pair for part in parts for pair in part.counts.pairs}
    return replace(parts[0].counts, finger_conditions=tuple(conditions), pairs=tuple(pairs.values()))
