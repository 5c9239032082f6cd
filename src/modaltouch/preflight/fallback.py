"""What a generator without burst mode makes of a stimulus: one record a period, which cannot be exact."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from modaltouch.rig.settings import MAX_POINTS, continuous_codes
from modaltouch.stimulus.design import Stimulus
from modaltouch.stimulus.quantise import signed_codes
from modaltouch.stimulus.vibration import states_by_channel


def continuous_figures(stimulus: Stimulus, velocity: float) -> dict[str, Any]:
    """Return what the repetition ``continuous`` of the generator misses at the focusing instant of the first burst.

    A record of a whole period has fewer points for the burst: its steps come late or early by up to half a point,
    on top of the clock's own jitter.

    Parameters
    ----------
    stimulus : Stimulus
        The stimulus of all levels.
    velocity : float
        Level [m/s].

    Returns
    -------
    dict
        ``velocity_mm_s``; ``n_samples`` of the record; ``step_error_us``, by how much a step is late or early at
        most; ``worst_modal_error_mm_s``, the largest of |velocity - target| and |w eta| over the modes; and a
        ``warning`` in words.
    """
    burst, timing = stimulus.burst, stimulus.timing
    played = replace(timing, n_samples=MAX_POINTS, duration=1 / timing.repetition_rate)
    # What is played after the focusing instant does not act on it.
    codes = signed_codes(continuous_codes(burst)[:, : int(timing.focusing_instant / played.hold) + 2])
    state = stimulus.volts_per_code(velocity) @ states_by_channel(
        stimulus.system, codes, played, timing.focusing_instant
    )
    reached = np.concatenate([stimulus.system.velocity @ state, stimulus.system.displacement @ state]).real
    aim = np.concatenate(stimulus.aim) * (velocity / stimulus.wish.velocity)
    error = 1e3 * float(np.abs(reached - aim).max())
    step = 1e6 * (played.hold / 2 + 1 / timing.clock_rate)
    return {
        "velocity_mm_s": velocity * 1e3,
        "n_samples": MAX_POINTS,
        "step_error_us": step,
        "worst_modal_error_mm_s": error,
        "warning": (
            f"played continuously, without burst mode, {velocity * 1e3:g} mm/s cannot be exact: steps come up to "
            f"{step:.2g} us late or early, and a mode is missed by {error:.2g} mm/s"
        ),
    }
