"""Analysis pipeline: read the answers, compute the statistics, and write tables, figures and the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from modaltouch.analysis.columns import Speed
from modaltouch.analysis.provenance import form_files
from modaltouch.protocol import InputError
from modaltouch.report import ReportFigure, write_files
from modaltouch.system import version

if TYPE_CHECKING:
    from modaltouch.analysis.crossed import Analysis
    from modaltouch.analysis.csv_table import TableFormat
    from modaltouch.analysis.parts import PartsAnalysis
    from modaltouch.analysis.preregistration import RegisteredAnalysis
    from modaltouch.analysis.responses import Responses
    from modaltouch.analysis.runs import ThresholdAnalysis

Held = TypeVar("Held", bound="RegisteredAnalysis")


def read_responses(
    path: Path | str,
    *labs: Path | str,
    mode: str | None = None,
    stimulus: str | None = None,
    table_format: TableFormat | None = None,
) -> Responses:
    """Read the answers in a CSV file, a session log, or a tree of sessions.

    Parameters
    ----------
    path : Path or str
        A CSV file; or a results folder, or any folder or session log in it.
    *labs : Path or str
        Results folders of other labs with the same protocol.
    mode : {"real", "pilot", "simulated"}, optional
        Which sessions of a tree, or rows of a CSV with a column ``mode``, to use. By default the real ones; if there
        are none, those of the only mode.
    stimulus : str, optional
        Stimulus to analyse, if there are several; by default all.
    table_format : TableFormat, optional
        The answers offered, their spelling and the equivalence margin, for a CSV; recorded sessions contain them.

    Raises
    ------
    InputError
        With all problems found, their locations and remedies: unknown words, missing columns or cells, duplicate rows,
        a tree with mixed modes or protocols.
    """
    place, *further = map(Path, (path, *labs))
    for each in (place, *further):
        if not each.exists():
            remedy = "check the name; results are in results/<protocol> unless --results named another folder"
            raise InputError.of(each, "no such file or folder", "a CSV file or a results folder", remedy)
        if further and not each.is_dir():
            remedy = "give the results folder of each lab; combine tables into one"
            raise InputError.of(each, "a file among several sources", "folders alone", remedy)
    if place.is_dir() or place.suffix == ".jsonl":
        if table_format is not None:
            given = "the meaning of words in a CSV with recorded sessions, which contain theirs"
            remedy = "leave out --answers, --missing and, with `analyse`, --protocol"
            raise InputError.of(place, given, "a CSV file", remedy)
        from modaltouch.analysis.results_tree import read_tree

        return _refuse_none(place, read_tree(place, *further, mode=mode, stimulus=stimulus))
    if place.name.endswith("_beh.tsv") and (place.parent / "session.jsonl").exists():
        remedy = f"give its folder {place.parent}, or that of the whole study"
        raise InputError.of(place, "the table of one recorded session", "a CSV file or a results folder", remedy)
    if table_format is not None and table_format.design.get("adaptive"):
        given = "a table with an adaptive protocol, whose levels followed from the answers"
        raise InputError.of(place, given, "recorded sessions", "give the folder of the sessions, without --protocol")
    from modaltouch.analysis.tidy import read_csv

    return _refuse_none(place, read_csv(place, table_format, mode, stimulus))


def _refuse_none(place: Path, responses: Responses) -> Responses:
    if responses.frame.empty:
        given = "no answer to any trial: each timed out, or has none"
        raise InputError.of(
            place, given, "at least one answer", "look at answers.time_out_s, or at the column response"
        )
    return responses


def analyse(
    path: Path | str,
    out: Path | str | None = None,
    *,
    labs: Sequence[Path | str] = (),
    mode: str | None = None,
    stimulus: str | None = None,
    table_format: TableFormat | None = None,
    fields: bool = False,
    prereg: Path | str | None = None,
    model: bool = False,
    speed: Speed = "nominal",
) -> Analysis | ThresholdAnalysis | PartsAnalysis:
    """Analyse answers and write tables, figures, statistics and a report.

    Parameters
    ----------
    path : Path or str
        A tidy CSV, or a tree of recorded sessions.
    out : Path or str, optional
        By default ``derivatives/analysis`` in a dataset, ``analysis`` in another folder, ``<name>_analysis`` by a CSV.
    labs : sequence of Path or str
        Trees of other labs with the same protocol, compared like groups; `out` is then required.
    mode : {"real", "pilot", "simulated"}, optional
        Which sessions of a tree to use.
    stimulus : str, optional
        Stimulus to analyse, if sessions at fixed levels have several; by default all.
    table_format : TableFormat, optional
        The answers offered, their spelling and the equivalence margin, for a CSV; recorded sessions contain them.
    fields : bool
        Whether to draw the velocity fields of the stimulus, too.
    prereg : Path or str, optional
        The preregistration written by ``modaltouch prereg``; by default the one beside the protocol, if any.
    model : bool
        Whether to fit the mixed logistic model, too (imports statsmodels).
    speed : {"nominal", "predicted", "delivered"}
        Definition of the levels: nominal speed at the focus, or predicted or delivered speed under the faster finger.

    Returns
    -------
    Analysis, ThresholdAnalysis or PartsAnalysis
        `ThresholdAnalysis` for adaptive sessions, `PartsAnalysis` for designs that are not crossed.

    Raises
    ------
    InputError
        If the answers cannot be used, with all problems found.
    RecordError
        If a file cannot be written, or would overwrite a file not written by this command.
    """
    asked: dict[str, Any] = {"--fields": fields, "--prereg": prereg, "--model": model}
    if labs and out is None:
        raise InputError.of(path, "the folders of several labs", "with --out", "say with --out where the results go")
    responses = read_responses(path, *labs, mode=mode, stimulus=stimulus, table_format=table_format)
    responses = responses if speed == "nominal" else responses.by_speed(speed)
    folder = Path(out) if out is not None else default_folder(Path(path), responses.stimulus)
    asked |= {"--speed": speed != "nominal"} if responses.scheduled is not None else {}
    (found, files), source = _results(responses, path, asked), responses.source
    about = {"version": version(), "source": source.path, "sha256": source.sha256, "mode": source.mode}
    return replace(found, files=write_files(folder, files | form_files(responses.sessions), about))


def _results(
    responses: Responses, path: Path | str, asked: dict[str, Any]
) -> tuple[Analysis | ThresholdAnalysis | PartsAnalysis, dict[str, Any]]:
    """Analyse the answers and render the files; refuse options that do not apply to the design."""
    prereg = asked.pop("--prereg")
    options = [option for option, value in asked.items() if value]
    if options and responses.is_adaptive:
        raise InputError.of(options[0], "adaptive sessions", "sessions at fixed levels", f"leave {options[0]} out")
    if options and responses.scheduled is not None:
        what = " and ".join(
            name for name, several in (("stimuli", responses.stimuli), ("groups", responses.groups),
                                       ("kinds of session", responses.kinds)) if several
        )  # fmt: skip
        given = f"{' and '.join(options)} with {f'several {what}' if what else 'a design that is not crossed'}"
        remedy = "leave these options out" + ", or take one stimulus with --stimulus" * bool(responses.stimuli)
        raise InputError.of(path, given, "tables, tests of each crossed part, models.R", remedy)
    found: Any = _hold_against(prereg, analyse_responses(responses, model=asked["--model"]))
    if responses.is_adaptive:
        from modaltouch.analysis.run_report import render_runs

        return found, render_runs(found)
    if responses.scheduled is not None:
        from modaltouch.analysis.parts import render_parts

        return found, render_parts(found)
    return found, render_files(found, fields=asked["--fields"])


def analyse_responses(responses: Responses, *, model: bool = False) -> Analysis | ThresholdAnalysis | PartsAnalysis:
    """Analyse answers like `analyse`, but without writing files."""
    if responses.is_adaptive:
        from modaltouch.analysis.runs import analyse_runs

        return analyse_runs(responses)
    if responses.scheduled is not None:
        from modaltouch.analysis.parts import analyse_parts

        return analyse_parts(responses)
    from modaltouch.analysis.crossed import Analysis

    return Analysis.of(responses, model=model)


def _hold_against(prereg: Path | str | None, analysis: Held) -> Held:
    """Compare an analysis with the preregistration that is given or found beside the protocol."""
    if prereg is None:
        protocol = analysis.responses.start.get("sources", {}).get("protocol", {}).get("path", "")
        beside = Path(protocol or "none").with_suffix(".prereg.md")
        if not beside.is_file():
            return analysis
        prereg = beside
    from modaltouch.analysis.preregistration import Registration, read_preregistration

    path = Path(prereg)
    departures = analysis.departures_from(read_preregistration(path))
    return replace(analysis, registration=Registration(path, departures))


def default_folder(path: Path, stimulus: str = "") -> Path:
    """Return the default output folder of an analysis; inside a BIDS dataset, it is in ``derivatives``."""
    if path.suffix != ".jsonl" and not path.is_dir():
        return path.parent / f"{path.stem}_analysis"
    folder = (path if path.is_dir() else path.parent).resolve()
    dataset = next((each for each in (folder, *folder.parents) if (each / "dataset_description.json").exists()), None)
    chosen = [stimulus] if stimulus else []
    if dataset is None:
        return (path if path.is_dir() else path.parent) / "_".join(["analysis", *chosen])
    names = folder.relative_to(dataset).parts[:2]
    return dataset / "derivatives" / "_".join(["analysis", *names, *chosen])


def render_files(analysis: Analysis, *, fields: bool = False) -> dict[str, Any]:
    """Render all files of an analysis, by name, for `write_files`."""
    from modaltouch.analysis.crossed import figure_names, zone_table
    from modaltouch.analysis.findings import rows_of, test_files
    from modaltouch.analysis.models import model_files
    from modaltouch.analysis.report import report_files

    files: dict[str, Any] = {"counts.csv": rows_of(analysis.counts)}
    chosen = analysis.answers if len(analysis.answers.answers) > 1 else None
    for condition, name in figure_names(chosen.finger_conditions if chosen else ()).items():
        table = zone_table(analysis.answers, condition)
        table.columns = table.columns.map("{:g}".format)
        files[f"{name}.csv"] = rows_of(table.reset_index())
    if analysis.design and analysis.design.rows:
        files["measures.csv"] = analysis.design.rows
    files |= test_files(analysis.tests)
    files |= model_files(analysis.answers, analysis.responses)
    # Matplotlib is loaded only now, since the tables above take much memory until they are written as text.
    from modaltouch.analysis.figures import FIELDS, draw_bars, draw_fields

    pictures, responses = draw_bars(analysis.answers), analysis.responses
    if fields:
        if (figure := draw_fields(responses.start, responses.stimulus)) is None:
            allowed = "sessions recorded by a version later than 0.2.0"
            raise InputError.of(
                "--fields", "answers without the field of their stimulus", allowed, "leave --fields out"
            )
        pictures.append(ReportFigure("fields", figure, FIELDS, "stimulus"))
    if analysis.design:
        from modaltouch.analysis.measure_figures import draw_design

        pictures += draw_design(analysis.design)
    return files | report_files(analysis, pictures)
