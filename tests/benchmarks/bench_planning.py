"""Time of planning: thousands of experiments together, against pandas and SciPy one experiment at a time.

Writes ``results/benchmarks/planning.json``. Both simulate the paper's protocol with the observer `paper` and
do the same 21 exact tests with Holm's correction; the second uses only the libraries: groupby
and pivot, `scipy.stats.permutation_test` with a vectorised statistic (all 2^N sign flips, or 9999 shuffles of the
levels within participants), `statsmodels` for Holm. One thread, CPU time, best of several runs. They must agree
on the sign-flip tests, which are exact in both.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy
from bars import at_least, at_most
from scipy.stats import permutation_test
from statsmodels.stats.multitest import multipletests
from threadpoolctl import threadpool_limits

from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.statistics import STATISTICS
from modaltouch.planning.design import designs_for
from modaltouch.planning.experiments import Job, Study, divide, run_job, simulate
from modaltouch.planning.observer import Observer
from modaltouch.preflight import examine

ROOT = Path(__file__).parents[2]
CONFIRMED = ("a2", "b", "c", "d")
N_EXPERIMENTS, N_PARTICIPANTS, N_PEER = 1000, 10, 4
SWEEP = (6, 8, 10, 12, 16, 20, 24, 32, 40)


def timed(run: Callable[[], Any], n_runs: int) -> tuple[float, float]:
    """Return the least CPU time and wall time of several runs [s]."""
    cpu, wall = [], []
    for _ in range(n_runs):
        start_cpu, start_wall = time.process_time(), time.perf_counter()
        run()
        cpu.append(time.process_time() - start_cpu)
        wall.append(time.perf_counter() - start_wall)
    return min(cpu), min(wall)


def sweep(study: Study, sizes: list[tuple[int, int]]) -> None:
    """Run all experiments of the given sizes."""
    for job in divide(study.design, sizes, N_EXPERIMENTS):
        run_job(study, job)


def to_table(answers: AnswerCounts, experiment: int) -> pd.DataFrame:
    """Return the answers of one experiment as a tidy table."""
    rows = []
    for person, f, q, v, place in np.argwhere(answers.counts[experiment]):
        pair, answer = answers.pairs[q], answers.answers[place].name
        chosen = {"left": pair.left, "right": pair.right}.get(answer, "both")
        rows.append((person, answers.finger_conditions[f], pair.label, answers.levels[v], chosen == pair.dominant,
                     chosen == pair.other, answer == "both"))  # fmt: skip
    return pd.DataFrame(rows, columns=["participant", "hand", "pair", "level", "dominant", "other", "both"])


def sign_flip(scores: np.ndarray) -> float:
    """Return p over all sign flips, as SciPy enumerates them."""
    test = permutation_test(
        (scores,), np.sum, permutation_type="samples", vectorized=True, n_resamples=np.inf, alternative="two-sided"
    )
    return float(test.pvalue)


def level_shuffle(chosen: np.ndarray, levels: np.ndarray, rng: np.random.Generator) -> float:
    """Return p over 9999 shuffles of the levels within participants."""

    def trend(*columns: np.ndarray, axis: int = 0) -> np.ndarray:
        weights = levels - levels.mean()
        return sum(weight * column.sum(axis=axis) for weight, column in zip(weights, columns, strict=True))

    test = permutation_test(
        tuple(chosen.T.astype(float)), trend, permutation_type="samples", vectorized=True, n_resamples=9999, rng=rng
    )
    return float(test.pvalue)


def analyse_by_libraries(table: pd.DataFrame, rng: np.random.Generator) -> dict[str, list[float]]:
    """Return the 24 p of one experiment, family by family, corrected by Holm's method."""
    hands, pairs = sorted(table["hand"].unique()), sorted(table["pair"].unique())
    sums = table.groupby(["hand", "pair", "participant"])[["dominant", "other", "both"]].sum()
    found: dict[str, list[float]] = {"a2": [], "b": [], "c": [], "d": []}
    for hand in hands:
        for pair in pairs:
            own = sums.loc[hand, pair]
            found["a2"].append(sign_flip((own["dominant"] - own["other"]).to_numpy(dtype=float)))
            part = table[(table["hand"] == hand) & (table["pair"] == pair)]
            wide = part.pivot_table(index="participant", columns="level", values="dominant", aggfunc="sum")
            found["b"].append(level_shuffle(wide.to_numpy(), wide.columns.to_numpy(dtype=float), rng))
        for first, second in combinations(pairs, 2):
            difference = sums.loc[hand, first]["both"] - sums.loc[hand, second]["both"]
            found["d"].append(sign_flip(difference.to_numpy(dtype=float)))
    for effect, pair in product(("dominant", "both"), pairs):
        difference = sums.loc[hands[0], pair][effect] - sums.loc[hands[1], pair][effect]
        found["c"].append(sign_flip(difference.to_numpy(dtype=float)))
    for p in found.values():
        multipletests(p, method="holm")
    return found


