"""Run time against error at the focusing instant: samples x modes x bits x law, this engine and its peers.

Writes ``results/benchmarks/tradeoff.json`` and ``time_against_error.png``. One BLAS thread, best of the repetitions,
run in rotation. An error is the largest of any modelled mode over the target peak: for making a stimulus that of
velocity and displacement (as w eta) from their targets, for predicting one that of velocity from 80-bit steps of the
same voltages. For whole commands it is the change that `check --tolerance` bounds: the largest of the field at the
zones within 1 ms of the focusing instant, here from the field of 500,000 samples.
"""

import math
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import numpy as np
from bars import at_most, write
from bench_commands import run, written_with
from peers import (
    design,
    eighty_bits,
    forced_response,
    lsim,
    modal_history,
    nine_lfilters,
    plain_prediction,
    race,
    shipped_model,
    state_space,
)
from threadpoolctl import threadpool_limits
from tradeoff_figure import draw

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.stimulus import Stimulus
from modaltouch.stimulus.target_field import TargetField
from modaltouch.stimulus.tolerances import cheapest_samples

SAMPLES = (12_500, 25_000, 62_500, 125_000)
MODES = (3, 6, 9)
BITS = ("10 bits", "12 bits", "14 bits", "14 bits, settled", "before rounding")
PEAK = 0.2
ZONES = (-0.04, -0.02, 0.0, 0.02, 0.04)
FINEST = 500_000
"""More samples than any supported generator plays: the reference for the field of whole commands."""

Point = dict[str, Any]


def made(model: ModalModel, n_samples: int, n_modes: int, law: str, bits: str) -> Stimulus:
    """Return a stimulus of which only the design has been computed."""
    rounding = "settled" if bits == "14 bits, settled" else "plain"
    timing, target_field = Timing(AFG3022B.converter, n_samples=n_samples), TargetField(selection=n_modes)
    return design(model, timing=timing, target_field=target_field, law=law, rounding=rounding)


def finish(stimulus: Stimulus, bits: str) -> Any:
    """Compute the voltages of a stimulus, rounded to a number of bits; return those of 10 and 12 bits."""
    if bits == "before rounding":
        return stimulus.drive
    if bits.startswith("14"):
        return stimulus.burst
    # Coarser codes than the generator's, at full scale.
    unit = stimulus.peak_voltage / (2 ** (int(bits[:2]) - 1) - 1)
    return np.rint(stimulus.voltage / unit[:, None]) * unit[:, None]


def making_error(stimulus: Stimulus, bits: str) -> float:
    """Return the largest modal error at the focusing instant over the peak [1]."""
    if bits.startswith("14"):
        return stimulus.worst_modal_error(PEAK) / PEAK
    voltage = stimulus.voltage if bits == "before rounding" else finish(stimulus, bits)
    state = stimulus.system.states_by_channel(voltage, stimulus.timing, 0.025).sum(axis=0)
    velocity, displacement = (stimulus.system.velocity @ state).real, (stimulus.system.displacement @ state).real
    return float(max(np.abs(velocity - stimulus.target).max(), np.abs(displacement).max())) / PEAK


def making(model: ModalModel) -> list[Point]:
    """Return time and error of computing the voltages of a stimulus, or its codes."""
    cases = [
        (n_samples, n_modes, law, bits)
        for n_samples in SAMPLES
        for n_modes in MODES
        for law in ("exact", "paper")
        for bits in BITS
        if (law, bits) != ("paper", "14 bits, settled")
    ]
    times = race({str(case): lambda case=case: finish(made(model, *case), case[3]) for case in cases}, 25.0, 3)
    return [
        {
            "task": "making",
            "n_samples": case[0],
            "n_modes": case[1],
            "law": case[2],
            "bits": case[3],
            "time_ms": times[str(case)],
            "error": making_error(made(model, *case), case[3]),
        }
        for case in cases
    ]


