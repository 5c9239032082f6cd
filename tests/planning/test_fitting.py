"""Fitting an observer to recorded answers."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from modaltouch.planning.design import designs_for
from modaltouch.planning.experiments import Job, answer_shares, simulate
from modaltouch.planning.fitting import RecordedAnswers, _grid, _of_everybody, fit_answers, fit_observer
from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import Participant
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol.source import InputError
from modaltouch.protocol.trial import Condition, Trial
from modaltouch.session.wiring import simulate_session

TWO_FIELDS = Path(__file__).parents[2] / "protocols" / "two_fields.yaml"
HEADER = "participant,finger_condition,zone_left,zone_right,velocity_mm_s,response,n"
TRUTH = Observer(Participant(noise=0.4, criterion=0.5, suppression=0.5, suppression_across_hands=0.5))


@pytest.fixture(scope="module")
def preflight() -> Preflight:
    """The one-minute protocol, examined."""
    return examine(Path(__file__).parents[2] / "protocols" / "demo.yaml").require()


def write_answers(file: Path, preflight: Preflight) -> None:
    """Write the answers of 20 simulated participants as counts."""
    design = designs_for(preflight, TRUTH)[""]
    answers = simulate(design, TRUTH, Job(20, 4, 0, 1), np.random.default_rng(3))
    rows = [HEADER]
    for (person, f, q, v, place), n in np.ndenumerate(answers.counts[0]):
        if n:
            pair, response = design.pairs[q], answers.answers[place].name
            condition, level = design.finger_conditions[f], design.levels[v]
            rows.append(f"p{person},{condition},{pair.left},{pair.right},{level:g},{response},{n}")
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")


def test_the_observer_is_recovered_from_a_file_of_answers(tmp_path: Path, preflight: Preflight) -> None:
    """The fit recovers the observer's sigma / (1 + s) = 0.267 and exp(c / (1 + s)) = 1.396."""
    write_answers(tmp_path / "answers.csv", preflight)
    fitted = fit_answers(preflight, tmp_path / "answers.csv", Observer())
    assert (fitted.n_participants, fitted.n_answers) == (20, 20 * 12 * 4)
    found = {estimate.name: estimate for estimate in fitted.identified}
    for kind in ("one_hand", "two_hands"):
        noise, ratio = found[f"noise of the log ratio, {kind}"], found[f"speed ratio named half the time, {kind}"]
        assert noise.low * 0.9 < 0.4 / 1.5 < noise.high * 1.1
        assert ratio.low * 0.97 < np.exp(0.5 / 1.5) < ratio.high * 1.03
    assert "scale is the prior's" in fitted.as_dict()["not_identifiable"]


def test_one_observer_is_fitted_to_the_answers_of_all_stimuli(tmp_path: Path) -> None:
    """In sessions of two stimuli every answer counts once, with the speeds of its stimulus."""
    preflight = examine(TWO_FIELDS).require()
    for number in (1, 2):
        simulate_session(preflight, f"p0{number}", tmp_path, observer=TRUTH)
    fitted = fit_answers(preflight, tmp_path, Observer())
    assert (fitted.n_participants, fitted.n_answers) == (2, 2 * 32)
    expected = 0.0
    crowd = fitted.observer.participants_at(_grid())
    for person in ("p01", "p02"):
        logs = np.zeros(_grid().shape[1])
        for responses in fitted.responses:
            stimulus = preflight.parts[responses.stimulus]
            own = responses.frame[responses.frame["participant"] == person]
            for row in own.itertuples():
                trial = Condition(row.finger_condition, row.zone_left, row.zone_right, row.velocity_mm_s)
                speeds = stimulus.speeds(Trial(0, 0, trial))
                left, right = (share[..., 0] for share in answer_shares(crowd, [speeds], [row.finger_condition]))
                logs += np.log({"left": left, "right": right, "both": 1 - left - right}[row.response])
        expected += float(np.log(np.exp(logs).mean()))
    assert fitted.log_likelihood == pytest.approx(expected, rel=1e-3)


def test_the_observer_is_recovered_from_two_stimuli() -> None:
    """Four fits to 30 participants recover sigma / (1 + s) = 0.267 and exp(c / (1 + s)) = 1.396.

    Of 16 intervals of 95 %, at least 14 contain the true value except with a probability of 1 %; the means are within 5
    %.
    """
    designs = designs_for(examine(TWO_FIELDS).require(), TRUTH)
    held, values = 0, []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        crowd, parts = TRUTH.draw_participants(rng, (30,)), []
        for design in designs.values():
            speeds = design.speeds.reshape(-1, 2)
            left, right = answer_shares(crowd, speeds, design.cells)
            counts = rng.multinomial(4, np.stack([left, 1 - left - right, right], axis=-1))
            parts.append(RecordedAnswers(counts, speeds, design.cells, np.ones(30)))
        fit = fit_observer(RecordedAnswers.joined(parts), Observer())
        assert fit.n_answers == 30 * 4 * 16
        for ratio, noise in zip(fit.identified[::2], fit.identified[1::2], strict=True):
            held += int(ratio.low < np.exp(0.5 / 1.5) < ratio.high) + int(noise.low < 0.4 / 1.5 < noise.high)
            values.append((ratio.value, noise.value))
    assert held >= 14
    assert np.mean(values, axis=0) == pytest.approx((np.exp(0.5 / 1.5), 0.4 / 1.5), rel=0.05)


