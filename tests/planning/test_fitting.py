"""From recorded answers to an observer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from modaltouch.document import InputError
from modaltouch.observer import Observer, Participant
from modaltouch.planning.experiments import Job, simulate
from modaltouch.planning.fitting import fit_answers
from modaltouch.planning.presented import design_for
from modaltouch.preflight import Preflight, examine

HEADER = "participant,finger_condition,zone_left,zone_right,velocity_mm_s,response,n"
TRUTH = Observer(Participant(noise=0.4, criterion=0.5, suppression=0.5, suppression_across_hands=0.5))


@pytest.fixture(scope="module")
def preflight() -> Preflight:
    """The minute-long protocol, examined."""
    return examine(Path(__file__).parents[2] / "protocols" / "demo.yaml").require()


def write_answers(file: Path, preflight: Preflight) -> None:
    """Write the answers of 20 simulated participants, as counts."""
    design = design_for(preflight, TRUTH)
    answers = simulate(design, TRUTH, Job(20, 4, 0, 1), np.random.default_rng(3))
    rows = [HEADER]
    for (_, person, f, q, v), left in np.ndenumerate(answers.left):
        right = int(answers.right[0, person, f, q, v])
        for response, n in (("left", left), ("right", right), ("both", 4 - left - right)):
            if n:
                pair = design.pairs[q]
                condition, level = design.finger_conditions[f], design.levels[v]
                rows.append(f"p{person},{condition},{pair.left},{pair.right},{level:g},{response},{n}")
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")


def test_answers_in_a_file_give_back_their_observer(tmp_path: Path, preflight: Preflight) -> None:
    """Expected: sigma / (1 + s) = 0.267 and exp(c / (1 + s)) = 1.396, of the observer who answered."""
    write_answers(tmp_path / "answers.csv", preflight)
    fitted = fit_answers(preflight, tmp_path / "answers.csv", Observer())
    assert (fitted.n_participants, fitted.fit.n_answers) == (20, 20 * 12 * 4)
    found = {estimate.name: estimate for estimate in fitted.fit.identified}
    for kind in ("one_hand", "two_hands"):
        noise, ratio = found[f"noise of the log ratio, {kind}"], found[f"speed ratio named half the time, {kind}"]
        assert noise.low * 0.9 < 0.4 / 1.5 < noise.high * 1.1
        assert ratio.low * 0.97 < np.exp(0.5 / 1.5) < ratio.high * 1.03
    assert "scale is the prior's" in fitted.as_dict()["not_identifiable"]


def test_answers_about_another_beam_are_refused(tmp_path: Path, preflight: Preflight) -> None:
    """Expected: the zone, the zones of the beam, and what to do."""
    (tmp_path / "a.csv").write_text(f"{HEADER}\np1,one_hand,A,Z,80,left,1\n", encoding="utf-8")
    with pytest.raises(InputError, match="the zone 'Z'; allowed: A, B, C, D, E; give the protocol in which"):
        fit_answers(preflight, tmp_path / "a.csv", Observer())
