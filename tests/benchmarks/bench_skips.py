"""Time saved by omitting each unnecessary computation: run with and without it in rotation; results must not change.

Writes ``results/benchmarks/skips.json``. One BLAS thread, best of the repetitions. Both must give the same
result except for the last digits; fewer samples are chosen by the change that they cause, for which there is no bar.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from bars import at_least, at_most, write
from bench_synthesis import exact_amplitudes
from peers import ZONES, design, milliseconds, modal_history, peak_velocity, race, shipped_model, velocity_history
from threadpoolctl import threadpool_limits

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.generator import Generator
from modaltouch.rig.simulator import Simulator
from modaltouch.stimulus import synthesis
from modaltouch.stimulus.burst import Burst, Timing
from modaltouch.stimulus.stimulus import Stimulus
from modaltouch.stimulus.synthesis import synthesise
from modaltouch.stimulus.tolerances import SampleCount, cheapest_samples

APPARATUS = Path(__file__).resolve().parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"
TOLERANCE = 1e-3
Work = Callable[[], object]


def synthesis_skips(stimulus: Stimulus) -> dict[str, tuple[Work, Work]]:
    """Return what synthesis omits, as pairs without and with the skip."""
    s, hold = stimulus.model.exponent, stimulus.timing.hold
    exact, out = exact_amplitudes(), np.zeros((2, stimulus.timing.n_samples))
    one = exact * [[1.0], [0.0]]

    def samples(amplitude: Any, channels: slice) -> Any:
        synthesise(amplitude, s, hold, out)
        return out[channels]

    def without_dead_blocks() -> Any:
        with patch.object(synthesis, "_DEAD", 0.0):
            return samples(exact, slice(2))

    return {
        "silent channels": (lambda: samples(exact, slice(1)), lambda: samples(one, slice(1))),
        "dead blocks": (without_dead_blocks, lambda: samples(exact, slice(2))),
    }


def prediction_skips(stimulus: Stimulus) -> dict[str, tuple[Work, Work]]:
    """Return what predictions omit, as pairs without and with the skip."""
    model, timing, voltage = stimulus.model, stimulus.timing, stimulus.voltage_played(0.2)
    along, drive, projection = np.linspace(-0.05, 0.05, 41), stimulus.drive, stimulus.projection

    def anew() -> object:
        # A copy has only computed its voltages so far.
        fresh = replace(stimulus)
        vars(fresh).update(drive=drive, projection=projection)
        return fresh.peak_velocity(ZONES, 0.15)

    return {
        "untouched positions: 41 points, or the two touched": (
            lambda: velocity_history(model, voltage, timing, along)[[5, 20]],
            lambda: velocity_history(model, voltage, timing, along[[5, 20]]),
        ),
        "histories where peaks are asked for": (
            lambda: np.abs(velocity_history(model, voltage, timing, [-0.04, 0.0])).max(axis=1),
            lambda: peak_velocity(model, voltage, timing, [-0.04, 0.0]),
        ),
        "histories where the state at t_F is asked for": (
            lambda: modal_history(model, voltage, timing)[:, 62_500],
            lambda: (stimulus.system.velocity @ stimulus.system.states_by_channel(voltage, timing, 0.025).sum(0)).real,
        ),
        "levels that only scale": (anew, lambda: stimulus.peak_velocity(ZONES, 0.15)),
    }


def sample_skip(stimulus: Stimulus) -> tuple[SampleCount, tuple[Work, Work]]:
    """Return the cheapest number of samples for a tolerance, and designs with all and with that number."""
    economy = cheapest_samples(stimulus, TOLERANCE, ZONES)
    few = Timing(AFG3022B.converter, n_samples=economy.n_samples)
    return economy, (lambda: design(stimulus.model).burst, lambda: design(stimulus.model, timing=few).burst)


def rotated(burst: Burst, n: int) -> list[Burst]:
    """Return records of the same size, all different."""
    records = []
    for shift in range(n):
        codes = burst.codes.copy()
        codes[:, 1:-1] = np.roll(codes[:, 1:-1], shift, axis=1)
        records.append(replace(burst, codes=codes))
    return records


def loads(bursts: list[Burst], rig: Generator, simulator: Simulator) -> dict[str, float]:
    """Return how long the rig takes to load records that are not in its memories, and one that is [ms]."""
    other = cycle(bursts)
    new = milliseconds(lambda: rig.load(next(other)), 1.0, 8)
    rig.load(bursts[0])
    held = milliseconds(lambda: rig.load(bursts[0]), 1.0, 8)
    names = [channel.function for channel in simulator.afg.channels.values()]
    selected = [np.frombuffer(simulator.afg.user[int(name.removeprefix("USER"))], ">u2") for name in names]
    return {"without_ms": new, "with_ms": held, "difference": difference(bursts[0].codes, np.array(selected))}


def difference(without: Any, with_skip: Any) -> float:
    """Return the largest difference of two results, over the largest value [1]."""
    return float(np.abs(np.subtract(with_skip, without, dtype=float)).max() / np.abs(without).max())


def main() -> int:
    """Run the benchmark and write its figures."""
    stimulus = design(shipped_model())
    stimulus.peak_velocity(ZONES, 0.2)
    economy, fewer = sample_skip(stimulus)
    works = {**synthesis_skips(stimulus), **prediction_skips(stimulus)}
    few = f"samples beyond a tolerance of {TOLERANCE:g} on the field"
    rows: dict[str, dict[str, Any]] = {}
    with threadpool_limits(1):
        for name, (without, with_skip) in works.items():
            rows[name] = race({"without_ms": without, "with_ms": with_skip}, 1.5)
            rows[name]["difference"] = difference(np.array(without()), np.array(with_skip()))
        rows[few] = {**race(dict(zip(("without_ms", "with_ms"), fewer, strict=True)), 1.5), "difference": economy.error}
        apparatus = Apparatus.read(APPARATUS)
        with Simulator(apparatus) as simulator, Generator(simulator.address, apparatus) as rig:
            rows["records already in the instrument"] = loads(rotated(stimulus.burst, 12), rig, simulator)
    bars = []
    for name, row in rows.items():
        row["times_faster"] = row["without_ms"] / row["with_ms"]
        bars.append(at_least(f"skipping {name}: speed-up", row["times_faster"], 1.1))
        if name != few:
            bars.append(at_most(f"skipping {name}: change of the result", row["difference"], 1e-12, ""))
    return write("skips", {"skips": rows, "cheapest_samples": str(economy)}, bars)


if __name__ == "__main__":
    sys.exit(main())
