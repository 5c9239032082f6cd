"""Power of an experiment for the effects of an observer, by simulating the protocol; its tables and figure."""

from __future__ import annotations

import signal
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modaltouch import report
from modaltouch.analysis import ALPHA, STATISTICS, wilson
from modaltouch.planning.design import Design
from modaltouch.planning.experiments import Study, Tallies, divide, run_job
from modaltouch.system import version

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST = 200


@dataclass(frozen=True)
class Floor:
    """Minimum number of participants for a family of tests to reach significance.

    Attributes
    ----------
    family : str
        The family.
    n_tests : int
        Tests corrected together by Holm's method.
    n_repetitions : int
        Answers per participant and cell.
    least_participants : int or None
        Minimum number of participants for a test of the family to be significant after correction; None if no number
        below 200 suffices.
    """

    family: str
    n_tests: int
    n_repetitions: int
    least_participants: int | None


def find_floor(design: Design, family: str, n_repetitions: int) -> Floor:
    """Return the minimum number of participants for a family's tests to reach significance."""
    n_tests, smallest_p = len(design.tests[family]), STATISTICS[family].smallest_p
    levels, margin = design.levels, design.margin
    reach = (n for n in range(1, _MOST) if smallest_p(levels, n, n_repetitions, margin) * n_tests <= ALPHA)
    least = next(reach, None) if len(levels) > 1 or family != "b" else None
    return Floor(family, n_tests, n_repetitions, least)


Size = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Power:
    """The power of a planned study.

    Attributes
    ----------
    study : Study
        The simulated study.
    sizes : tuple of (int, int)
        Numbers of participants and repetitions of each size.
    n_experiments : int
        Requested number of experiments of each size.
    tallies : dict
        Results by size and family; sizes without any experiment are missing.
    """

    study: Study
    sizes: tuple[Size, ...]
    n_experiments: int
    tallies: dict[Size, Tallies]

    @property
    def complete(self) -> bool:
        """Whether all requested experiments were simulated."""
        return all(
            size in self.tallies and all(t.n_experiments == self.n_experiments for t in self.tallies[size].values())
            for size in self.sizes
        )

    @cached_property
    def floors(self) -> tuple[Floor, ...]:
        """Minimum number of participants for each family's tests, by number of repetitions."""
        repetitions = sorted({n_repetitions for _, n_repetitions in self.sizes})
        design = self.study.design
        return tuple(find_floor(design, family, r) for family in self.study.families for r in repetitions)

    @cached_property
    def families(self) -> list[dict[str, Any]]:
        """Rows of plain values, one per size and family of tests.

        `power` is the share of experiments in which at least one test of the family was significant after Holm's
        correction, which under the null is the rate of false alarms.
        """
        return [self._family_row(size, family) for size, family in self._order()]

    @cached_property
    def tests(self) -> list[dict[str, Any]]:
        """Rows of plain values, one per size and test."""
        return [row for size, family in self._order() for row in self._test_rows(size, family)]

    def _order(self) -> Iterator[tuple[Size, str]]:
        by_repetitions = sorted(self.tallies, key=lambda size: (size[1], size[0]))
        return ((size, family) for size in by_repetitions for family in self.study.families)

    def _family_row(self, size: Size, family: str) -> dict[str, Any]:
        tally, design = self.tallies[size][family], self.study.design
        n_tests, p_min = len(tally.single), self._p_min[size, family]
        return {
            "question": STATISTICS[family].question,
            "family": family,
            **_size(size, design.shape),
            "n_experiments": tally.n_experiments,
            "n_tests": n_tests,
            **_shares("power", "", tally.any_test, tally.n_experiments),
            **_shares("power_every_test", "power_every_test_", tally.every_test, tally.n_experiments),
            "p_min": p_min,
            "p_min_holm": min(1.0, p_min * n_tests),
            "reachable": p_min * n_tests <= ALPHA,
        }

    def _test_rows(self, size: Size, family: str) -> Iterator[dict[str, Any]]:
        tally, design = self.tallies[size][family], self.study.design
        for place, (scope, _) in enumerate(design.tests[family]):
            width = float(tally.width[place]) / tally.n_experiments
            yield {
                "question": STATISTICS[family].question,
                "family": family,
                "scope": scope,
                **_size(size, design.shape),
                "n_experiments": tally.n_experiments,
                **_shares("power", "", int(tally.corrected[place]), tally.n_experiments),
                **_shares("power_uncorrected", "power_uncorrected_", int(tally.single[place]), tally.n_experiments),
                "half_width": width if width == width else None,
                "half_width_of": STATISTICS[family].unit,
                "p_min": self._p_min[size, family],
            }

    @cached_property
    def _p_min(self) -> dict[tuple[Size, str], float]:
        known = self.study.design
        return {
            (size, family): STATISTICS[family].smallest_p(known.levels, *size, known.margin)
            for size, family in self._order()
        }

    def needed(self, target: float) -> list[dict[str, Any]]:
        """Return the number of participants needed for a power, by family, test and number of repetitions.

        `n_participants` is the smallest simulated number from which all larger simulated numbers reach the target too;
        None if there is none.
        """
        wanted: dict[tuple[Any, ...], dict[str, Any]] = {}
        for row in (*self.families, *self.tests):
            key = {"scope": "any test", **row}
            key = {name: key[name] for name in ("question", "family", "scope", "n_repetitions")}
            entry = wanted.setdefault(tuple(key.values()), {**key, "target_power": target, "n_participants": None})
            if row["power"] < target:
                entry["n_participants"] = None
            elif entry["n_participants"] is None:
                entry["n_participants"] = row["n_participants"]
        return list(wanted.values())

    def as_dict(self, target: float = 0.8) -> dict[str, Any]:
        """Return all results as plain values, as printed by ``modaltouch power --json``."""
        study = self.study
        return {
            "protocol": study.design.protocol,
            **({"stimulus": study.design.stimulus} if study.design.stimulus else {}),
            "observer": study.observer.as_dict(),
            "null": study.null,
            "alpha": ALPHA,
            "seed": study.seed,
            "n_experiments": self.n_experiments,
            "complete": self.complete,
            "floors": [vars(floor) for floor in self.floors],
            "power": self.families,
            "tests": self.tests,
            "needed": self.needed(target),
        }


