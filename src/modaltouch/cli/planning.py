"""``modaltouch power``, ``prereg`` and ``fit``: sample size, preregistration and observer."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer

from modaltouch import analysis, planning, preflight, record, report, session, system
from modaltouch.cli import (
    INTERRUPTED,
    JSON,
    MODE,
    OBSERVER,
    PROTOCOL,
    USUAL_OBSERVER,
    print_json,
    print_table,
    progress,
    reporting,
    say,
)
from modaltouch.cli.analyse import ANSWERS, MISSING, parse_words, participants

_FAMILIES_PER_TABLE = 4
"""Maximum number of test families per table, so that it fits 80 columns."""

_IN_MEMORY, _SESSION_MB = Path("/dev/shm"), 4
"""File system in memory, on Linux, and more than the size of a session's record [MB]."""

_MOST_PARTICIPANTS, _MOST_ANSWERS = 1000, 10_000

PARTICIPANTS = Annotated[
    str, typer.Option("--participants", "-n", help="Sizes of the cohort: 6:40, 6:40:2 or 8,12,16.")
]
REPETITIONS = Annotated[
    str | None,
    typer.Option(
        "--reps",
        help="Repetitions of each condition, such as 1,2,4.",
        show_default="the protocol's own, of all sessions",
    ),
]
JOBS = Annotated[int, typer.Option("--jobs", "-j", min=1, max=256, help="Processes that share the work.")]
NULL = Annotated[bool, typer.Option("--null", help="Simulate no effect, to check the rate of false alarms.")]


