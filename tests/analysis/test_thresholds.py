"""Psychometric functions of adaptive runs: recovery, safeguards, and a complete analysis."""

from __future__ import annotations

import itertools
import json
import math
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize
from scipy.special import ndtr
from scipy.stats import binom

from modaltouch.analysis.intervals import Interval
from modaltouch.analysis.pipeline import analyse, read_responses
from modaltouch.analysis.psychometric import DROP, REGION, Psychometric, fit_psychometric
from modaltouch.analysis.responses import AnswerSource, Responses
from modaltouch.analysis.run_report import render_runs
from modaltouch.analysis.runs import (
    Run,
    ThresholdAnalysis,
    analyse_runs,
    compare_runs,
    find_runs,
    is_forced,
    over_participants,
)
from modaltouch.analysis.words import certificates_in_words
from modaltouch.cli.analyse import tell
from modaltouch.planning.design import designs_for
from modaltouch.planning.fitting import fit_answers
from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import Participant
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol import AnswerList
from modaltouch.protocol.levels import follow, to_dB
from modaltouch.protocol.source import InputError
from modaltouch.record.session import Session
from modaltouch.session.setup import begin
from modaltouch.session.wiring import wire_run

pytestmark = pytest.mark.usefixtures("svg_alone")

ROOT = Path(__file__).parents[2]
BOUNDS = (to_dB(2), to_dB(200))


def chance(level: float, threshold: float, spread: float, guess: float, lapse: float) -> float:
    """Return the probability of success of a known observer."""
    return float(guess + (1 - guess - lapse) * ndtr((level - threshold) / spread))


def staircase(threshold: float, seed: int, n_trials: int = 40) -> Psychometric:
    """Return the fit of a simulated one-up-one-down run: spread 4 dB, 3 % guesses, 2 % lapses, 5 catch trials."""
    from modaltouch.protocol.conditions import StaircaseSection

    rng, rule = np.random.default_rng(seed), StaircaseSection(steps_dB=(8.0, 4.0, 2.0))
    levels, successes = [], list[bool]()
    for _ in range(n_trials):
        levels.append(follow(rule, to_dB(60), BOUNDS, successes))
        successes.append(bool(rng.random() < chance(levels[-1], threshold, 4.0, 0.03, 0.02)))
    catches = (rng.random(5) < 0.03).tolist()
    return fit_psychometric(levels, successes, guess_rate=0.02, most_lapse=0.06, catches=catches)


def test_threshold_intervals_have_their_coverage() -> None:
    """Known observers, 120 runs of 40 trials: coverage 95 % minus 3 Monte Carlo sd, bias within 0.4 dB."""
    thresholds = np.random.default_rng(7).uniform(to_dB(6), to_dB(80), 120)
    fits = [staircase(float(threshold), seed) for seed, threshold in enumerate(thresholds)]
    told = [(fit.threshold, true) for fit, true in zip(fits, thresholds, strict=True) if fit.threshold is not None]
    assert len(told) >= 114
    covered = sum(e.low <= true <= e.high for e, true in told)
    assert covered >= len(told) * 0.95 - 3 * math.sqrt(len(told) * 0.95 * 0.05)
    assert np.mean([e.estimate - true for e, true in told]) == pytest.approx(0, abs=0.4)


def test_the_fit_agrees_with_psignifit() -> None:
    """Package psignifit 4.3: 2AFC, sigmoid norm, lambda and eta fixed at 0; its width is from 5 to 95 %.

    Its intervals are of the marginal posterior of the threshold with weak priors, ours of the joint region:
    sqrt(2.996 / 1.92) times as wide, to 0.15 dB.
    """
    hits = {26: 45, 28: 50, 30: 44, 32: 56, 34: 53, 36: 63, 38: 73, 40: 79, 42: 86, 44: 88}
    levels = [float(level) for level in hits for _ in range(90)]
    successes = [trial < right for right in hits.values() for trial in range(90)]
    found = fit_psychometric(levels, successes, guess_rate=0.5, most_lapse=0.0)
    assert found.threshold is not None
    assert found.spread is not None
    assert found.threshold.estimate == pytest.approx(36.8646, abs=0.05)
    wider = math.sqrt(REGION / DROP)
    bounds = 36.8646 - wider * (36.8646 - 35.7965), 36.8646 + wider * (37.7285 - 36.8646)
    assert (found.threshold.low, found.threshold.high) == pytest.approx(bounds, abs=0.15)
    assert found.spread.estimate == pytest.approx(13.6314 / (2 * 1.6449), rel=0.01)