def plan(
    study: Study,
    sizes: Sequence[Size],
    n_experiments: int,
    *,
    n_processes: int = 1,
    on_progress: Callable[[int, int], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Power:
    """Estimate the power of a study at several sizes.

    The result depends only on the study and the sizes, not on the number of processes: each job has its own seed.

    Parameters
    ----------
    study : Study
        The study to simulate.
    sizes : sequence of (int, int)
        Numbers of participants and repetitions of each size.
    n_experiments : int
        Experiments of each size.
    n_processes : int
        Number of worker processes.
    on_progress : callable, optional
        Called with (jobs done, total jobs).
    should_stop : callable, optional
        Called between jobs; the results so far are returned once it returns True.

    Returns
    -------
    Power
        Not `complete` if stopped early.
    """
    import joblib

    jobs = divide(study.design, sizes, n_experiments)
    asked = jobs if should_stop is None else takewhile(lambda _: not should_stop(), jobs)
    added: dict[Size, Tallies] = {}
    with processes(min(n_processes, len(jobs))):
        # Queue only a few jobs per process: with thousands, progress reports and stopping would lag. Tallies come in
        # the order of the jobs, on which their floating-point sums depend.
        parallel = joblib.Parallel(return_as="generator", batch_size=1, pre_dispatch="2 * n_jobs")
        tallied = parallel(joblib.delayed(run_job)(study, job) for job in asked)
        for n_done, (tallies, job) in enumerate(zip(tallied, jobs, strict=False), start=1):
            size = (job.n_participants, job.n_repetitions)
            before = added.get(size)
            added[size] = tallies if before is None else {name: before[name] + tallies[name] for name in before}
            if on_progress is not None:
                on_progress(n_done, len(jobs))
    return Power(study, tuple(sizes), n_experiments, added)


def processes(number: int) -> Any:
    """Return the context in which `joblib` shares work between processes that leave Ctrl-C to their parent."""
    import joblib

    return joblib.parallel_config("loky", n_jobs=number, inner_max_num_threads=1, initializer=_ignore_interrupts)


def _ignore_interrupts() -> None:
    """Ignore Ctrl-C, which reaches every process of a terminal, so that the parent handles it alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _shares(name: str, prefix: str, n_found: int, n_experiments: int) -> dict[str, float]:
    """Return the share of experiments with its Monte Carlo interval."""
    share = wilson(n_found, n_experiments)
    return {name: share.estimate, f"{prefix}low": share.low, f"{prefix}high": share.high}


def _size(size: Size, shape: tuple[int, int, int]) -> dict[str, int]:
    n_participants, n_repetitions = size
    n_trials = shape[0] * shape[1] * shape[2] * n_repetitions
    return {"n_participants": n_participants, "n_repetitions": n_repetitions, "n_trials_each": n_trials}


_COLUMNS = 3
_LINE_STYLES = ("-", "--", ":", "-.")


def write_power(folder: Path, power: Power, target: float = 0.8) -> dict[str, Path]:
    """Write a power analysis into a folder, and return the path of each file.

    Parameters
    ----------
    folder : Path
        Output folder, created if needed.
    power : Power
        Power analysis with at least one simulated size.
    target : float
        Target power [1].

    Raises
    ------
    RecordError
        If the folder belongs to another command, or cannot be written.
    """
    values = power.as_dict(target)
    files = {
        "power.csv": values["power"],
        "power_tests.csv": values["tests"],
        "power_needed.csv": values["needed"],
        "power.json": values,
    }
    about = {"version": version(), "seed": power.study.seed}
    return report.write_files(folder, files, about, "power", power=draw_power(power, target))


def draw_power(power: Power, target: float = 0.8) -> Figure:
    """Plot power over the number of participants, one panel per family of tests, with the target power marked.

    Each number of repetitions has a curve with its Monte Carlo intervals.
    """
    families = power.study.families
    n_rows = -(-len(families) // _COLUMNS)
    with report.house_style(
        3.2 * min(len(families), _COLUMNS) + 0.8, 2.7 * n_rows + 0.5, n_rows, min(len(families), _COLUMNS)
    ) as (figure, axes):
        for place, panel in zip(axes.flat, (*families, *[None] * (axes.size - len(families))), strict=True):
            if panel is None:
                place.set_axis_off()
                continue
            rows = [row for row in power.families if row["family"] == panel]
            _draw_curves(place, rows, ALPHA if power.study.null else target)
            place.set_title(textwrap.fill(f"{panel}: {STATISTICS[panel].asks}?", 38), fontsize=8.5)
            place.set_xlabel("participants")
        figure.suptitle(_headline(power), fontsize=9, color=report.INK)
    return figure


def _draw_curves(place: Axes, rows: list[dict[str, Any]], mark: float) -> None:
    for i, r in enumerate(sorted({row["n_repetitions"] for row in rows})):
        own = sorted((row for row in rows if row["n_repetitions"] == r), key=lambda row: int(row["n_participants"]))
        n = [row["n_participants"] for row in own]
        colour = report.PAIR_COLOURS[i % len(report.PAIR_COLOURS)]
        place.fill_between(n, [row["low"] for row in own], [row["high"] for row in own], color=colour, alpha=0.25, lw=0)
        place.plot(
            n,
            [row["power"] for row in own],
            color=colour,
            ls=_LINE_STYLES[i % len(_LINE_STYLES)],
            marker="o",
            ms=2.5,
            label=f"{r} repetitions",
        )
    place.axhline(mark, color=report.FAINT, lw=0.8, ls=":")
    place.set_ylim(-0.02, 1.02)
    place.set_ylabel("power")
    report.quiet_grid(place)
    if len({row["n_repetitions"] for row in rows}) > 1:
        place.legend(frameon=False)


def _headline(power: Power) -> str:
    study = power.study
    done = min(tally.n_experiments for found in power.tallies.values() for tally in found.values())
    kind = "false alarms where nothing is to be found" if study.null else "power"
    return (
        f"{study.design.title}, observer {study.observer.name or 'made in code'}: {kind}, at least one test of the "
        f"family significant at {ALPHA:g} after Holm\n"
        f"{done} simulated experiments of each size, seed {study.seed}"
    )
