"""Certificates: how often each test and interval of the report errs, in populations with known true values.

Every row is a test or interval in one population: the share of simulated experiments in which a test rejects a true
hypothesis, or a 95 % interval misses the true value. The functions are those of the report. A row fails if that share
is significantly above 0.05, by an exact bound corrected for all rows (Bonferroni).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import time
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

import joblib
import numpy as np
import scipy

import certified_measures
import modaltouch
from modaltouch.analysis.consistency import ac1_interval, shows_dominance
from modaltouch.analysis.contrasts import Shares
from modaltouch.analysis.counts import AnswerCounts, Pair
from modaltouch.analysis.exact import sign_flip_test, sign_test
from modaltouch.analysis.findings import holm
from modaltouch.analysis.intervals import BoundedMean, clopper_pearson
from modaltouch.analysis.permutation import association_test
from modaltouch.analysis.statistics import STATISTICS, conditions_compared, dominance, pairs_compared, slopes
from modaltouch.system import version

LEVELS = (80.0, 100.0, 150.0, 200.0)
KINDS = ("alike", "minority", "skew", "slopes", "spread", "sure", "guessing")
CROWD = 40_000
"""Participants whose mean is taken for the truth."""

LIMITS = {
    "a1, a2, b, c, d, leaning": "hold under their null, that no participant differs; not if they differ around zero",
    "means, share, paired difference": "coverage is proven for scores at both ends of the scale, else only shown here",
    "agreement": "coverage is only shown here",
    "time, rank": "hold if differences are symmetric about their centre",
    "d'": "tests the difference of two rates; the symmetry of its sign is only shown here",
    "together": "hold if a participant's levels, or finger conditions as a whole, are exchangeable",
    "group, friedman": "hold if groups, or a participant's ratings, are exchangeable",
    "of one, of runs, mean d' to mean exponent": "participants answer by the model that is fitted",
    "compared": "hold if differences are symmetric about their mean; shares do not differ, but numbers of answers do",
    "magnitude": "a fifth of the participants use numbers ten times as large; errs less without them",
    "fits compared, detection threshold, QUEST+": "participants are drawn from 500 people, since fits take long",
    "rating": "a fifth of the participants rate much higher",
    "as estimated": "the truth is the population mean of estimates from as many trials, including their bias",
    "all": "an interval that inverts a test errs as often; answers are missing by chance; mixed models have none",
}
BATCH = 500
ALPHA = 0.05
N_COLUMNS = 3  # of the picture
TIES = 1 + 1e-9


@dataclass(frozen=True)
class Population:
    """A population of participants, and the size of the experiments.

    Attributes
    ----------
    kind : str
        How they answer: the same with either hand and pair (alike, sure, guessing, spread), a minority opposite to the
        others (minority), the others slightly against it so that the mean difference is near zero (skew), or each with
        an individual slope (slopes).
    participants, repetitions : int
        Size of the experiments.
    minority : float
        Share of people who answer the opposite way [1].
    slope_sd : float
        Standard deviation of slopes with zero mean [logit per 50 mm/s].
    lapses : float
        Share of answers that are guesses [1].
    correlation : float
        Correlation of the answers of one participant to one pair under one finger condition [1].
    missing : float
        Probability that an answer is missing [1].
    """

    kind: str
    participants: int
    repetitions: int
    minority: float
    slope_sd: float
    lapses: float
    correlation: float
    missing: float

    @classmethod
    def draw(cls, number: int) -> Population:
        """Return one of the populations."""
        rng = np.random.default_rng([19, number])

        def one_of(*values):
            return values[rng.integers(len(values))]

        kind, missing, repetitions = (
            KINDS[number % len(KINDS)],
            one_of(0.0, 0.0, 0.02, 0.05, 0.1),
            one_of(1, 1, 2, 4, 8),
        )
        n = one_of(6, 8, 10, 10, 12, 16, 20, 30, 60)
        n = min(n, 10) if missing and repetitions > 2 else n  # exact trends of many patterns of gaps take long
        opposite, sd = one_of(0.05, 0.1, 0.15, 0.2, 0.3), one_of(0.5, 1.0, 2.0)
        return cls(kind, n, repetitions, opposite, sd, one_of(0.0, 0.05, 0.15), one_of(0.0, 0.2, 0.5), missing)

    def chances(self, rng, shape, null):
        """Return chances of dominant zone, both and other zone, (*shape, 2, 2, 4, 3); `null`: without differences."""
        few = rng.random(shape) < self.minority
        base = {"guessing": 0.0, "sure": 4.0}.get(self.kind, 2.0) + (self.kind == "spread") * rng.normal(0, 1.5, shape)
        hand = {"minority": -5.0 * few, "skew": np.where(few, -5.0, 0.7)}.get(self.kind, np.zeros(shape))
        slope = (self.kind == "slopes") * rng.normal(0, self.slope_sd, shape) * (not null)
        hands = np.stack([np.zeros(shape), hand * (not null)], axis=-1)[..., :, None, None]
        steps = (np.array(LEVELS) - np.mean(LEVELS)) / 50
        level = base[..., None, None, None] + slope[..., None, None, None] * steps + hands
        first = 1 / (1 + np.exp(-np.broadcast_to(level, (*shape, 2, 2, 4))))
        undecided = 0.5 if null else np.array([0.3, 0.7])[:, None]
        both = (1 - first) * undecided
        chances = np.stack([first, both, 1 - first - both], axis=-1)
        if null:  # as many people lean one way as the other
            turned = (rng.random(shape) < 0.5)[..., None, None, None, None]
            chances = np.where(turned, chances[..., ::-1], chances)
        return (1 - self.lapses) * chances + self.lapses / 3

    def answers(self, rng, shape, *, null=False, guesses=False):
        """Return the counted answers of some experiments, and the chances before answers correlate."""
        chances = np.full((*shape, 2, 2, 4, 3), 1 / 3) if guesses else self.chances(rng, shape, null)
        own = chances
        if self.correlation and not guesses:
            # One draw for a pair under a finger condition at all levels: the same mean, varying together.
            strength = (1 - self.correlation) / self.correlation
            uniform = rng.random((*shape, 2, 2, 1, 1))
            picked = (uniform > np.cumsum(chances, axis=-1)[..., :-1]).sum(axis=-1)
            share = rng.beta(1, strength, (*shape, 2, 2, 1, 1))
            own = (1 - share) * chances + share * np.eye(3)[picked]
        given = np.full((*shape, 2, 2, 4), self.repetitions)
        if self.missing:
            given = rng.binomial(given, 1 - self.missing)
        first = rng.binomial(given, np.clip(own[..., 0], 0, 1))
        both = rng.binomial(given - first, np.clip(own[..., 1] / np.maximum(1 - own[..., 0], 1e-12), 0, 1))
        other = given - first - both
        # (A, C): C lies on the right; (B, D): B, the left one, counts as dominant.
        counts = np.stack([[other[..., 0, :], both[..., 0, :], first[..., 0, :]],
                           [first[..., 1, :], both[..., 1, :], other[..., 1, :]]], axis=0)  # fmt: skip
        counts = np.moveaxis(counts, (0, 1), (-2, -1))
        pairs = (Pair.of("A", "C", "C"), Pair.of("B", "D", "C"))
        names = tuple(f"p{number}" for number in range(shape[-1]))
        hands = ("one_hand", "two_hands")
        return AnswerCounts(names, hands, pairs, LEVELS, np.swapaxes(counts, -2, -3), self.repetitions), chances


def errors_of_means(answers, truths, margins):
    """Yield the name of each mean, whether its interval misses the true value, and half its width."""
    for name, scores in {
        "a2 mean": dominance(answers).scores,
        "b mean": slopes(answers),
        "c mean": conditions_compared(answers).scores,
        "d mean": pairs_compared(answers).scores,
    }.items():
        mean = BoundedMean(scores.scores[..., 0, :], -scores.scale, scores.scale)
        some = BoundedMean(scores.scores[:100, 0, :], -scores.scale, scores.scale)
        yield name, mean.test(truths[name]).p <= ALPHA / TIES, some
        if name == "c mean":
            yield "c alike", mean.equivalence(margins).p <= ALPHA / TIES, None


def truths_of(population, rng):
    """Return the measures of a very large crowd."""
    answers, chances = population.answers(rng, (CROWD,))
    mean = chances.mean(axis=0)
    weights = 100 * (np.array(LEVELS) - np.mean(LEVELS)) / ((np.array(LEVELS) - np.mean(LEVELS)) ** 2).sum()
    shown = mean[0, 0]
    alike, popular = (shown**2).sum(axis=-1).mean(), shown.mean(axis=0)
    chance = (popular * (1 - popular)).sum() / 2
    score = answers.dominant[0, 0].sum(axis=-1) - answers.other[0, 0].sum(axis=-1)
    modal = answers.modal()[:, :, 0, 0]
    known = (modal >= 0).all(axis=1)
    hit = modal[known] == answers.dominant_place(answers.pairs[0])
    one = modal[modal[:, 0] >= 0, 0] == answers.dominant_place(answers.pairs[0])
    b, c = np.mean(hit[:, 0] & ~hit[:, 1]), np.mean(hit[:, 1] & ~hit[:, 0])
    showing = shows_dominance(answers.dominant[0, 0].sum(axis=-1), answers.other[0, 0].sum(axis=-1))
    return {
        "a1 share": one.mean(),
        "a2 mean": (shown[:, 0] - shown[:, 2]).mean(),
        "leaning share": (score > 0).sum() / max((score != 0).sum(), 1),
        "b mean": shown[:, 0] @ weights,
        "c mean": (mean[0, 0, :, 0] - mean[1, 0, :, 0]).mean(),
        "d mean": (mean[0, 0, :, 1] - mean[0, 1, :, 1]).mean(),
        "agreement": (alike - chance) / (1 - chance),
        "prevalence": showing.mean(),
        "share": shown[:, 0].mean(),
        "paired difference": b - c,
    }


def errors_of_shares(answers, truth):
    """Yield the name of each other interval and whether it misses the true value."""
    place = answers.dominant_place(answers.pairs[0])
    kinds = answers.n_modal[..., 0, 0, 0, :]
    yield "a1 share", missed(clopper_pearson(kinds[..., place], kinds.sum(axis=-1)), truth["a1 share"])
    first, second = (each[..., 0, 0, :, :].sum(axis=-1) for each in (answers.dominant, answers.other))
    score = first - second
    share = clopper_pearson((score > 0).sum(axis=-1), (score != 0).sum(axis=-1))
    yield "leaning share", missed(share, truth["leaning share"])
    n = np.full(len(score), score.shape[-1])
    yield "prevalence", missed(clopper_pearson(shows_dominance(first, second).sum(axis=-1), n), truth["prevalence"])
    own = Shares(answers.dominant[..., 0, 0, :, :], answers.answered[..., 0, 0, :, :], answers.n_repetitions)
    yield "share", BoundedMean(own.mean, 0.0, 1.0).test(truth["share"]).p <= ALPHA / TIES
    modal = answers.modal()[..., 0, 0]
    hit, known = modal == place, (modal >= 0).all(axis=-1)
    gap = np.where(known, hit[..., 0].astype(float) - hit[..., 1], np.nan)
    yield "paired difference", BoundedMean(gap).test(truth["paired difference"]).p <= ALPHA / TIES
    rated = answers.counts[..., 0, 0, :, :]
    parts = [rated[start : start + 10] for start in range(0, len(rated), 10)]
    yield "agreement", np.concatenate([missed(ac1_interval(part), truth["agreement"]) for part in parts])


def missed(interval, truth):
    """Return which intervals miss the true value."""
    return (truth < interval.low - 1e-9) | (interval.high + 1e-9 < truth)


def errors_of_tests(population, rng, shape):
    """Yield each exact test and whether it rejects in a population without differences, and families after Holm."""
    nobody, _ = population.answers(rng, shape, null=True)
    guesses, _ = population.answers(rng, shape, guesses=True)
    for family, statistic in STATISTICS.items():
        if " " in family:  # means and their equivalence have their own true values
            continue
        p = statistic.compute(guesses if statistic.against_guessing else nobody).test.quick_p
        yield family, p[:, 0] <= ALPHA * TIES
        yield f"{family} Holm", (holm(p) <= ALPHA * TIES).any(axis=-1)
    score = (nobody.dominant - nobody.other)[..., 0, 0, :, :].sum(axis=-1)
    yield "leaning", sign_test(score).quick_p <= ALPHA * TIES
    # Medians of reaction times [0.02 s]: heavy-tailed, and differences symmetric about zero.
    medians = np.exp(rng.normal(-0.5, 0.4, (*shape, 2)))
    gaps = np.rint(50 * (medians[..., 0] - medians[..., 1])).astype(int)
    yield "time", sign_flip_test(gaps).quick_p <= ALPHA * TIES


def errors_together(population, rng, n_experiments):
    """Yield joint tests of all unordered answers without differences, over levels and between finger conditions.

    They have their own random stream, so that the other rows do not change.
    """
    for start in range(0, n_experiments, BATCH):
        shape = (min(BATCH, n_experiments - start), population.participants)
        nobody, _ = population.answers(rng, shape, null=True)
        own = nobody.counts[..., 0, :, :]
        for name, table in (("b together", own[..., 0, :, :]), ("c together", own.sum(axis=-2))):
            yield name, association_test(table).p <= ALPHA * TIES


def certify(number, n_experiments):
    """Return the rows of one population, and the processor time that they took [s]."""
    began, population = time.process_time(), Population.draw(number)
    rng = np.random.default_rng([1906, number])
    truth = truths_of(population, rng)
    wrong: dict[str, list[np.ndarray]] = {}
    widths: dict[str, float] = {}
    for start in range(0, n_experiments, BATCH):
        shape = (min(BATCH, n_experiments - start), population.participants)
        answers, _ = population.answers(rng, shape)
        margin = max(abs(float(truth["c mean"])), 0.02)
        for name, errors, mean in errors_of_means(answers, truth, margin):
            wrong.setdefault(name, []).append(errors)
            if mean is not None and name not in widths:
                widths[name] = float(np.mean(mean.interval().half_width))
        for name, errors in chain(errors_of_shares(answers, truth), errors_of_tests(population, rng, shape)):
            wrong.setdefault(name, []).append(errors)
    for name, errors in errors_together(population, np.random.default_rng([1909, number]), n_experiments):
        wrong.setdefault(name, []).append(errors)
    wrong |= {
        name: [errors]
        for name, errors in certified_measures.errors_of_measures(number, population.participants, n_experiments)
    }
    rows = []
    for name, parts in wrong.items():
        errors = np.concatenate(parts)
        row = {"certificate": name, "population": number, "n": errors.size, "errors": int(errors.sum())}
        rows.append(row | ({"half_width": round(widths[name], 4)} if name in widths else {}))
    return {"population": asdict(population), "rows": rows, "seconds": time.process_time() - began}


def program() -> dict[str, str]:
    """Return what the figures depend on: a hash of the program and this file, and the library versions."""
    files = [Path(__file__), Path(certified_measures.__file__), *sorted(Path(modaltouch.__file__).parent.rglob("*.py"))]
    source = hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()
    return {"source": source, "numpy": np.__version__, "scipy": scipy.__version__}


def unlike(expected: dict[str, str]) -> list[str]:
    """List the parts of this program, source and libraries, that differ from the submitter's."""
    here = program()
    return [name for name in here if here[name] != expected[name]]


