"""Observer files: the behaviour of the shipped ones, and faults with their place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modaltouch.planning.experiments import answer_shares
from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import Participant
from modaltouch.preflight import examine
from modaltouch.protocol.source import InputError, Source

PEAKS = {"A": 0.123, "B": 0.115, "C": 0.2, "D": 0.115, "E": 0.123}
"""Peak speeds of the shipped stimulus at 200 mm/s [m/s]."""


def test_the_paper_observer_reproduces_the_papers_pattern() -> None:
    """Section V-C: nearly all C in (A,C) and (C,E), 38 to 40 of 40; a majority of both in (B,D)."""
    crowd = Observer.read("paper").draw_participants(np.random.default_rng(1), (20_000,))
    speeds = [[PEAKS[left], PEAKS[right]] for left, right in ("AC", "BD", "CE")]
    for condition in ("one_hand", "two_hands"):
        left, right = (share.mean(axis=0) for share in answer_shares(crowd, speeds, [condition] * 3))
        assert 0.93 < right[0] < 0.99
        assert 0.93 < left[2] < 0.99
        assert 0.6 < 1 - left[1] - right[1] < 0.95


def test_the_paper_observer_is_the_default() -> None:
    """Sessions simulated without a file use the same model, to the three digits of the file."""
    shipped, default = Observer.read("paper"), Observer()
    assert shipped.typical.noise == pytest.approx(default.typical.noise, rel=1e-3)
    assert shipped.typical.criterion == default.typical.criterion
    assert shipped.side_bias_spread == default.side_bias_spread
    assert shipped.front_end == default.front_end


def test_only_the_fingertip_observer_has_internal_noise() -> None:
    """All others answer as without it; at 80 mm/s the fingertip answers C nearly as often as the paper's observer."""
    noisy = [name for name in Source.shipped("observer") if Observer.read(name).typical.internal_noise]
    assert noisy == ["fingertip"]
    crowds = [
        Observer.read(name).draw_participants(np.random.default_rng(1), (5_000,)) for name in ("paper", "fingertip")
    ]
    named = [answer_shares(crowd, [[0.4 * PEAKS["A"], 0.4 * PEAKS["C"]]], ["one_hand"])[1].mean() for crowd in crowds]
    assert named[0] > 0.94
    assert named[1] > 0.85


def test_protocols_of_thresholds_simulate_the_fingertip_observer(shipped: Path) -> None:
    """Adaptive runs, levels relative to thresholds, and detection use the fingertip; other protocols the paper's."""
    names = ("demo", "with_catch_trials", "threshold", "sensation_levels", "detection_with_confidence")
    usual = [Observer.usual_name(examine(shipped / f"{name}.yaml").experiment.protocol) for name in names]
    assert usual == ["paper", "paper", "fingertip", "fingertip", "fingertip"]


def test_guessing_is_a_third_of_each_answer() -> None:
    """Expected: 1/3, whatever is felt."""
    left, right = answer_shares(
        Observer.read("guessing").draw_participants(np.random.default_rng(1), (3,)), [[0, 1]], ["one_hand"]
    )
    assert left == pytest.approx(np.full((3, 1), 1 / 3))
    assert right == pytest.approx(left)


def test_every_shipped_observer_is_read_by_its_name() -> None:
    """The name of the file is that of the observer."""
    names = list(Source.shipped("observer"))
    assert {"paper", "near_miss", "envelope", "below_1_khz", "guessing"} <= set(names)
    assert [Observer.read(name).name for name in names] == names


def test_a_written_observer_is_read_back(tmp_path: Path) -> None:
    """Numbers agree to four digits, and the description may have any characters."""
    observer = Observer(
        Participant(noise=0.31, side_bias=-0.07, near_miss=0.2, internal_noise=0.0042),
        front_end="rms",
        noise_spread=0.33,
    )
    file = tmp_path / "mine.yaml"
    file.write_text(observer.as_file("mine", "a \"quoted\": 80 % 'word'"), encoding="utf-8")
    read = Observer.read(file)
    assert read.typical.noise == pytest.approx(0.31, rel=1e-3)
    assert (read.typical.side_bias, read.typical.near_miss) == (-0.07, 0.2)
    assert read.typical.internal_noise == pytest.approx(0.0042)
    assert (read.front_end, read.noise_spread, read.name) == ("rms", 0.33, "mine")


def test_all_faults_of_a_file_are_reported_together_with_their_place(edit: Callable[..., Path]) -> None:
    """Each gives line and key, the value and what is allowed."""
    file = edit("observers/paper.yaml", ("front_end: peak", "front_end: peek"), ("lapse_rate: 0.005", "lapse_rate: 5"))
    with pytest.raises(InputError, match="did you mean 'peak'") as caught:
        Observer.read(file)
    first, second = caught.value.problems
    assert (first.line, first.path) == (5, "front_end")
    assert (second.line, second.path, second.given) == (11, "typical.lapse_rate", "5")


def test_an_unknown_observer_is_refused_with_the_shipped_names() -> None:
    """The message suggests the most similar name and lists all."""
    with pytest.raises(InputError, match=r"one of below_1_khz, envelope, .*; did you mean 'paper'\?"):
        Observer.read("papr")