def predicting(model: ModalModel, n_samples: int) -> list[Point]:
    """Return time and error of predicting the modal velocities at t_F from the voltages, by every method."""
    timing, whole = Timing(AFG3022B.converter, n_samples=n_samples), state_space(model)
    whole_system, stimulus = control.ss(*whole), design(model, timing=timing)
    system, hold = stimulus.system, timing.hold
    # One more sample, whose start is the focusing instant: histories are read there.
    voltage = np.ascontiguousarray(stimulus.voltage[:, : stimulus.drive.n_before + 1])
    quick: dict[str, Callable[[], Any]] = {
        "engine, state at t_F": lambda: (
            (system.velocity @ system.states_by_channel(voltage, timing, 0.025).sum(axis=0)).real
        ),
        "engine, whole history": lambda: modal_history(model, voltage, timing)[:, -1],
        "plain NumPy": lambda: plain_prediction(model, voltage[:, :-1], hold),
        "lfilter, nine calls": lambda: nine_lfilters(model, voltage, hold)[:, -1],
    }
    slow: dict[str, Callable[[], Any]] = {
        "lsim, one call": lambda: lsim([whole], voltage, hold)[:, -1],
        "forced_response, one call": lambda: forced_response([whole_system], voltage, hold)[:, -1],
    }
    times, exact = {**race(quick, 1.5), **race(slow, 1.5, 2)}, eighty_bits(model, voltage, hold)[:, -1]
    return [
        {
            "task": "predicting",
            "who": who,
            "n_samples": n_samples,
            "n_modes": model.n_modes,
            "time_ms": times[who],
            "error": float(np.abs(work() - exact).max()) / PEAK,
        }
        for who, work in {**quick, **slow}.items()
    ]


def commands(model: ModalModel) -> list[Point]:
    """Return processor time and error of whole commands with fewer samples: what `check --tolerance` can save."""
    converter = replace(AFG3022B.converter, max_points=FINEST)
    finest = design(model, timing=Timing(converter, n_samples=FINEST))
    errors = dict(cheapest_samples(finest, 1e-12, ZONES).tried)
    best: dict[tuple[str, int], float] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for turn in range(5):
            for n_samples in SAMPLES:
                protocol = written_with(Path(scratch), f"n_samples: {SAMPLES[-1]}", f"n_samples: {n_samples}")
                study = f"{scratch}/{n_samples}/{turn}"
                for who, arguments in {
                    "check": ["check", protocol],
                    "simulate": ["simulate", protocol, "-n", "1", "--results", study],
                    "verify": ["verify", study],
                }.items():
                    took = run(["-m", "modaltouch", *arguments])[0]
                    best[who, n_samples] = min(best.get((who, n_samples), math.inf), took)
    return [
        {"task": "command", "who": who, "n_samples": n, "time_ms": took * 1e3, "error": errors[n]}
        for (who, n), took in best.items()
    ]


def main() -> int:
    """Run the benchmark, write its figures and draw them."""
    model = shipped_model()
    with threadpool_limits(1):
        points = making(model)
        for n_samples in SAMPLES:
            points += predicting(model, n_samples)
    points += commands(model)
    draw(points)

    def worst(task: str, **like: Any) -> float:
        some = [each for each in points if each["task"] == task and like.items() <= each.items()]
        return max(each["error"] for each in some)

    bars = [
        at_most(
            "exact law before rounding: error relative to the peak",
            worst("making", law="exact", bits=BITS[4]),
            1e-13,
            "",
        ),
        at_most(
            "exact law, settled codes: error relative to the peak", worst("making", law="exact", bits=BITS[3]), 1e-6, ""
        ),
        at_most("state at t_F: error relative to the peak", worst("predicting", who="engine, state at t_F"), 1e-14, ""),
    ]
    return write("tradeoff", {"points": points}, bars)


if __name__ == "__main__":
    sys.exit(main())