def certify_alike(expected: dict[str, str], number: int, n_experiments: int) -> dict:
    """Return the rows of one population, if this worker runs the submitter's program.

    A worker may join after `check_workers` has checked them all.
    """
    if others := unlike(expected):
        raise RuntimeError(f"a worker has another {' and '.join(others)}: install this very program there")
    return certify(number, n_experiments)


def certify_on(address: str, n_populations: int, n_experiments: int, kept: Path) -> list[dict]:
    """Certify populations on a Dask cluster; finished ones are kept in `kept` and not repeated.

    Raises
    ------
    SystemExit
        If a worker has another program, there is no worker for a minute, or the scheduler is lost.
    """
    import cloudpickle
    from distributed import Client

    cloudpickle.register_pickle_by_value(certified_measures)
    mine = program() | {"experiments": n_experiments}
    lines = [json.loads(line) for line in kept.read_text(encoding="utf-8").splitlines()] if kept.exists() else []
    done = {line["number"]: line["part"] for line in lines if line["program"] == mine}
    try:
        client = Client(address, timeout=10, set_as_default=False)
    except OSError as error:
        raise SystemExit(f"no scheduler at {address}: {error}; start one with `dask scheduler`") from error
    with client, kept.open("a", encoding="utf-8") as file:
        check_workers(client, address)
        left = [number for number in range(n_populations) if number not in done]
        print(f"{len(done)} of {n_populations} populations are done already", flush=True)
        futures = {client.submit(certify_alike, program(), number, n_experiments): number for number in left}
        seen = time.monotonic()
        while futures:
            ready = [future for future in futures if future.done()]
            for future in ready:
                number = futures.pop(future)
                try:
                    done[number] = future.result()
                except Exception as error:
                    raise SystemExit(f"population {number}: {error}; {kept} has {len(done)}: run again") from error
                file.write(json.dumps({"number": number, "program": mine, "part": done[number]}) + "\n")
                file.flush()
            if client.status != "running":
                raise SystemExit(f"the scheduler at {address} is lost; {kept} has {len(done)} populations: run again")
            if client.scheduler_info()["workers"]:
                seen = time.monotonic()
            elif time.monotonic() - seen > 60:
                raise SystemExit(f"no worker is left at {address}; {kept} has {len(done)} populations: run again")
            if not ready:
                time.sleep(0.2)
    kept.unlink()
    return [done[number] for number in range(n_populations)]