def test_the_fit_maximises_the_likelihood() -> None:
    """Reference: scipy.optimize on the binomial likelihood, with guess and lapse rates fixed."""
    levels = np.repeat([10.0, 14.0, 18.0, 22.0, 26.0, 30.0], 10)
    hits = np.array([0, 1, 4, 6, 9, 10])
    successes = [i < k for k in hits for i in range(10)]
    fit = fit_psychometric(levels.tolist(), successes, guess_rate=0.0, most_lapse=0.0)

    def loss(point: np.ndarray) -> float:
        p = np.clip(ndtr((levels[::10] - point[0]) / math.exp(point[1])), 1e-12, 1 - 1e-12)
        return -float(binom.logpmf(hits, 10, p).sum())

    best = minimize(loss, [20.0, 1.5], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9})
    assert fit.threshold is not None
    assert fit.spread is not None
    assert fit.threshold.estimate == pytest.approx(best.x[0], abs=0.05)
    assert fit.spread.estimate == pytest.approx(math.exp(best.x[1]), rel=0.05)
    drop = [loss_at(loss, bound, best.x[1]) - best.fun for bound in (fit.threshold.low, fit.threshold.high)]
    assert drop == pytest.approx([2.996, 2.996], abs=0.07)


def loss_at(loss: object, threshold: float | None, start: float) -> float:
    """Return the minimum loss with the threshold fixed."""
    assert threshold is not None
    return float(minimize(lambda s: loss([threshold, s[0]]), [start], method="Nelder-Mead").fun)  # type: ignore[operator]


@pytest.mark.parametrize(
    ("levels", "successes", "words"),
    [
        ([10.0, 20.0, 30.0] * 5, [True] * 15, "every answer was a success: the threshold lies below 3.16 mm/s"),
        ([10.0, 20.0, 30.0] * 5, [False] * 15, "no answer was a success: the threshold lies above 31.6 mm/s"),
        ([10.0, 30.0] * 10, [True, True, False, False] * 5, "successes do not depend on the level"),
        ([10.0, 30.0] * 10, [True, False] * 10, "successes do not depend on the level"),
        ([30.0] * 20, [True, False] * 10, "successes do not depend on the level"),
        ([10.0] * 20 + [14.0] * 20, [False] * 20 + [True] * 6 + [False] * 14, "above the levels that were presented"),
    ],
)
def test_flat_answers_give_no_threshold(levels: list[float], successes: list[bool], words: str) -> None:
    """There is no estimate, and the reason is given."""
    fit = fit_psychometric(levels, successes, guess_rate=0.0, most_lapse=0.06)
    assert fit.threshold is None
    assert fit.spread is None
    assert fit.slope is None
    assert words in fit.why_not


def test_guessing_observers_rarely_get_a_threshold() -> None:
    """False positives: of 100 runs of an observer who ignores the level, at most 8 give a threshold."""
    rng = np.random.default_rng(3)
    levels = np.tile(np.linspace(10, 40, 8), 5).tolist()
    fits = [
        fit_psychometric(levels, (rng.random(40) < 0.5).tolist(), guess_rate=0.0, most_lapse=0.06) for _ in range(100)
    ]
    assert sum(fit.threshold is not None for fit in fits) <= 8


def forced_choice(chance_of: Callable[[float], float], seed: int) -> Psychometric:
    """Return the fit of a simulated run of 30 trials of two alternatives, down after two successes."""
    from modaltouch.protocol.conditions import StaircaseSection

    rng, rule = np.random.default_rng(seed), StaircaseSection(steps_dB=(8.0, 4.0, 2.0), down_after=2)
    levels, successes = [], list[bool]()
    for _ in range(30):
        levels.append(follow(rule, to_dB(40), BOUNDS, successes))
        successes.append(bool(rng.random() < chance_of(levels[-1])))
    return fit_psychometric(levels, successes, guess_rate=0.5, most_lapse=0.04, flat_rate=0.5)


