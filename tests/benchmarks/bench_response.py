"""Forward response: nine modes with 65,536 arbitrary samples, against lsim, forced_response and lfilter; and errors.

Writes ``results/benchmarks/response.json``. One BLAS thread; times are the best of their repetitions, run in rotation.
Errors are those of each mode over its own peak, against one-poles stepped in 80-bit numbers.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import control
import numpy as np
from bars import at_least, at_most, write
from peers import (
    compiled_recursion,
    eighty_bits,
    forced_response,
    lsim,
    modal_history,
    nine_lfilters,
    one_by_one,
    peak_velocity,
    race,
    shipped_model,
    state_space,
    velocity_history,
)
from threadpoolctl import threadpool_limits

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.modes import ModalModel

N_SAMPLES = 65_536
TIMING = Timing(replace(AFG3022B.converter, clock_rate=N_SAMPLES * 20 * 190), n_samples=N_SAMPLES)
"""A clock with equal durations of all samples, as the peers assume."""


def speed(model: ModalModel, voltage: Any) -> dict[str, float]:
    """Return run times and ratios."""
    hold, system = TIMING.hold, DiagonalSystem.of(model)
    compiled, zones = compiled_recursion(model, hold), [-0.04, -0.02, 0.0, 0.02, 0.04]
    whole, single = state_space(model), [state_space(each) for each in one_by_one(model)]
    whole_system, single_systems = control.ss(*whole), [control.ss(*each) for each in single]
    quick: dict[str, Callable[[], object]] = {
        "nine_modes_ms": lambda: modal_history(model, voltage, TIMING),
        "two_zones_ms": lambda: velocity_history(model, voltage, TIMING, [-0.04, 0.0]),
        "state_at_focus_ms": lambda: system.states_by_channel(voltage, TIMING, 0.025),
        "five_zones_ms": lambda: velocity_history(model, voltage, TIMING, zones),
        "peaks_of_five_zones_ms": lambda: peak_velocity(model, voltage, replace(TIMING, at_samples=True), zones),
        "peaks_between_samples_ms": lambda: peak_velocity(model, voltage, TIMING, zones),
        "numba_ms": lambda: compiled(voltage),
        "nine_lfilters_ms": lambda: nine_lfilters(model, voltage, hold),
    }
    slow: dict[str, Callable[[], object]] = {
        "lsim_ms": lambda: lsim([whole], voltage, hold),
        "forced_response_ms": lambda: forced_response([whole_system], voltage, hold),
    }
    slowest: dict[str, Callable[[], object]] = {
        "nine_lsims_ms": lambda: lsim(single, voltage, hold),
        "nine_forced_responses_ms": lambda: forced_response(single_systems, voltage, hold),
    }
    row = {**race(quick, 6.0), **race(slow, 6.0, 3), **race(slowest, 1.0, 2)}
    for peer in ("lsim", "forced_response", "nine_lfilters", "nine_lsims", "nine_forced_responses", "numba"):
        row[f"times_faster_than_{peer}"] = row[f"{peer}_ms"] / row["nine_modes_ms"]
    return row


def errors(model: ModalModel, voltage: Any) -> dict[str, float]:
    """Return the largest error of any mode over its own peak, for the engine and its peers."""
    exact, hold = eighty_bits(model, voltage, TIMING.hold), TIMING.hold
    peak = np.abs(exact).max(axis=1, keepdims=True)
    found = {
        "engine": modal_history(model, voltage, TIMING),
        "numba": compiled_recursion(model, hold)(voltage),
        "lsim": lsim([state_space(model)], voltage, hold),
        "nine_lfilters": nine_lfilters(model, voltage, hold),
    }
    return {who: float((np.abs(each - exact) / peak).max()) for who, each in found.items()}


def main() -> int:
    """Run the benchmark and write its figures."""
    model, voltage = shipped_model(), np.random.default_rng(2).normal(size=(2, N_SAMPLES))
    light = replace(model, damping_ratio=np.full(9, 1e-6))
    with threadpool_limits(1):
        row = speed(model, voltage)
        wrong = {"table_i": errors(model, voltage), "damping_1e-6": errors(light, voltage)}
    what = f"response of nine modes to {N_SAMPLES} samples"
    bars = [
        at_least(f"{what}: speed relative to one lsim call", row["times_faster_than_lsim"], 40),
        at_least(f"{what}: speed relative to one forced_response call", row["times_faster_than_forced_response"], 60),
        at_least(f"{what}: speed relative to nine lfilter calls", row["times_faster_than_nine_lfilters"], 1),
        at_least(f"{what}: speed relative to a recursion compiled by numba", row["times_faster_than_numba"], 0.8),
        at_most(
            f"{what}: time of the state at t_F alone, relative to all",
            row["state_at_focus_ms"] / row["nine_modes_ms"],
            0.5,
        ),
        at_most(f"{what}: time of two zones alone, relative to all", row["two_zones_ms"] / row["nine_modes_ms"], 0.9),
        at_most(
            f"{what}: time of the peaks of five zones at the samples, relative to their histories",
            row["peaks_of_five_zones_ms"] / row["five_zones_ms"],
            1.0,
        ),
        at_most(f"{what}, Table I: error relative to the peak of each mode", wrong["table_i"]["engine"], 1e-12, ""),
        at_most(
            f"{what}, damping ratio 1e-6: error relative to the peak of each mode",
            wrong["damping_1e-6"]["engine"],
            1e-11,
            "",
        ),
    ]
    return write("response", {"speed": row, "error_over_own_peak": wrong}, bars)


if __name__ == "__main__":
    sys.exit(main())
