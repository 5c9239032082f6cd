"""Synthesis of two channels, against the direct NumPy expression and a copy of the output; its error and memory.

Writes ``results/benchmarks/synthesis.json``. One BLAS thread; every time is the best of its repetitions, run in
rotation with its peers. The amplitudes are those of the exact law on the shipped rig, and random ones of every mode on
both channels, which do not occur on the shipped rig.
"""

import math
import sys
import tracemalloc
from typing import Any

import mpmath
import numpy as np
from bars import at_least, at_most, write
from peers import design, plain_synthesis, race, shipped_model
from threadpoolctl import threadpool_limits

from modaltouch.stimulus.drive import Steering
from modaltouch.stimulus.synthesis import BLOCK, synthesise

COPIES = {65_536: 8.0, 125_000: 4.0}


def exact_amplitudes() -> Any:
    """Return the amplitudes of the exact law on the shipped rig, (2, 9) array [V]."""
    stimulus = design(shipped_model())
    steering = Steering(stimulus.model, stimulus.system, stimulus.timing, stimulus.release, *stimulus.corrected_target)
    return np.tensordot(steering.solver.solve(steering.goal), steering.reach.row, axes=1)


def undying(exponent: Any) -> Any:
    """Return exponents of modes damped so lightly that no block is negligible."""
    return exponent.imag * 1j - 50.0


def speed(n_samples: int) -> dict[str, float]:
    """Return run times and ratios for N samples on each channel."""
    hold, s = 0.05 / n_samples, shipped_model().exponent
    out, other = np.zeros((2, n_samples)), np.ones((2, n_samples))
    ago = np.arange(n_samples - 1, -1, -1) * hold
    exact, rng = exact_amplitudes(), np.random.default_rng(1)
    dense = rng.normal(size=(2, 9)) + 1j * rng.normal(size=(2, 9))
    coarse, fine = rng.normal(size=(n_samples // BLOCK, 18)), rng.normal(size=(2, 18, BLOCK))
    product = np.empty((2, n_samples // BLOCK, BLOCK))
    row = race(
        {
            "plain_ms": lambda: plain_synthesis(exact, s, ago, other),
            "copy_ms": lambda: np.copyto(other, out),
            "bare_product_ms": lambda: np.matmul(coarse, fine, out=product),
            "exact_law_ms": lambda: synthesise(exact, s, hold, out),
            "every_mode_on_both_ms": lambda: synthesise(dense, s, hold, out),
            "no_block_dead_ms": lambda: synthesise(dense, undying(s), hold, out),
            "silent_ms": lambda: synthesise(dense * 0, s, hold, out),
        },
        seconds=6.0,
    )
    row["bare_product_in_copies"] = row["bare_product_ms"] / row["copy_ms"]
    for name in ("exact_law", "every_mode_on_both", "no_block_dead"):
        row[f"{name}_times_faster_than_plain"] = row["plain_ms"] / row[f"{name}_ms"]
        row[f"{name}_in_copies"] = row[f"{name}_ms"] / row["copy_ms"]
    return row


def reference(amplitude: Any, exponent: Any, hold: float, steps: Any) -> Any:
    """Return the sums some steps before the end in 60 digits, (n_channels, n_steps) array."""
    with mpmath.workdps(60):
        s = [mpmath.mpc(each.real, each.imag) * mpmath.mpf(hold) for each in exponent.tolist()]
        powers = [[mpmath.exp(each * int(step)) for each in s] for step in steps]
        rows = [[mpmath.mpc(a.real, a.imag) for a in channel] for channel in amplitude.tolist()]
        return np.array([[float(mpmath.re(mpmath.fdot(row, power))) for power in powers] for row in rows])


def errors() -> dict[str, float]:
    """Return the largest errors against mpmath: over the peak for Table I, in units of eps b t for long phases."""
    s, rng = shipped_model().exponent, np.random.default_rng(3)
    found: dict[str, float] = {}
    for n_samples in COPIES:
        hold, out = 0.05 / n_samples, np.empty((2, n_samples))
        some = np.unique(np.append(rng.integers(0, n_samples, 300), (0, n_samples - 1)))
        for name, amplitude in (
            ("exact_law", exact_amplitudes()),
            ("every_mode_on_both", rng.normal(size=(2, 9)) + 0j),
        ):
            synthesise(amplitude, s, hold, out)
            exact = reference(amplitude, s, hold, n_samples - 1 - some)
            found[f"{name}_{n_samples}"] = float(np.abs(out[:, some] - exact).max() / np.abs(out).max())
    n_samples, hold = 2**22, 10.0 / 2**22
    worst = 0.0
    for frequency in (229.0, 12_701.0, 87_855.0):
        b = 2 * math.pi * frequency
        light, one = np.array([complex(-1e-6 * b, b)]), np.ones((1, 1), dtype=complex)
        out = np.empty((1, n_samples))
        synthesise(one, light, hold, out)
        some = np.unique(rng.integers(0, n_samples - 1, 300))
        ago = n_samples - 1 - some
        error = np.abs(out[0, some] - reference(one, light, hold, ago)[0])
        worst = max(worst, float((error / (np.finfo(float).eps * np.maximum(b * hold * ago, 1.0))).max()))
    return {**found, "ten_seconds_over_eps_b_t": worst}


def memory() -> dict[int, int]:
    """Return the peak memory of a call in addition to its output, by samples [bytes]."""
    taken = {}
    for power in (14, 17, 20, 22):
        out, amplitude = np.empty((2, 2**power)), np.ones((2, 9), dtype=complex)
        synthesise(amplitude, undying(shipped_model().exponent), 4e-7, out)
        tracemalloc.start()
        synthesise(amplitude, undying(shipped_model().exponent), 4e-7, out)
        taken[2**power] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return taken


def main() -> int:
    """Run the benchmark and write its figures."""
    with threadpool_limits(1):
        rows = {n: speed(n) for n in (*COPIES, 131_072)}
        wrong, taken = errors(), memory()
    bars = []
    for n, copies in COPIES.items():
        for name, what in (("exact_law", "exact law"), ("every_mode_on_both", "every mode on both channels")):
            faster, in_copies = rows[n][f"{name}_times_faster_than_plain"], rows[n][f"{name}_in_copies"]
            bars.append(at_least(f"synthesis of 2 x {n}, {what}: speed relative to plain NumPy", faster, 40))
            # If a processor takes longer for the bare matrix product of this size, that is the bar.
            most = max(copies, rows[n]["bare_product_in_copies"])
            bars.append(at_most(f"synthesis of 2 x {n}, {what}: time relative to copying the output", in_copies, most))
    table_i = max(error for name, error in wrong.items() if name != "ten_seconds_over_eps_b_t")
    bars.append(at_most("synthesis, Table I: error relative to the peak, against mpmath", table_i, 1e-14, ""))
    long = wrong["ten_seconds_over_eps_b_t"]
    bars.append(at_most("synthesis over 10 s at damping ratio 1e-6: error in eps b t, against mpmath", long, 4, ""))
    growth = taken[2**22] / taken[2**17]
    bars.append(at_most("synthesis: memory for 2^22 samples, relative to 2^17", growth, 1.05))
    return write("synthesis", {"speed": rows, "error": wrong, "memory_bytes": taken}, bars)


if __name__ == "__main__":
    sys.exit(main())