def test_uncertain_runs_of_a_forced_choice_are_kept() -> None:
    """Known: 28 dB, spread 8 dB; a constant rate explains one run in three as well, which gets a wide interval.

    Without these runs the mean would be biased. An observer who guesses at every level rarely gets a threshold.
    """
    fits = [forced_choice(lambda level: chance(level, 28, 8, 0.5, 0.02), seed) for seed in range(40)]
    unsure = [fit.threshold for fit in fits if fit.is_uncertain and fit.threshold is not None]
    told = [fit.threshold.estimate for fit in fits if fit.threshold is not None]
    assert len(unsure) >= 8 and len(told) >= 38
    assert np.mean(told) == pytest.approx(28, abs=2)
    inside = [(each.low or -math.inf) <= 28 <= (each.high or math.inf) for each in unsure]
    widths = [(each.high or math.inf) - (each.low or -math.inf) for each in unsure]
    assert np.mean(inside) >= 0.9 and np.median(widths) > 20
    assert sum(forced_choice(lambda level: 0.5, seed).threshold is not None for seed in range(40)) <= 8


def test_catch_trials_determine_the_guess_rate() -> None:
    """With half of twenty catch trials successes, the guess rate is near 0.5, not the protocol's."""
    levels = np.repeat([10.0, 20.0, 30.0, 40.0], 20).tolist()
    successes = [i < k for k in (10, 11, 17, 20) for i in range(20)]
    fit = fit_psychometric(levels, successes, guess_rate=0.0, most_lapse=0.06, catches=[True, False] * 10)
    assert fit.guess_rate == pytest.approx(0.5, abs=0.11)
    assert (fit.n_catch, fit.n_false) == (20, 10)


def test_separated_answers_have_a_finite_threshold_and_an_open_spread() -> None:
    """All failures below, all successes above: the fit does not diverge; the spread has no lower bound."""
    fit = fit_psychometric([10.0, 14.0, 18.0, 22.0] * 5, [False, False, True, True] * 5, guess_rate=0.0, most_lapse=0.0)
    assert fit.threshold is not None
    assert fit.spread is not None
    assert 14 <= fit.threshold.estimate <= 18
    assert fit.spread.low == -math.inf
    assert fit.slope is None


@pytest.fixture(scope="module")
def preflight() -> Preflight:
    """The shipped adaptive protocol."""
    return examine(ROOT / "protocols" / "threshold.yaml").require()


FAINT = Observer(
    Participant(detection_speed=0.015, lapse_rate=0.01),
    side_bias_spread=0.0,
    noise_spread=0.0,
    criterion_spread=0.0,
    suppression_spread=0.0,
    pace_spread=0.0,
    name="faint",
)
"""All alike, so that there is one true threshold."""