def test_answers_without_their_stimulus_are_refused(tmp_path: Path, preflight: Preflight) -> None:
    """For several stimuli a CSV needs their column; adaptive runs are refused, too."""
    (tmp_path / "a.csv").write_text(f"{HEADER}\np1,one_hand,A,C,80,left,1\n", encoding="utf-8")
    with pytest.raises(InputError, match="add the column stimulus"):
        fit_answers(examine(TWO_FIELDS).require(), tmp_path / "a.csv", Observer())
    with pytest.raises(InputError, match="adaptive sessions, which have no table of counts"):
        fit_answers(examine(TWO_FIELDS.with_name("threshold.yaml")).require(), tmp_path / "a.csv", Observer())


def test_a_table_with_its_stimuli_is_fitted(tmp_path: Path) -> None:
    """One answer in each cell of both stimuli counts once, with the speeds of its stimulus.

    A participant without answers to one of them counts with the others, as that participant.
    """
    preflight = examine(TWO_FIELDS).require()
    rows, people = [f"{HEADER},stimulus"], (("p1", "p2"), ("p3", "p1"))
    for (stimulus, design), met in zip(designs_for(preflight, TRUTH).items(), people, strict=True):
        for condition, pair, level in product(design.finger_conditions, design.pairs, design.levels):
            rows += [f"{who},{condition},{pair.left},{pair.right},{level:g},both,1,{stimulus}" for who in met]
    (tmp_path / "a.csv").write_text("\n".join(rows), encoding="utf-8")
    fitted = fit_answers(preflight, tmp_path / "a.csv", Observer())
    assert (fitted.n_participants, fitted.n_answers, len(fitted.responses)) == (3, len(rows) - 1, 2)
    counted = [each.count("C") for each in fitted.responses]
    whose = [(each.participants, each.counts.sum(axis=(1, 2, 3, 4)).tolist()) for each in _of_everybody(counted)]
    assert whose == [(("p1", "p2", "p3"), [8, 8, 0]), (("p1", "p2", "p3"), [8, 0, 8])]


def test_the_words_of_a_table_are_mapped_as_by_analyse(tmp_path: Path, preflight: Preflight) -> None:
    """B for both, and NA for no answer; recorded sessions have words of their own."""
    cells = designs_for(preflight, TRUTH)[""]
    rows = [f"p1,{fingers},{pair.left},{pair.right},{level:g},B,1"
            for fingers, pair, level in product(cells.finger_conditions, cells.pairs, cells.levels)]  # fmt: skip
    rows[0] = rows[0].replace("B,1", "NA,1")
    (tmp_path / "a.csv").write_text("\n".join([HEADER, *rows]), encoding="utf-8")
    words = ({"B": "both"}, ("NA",))
    fitted = fit_answers(preflight, tmp_path / "a.csv", Observer(), words=words)
    assert fitted.n_answers == len(rows) - 1
    with pytest.raises(InputError, match="sessions, which contain theirs; .*; leave out --answers, --missing"):
        fit_answers(preflight, tmp_path, Observer(), words=words)


def test_a_pilot_at_other_levels_is_fitted(tmp_path: Path, preflight: Preflight) -> None:
    """An observer is a function of speed, so levels between the protocol's inform about it, too."""
    cells = product(("one_hand", "two_hands"), ("A,C", "B,D", "C,E"), (90, 160))
    rows = [f"p1,{condition},{zones},{level},both,1" for condition, zones, level in cells]
    (tmp_path / "a.csv").write_text("\n".join([HEADER, *rows]), encoding="utf-8")
    fitted = fit_answers(preflight, tmp_path / "a.csv", Observer())
    assert (fitted.n_participants, fitted.n_answers) == (1, 12)


def test_answers_about_another_beam_are_refused(tmp_path: Path, preflight: Preflight) -> None:
    """Expected: the zones in the table, those of the protocol, and what to do."""
    (tmp_path / "a.csv").write_text(f"{HEADER}\np1,one_hand,A,Z,80,left,1\n", encoding="utf-8")
    with pytest.raises(InputError, match="given 'A-Z'; allowed: A-C, B-D, C-E; .* name the protocol"):
        fit_answers(preflight, tmp_path / "a.csv", Observer())