def check_workers(client, address: str) -> None:
    """Refuse a cluster without workers, and workers with another program or none."""
    others = client.run(unlike, program(), on_error="return")
    if not others:
        raise SystemExit(f"no worker at {address}; start some with `dask worker {address}`")
    for worker, other in others.items():
        if isinstance(other, Exception):
            raise SystemExit(f"worker {worker} cannot run this program: {other}; install it there, at the same place")
        if other:
            raise SystemExit(f"worker {worker} has another {' and '.join(other)}: install this very program there")


def judge(parts):
    """Return the certificates: errors of every population, the worst rate, and how many populations fail."""
    certificates: dict[str, dict] = {}
    for part in parts:
        for row in part["rows"]:
            each = certificates.setdefault(row["certificate"], {"experiments": [], "errors": [], "half_width": []})
            each["experiments"].append(row["n"])
            each["errors"].append(row["errors"])
            each["half_width"] += [row["half_width"]] if "half_width" in row else []
    level = 1 - 2 * ALPHA / sum(len(each["errors"]) for each in certificates.values())
    for each in certificates.values():
        errors, n = np.array(each["errors"]), np.array(each["experiments"])
        fails, rates = clopper_pearson(errors, n, level).low > ALPHA, errors / n
        each |= {"mean_rate": round(float(rates.mean()), 5), "worst_rate": round(float(rates.max()), 5)}
        each |= {"worst_population": int(rates.argmax()), "fails": np.flatnonzero(fails).tolist()}
        if (n == n[0]).all():
            each["experiments"] = int(n[0])
    return certificates