@pytest.fixture(scope="module")
def results(preflight: Preflight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sessions of simulated participants whose thresholds lie within the levels."""
    folder = tmp_path_factory.mktemp("results")
    for participant in ("p01", "p02"):
        begin(wire_run(preflight, participant, answers="simulated", results=folder, observer=FAINT))
    return folder


def test_a_session_recovers_the_observers_thresholds(preflight: Preflight, results: Path, tmp_path: Path) -> None:
    """The complete chain with rig and record; reference: the model's share of C."""
    found = analyse(results, tmp_path / "out")
    assert isinstance(found, ThresholdAnalysis)
    values = json.loads((tmp_path / "out" / "thresholds.json").read_text(encoding="utf-8"))
    assert values == {key: found.as_dict()[key] for key in values}
    assert len(values["thresholds"]) == 4
    assert {row["n_trials"] for row in values["thresholds"]} == {40}
    assert sum(row["n_catch_trials"] for row in values["thresholds"]) == 20
    people = {run.participant: run for run in found.runs}
    assert set(people) == {"p01", "p02"}
    # 10 % margin: the model's function is not a cumulative normal, and the twin's beam differs from the identified one.
    truth = model_threshold(preflight)
    bounds = [(row["threshold_low_mm_s"] / 1.1, row["threshold_high_mm_s"] * 1.1) for row in values["thresholds"]]
    assert sum(low <= truth <= high for low, high in bounds) >= 3
    for name in ("report.html", "thresholds.svg", "runs_sub-p01_ses-1.svg", "thresholds.csv"):
        assert (tmp_path / "out" / name).stat().st_size > 500
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "SIMULATED DATA" in report
    assert "<p><strong>The mean threshold ranges from " in report
    for name in ("run of one, felt, QUEST+", "mean of runs, felt, QUEST+"):
        assert certificates_in_words([name]) in report, "the certificates are those of the method"
    assert "http://" not in report.replace("http://www.w3.org", "")


def test_thresholds_of_several_kinds_of_session_are_kept_separate(results: Path) -> None:
    """Thresholds before and after training are not repeated measurements; with one kind only, no kind is shown."""
    responses = read_responses(results)
    kinds = responses.frame["participant"].map({"p01": "pre", "p02": "post"})
    runs = find_runs(replace(responses, frame=responses.frame.assign(session_kind=kinds)))
    rows = over_participants(runs)
    assert [(row["session_kind"], row["n_runs"]) for row in rows] == [("pre", 1), ("pre", 1), ("post", 1), ("post", 1)]
    assert {run.kind for run in runs} == {
        f"{kind} one hand {pair}" for kind in ("pre", "post") for pair in ("A-C", "C-E")
    }
    assert all("session_kind" not in row for row in over_participants(find_runs(responses)))


def test_thresholds_of_several_labs_are_reported_by_lab(results: Path, tmp_path: Path) -> None:
    """One participant in each of two labs: a mean for each lab, plain file names, and a note on the comparison."""
    labs = [tmp_path / name for name in ("north", "south")]
    for lab, participant in zip(labs, ("p01", "p02"), strict=True):
        (session,) = results.glob(f"**/sub-{participant}/ses-1")
        shutil.copytree(session, lab / session.relative_to(results))
    analyse(labs[0], tmp_path / "out", labs=labs[1:])
    values = json.loads((tmp_path / "out" / "thresholds.json").read_text(encoding="utf-8"))
    told = [(row["group"], row["pair"], row["n_runs"]) for row in values["over_participants"]]
    assert sorted(told) == [("north", "A-C", 1), ("north", "C-E", 1), ("south", "A-C", 1), ("south", "C-E", 1)]
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert (tmp_path / "out" / "runs_sub-north-p01_ses-1.svg").is_file()
    assert "<p>Groups are labs: north, south.</p>" in report and '<td class="word">south</td>' in report
    assert re.search(r"<strong>The mean threshold ranges from .* \((north|south) one hand [AC]-[CE]\)", report)
    assert f"<code>modaltouch analyse {labs[0]} {labs[1]} --out FOLDER --mode simulated</code>" in report


def runs_of(threshold: dict[tuple[str, str, str], float | None], groups: dict[str, str] | None = None) -> list[Run]:
    """Return runs by participant, finger condition and kind of session, with thresholds in mm/s or None."""
    nothing = Psychometric(40, 20, 0, 0, None, None, 0.0, 0.0, "all alike")
    runs = []
    for (who, fingers, kind), value in threshold.items():
        told = None if value is None else Interval.point(20 * math.log10(value), 40)
        fitted, none = replace(nothing, threshold=told), np.array([])
        own = Run(who, 1, fingers, "A-C", "", none, none.astype(bool), fitted, session_kind=kind)
        runs.append(replace(own, group=(groups or {}).get(who, "")))
    return runs


def test_thresholds_are_compared_within_participants() -> None:
    """Two hands need twice the level in six of six, or in five with the sixth equal: p 2/64 and 2/32 by sign flips.

    A seventh has a threshold with one hand only and does not count; conditions that differ in two factors are not
    compared.
    """
    alone = {(f"p{k}", "one_hand", ""): 20.0 + k for k in range(7)}
    both = {(f"p{k}", "two_hands", ""): 2 * (20.0 + k) for k in range(6)}
    (row,) = compare_runs(runs_of({**alone, **both, ("p6", "two_hands", ""): None}))
    assert (row.scope, row.role, row.n) == ("one_hand - two_hands A-C", "exploratory", 6)
    assert (row.estimate, row.p) == (pytest.approx(0.5), 2 / 64)
    assert row.quantity == "ratio of threshold"
    (row,) = compare_runs(runs_of({**alone, **both, ("p5", "two_hands", ""): 25.0}))
    assert row.p == 2 / 32
    kinds = {(who, fingers, "pre" if fingers == "one_hand" else "post"): v for (who, fingers, _), v in alone.items()}
    assert compare_runs(runs_of({**kinds, **{(f"p{k}", "two_hands", "post"): 9.0 for k in range(6)}})) == []


def test_thresholds_before_and_after_are_compared() -> None:
    """Kinds of session are compared like other factors: training halves every threshold."""
    pre = {(f"p{k}", "one_hand", "pre"): 30.0 + k for k in range(8)}
    (row,) = compare_runs(runs_of({**pre, **{(who, c, "post"): v / 2 for (who, c, _), v in pre.items()}}))
    assert (row.scope, row.estimate, row.p) == ("one_hand A-C pre - A-C post", pytest.approx(2), 2 / 2**8)


def test_thresholds_of_groups_are_compared_by_shuffling_participants() -> None:
    """Four against four without overlap: 2 of 70 orders differ as much; only common cells are used."""
    values = {(f"p{k}", "one_hand", ""): (10.0 if k < 4 else 40.0) + k for k in range(8)}
    groups = {f"p{k}": "young" if k < 4 else "old" for k in range(8)}
    (row,) = compare_runs(runs_of(values, groups))
    assert (row.question, row.scope, row.p) == ("group", "young - old", pytest.approx(2 / 70))
    assert row.low < row.estimate < row.high < 1


@pytest.mark.parametrize(("late", "n_told"), [({"A"}, 2), ({"A", "C"}, 0)])
def test_runs_without_any_answer_in_time_are_reported(
    results: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    late: set[str],
    n_told: int,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """For one pair, or all, the run has no threshold, and the console reports what is missing."""
    table = Session.table

    def late_table(session: Session) -> Iterator[dict[str, object]]:
        for row in table(session):
            is_late = row["zone_left"] in late and not row["catch"]
            yield row | ({"response": "time_out"} if is_late else {})

    monkeypatch.setattr(Session, "table", late_table)
    found = analyse(results, tmp_path / "out")
    assert isinstance(found, ThresholdAnalysis)
    assert [run.fitted.n_trials for run in found.runs].count(40) == n_told
    silent = [run for run in found.runs if not run.fitted.n_trials]
    assert {(run.n_missing, run.fitted.why_not) for run in silent} == {(40, "no trial was answered in time")}
    assert len(found.runs) == 4 == n_told + len(silent)
    tell(found)
    assert f"missing answers, {40 * len(silent)}: p01 session 1, one hand A-C" in capsys.readouterr().err


def model_threshold(preflight: Preflight) -> float:
    """Return the level at which the median participant answers C in half of the trials on (A, C) [mm/s]."""
    from modaltouch.protocol import Protocol
    from modaltouch.protocol.trial import Condition, Trial

    protocol: Protocol = preflight.experiment.protocol
    rng, answers = np.random.default_rng(1), protocol.answers.offered
    levels = np.geomspace(*protocol.conditions.peak_velocities_mm_s, 30)
    shares = []
    for level in levels:
        speeds = preflight.speeds(Trial(1, 1, Condition("one_hand", "A", "C", float(level))))
        given = [FAINT.typical.answer(*speeds, "one_hand", rng, answers)[0] for _ in range(400)]
        shares.append(np.mean([answer == "right" for answer in given]))
    return float(np.exp(np.interp(0.5, shares, np.log(levels))))


def test_adaptive_sessions_are_refused_where_fixed_levels_are_needed(preflight: Preflight, results: Path) -> None:
    """Power and fits count answers in fixed cells: the refusal gives an alternative, without a traceback."""
    with pytest.raises(InputError, match="adaptive runs, which .*; let `modaltouch prereg` say how precisely"):
        designs_for(preflight, FAINT)
    with pytest.raises(InputError, match="adaptive sessions, which have no table of counts"):
        fit_answers(preflight, results, FAINT)
    assert read_responses(results).is_adaptive
    with pytest.raises(InputError, match="leave it out: each run has one stimulus"):
        read_responses(results, stimulus="sharp")
    for option in ("fields", "model"):
        with pytest.raises(InputError, match=f"--{option}: given adaptive sessions; .*; leave --{option} out"):
            analyse(results, **{option: True})  # type: ignore[arg-type]


def test_runs_without_a_threshold_are_in_the_legend() -> None:
    """The legend has every finger condition and pair; a warning of matplotlib would fail the test."""
    from modaltouch.analysis.run_report import draw_thresholds
    from modaltouch.analysis.runs import Run

    levels, successes = np.full(8, 60.0), np.ones(8, dtype=bool)
    fitted = fit_psychometric([to_dB(60)] * 8, [True] * 8, guess_rate=0.02, most_lapse=0.06, catches=[])
    assert fitted.threshold is None
    figure = draw_thresholds([Run("p01", 1, "one_hand", "A-C", "", levels, successes, fitted)], (2.0, 200.0))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["one hand A-C"]


def test_the_trial_axis_has_integer_ticks() -> None:
    """Few trials must not give ticks at every half, nor twenty trials one at 2.5."""
    from modaltouch.analysis.run_report import draw_runs
    from modaltouch.analysis.runs import Run

    fitted = fit_psychometric([to_dB(60)] * 20, [True] * 20, guess_rate=0.5, most_lapse=0.0)
    run = Run("p01", 1, "one_hand", "A-C", "", np.full(4, 60.0), np.ones(4, dtype=bool), fitted)
    marks = draw_runs([run], (2.0, 200.0)).axes[0].get_xticks()
    assert list(marks) == [round(mark) for mark in marks]


def test_kinds_of_runs_differ_in_colour_or_marker() -> None:
    """Two finger conditions, two pairs and two stimuli are eight kinds, each with its own combination."""
    from modaltouch.analysis.run_report import draw_thresholds
    from modaltouch.analysis.runs import Run

    fitted = fit_psychometric([to_dB(60)] * 8, [True] * 8, guess_rate=0.5, most_lapse=0.0)
    levels, successes = np.full(8, 60.0), np.ones(8, dtype=bool)
    kinds = itertools.product(("one_hand", "two_hands"), ("A-C", "C-E"), ("sharp", "blunt"))
    figure = draw_thresholds([Run("p01", 1, *kind, levels, successes, fitted) for kind in kinds], (2.0, 200.0))
    drawn = {(line.get_color(), line.get_marker()) for line in figure.axes[0].lines}
    assert len(drawn) == 8


@pytest.mark.parametrize(
    ("design", "words"),
    [
        ({"intervals": {"number": 2, "standard": {"velocity_mm_s": 90}, "asked": "stronger"},
          "answers": {"keys": {"first": ["left"], "second": ["right"]}, "intervals": {"first": 1, "second": 2}},
          "adaptive": {"success": "correct"}},
         "standard, of 90 mm/s.</li> <li>Success is a correct answer: the interval of the higher level. The threshold "
         "is thus the level from which the comparison can be distinguished from the standard."),
        ({"intervals": {"number": 3, "standard": {"velocity_mm_s": 0}},
          "answers": {"keys": {"one": ["a"], "two": ["b"], "three": ["c"]},
                      "intervals": {"one": 1, "two": 2, "three": 3}},
          "adaptive": {"success": "correct"}},
         "the others the standard: nothing was driven.</li> <li>Success is a correct answer: the interval of the "
         "comparison."),
        ({"answers": {"keys": {"rough": ["left"], "smooth": ["right"]}}, "adaptive": {"success": "rough"}},
         "<ul> <li>Success is the answer “rough”; any other answer is a failure. The threshold is thus the level from "
         "which that answer is given."),
    ],
)  # fmt: skip
def test_the_report_states_the_success_and_the_standard(design: dict, words: str) -> None:
    """A success is the correct interval or an answer of the protocol; the finger at the focus is not mentioned."""
    design = {
        "conditions": {"peak_velocities_mm_s": [2, 200]},
        **design,
        "adaptive": {"trials": 8, "method": "staircase", "guess_rate": 0.5, "lapse_rate": 0.02, **design["adaptive"]},
    }
    answers = AnswerList.of(design["answers"])
    frame = pd.DataFrame({
        "participant": "p01", "session": 1, "trial": range(8), "finger_condition": "one_hand", "zone_left": "A",
        "zone_right": "C", "stimulus": "", "session_kind": "", "velocity_mm_s": 60.0, "response": answers.names[0],
        "correct": 1,
    })  # fmt: skip
    source = AnswerSource("somewhere", "results", "", "real")
    responses = Responses(frame, (), (), source, "C", {"design": design, "adaptive": {"algorithm": "a rule"}},
                          answers=answers, design=design)  # fmt: skip
    page = " ".join(render_runs(analyse_runs(responses))["report.html"].split())
    assert words in page and "timed out" not in page
    late = analyse_runs(replace(responses, frame=frame[1:]))
    assert [run.n_missing for run in late.runs] == [late.as_dict()["n_missing"]] == [1]
    assert "1 trial timed out without an answer. The next level was chosen" in render_runs(late)["report.html"]
    assert "which is in focus" not in page


@pytest.mark.parametrize(("guess_rate", "expected"), [(0.3333, True), (0.33, True), (0.25, False)])
def test_a_rounded_guess_rate_counts_as_guessing(guess_rate: float, expected: bool) -> None:
    """Of three intervals it is 1/3, however rounded: `check` itself writes 0.3333."""
    answers = AnswerList.of({"keys": {"one": ["a"], "two": ["b"], "three": ["c"]}})
    frame = pd.DataFrame({"response": ["one"], "velocity_mm_s": [60.0]})
    start = {"design": {"adaptive": {"guess_rate": guess_rate}}}
    source = AnswerSource("somewhere", "results", "", "real")
    assert is_forced(Responses(frame, (), (), source, start=start, answers=answers)) == expected
