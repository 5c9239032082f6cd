"""What each thing that a scene does not need spares: with it beside without it, in turns.

Writes ``results/benchmarks/skips.json``. One BLAS thread, best of the repetitions.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from bars import at_least, write
from bench_synthesis import exact_amplitudes, undying
from peers import ZONES, design, milliseconds, race, shipped_model
from threadpoolctl import threadpool_limits

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.generator import Generator
from modaltouch.rig.simulator import Simulator
from modaltouch.stimulus.burst import Burst
from modaltouch.stimulus.sample_count import cheapest_samples
from modaltouch.stimulus.stimulus import Stimulus
from modaltouch.stimulus.synthesis import synthesise
from modaltouch.stimulus.timing import Timing
from modaltouch.stimulus.vibration import modal_history, peak_velocity, velocity_history

APPARATUS = Path(__file__).resolve().parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"
TOLERANCE = 1e-3
Work = Callable[[], object]


def synthesis_skips(stimulus: Stimulus) -> dict[str, tuple[Work, Work]]:
    """Return what synthesis leaves out: without and with the skip."""
    s, hold, out = stimulus.model.exponent, stimulus.timing.hold, np.zeros((2, stimulus.timing.n_samples))
    exact = exact_amplitudes()
    one = exact * [[1.0], [0.0]]
    return {
        "silent channels": (lambda: synthesise(exact, s, hold, out), lambda: synthesise(one, s, hold, out)),
        "dead blocks": (
            lambda: synthesise(exact, undying(s), hold, out),
            lambda: synthesise(exact, s, hold, out),
        ),
    }


def prediction_skips(stimulus: Stimulus) -> dict[str, tuple[Work, Work]]:
    """Return what predictions leave out: without and with the skip."""
    model, timing, voltage = stimulus.model, stimulus.timing, stimulus.voltage_played(0.2)
    along, levels = np.linspace(-0.05, 0.05, 41), cycle((0.1, 0.15))

    def anew() -> object:
        # A copy has computed nothing yet but its voltages.
        fresh = replace(stimulus)
        vars(fresh).update(drive=stimulus.drive, projection=stimulus.projection)
        return fresh.peak_velocity(ZONES, next(levels))

    return {
        "untouched positions: 41 points, or the two touched": (
            lambda: velocity_history(model, voltage, timing, along),
            lambda: velocity_history(model, voltage, timing, along[[5, 20]]),
        ),
        "histories where peaks are asked for": (
            lambda: np.abs(velocity_history(model, voltage, timing, [-0.04, 0.0])).max(axis=1),
            lambda: peak_velocity(model, voltage, timing, [-0.04, 0.0]),
        ),
        "histories where the state at t_F is asked for": (
            lambda: modal_history(model, voltage, timing)[:, 62_500],
            lambda: stimulus.system.states_by_channel(voltage, timing, 0.025),
        ),
        "levels that only scale": (anew, lambda: stimulus.peak_velocity(ZONES, next(levels))),
    }


def sample_skip(stimulus: Stimulus) -> tuple[str, tuple[Work, Work]]:
    """Return the cheapest count of samples for a tolerance, and designs with all and with as many."""
    economy = cheapest_samples(stimulus, TOLERANCE, ZONES)
    few = Timing(AFG3022B.converter, n_samples=economy.n_samples)
    work = (lambda: design(stimulus.model).burst, lambda: design(stimulus.model, timing=few).burst)
    return str(economy), work


def rotated(burst: Burst, n: int) -> list[Burst]:
    """Return records of the same size, all different."""
    records = []
    for shift in range(n):
        codes = burst.codes.copy()
        codes[:, 1:-1] = np.roll(codes[:, 1:-1], shift, axis=1)
        records.append(replace(burst, codes=codes))
    return records


def loads(bursts: list[Burst], rig: Generator) -> dict[str, float]:
    """Return how long the rig takes to load records that it does not hold, and one that it does [ms]."""
    other = cycle(bursts)
    new = milliseconds(lambda: rig.load(next(other)), 1.0, 8)
    rig.load(bursts[0])
    return {"without_ms": new, "with_ms": milliseconds(lambda: rig.load(bursts[0]), 1.0, 8)}


def main() -> int:
    """Run the benchmark and write its figures."""
    stimulus = design(shipped_model())
    stimulus.peak_velocity(ZONES, 0.2)
    said, samples = sample_skip(stimulus)
    works = {
        **synthesis_skips(stimulus),
        **prediction_skips(stimulus),
        f"samples beyond a tolerance of {TOLERANCE:g} on the field": samples,
    }
    rows: dict[str, dict[str, Any]] = {}
    with threadpool_limits(1):
        for name, (without, with_skip) in works.items():
            rows[name] = race({"without_ms": without, "with_ms": with_skip}, 1.5)
        apparatus = Apparatus.read(APPARATUS)
        with Simulator(apparatus) as simulator, Generator(simulator.address, apparatus) as rig:
            rows["records already in the instrument"] = loads(rotated(stimulus.burst, 12), rig)
    for row in rows.values():
        row["times_faster"] = row["without_ms"] / row["with_ms"]
    bars = [at_least(f"skipping {name}: faster", row["times_faster"], 1.1) for name, row in rows.items()]
    return write("skips", {"skips": rows, "cheapest_samples": said}, bars)


if __name__ == "__main__":
    sys.exit(main())
