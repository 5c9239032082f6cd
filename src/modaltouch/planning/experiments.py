"""Simulation of experiments: draw participants and answers, and count significant tests."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis import ALPHA, STATISTICS, AnswerCounts
from modaltouch.planning.design import Design
from modaltouch.planning.observer import DrawnParticipants, FloatArray, Observer
from modaltouch.planning.participant import REFERENCE, Participant

_LEAST_NOISE = 1e-12

N_NODES = 12
"""Quadrature nodes for the internal noise of each finger."""

IntArray = NDArray[np.int64]

BATCH = 250
"""Maximum number of experiments per job; like the seed, it affects the random answers."""

BATCH_CELLS = 3_000_000
"""Maximum number of answers per job and repetition, which bounds its memory; it affects the random answers, too."""

_TIES = 1 + 1e-9
"""Factor on the significance level, so that p values equal to it up to rounding count as significant [1]."""


@dataclass(frozen=True, eq=False)
class Study:
    """Specification of a simulation.

    Attributes
    ----------
    design : Design
        The cells, with the felt speeds in each.
    observer : Observer
        Population from which participants are drawn.
    families : tuple of str
        Families of tests to run.
    null : bool
        Whether to simulate no effect, so that significant tests are false alarms.
    seed : int
        Seed of all jobs.
    """

    design: Design
    observer: Observer
    families: tuple[str, ...]
    null: bool
    seed: int

    @cached_property
    def simulated(self) -> tuple[Design, Observer]:
        """Design and observer; under the null, both fingers feel the same in all cells and there is no side bias."""
        if not self.null:
            return self.design, self.observer
        alike = np.full_like(self.design.speeds, float(self.design.speeds.mean()))
        typical = replace(self.observer.typical, side_bias=0.0)
        return replace(self.design, speeds=alike), replace(self.observer, typical=typical)


@dataclass(frozen=True, order=True)
class Job:
    """A batch of experiments of one size.

    Attributes
    ----------
    n_participants, n_repetitions : int
        Size of the experiments.
    batch : int
        Index of the job among those of this size, from 0.
    n_experiments : int
        Number of experiments.
    """

    n_participants: int
    n_repetitions: int
    batch: int
    n_experiments: int


@dataclass(frozen=True, eq=False)
class Tally:
    """Results of experiments of one size, for one family of tests.

    Attributes
    ----------
    n_experiments : int
        Number of experiments.
    single : (n_tests,) array of int
        Experiments in which each test was significant without correction.
    corrected : (n_tests,) array of int
        Experiments in which it was significant after Holm's correction.
    any_test, every_test : int
        Experiments in which at least one test, and all tests, were significant after correction.
    width : (n_tests,) array
        Sum of the half-widths of each interval over the experiments.
    """

    n_experiments: int
    single: IntArray
    corrected: IntArray
    any_test: int
    every_test: int
    width: FloatArray

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.n_experiments + other.n_experiments,
            self.single + other.single,
            self.corrected + other.corrected,
            self.any_test + other.any_test,
            self.every_test + other.every_test,
            self.width + other.width,
        )


Tallies = dict[str, Tally]
"""Results of experiments, by family of tests."""


def divide(design: Design, sizes: Iterable[tuple[int, int]], n_experiments: int) -> list[Job]:
    """Return the jobs of a study, ordered so that the first ones cover all numbers of participants and repetitions."""
    jobs = []
    for n_participants, n_repetitions in sizes:
        most = min(BATCH, max(1, BATCH_CELLS // (n_participants * len(design.cells))))
        for batch, start in enumerate(range(0, n_experiments, most)):
            jobs.append(Job(n_participants, n_repetitions, batch, min(most, n_experiments - start)))
    return sorted(jobs, key=lambda job: (job.batch, job.n_repetitions, job.n_participants))


def run_job(study: Study, job: Job) -> Tallies:
    """Simulate the experiments of a job and tally the significant tests by family."""
    # The seed of a job does not depend on the other jobs.
    seed = np.random.SeedSequence(study.seed, spawn_key=(job.n_participants, job.n_repetitions, job.batch))
    observed, guessed = map(np.random.default_rng, seed.spawn(2))
    design, observer = study.simulated
    answers = simulate(design, observer, job, observed)
    tallies = {}
    for family in study.families:
        guesses = study.null and STATISTICS[family].against_guessing
        asked = simulate(design, Observer(Participant(lapse_rate=1.0)), job, guessed) if guesses else answers
        tallies[family] = count_significant(asked, family)
    return tallies


def simulate(design: Design, observer: Observer, job: Job, rng: np.random.Generator) -> AnswerCounts:
    """Simulate the answers of a batch of experiments.

    Each participant is drawn once from the population and answers every cell with the probabilities of
    `modaltouch.planning.participant.Participant`.
    """
    crowd = observer.draw_participants(rng, (job.n_experiments, job.n_participants))
    left, both, right, *nothing = design.places
    share_left, share_right, *share_nothing = answer_shares(
        crowd,
        design.speeds.reshape(-1, 2),
        design.cells,
        design.facing(job.n_participants),
        offers_nothing=bool(nothing),
    )
    # Keep answers on the first axis in memory, since the tests access one answer at a time.
    counts = np.zeros((len(design.places), *share_left.shape), dtype=np.int64)
    for _ in range(job.n_repetitions):
        chance = rng.random(share_left.shape)
        counts[left] += chance < share_left
        counts[right] += chance >= 1 - share_right
        for place, share in zip(nothing, share_nothing, strict=True):
            counts[place] += (chance >= share_left) & (chance < share_left + share)
    counts[both] = job.n_repetitions - counts.sum(axis=0)
    shape = (len(counts), job.n_experiments, job.n_participants, *design.shape)
    return design.count(np.moveaxis(counts.reshape(shape), 0, -1), job.n_repetitions)


def count_significant(answers: AnswerCounts, family: str) -> Tally:
    """Count the simulated experiments in which a family of tests is significant."""
    found = STATISTICS[family].compute(answers)
    if found is None:
        raise ValueError(f"no tests of {family} for {len(answers.finger_conditions)} finger conditions and these pairs")
    single, corrected = found.test.quick_p <= ALPHA * _TIES, found.quick_p_holm <= ALPHA * _TIES
    return Tally(
        len(single),
        single.sum(axis=0),
        corrected.sum(axis=0),
        int(corrected.any(axis=1).sum()),
        int(corrected.all(axis=1).sum()),
        found.interval.half_width.sum(axis=0),
    )


def answer_shares(
    crowd: DrawnParticipants,
    speeds: ArrayLike,
    finger_conditions: Sequence[str],
    facing: ArrayLike = 1.0,
    *,
    offers_nothing: bool = False,
) -> FloatArray:
    """Return the probabilities of the answers left, right and nothing felt in each cell; the remainder is both.

    They are in closed form, averaged over the internal noise of both fingers, if any, by Gauss-Hermite quadrature.

    Parameters
    ----------
    speeds : (n_cells, 2) array
        Speeds felt by the left and the right finger in each cell [m/s].
    finger_conditions : sequence of str
        Finger condition of each cell.
    facing : array
        1, or -1 for participants for whom the beam is turned end to end: left and right are those of the beam, so
        the side bias changes sign.
    offers_nothing : bool
        Whether nothing felt is among the answers.

    Returns
    -------
    (2 or 3, ..., n_cells) array
        Probabilities of left, right and, if offered, nothing felt [1]; the axes between are those of the
        participants.
    """
    speeds, sigma = np.asarray(speeds, dtype=float), crowd.typical.internal_noise
    if not sigma:
        return _shares_felt(crowd, speeds, finger_conditions, facing, offers_nothing=offers_nothing)
    nodes, weights = np.polynomial.hermite_e.hermegauss(N_NODES)
    weights = weights / weights.sum()
    shares = np.zeros(())
    for i, j in product(range(N_NODES), repeat=2):
        felt = np.maximum(speeds + sigma * nodes[[i, j]], 0.0)
        own = _shares_felt(crowd, felt, finger_conditions, facing, offers_nothing=offers_nothing)
        shares = shares + weights[i] * weights[j] * own
    return shares


def _shares_felt(
    crowd: DrawnParticipants,
    speeds: FloatArray,
    finger_conditions: Sequence[str],
    facing: ArrayLike,
    *,
    offers_nothing: bool,
) -> FloatArray:
    from scipy.special import ndtr

    felt = speeds + crowd.typical.floor
    ratio = np.log(felt[:, 1] / felt[:, 0])
    kinds = list(dict.fromkeys(finger_conditions))
    contrast = np.stack([crowd.contrast(kind) for kind in kinds], axis=-1)
    place = [kinds.index(kind) for kind in finger_conditions]
    expected = contrast[..., place] * ratio + (crowd.side_bias * np.asarray(facing, dtype=float))[..., None]
    scale = np.maximum(crowd.noise, _LEAST_NOISE)[..., None]
    if crowd.typical.near_miss:
        scale = scale * (felt.max(axis=1) / REFERENCE) ** -crowd.typical.near_miss
    limit = crowd.criterion[..., None]
    named = np.stack([ndtr((-limit - expected) / scale), ndtr((expected - limit) / scale)])
    if offers_nothing:
        # The detection threshold varies from trial to trial with the noise of the comparison.
        nothing = ndtr(-np.log(np.maximum(speeds.max(axis=1), _LEAST_NOISE) / crowd.typical.floor) / scale)
        named = np.stack([*(named * (1 - nothing)), nothing])
    guessed = crowd.typical.lapse_rate / (4 if offers_nothing else 3)
    return np.asarray((1 - crowd.typical.lapse_rate) * named + guessed)
