"""A braked burst begins and ends at rest, so that the timing of the next one does not matter."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modaltouch.preflight import examine
from modaltouch.preflight.single_design import design_to_fit
from modaltouch.rig.pacing import LATEST
from modaltouch.stimulus.drive import Release

PROTOCOL = Path(__file__).parents[2] / "protocols" / "differentiated_stimulation.yaml"


def left_at_the_next_focus(release: Release) -> float:
    """Return the residual motion of a mode at the next focus, at the shortest interval, over the peak [1].

    By linearity, the interval only affects the state at the end of a burst, decayed until the next focusing instant.
    """
    ground, _ = examine(PROTOCOL).require().sound
    stimulus = design_to_fit(ground, release=release)
    velocity, timing, system = 0.2, stimulus.timing, stimulus.system
    by_channel = system.states_by_channel(timing.converter.signed(stimulus.burst.codes), timing, timing.duration)
    at_end = stimulus.volts_per_code(velocity) @ by_channel
    shortest = (1 - LATEST) / timing.repetition_rate
    left = at_end * np.exp(system.exponent * (shortest - timing.duration + timing.focusing_instant))
    return float(np.abs(system.velocity @ left).max() / velocity)


def test_jitter_of_a_braked_burst_does_not_affect_the_focus() -> None:
    """Shortest interval that the pacer allows, rounded codes: at most 1e-5 of the peak, any phase, every mode."""
    assert left_at_the_next_focus("braked") <= 1e-5


def test_a_burst_with_a_free_release_leaves_more() -> None:
    """Shows that the test above can fail: at least ten times more than a braked burst."""
    assert left_at_the_next_focus("free") > 10 * left_at_the_next_focus("braked")