def power(
    protocol: PROTOCOL,
    participants: PARTICIPANTS = "6:40:2",
    reps: REPETITIONS = None,
    observer: OBSERVER = "paper",
    experiments: Annotated[int, typer.Option(min=1, max=1_000_000, help="Experiments simulated for each size.")] = 1000,
    questions: Annotated[
        str | None,
        typer.Option(
            help="Which families of tests: a1, a2, b, c, d, the means `a2 mean` to `d mean`, and `c alike`.",
            show_default="all but the means; c alike if the protocol sets a margin",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed; the same seed gives the same figures.")] = 1,
    null: NULL = False,
    target: Annotated[float, typer.Option(min=0.01, max=0.999, help="Power to reach.")] = 0.8,
    jobs: JOBS = 1,
    out: Annotated[
        Path | None, typer.Option(help="Folder for tables and the picture.", show_default="nothing is written")
    ] = None,
    json_output: JSON = False,
) -> None:
    """Estimate the power of each test for each number of participants, by simulating the protocol.

    Simulated participants answer every condition of the protocol, and the exact tests of the analysis, with Holm's
    correction, are run on their answers. If the protocol has several stimuli, each is planned separately, as in
    `modaltouch analyse --stimulus`. Ctrl-C keeps the results so far.
    """
    sizes_n = parse_sizes(participants, "--participants", _MOST_PARTICIPANTS)
    sizes_r = parse_sizes(reps, "--reps", _MOST_ANSWERS) if reps is not None else None
    with reporting(json_output=json_output):
        model = planning.Observer.read(observer)
        designs = planning.designs_for(preflight.examine(protocol, uncalibrated=True).require(), model)
        first = next(iter(designs.values()))
        repetitions = sizes_r or (first.n_repetitions,)
        n_answers = max(sizes_n) * max(repetitions) * len(first.levels)
        if n_answers > _MOST_ANSWERS:
            given = f"given {n_answers} answers to each pair (participants x repetitions x levels)"
            raise typer.BadParameter(f"{given}; allowed: at most {_MOST_ANSWERS}; lower --participants or --reps")
        folders = {name: out / name for name in designs} if out is not None else {}
        for folder in folders.values():
            report.refuse_other(folder, "power")
        families = {name: _families(questions, design.tests, null=null) for name, design in designs.items()}
        found: list[planning.Power] = []
        with system.Interruption() as interruption:
            for name, design in designs.items():
                with progress(f"{name}: experiments" if name else "experiments") as on_progress:
                    planned = planning.plan(
                        planning.Study(design, model, families[name], null, seed),
                        [(n, r) for r in repetitions for n in sizes_n],
                        experiments,
                        n_processes=jobs,
                        on_progress=on_progress,
                        should_stop=lambda: bool(interruption.pending),
                    )
                found.append(planned)
                if not planned.complete:
                    break
        _report(found, target, folders, json_output=json_output)


def _report(plans: Sequence[planning.Power], target: float, folders: Mapping[str, Path], *, json_output: bool) -> None:
    """Write and print the power analysis of each stimulus, even if the last one was interrupted."""
    values = []
    for found in plans:
        folder = folders.get(found.study.design.stimulus)
        files: dict[str, Path] = {}
        if folder is not None and found.tallies:
            files = planning.write_power(folder, found, target)
        values.append({**found.as_dict(target), "files": {name: str(path) for name, path in files.items()}})
        if not json_output:
            tell(found, target)
            for name, path in files.items():
                print(f"{name:16} {path}")
    if json_output:
        of_several = {"protocol": values[0]["protocol"], "complete": plans[-1].complete, "stimuli": values}
        print_json(of_several if "stimulus" in values[0] else values[0])
    if not plans[-1].complete:
        whose = f" of {plans[-1].study.design.title}" if plans[-1].study.design.stimulus else ""
        typer.secho(f"interrupted; kept: {_done(plans[-1])}{whose}", err=True)
        raise typer.Exit(INTERRUPTED)


def parse_sizes(words: str, option: str, most: int) -> tuple[int, ...]:
    """Parse a range or list of integers into a sorted tuple without duplicates.

    Parameters
    ----------
    words : str
        ``6:40`` (both ends included), ``6:40:2``, ``8,12,16``, or several of these separated by commas.
    option : str
        Name of the option, for the error message.
    most : int
        Largest allowed number.

    Raises
    ------
    typer.BadParameter
        If the format is invalid or a number is out of bounds.

    Examples
    --------
    >>> parse_sizes("6:10:2,20", "--participants", 1000)
    (6, 8, 10, 20)
    """
    found: set[int] = set()
    for part in words.split(","):
        ends = part.strip().split(":")
        if not (1 <= len(ends) <= 3 and all(end.strip().isascii() and end.strip().isdecimal() for end in ends)):
            _refuse(option, words, most)
        first, last, step = (int(value) for value in (*ends, *(ends[:1] if len(ends) == 1 else []), "1")[:3])
        if not (1 <= first <= last <= most and step >= 1):
            _refuse(option, words, most)
        found.update(range(first, last + 1, step))
    return tuple(sorted(found))


def _refuse(option: str, words: str, most: int) -> None:
    raise typer.BadParameter(
        f"given {option} {words!r}; allowed: whole numbers from 1 to {most}, as a range 6:40, a range with a step "
        "6:40:2, or a list 8,12,16"
    )


def _families(questions: str | None, tests: Mapping[str, Sequence[object]], *, null: bool) -> tuple[str, ...]:
    """Return the requested families of tests that apply to the protocol."""
    by_default = ",".join(family for family in analysis.STATISTICS if not family.endswith(" mean"))
    asked = [word.strip() for word in (questions or by_default).split(",")]
    for word in asked:
        if word not in analysis.STATISTICS:
            allowed = ", ".join(analysis.STATISTICS)
            raise typer.BadParameter(f"given --questions {word!r}; allowed: {allowed}, separated by commas")
    # Without a simulated effect, finding the conditions equivalent is no false alarm.
    found = tuple(
        family
        for family, each in analysis.STATISTICS.items()
        if family in asked and tests[family] and not (null and each.when_alike)
    )
    if not found:
        raise typer.BadParameter(
            f"given --questions {questions!r}, for which this protocol has no test: c needs two finger conditions, d "
            "two pairs of zones, c alike analysis.equivalence_margin and no --null"
        )
    return found


def _done(found: planning.Power) -> str:
    if not found.tallies:
        return "nothing, as no experiment was finished"
    if found.complete:
        return f"{found.n_experiments} experiments of each size"
    counts = [tally.n_experiments for tallies in found.tallies.values() for tally in tallies.values()]
    return (
        f"{min(counts)} to {max(counts)} of {found.n_experiments} experiments for {len(found.tallies)} of "
        f"{len(found.sizes)} sizes"
    )


def tell(found: planning.Power, target: float) -> None:
    """Print a power analysis: power by family and size, participants needed, and minimum numbers for significance."""
    study = found.study
    what = "False alarms, with no effect simulated, of" if study.null else "Power of"
    observer, name = study.observer.name, study.design.stimulus
    alone = f"; the tests of {name} alone, as by `analyse --stimulus {name}`" if name else ""
    alone += ": without it the correction is over all stimuli, as `prereg` simulates" * bool(name)
    say(
        f"{what} {study.design.title} with observer {observer}: share of {_done(found)} in "
        f"which at least one test of a family is significant at {analysis.ALPHA:g} after Holm's correction, in per "
        f"cent with a 95 % interval{alone}"
    )
    for n_repetitions, own in groupby(found.families, key=lambda row: row["n_repetitions"]):
        rows = [(str(n), *map(_cell, of_size)) for n, of_size in groupby(own, key=lambda row: row["n_participants"])]
        title = f"n participants, {n_repetitions} repetition{'s' * (n_repetitions > 1)}"
        for first in range(0, len(study.families), _FAMILIES_PER_TABLE):
            shown = slice(first, first + _FAMILIES_PER_TABLE)
            print_table(title, ("n", *study.families[shown]), [(n, *cells[shown]) for n, *cells in rows], n_words=0)
    if not study.null:
        of = study.design.finger_conditions, study.design.pairs
        print_table(
            f"Participants for a power of {target:g}",
            ("question", "test", "reps", "participants"),
            [
                (
                    row["family"],
                    analysis.scope_in_words(row["scope"], *of),
                    str(row["n_repetitions"]),
                    str(row["n_participants"] or "more"),
                )
                for row in found.needed(target)
                if row["family"] != "a1" or row["scope"] == "any test"
            ],
            n_words=2,
        )
    for floor in (each for each in found.floors if each.least_participants != 1):
        least = floor.least_participants
        reach = "any number of participants" if least is None else f"fewer than {least} participants"
        say(
            f"{floor.family} ({floor.n_tests} test{'s' * (floor.n_tests != 1)}, {floor.n_repetitions} per cell): "
            f"never significant with {reach}",
            dim=True,
        )


def _cell(row: dict[str, Any]) -> str:
    share = f"{100 * row['power']:.0f} ({100 * row['low']:.0f}-{100 * row['high']:.0f})"
    return share if row["reachable"] else "never"


def _scratch(n_sessions: int) -> Path | None:
    """Return where to simulate sessions: in memory if there is room, since each answer is flushed to the disk."""
    try:
        return _IN_MEMORY if shutil.disk_usage(_IN_MEMORY).free > n_sessions * _SESSION_MB * 1e6 else None
    except OSError:
        return None


def _simulate_study(
    checked: preflight.Preflight,
    population: planning.Observer,
    n_participants: int,
    threshold_mm_s: float | None,
    seed: int,
) -> analysis.Responses:
    """Simulate the sessions of a whole experiment and return the answers; the records are not kept."""
    schedule = checked.experiment.protocol.schedule
    due = [(who, nth) for who in range(1, n_participants + 1) for nth in range(1, schedule.n_sessions + 1)]
    with TemporaryDirectory(dir=_scratch(len(due))) as folder:
        try:
            for who, nth in due:
                session.simulate_session(
                    checked, f"p{who:04d}", folder, seed=seed, observer=population, session=nth,
                    threshold_mm_s=threshold_mm_s,
                )  # fmt: skip
        except BaseException as error:
            vars(error).pop("__notes__", None)  # the folder is temporary, so the session cannot be resumed
            raise
        return analysis.read_responses(Path(folder))


def prereg(
    protocol: PROTOCOL,
    participants: Annotated[
        int, typer.Option("--participants", "-n", min=1, max=1000, help="Planned number of participants.")
    ],
    observer: USUAL_OBSERVER = None,
    experiments: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1_000_000,
            help="Experiments simulated to find the power.",
            show_default="1000; 20 where whole sessions are simulated",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed; the same seed gives the same figures.")] = 1,
    threshold: Annotated[
        float | None,
        typer.Option(
            min=1e-3, help="Threshold in mm/s that is expected, if the protocol calibrates levels by participant."
        ),
    ] = None,
    jobs: JOBS = 1,
    out: Annotated[
        Path | None, typer.Option(help="File to write.", show_default="PROTOCOL.prereg.md, where analyse finds it")
    ] = None,
    json_output: JSON = False,
) -> None:
    """Write design, hypotheses, tests, margins, exclusion rules and sample size as one page of Markdown.

    The power is estimated by simulating the protocol: numbers of answers if two fingers are compared, otherwise whole
    sessions and their analysis. An existing page is never overwritten. `modaltouch analyse` lists departures
    from it.
    """
    with reporting(json_output=json_output):
        checked = preflight.examine(protocol, uncalibrated=True).require()
        source = checked.experiment.sources.protocol.path
        file = out or (source if protocol.is_file() else Path(source.name)).with_suffix(".prereg.md")
        record.prepare_file(file)
        population = planning.Observer.read(observer or planning.Observer.usual_name(checked.experiment.protocol))
        with progress("experiments") as on_progress:
            text = planning.preregister(
                checked, population, participants, n_experiments=experiments, seed=seed, threshold_mm_s=threshold,
                n_processes=jobs, on_progress=on_progress,
                study=partial(_simulate_study, checked, population, participants, threshold),
            )  # fmt: skip
        record.prepare_file(file)  # a page may have been written during the simulation
        record.replace_file(file, text.encode(), "give another file with --out")
        print_json({"file": str(file)}) if json_output else print(
            f"{file}\nPut it where nobody can change it, such as OSF."
        )


def fit(
    protocol: PROTOCOL,
    answers: Annotated[
        Path, typer.Argument(help="A results folder or a tidy CSV, as for `analyse`.", show_default=False)
    ],
    observer: OBSERVER = "paper",
    out: Annotated[
        Path | None, typer.Option(help="YAML file for the fitted observer.", show_default="nothing is written")
    ] = None,
    mode: MODE = None,
    words: ANSWERS = None,
    missing: MISSING = None,
    json_output: JSON = False,
) -> None:
    """Fit an observer, a model of how participants answer, to recorded answers such as those of a pilot.

    The given observer is the centre of the priors, and its front end is kept. If the protocol has several stimuli, one
    observer is fitted to the answers to all of them.
    """
    with reporting(json_output=json_output):
        prior = planning.Observer.read(observer)
        checked = preflight.examine(protocol, uncalibrated=True).require()
        if out is not None:
            record.prepare_file(out)
        fitted = planning.fit_answers(checked, answers, prior, mode=mode, words=parse_words(words, missing))
        n_answers = f"{fitted.n_answers} answers of {participants(fitted.n_participants)}"
        if out is not None:
            text = fitted.observer.as_file("fitted", f"Fitted to {n_answers} in {answers.name}")
            record.replace_file(out, text.encode(), "give another file with --out")
        if json_output:
            print_json({**fitted.as_dict(), "file": None if out is None else str(out)})
            return
        print(n_answers)
        for estimate in (*fitted.identified, *fitted.parameters):
            tied = ", scale by the prior" if estimate.tied_to_scale else ""
            print(
                f"{estimate.name:44} {estimate.value:8.4g}  95 % interval {estimate.low:.4g} to {estimate.high:.4g}, "
                f"learned {100 * estimate.learned:.0f} %{tied}"
            )
        print(fitted.not_identifiable)
        if not fitted.converged:
            typer.secho("the search did not end at a maximum; do not plan with this", err=True, fg=typer.colors.YELLOW)
        if out is not None:
            print(f"Next: modaltouch power {protocol} --observer {out}")
