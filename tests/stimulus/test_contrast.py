"""The drive of highest contrast, against another solver of linear programmes and on the beam."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier
from modaltouch.stimulus.fingers import Finger
from modaltouch.stimulus.other_drives import least_bound
from modaltouch.stimulus.target_field import TargetField

LEVEL, LIMIT = 0.2, 250.0


def test_the_bound_agrees_with_another_solver(rng):
    """Least s with |b + A x| <= s in forty rows and <= 1 in thirty: HiGHS lies between our bound and our solution."""
    rows, offset = rng.standard_normal((70, 8)), 0.3 * rng.standard_normal(70)
    slack = np.repeat([1.0, 0.0], [40, 30])
    weight, bound = least_bound(offset, rows, slack)
    reached = np.abs(offset + rows @ weight)
    upper = np.concatenate([np.column_stack([rows, -slack]), np.column_stack([-rows, -slack])])
    allowed = np.concatenate([1 - slack - offset, 1 - slack + offset])
    least = linprog(np.append(np.zeros(8), 1.0), A_ub=upper, b_ub=allowed, bounds=[(None, None)] * 9).fun
    assert reached[40:].max() <= 1
    assert bound <= least <= reached[:40].max() * (1 + 1e-9)
    assert reached[:40].max() <= bound / (1 - 0.15)


def test_a_focus_beside_a_quiet_zone(design, model):
    """Four modes, two fingers, a delay of 20 us: the level is met at 2.5 times the contrast of the exact law."""
    fingers = tuple(Finger(place, 1e-4, 0.5, 500.0) for place in (-0.04, 0.0))
    names = ("natural_frequency", "damping_ratio", "modal_gain")
    low = replace(model, label=(1, 3, 5, 7), mass=3.3e-3, **{name: getattr(model, name)[:4] for name in names})
    timing = Timing(AFG3022B.converter, n_samples=10_000, duration=0.02, focusing_instant=0.01)
    amplifier = Amplifier(gain=25.0, limit=LIMIT, delay=20e-6)
    stimulus = design(low.touched(fingers), timing=timing, target_field=TargetField(selection=4), amplifier=amplifier)
    beam, zone = stimulus.touched(fingers), np.array([-0.044, -0.04, -0.036])
    played, bound = beam.highest_contrast(0.0, zone, LEVEL)
    one = np.ones(2)
    assert played.velocity_at_focus([0.0], one)[0] == pytest.approx(LEVEL, rel=1e-9)
    assert np.abs(played.codes).max() <= LIMIT * (1 + 1e-9)
    peak, *others = played.peak_velocity([0.0, *zone], one)
    exact, *exact_others = beam.peak_velocity([0.0, *zone], stimulus.volts_per_code(LEVEL))
    assert peak / max(others) > 2.5 * exact / max(exact_others)
    assert LEVEL / max(others) <= bound
