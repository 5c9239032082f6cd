"""Cost of the kernels against size: modes 6 to 200, samples 2^10 to 2^22, positions 1 to 10^5; and memory.

Writes ``results/benchmarks/sizes.json``. One BLAS thread, best of the repetitions. Exponents are slopes of log time
against log size over the upper half of the sizes. Memory is that of a call in addition to its result.
"""

import sys
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
from bars import at_most, write
from bench_synthesis import undying
from peers import design, many_modes, milliseconds, modal_history, peak_velocity, shipped_model
from threadpoolctl import threadpool_limits

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import DiagonalSystem, moments
from modaltouch.stimulus.synthesis import synthesise
from modaltouch.stimulus.vibration import BlockKernel

MODES = (6, 12, 25, 50, 100, 200)
SAMPLES = tuple(2**power for power in range(10, 23, 2))
POSITIONS = (1, 10, 100, 1000, 10_000, 100_000)
PLACES = (1, 10, 100, 1000, 10_000)
HOLD = 4e-7
Works = dict[str, Callable[[], object]]


def mode_works(n_modes: int) -> Works:
    """Return the tasks for a number of modes, each on both channels."""
    model, timing = many_modes(n_modes), Timing(AFG3022B.converter, n_samples=65_536)
    amplitude, s = np.ones((2, n_modes), dtype=complex), undying(model.exponent)
    out, voltage = np.empty((2, 65_536)), np.ones((2, 65_536))
    return {
        "synthesis": lambda: synthesise(amplitude, s, timing.hold, out),
        "response": lambda: modal_history(model, voltage, timing),
        "state": lambda: moments(voltage, model.exponent, timing.hold),
    }


def sample_works(n_samples: int) -> Works:
    """Return the tasks for a number of samples, of nine modes on two channels."""
    model = shipped_model()
    s, amplitude, out = undying(model.exponent), np.ones((2, 9), dtype=complex), np.ones((2, n_samples))
    zones = model.shapes([-0.04, 0.0]).T @ DiagonalSystem.of(model).velocity
    voltage, velocity = np.ones((2, n_samples)), np.ones((2, n_samples))

    def respond() -> None:
        BlockKernel.of(DiagonalSystem.of(model), zones, HOLD).write(
            lambda start, stop: voltage[:, start:stop], velocity
        )

    return {
        "synthesis": lambda: synthesise(amplitude, s, HOLD, out),
        "response_at_two_zones": respond,
        "state": lambda: moments(voltage, model.exponent, HOLD),
    }


def field_works(n_positions: int) -> Works:
    """Return the tasks for a field at a number of positions."""
    stimulus, place = design(shipped_model()), np.linspace(-0.05, 0.05, n_positions)
    return {"field_at_focus": lambda: stimulus.model.field(stimulus.target, place)}


def peak_works(n_places: int) -> Works:
    """Return the tasks for the peaks of a whole burst at a number of places."""
    stimulus, place = design(shipped_model()), np.linspace(-0.05, 0.05, n_places)
    voltage = stimulus.voltage_played(0.2)
    return {"peaks": lambda: peak_velocity(stimulus.model, voltage, stimulus.timing, place)}


def sweep(sizes: tuple[int, ...], works: Callable[[int], Works]) -> dict[int, dict[str, float]]:
    """Return the run time of every task at every size [ms]."""
    return {n: {f"{k}_ms": milliseconds(work, 0.15, 1) for k, work in works(n).items()} for n in sizes}


def exponents(rows: dict[int, dict[str, float]]) -> dict[str, float]:
    """Return the slope of log time against log size over the upper half of the sizes."""
    size = sorted(rows)[len(rows) // 2 :]
    return {
        key.removesuffix("_ms"): float(np.polyfit(np.log(size), np.log([rows[n][key] for n in size]), 1)[0])
        for key in rows[size[0]]
    }


def memory(works: Callable[[int], Works], sizes: tuple[int, int], result: int) -> dict[str, list[float]]:
    """Return the peak memory beyond results of a given number of bytes per element, at two sizes [bytes]."""
    taken: dict[str, list[float]] = {}
    for size in sizes:
        for name, work in works(size).items():
            tracemalloc.start()
            work()
            taken.setdefault(name, []).append(tracemalloc.get_traced_memory()[1] - result * size)
            tracemalloc.stop()
    return taken


def main() -> int:
    """Run the benchmark and write its figures."""
    with threadpool_limits(1):
        rows = {
            "modes": sweep(MODES, mode_works),
            "samples": sweep(SAMPLES, sample_works),
            "positions": sweep(POSITIONS, field_works),
            "places": sweep(PLACES, peak_works),
        }
        taken = {
            "samples": memory(sample_works, (2**17, 2**22), 0),
            "positions": memory(field_works, (10_000, 100_000), 8),
            "places": memory(peak_works, (1000, 10_000), 8),
        }
    fitted = {what: exponents(each) for what, each in rows.items()}
    bars: list[dict[str, Any]] = []
    for what, each in fitted.items():
        print("  " + ", ".join(f"{name} grows with {what}^{value:.2f}" for name, value in each.items()))
    for name, (small, large) in taken["samples"].items():
        bars.append(at_most(f"{name}: memory for 2^22 samples, relative to 2^17", large / small, 1.05))
    (small, large) = taken["positions"]["field_at_focus"]
    bars.append(at_most("field_at_focus: memory for 1e5 positions, relative to 1e4", large / small, 1.05))
    peaks = taken["places"]["peaks"][1] / 1e6
    bars.append(at_most("peaks of a burst: memory for 1e4 positions", peaks, 20, "MB"))
    return write("sizes", {"run_time": rows, "exponents": fitted, "memory_bytes": taken}, bars)


if __name__ == "__main__":
    sys.exit(main())