def draw(certificates, place):
    """Draw the error rate of every test and interval in every population."""
    from matplotlib.figure import Figure

    rng, names = np.random.default_rng(1), list(certificates)
    rows = math.ceil(len(names) / N_COLUMNS)
    columns = [names[start : start + rows] for start in range(0, len(names), rows)]
    figure = Figure(figsize=(6.5 * len(columns), 0.25 * len(columns[0]) + 1.2), layout="constrained")
    for axes, listed in zip(figure.subplots(1, len(columns), squeeze=False)[0], columns, strict=True):
        for y, each in enumerate(map(certificates.get, listed)):
            rates = np.array(each["errors"]) / np.array(each["experiments"])
            colours = ["#b3261e" if number in each["fails"] else "#0b3c8c" for number in range(len(rates))]
            axes.scatter(rates, y + rng.uniform(-0.25, 0.25, len(rates)), s=4, c=colours, alpha=0.6, linewidths=0)
        axes.axvline(ALPHA, color="#444444", linewidth=0.8, linestyle=":")
        axes.set_yticks(range(len(listed)), listed)
        axes.set_ylim(len(columns[0]) - 0.3, -0.7)
        axes.set_xscale("function", functions=(np.sqrt, np.square))
        axes.set_xlim(0, 1)
        axes.set_xticks([0.01, 0.05, 0.2, 0.5, 1], ["0.01", " 0.05", "0.2", "0.5", "1"])
    figure.supxlabel("rate of errors: a true null rejected, or the truth outside the 95 % interval", fontsize=10)
    figure.suptitle("Each dot a population; red: above 0.05 beyond doubt", fontsize=10)
    figure.savefig(place, dpi=100)


