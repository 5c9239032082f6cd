"""QUEST+ over the level in decibels: the next level is the one expected to tell most about the function.

References
----------
Watson, "QUEST+: a general multidimensional Bayesian adaptive psychometric method", Journal of Vision 17(3) (2017) 10.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, Self

import numpy as np

STEP = 2.0
"""Distance of the levels that may be presented [dB]."""

MARGIN = 12.0
"""How far beyond the levels the threshold may lie [dB]."""

SPREADS = (1.0, 2.0, 4.0, 8.0, 12.0)
"""Standard deviations of the function that are thought possible [dB]."""


class Quest:
    """A run of QUEST+, built with the package questplus, which PsychoPy brings along.

    Parameters
    ----------
    bounds : (float, float)
        Lowest and highest level [dB].
    start : float
        Level of the first trial [dB].
    guess_rate, lapse_rate : float
        Asymptotes of the function, and the largest lapse rate thought possible [1].
    """

    def __init__(self, bounds: tuple[float, float], start: float, guess_rate: float, lapse_rate: float) -> None:
        # Slow to import, so only where a run needs it.
        from questplus import QuestPlus

        low, high = bounds
        self._start = start
        levels = np.linspace(low, high, 1 + max(1, round((high - low) / STEP)))
        self._quest: Any = QuestPlus(
            stim_domain={"intensity": np.unique(np.append(levels, start))},
            param_domain={
                "mean": np.arange(low - MARGIN, high + MARGIN + STEP / 2, STEP / 2),
                "sd": np.array(SPREADS),
                "lower_asymptote": np.array([guess_rate]),
                "lapse_rate": np.unique([0.0, lapse_rate / 2, lapse_rate]),
            },
            outcome_domain={"response": ["yes", "no"]},
            func="norm_cdf",
            stim_scale="linear",
            stim_selection_method="min_entropy",
            param_estimation_method="mean",
        )
        self._taken: list[tuple[float, bool]] = []

    def another(self) -> Self:
        """Return a run by the same rule at its beginning; it shares the likelihoods, which are slow to compute."""
        run = copy.copy(self)
        run._quest = copy.copy(self._quest)
        run._begin_anew()
        return run

    def next_level(self, history: Sequence[tuple[float, bool]]) -> float:
        """Return the level of the next trial [dB].

        Parameters
        ----------
        history : sequence of (float, bool)
            Level [dB] and success of the trials so far, in order.
        """
        if list(history[: len(self._taken)]) != self._taken:
            self._begin_anew()
        for level, success in history[len(self._taken) :]:
            self._quest.update(stim=self._nearest(level), outcome={"response": "yes" if success else "no"})
            self._taken.append((level, success))
        if not self._taken:
            return self._start
        return float(self._quest.next_stim["intensity"])

    def _begin_anew(self) -> None:
        self._quest.posterior = self._quest.prior.copy(deep=True)
        self._quest.stim_history, self._quest.resp_history = [], []
        self._taken = []

    def _nearest(self, level: float) -> dict[str, float]:
        """Return the level of the domain that was presented, which the record has to four digits."""
        domain = self._quest.stim_domain["intensity"]
        return {"intensity": float(domain[np.argmin(np.abs(domain - level))])}
