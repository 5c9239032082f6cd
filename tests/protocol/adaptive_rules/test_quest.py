"""QUEST+ as recorded, against its definition in plain NumPy."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from scipy.special import xlogy
from scipy.stats import norm

from modaltouch.protocol.levels import Quest


class Definition:
    """Watson (2017), equations (1) to (10), over all combinations of what is thought possible.

    Levels every 2 dB between the bounds, and the first one; thresholds every 1 dB to 12 dB beyond the bounds; five
    spreads; no lapses, half the largest rate of them, all of it. At first every combination is as likely.
    """

    def __init__(self, bounds: tuple[float, float], start: float, guess: float, lapse: float) -> None:
        low, high = bounds
        n_levels = 1 + max(1, round((high - low) / 2))
        self.levels = np.unique([*np.linspace(low, high, n_levels), start])
        threshold = np.arange(low - 12, high + 12.5, 1.0)
        spread, lapses = np.array([1, 2, 4, 8, 12.0]), np.array([0, lapse / 2, lapse])
        mean, sd, rate = (each.ravel() for each in np.meshgrid(threshold, spread, lapses, indexing="ij"))
        self.yes = guess + (1 - guess - rate) * norm.cdf((self.levels[:, None] - mean) / sd)
        self.belief = np.full(mean.size, 1 / mean.size)

    def learn(self, level: float, success: bool) -> None:
        """Update the posterior with an answer."""
        yes = self.yes[np.abs(self.levels - level).argmin()]
        self.belief = self.belief * (yes if success else 1 - yes)
        self.belief /= self.belief.sum()

    def next_level(self) -> float:
        """Return the level with the least expected entropy after its answer."""
        expected = np.zeros(self.levels.size)
        for chance in (self.yes, 1 - self.yes):
            joint = chance * self.belief
            share = joint.sum(axis=1, keepdims=True)
            after = joint / share
            expected -= share[:, 0] * xlogy(after, after).sum(axis=1)
        return float(self.levels[expected.argmin()])


@pytest.mark.parametrize(
    ("bounds", "start", "guess", "lapse"),
    [((6.0, 46.0), 35.6, 0.0, 0.05), ((10.0, 19.0), 13.5, 0.5, 0.02), ((10.0, 11.0), 10.4, 0.0, 0.1)],
)
def test_every_level_minimises_the_expected_entropy(
    bounds: tuple[float, float], start: float, guess: float, lapse: float
) -> None:
    """Two consecutive runs of one rule with a simulated observer; the second starts from the prior."""
    first = Quest(bounds, start, guess, lapse)
    for run, seed in ((first, 1), (copy.copy(first), 2)):
        rng, reference, history = np.random.default_rng(seed), Definition(bounds, start, guess, lapse), []
        for _ in range(25):
            level = run.next_level(history)
            assert level == pytest.approx(reference.next_level() if history else start, abs=1e-9)
            felt = bool(rng.random() < guess + (1 - guess - lapse) * norm.cdf((level - sum(bounds) / 2) / 3))
            history.append((level, felt))
            reference.learn(level, felt)
    assert first.next_level([]) == start