def main() -> None:
    """Certify every test and interval, and write the table and the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--populations", type=int, default=210)
    parser.add_argument("--experiments", type=int, default=2000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--dask", metavar="ADDRESS", help="scheduler of a Dask cluster that does the work")
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks/certify.json"))
    parser.add_argument("--brief", type=Path, default=Path("src/modaltouch/analysis/certificates.json"))
    asked = parser.parse_args()
    began = time.perf_counter()
    if asked.dask:
        parts = certify_on(asked.dask, asked.populations, asked.experiments, asked.out.with_suffix(".parts.jsonl"))
    else:
        work = (joblib.delayed(certify)(number, asked.experiments) for number in range(asked.populations))
        parts = joblib.Parallel(n_jobs=asked.jobs, verbose=1)(work)
    certificates = judge(parts)
    minutes = (time.perf_counter() - began) / 60
    populations = [part["population"] for part in parts]
    # Unlike the time, processor minutes hardly depend on what else the machine does.
    processor = round(sum(part["seconds"] for part in parts) / 60, 1)
    about = {"version": version(), "minutes": round(minutes, 1), "processor_minutes": processor, "limits": LIMITS}
    asked.out.write_text(compact(about, certificates, populations) + "\n", encoding="utf-8")
    draw(certificates, asked.out.with_suffix(".png"))
    brief = ",\n".join(map(brief_of, certificates, certificates.values()))
    asked.brief.write_text("{\n" + brief + "\n}\n", encoding="utf-8")
    for name, each in certificates.items():
        print(f"{name:20} worst {each['worst_rate']:.4f}  mean {each['mean_rate']:.4f}  fails {len(each['fails'])}")


def brief_of(name, each):
    """Return a certificate as one line of the report: its mean and worst rate, and the reason if it fails."""
    why = certified_measures.REASONS.get(name, "the reason is not known yet") if each["fails"] else ""
    return f"{json.dumps(name)}: {json.dumps([each['mean_rate'], each['worst_rate'], why])}"


def compact(about, certificates, populations):
    """Return everything as JSON, one certificate or population per line."""
    parts = [f'"{key}": {json.dumps(value)}' for key, value in about.items()]
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(each)}" for name, each in certificates.items())
    parts.append('"certificates": {\n' + lines + "\n}")
    parts.append('"populations": [\n' + ",\n".join(map(json.dumps, populations)) + "\n]")
    return "{\n" + ",\n".join(parts) + "\n}"


if __name__ == "__main__":
    main()