def largest_difference(answers: AnswerCounts, by_libraries: list[dict[str, list[float]]]) -> float:
    """Return the largest difference of the sign-flip p between the two implementations."""
    return max(
        float(np.abs(STATISTICS[family].compute(answers).test.quick_p[experiment] - found[family]).max())
        for family in ("a2", "c", "d")
        for experiment, found in enumerate(by_libraries)
    )


def main() -> None:
    """Time both implementations and write the figures."""
    observer = Observer.read("paper")
    preflight = examine(ROOT / "protocols" / "differentiated_stimulation.yaml").require()
    study = Study(designs_for(preflight, observer)[""], observer, CONFIRMED, null=False, seed=1)
    sweep(study, [(N_PARTICIPANTS, 1)])
    cpu, wall = timed(lambda: sweep(study, [(N_PARTICIPANTS, 1)]), 7)
    sweep_cpu, _ = timed(lambda: sweep(study, [(n, 1) for n in SWEEP]), 1)

    answers = simulate(study.design, observer, Job(N_PARTICIPANTS, 1, 0, N_PEER), np.random.default_rng(1))
    tables = [to_table(answers, experiment) for experiment in range(N_PEER)]
    rng = np.random.default_rng(2)
    by_libraries: list[dict[str, list[float]]] = []
    peer_cpu, peer_wall = timed(
        lambda: by_libraries.__setitem__(slice(None), [analyse_by_libraries(table, rng) for table in tables]), 2
    )
    each = peer_cpu / N_PEER
    figures = {
        "what": f"{N_EXPERIMENTS} experiments x 21 exact tests with Holm, {N_PARTICIPANTS} participants, one thread",
        "machine": {"python": platform.python_version(), "numpy": np.__version__, "pandas": pd.__version__,
                    "scipy": scipy.__version__, "system": platform.platform(),
                    "cores": os.cpu_count(), "load_average": [round(load, 1) for load in os.getloadavg()]},
        "ours_cpu_s": cpu,
        "ours_wall_s": wall,
        "ours_includes": "drawing participants and answers, tests, Holm, widths of all intervals",
        "sweep_participants": SWEEP,
        "sweep_cpu_s": sweep_cpu,
        "libraries_cpu_s_per_experiment": each,
        "libraries_wall_s_per_experiment": peer_wall / N_PEER,
        "libraries_includes": "tests and Holm from a tidy table",
        "libraries_cpu_s": each * N_EXPERIMENTS,
        "times_faster": each * N_EXPERIMENTS / cpu,
        "largest_difference_of_sign_flip_p": largest_difference(answers, by_libraries),
    }  # fmt: skip
    figures["bars"] = [
        at_most("processor time of 1,000 experiments", cpu, 0.25, "s"),
        at_least("speed relative to the libraries", each * N_EXPERIMENTS / cpu, 1000),
    ]
    target = ROOT / "results" / "benchmarks" / "planning.json"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
