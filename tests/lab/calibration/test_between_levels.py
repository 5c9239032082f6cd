"""A calibration for adaptive runs: some levels are verified, and those between them are interpolated."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modaltouch.lab.calibration import calibrate_each, design_inputs_of, levels_between
from modaltouch.lab.calibration.file import corrected_inputs
from modaltouch.preflight import examine
from modaltouch.preflight.single_design import design_to_fit
from modaltouch.protocol.apparatus import Apparatus

THRESHOLD = Path(__file__).parents[3] / "protocols" / "threshold.yaml"


def test_three_levels_at_equal_ratios_are_verified_between_the_bounds() -> None:
    """From 2 to 200 mm/s, a factor of 100^(1/4) = 3.162 apart; fixed levels need none."""
    assert levels_between(examine(THRESHOLD).require().experiment.protocol) == (6.325, 20.0, 63.25)
    own = examine(THRESHOLD.with_name("sensation_levels.yaml")).require().experiment.protocol
    assert levels_between(own) == (6.325, 20.0, 63.25), "participants' own levels lie anywhere between"
    assert levels_between(examine(THRESHOLD.with_name("demo.yaml")).require().experiment.protocol) == ()


def test_levels_between_the_verified_ones_are_met(make_bench: Callable, shipped_apparatus: Apparatus) -> None:
    """Amplitudes are 2 % high per decade below 15 Vpp; levels between hold to 1 % or 0.3 mm/s."""
    preflight = examine(THRESHOLD).require()
    grounds, between = design_inputs_of(preflight), levels_between(preflight.experiment.protocol)
    bench = make_bench(shipped_apparatus, 1, lambda amplitude: 1 + 0.02 * math.log10(15 / max(amplitude, 0.01)))
    outcome = calibrate_each(bench, shipped_apparatus, grounds, between=between)[""]
    assert [round(level.velocity * 1e3, 3) for level in outcome.levels] == [2, 6.325, 20, 63.25, 200]
    stimulus = design_to_fit(corrected_inputs(grounds[""], outcome.refined, outcome.correction))
    shapes = bench.twin.beam.shapes(stimulus.target_field.centre)[:, 0]
    for level in (0.011, 0.035, 0.11):
        assert level not in [each.velocity for each in outcome.levels]
        true = bench.true_state(stimulus.burst, level, stimulus.timing.focusing_instant)
        at_focus = float(shapes @ np.concatenate([true.velocity, true.unlisted_velocity]))
        proportional = stimulus.burst.amplitude[0] * level / stimulus.burst.velocity
        assert at_focus == pytest.approx(level, rel=0.01, abs=0.3e-3)
        assert stimulus.burst.amplitude_for(level)[0] < proportional
