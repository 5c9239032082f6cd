"""Run time against error of the stimulus engine, beside its peers, in one run on one BLAS thread.

Run as a script (``python tests/benchmarks/bench_stimulus.py``): writes ``stimulus.json`` and ``stimulus.svg``
under results/benchmarks/. Every time is the best of its repetitions, taken in turns with what it is compared with.
"""

import json
import math
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import control
import matplotlib as mpl
import numpy as np
import scipy
from scipy import signal
from threadpoolctl import threadpool_limits

from modaltouch.stimulus.design import Amplifier, ModalModel, Stimulus, Timing, Wish, design_stimulus
from modaltouch.stimulus.dynamics import modal_system
from modaltouch.stimulus.synthesis import synthesise
from modaltouch.stimulus.vibration import (
    modal_history,
    peak_velocity,
    states_by_channel,
    velocity_history,
)

RESULTS = Path(__file__).resolve().parents[2] / "results" / "benchmarks"
ZONES = (-0.04, -0.02, 0.0, 0.02, 0.04)
LEVELS = (0.08, 0.1, 0.15, 0.2)
_TURN = 0.01
NAMES: dict[int | str, str] = {
    10: "10 bits",
    12: "12 bits",
    14: "14 bits",
    "14 settled": "14 bits settled",
    "unrounded": "unrounded",
}
AMPLIFIER = Amplifier(gain=25.0, limit=250.0)
FREQUENCY = (229, 2553, 7137, 12701, 22810, 29390, 58303, 68543, 87855)
RATIO = (0.0437, 0.0165, 0.0265, 0.0168, 0.0112, 0.0166, 0.0101, 0.0176, 0.0147)
CENTRE = (114, 654, 0, 0, 0, -6285, -41448, 0, 0)
SIDE = (0, 0, 6500, -8346, 10414, 0, 0, -166030, 134615)


def shipped_model() -> ModalModel:
    """Return Table I on the centre and the side set."""
    gain = np.array([CENTRE, SIDE], dtype=float).T * 1e-3
    return ModalModel(tuple(range(1, 18, 2)), np.array(FREQUENCY, float), np.array(RATIO), gain, 0.1)


def many_modes(n_modes: int) -> ModalModel:
    """Return modes spread from 200 Hz to 90 kHz, every one on both channels."""
    rng = np.random.default_rng(n_modes)
    frequency, ratio = np.geomspace(200.0, 90e3, n_modes), rng.uniform(0.01, 0.03, n_modes)
    return ModalModel(tuple(range(1, n_modes + 1)), frequency, ratio, rng.normal(size=(n_modes, 2)), 0.1)


def race(works: dict[str, Callable[[], object]], seconds: float, least: int = 5) -> dict[str, float]:
    """Return the best time of each work [ms], run in turns so that all meet the same disturbances."""
    best = dict.fromkeys(works, math.inf)
    for work in works.values():
        work()
    start, rounds = time.perf_counter(), 0
    while rounds < least or time.perf_counter() - start < seconds:
        rounds += 1
        for who, work in works.items():
            # A few in a row: the first finds the caches as the one before left them.
            turn = time.perf_counter()
            for _ in range(10):
                before = time.perf_counter()
                work()
                best[who] = min(best[who], time.perf_counter() - before)
                if time.perf_counter() - turn > _TURN:
                    break
    return {who: value * 1e3 for who, value in best.items()}


def milliseconds(work: Callable[[], object], seconds: float = 0.4, least: int = 5) -> float:
    """Return the best time of some work, repeated for a while [ms]."""
    return race({"work": work}, seconds, least)["work"]


def plain_synthesis(amplitude: Any, exponent: Any, ago: Any, out: Any) -> None:
    """Write the sums by the straight vectorised expression."""
    envelope = np.exp(exponent.real[:, None] * ago)
    phase = exponent.imag[:, None] * ago
    np.matmul(amplitude.real, envelope * np.cos(phase), out=out)
    out -= amplitude.imag @ (envelope * np.sin(phase))


def state_space(model: ModalModel) -> tuple[Any, Any, Any, Any]:
    """Return (A, B, C, D) of the whole system in the states (w eta, eta'), read as eta'."""
    n = model.n_modes
    A, B, C = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2)), np.zeros((n, 2 * n))
    for k, (w, ratio) in enumerate(zip(model.angular_frequency, model.damping_ratio, strict=True)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0, w], [-w, -2 * ratio * w]]
        B[2 * k + 1] = model.modal_gain[k]
        C[k, 2 * k + 1] = 1
    return A, B, C, np.zeros((n, 2))


def nine_lfilters(model: ModalModel, voltage: Any, hold: float) -> Any:
    """Return the modal velocities by one second-order section to each mode."""
    s = model.exponent
    ratio, held = np.exp(s * hold), np.expm1(s * hold) / s * (1 - 1j * s.real / s.imag)
    force = model.modal_gain @ voltage
    velocity = np.empty_like(force)
    for k, (z, h) in enumerate(zip(ratio, held, strict=True)):
        numerator = [0.0, h.real, -(h * z.conjugate()).real]
        velocity[k] = signal.lfilter(numerator, [1.0, -2 * z.real, abs(z) ** 2], force[k])
    return velocity


def bench_synthesis(model: ModalModel, n_samples: int) -> dict[str, float]:
    """Return synthesis of two channels of N samples each beside the plain expression and a copy."""
    hold, s = 0.05 / n_samples, model.exponent
    out, other = np.zeros((2, n_samples)), np.ones((2, n_samples))
    ago = np.arange(n_samples - 1, -1, -1) * hold
    rng = np.random.default_rng(1)
    dense = rng.normal(size=(2, 9)) + 1j * rng.normal(size=(2, 9))
    sparse = dense * (model.modal_gain.T != 0)
    row = race(
        {
            "plain_ms": lambda: plain_synthesis(dense, s, ago, other),
            "copy_ms": lambda: np.copyto(other, out),
            "engine_ms": lambda: synthesise(dense, s, hold, out),
            "engine_silent_modes_skipped_ms": lambda: synthesise(sparse, s, hold, out),
            "engine_nothing_dead_ms": lambda: synthesise(dense, undying(model), hold, out),
            "engine_silent_ms": lambda: synthesise(dense * 0, s, hold, out),
        },
        seconds=4.0,
    )
    row["times_faster_than_plain"] = row["plain_ms"] / row["engine_ms"]
    row["times_a_copy"] = row["engine_ms"] / row["copy_ms"]
    return row


def undying(model: ModalModel) -> Any:
    """Return the exponents of modes so lightly damped that no block is dead."""
    return model.exponent.imag * 1j - 50.0


def bench_forward(model: ModalModel) -> dict[str, Any]:
    """Return the response of nine modes to 65,536 arbitrary samples beside its peers."""
    # A clock that holds every sample equally long, as the peers assume.
    timing = Timing(n_samples=65_536, clock_rate=65_536 * 20 * 190)
    voltage = np.random.default_rng(2).normal(size=(2, 65_536))
    system, hold = modal_system(model), timing.hold
    instants, inputs = np.arange(65_536) * hold, np.ascontiguousarray(voltage.T)
    whole = state_space(model)
    state_space_whole = control.ss(*whole)
    single = [ModalModel((k,), [f], [r], [g], 0.1) for k, f, r, g in _one_by_one(model)]
    quick: dict[str, Callable[[], object]] = {
        "engine_nine_modes_ms": lambda: modal_history(model, voltage, timing),
        "engine_two_zones_ms": lambda: velocity_history(model, voltage, timing, [-0.04, 0.0]),
        "engine_state_at_focus_ms": lambda: states_by_channel(system, voltage, timing, 0.025),
        "lfilter_nine_calls_ms": lambda: nine_lfilters(model, voltage, hold),
    }
    slow: dict[str, Callable[[], object]] = {
        "lsim_one_call_ms": lambda: signal.lsim(whole, inputs, instants, interp=False),
        "forced_response_one_call_ms": lambda: control.forced_response(state_space_whole, instants, voltage),
        "lsim_nine_calls_ms": lambda: [signal.lsim(state_space(m), inputs, instants, interp=False) for m in single],
        "forced_response_nine_calls_ms": lambda: [
            control.forced_response(control.ss(*state_space(m)), instants, voltage) for m in single
        ],
    }
    row = {**race(quick, 4.0), **race(slow, 4.0, 2)}
    for peer in ("lsim_one_call", "forced_response_one_call", "lfilter_nine_calls"):
        row[f"times_faster_than_{peer}"] = row[f"{peer}_ms"] / row["engine_nine_modes_ms"]
    return row


def _one_by_one(model: ModalModel) -> list[tuple[int, float, float, Any]]:
    return list(zip(model.label, model.natural_frequency, model.damping_ratio, model.modal_gain, strict=True))


def design(model: ModalModel, **options: Any) -> Stimulus:
    """Return the shipped stimulus but for the options."""
    timing = options.pop("timing", Timing())
    return design_stimulus(model, Wish(), timing, AMPLIFIER, levels=LEVELS, **options)


def preflight(model: ModalModel) -> None:
    """Do the physics of the paper's preflight: both laws, four levels, five zones, limits."""
    for law in ("exact", "paper"):
        stimulus = design(model, law=law)
        stimulus.fwhm, stimulus.reconstruction_error, stimulus.peak_voltage.max()  # noqa: B018
        for level in LEVELS:
            stimulus.worst_modal_error(level)
            stimulus.velocity_at_focus(ZONES, level)
            stimulus.peak_velocity(ZONES, level)


def bench_skips(model: ModalModel) -> dict[str, Any]:
    """Return what each thing left out spares."""
    stimulus = design(model)
    stimulus.peak_velocity(ZONES, 0.2)
    voltage, timing = stimulus.voltage_played(0.2), stimulus.timing
    half = Timing(n_samples=62_500)
    return {
        "history_at_41_points_ms": milliseconds(
            lambda: velocity_history(model, voltage, timing, np.linspace(-0.05, 0.05, 41))
        ),
        "history_at_the_two_touched_zones_ms": milliseconds(
            lambda: velocity_history(model, voltage, timing, [-0.04, 0.0])
        ),
        "peaks_at_the_two_touched_zones_ms": milliseconds(lambda: peak_velocity(model, voltage, timing, [-0.04, 0.0])),
        "peaks_at_another_level_ms": milliseconds(lambda: stimulus.peak_velocity(ZONES, 0.1)),
        "design_and_codes_125000_samples_ms": milliseconds(lambda: design(model).burst),
        "design_and_codes_62500_samples_ms": milliseconds(lambda: design(model, timing=half).burst),
        "recognise_a_record_already_loaded_ms": milliseconds(lambda: design_hash(stimulus)),
    }


def design_hash(stimulus: Stimulus) -> str:
    """Return the content hash by which the generator's record is recognised, computed anew."""
    return type(stimulus.burst).content_hash.func(stimulus.burst)


def modes_row(n_modes: int) -> dict[str, float]:
    """Return synthesis and forward response against the number of modes, each on both channels."""
    model, timing = many_modes(n_modes), Timing(n_samples=65_536)
    amplitude, s = np.ones((2, n_modes), dtype=complex), undying(model)
    out, voltage = np.empty((2, 65_536)), np.ones((2, 65_536))
    return {
        "synthesis_ms": milliseconds(lambda: synthesise(amplitude, s, timing.hold, out), 0.2, 3),
        "forward_ms": milliseconds(lambda: modal_history(model, voltage, timing), 0.2, 3),
    }


def samples_row(n_samples: int) -> dict[str, float]:
    """Return synthesis against the number of samples."""
    s, amplitude, out = undying(shipped_model()), np.ones((2, 9), complex), np.empty((2, n_samples))
    return {"synthesis_ms": milliseconds(lambda: synthesise(amplitude, s, 4e-7, out), 0.2, 3)}


def positions_row(n_positions: int) -> dict[str, float]:
    """Return the field at the focusing instant against the number of positions."""
    model, place = shipped_model(), np.linspace(-0.05, 0.05, n_positions)
    target = design(model).target
    return {"field_at_focus_ms": milliseconds(lambda: target @ model.shapes(place), 0.2, 3)}


def bench_scaling() -> dict[str, Any]:
    """Return run times against modes, samples and positions, with fitted exponents."""
    modes = {n: modes_row(n) for n in (6, 12, 25, 50, 100, 200)}
    samples = {2**power: samples_row(2**power) for power in range(10, 23, 2)}
    positions = {n: positions_row(n) for n in (1, 10, 100, 1000, 10_000, 100_000)}
    return {
        "modes": modes,
        "samples": samples,
        "positions": positions,
        "exponents": {
            "synthesis_against_modes": exponent_of(modes, "synthesis_ms"),
            "forward_against_modes": exponent_of(modes, "forward_ms"),
            "synthesis_against_samples": exponent_of(samples, "synthesis_ms"),
            "field_against_positions": exponent_of(positions, "field_at_focus_ms"),
        },
    }


def exponent_of(rows: dict[int, dict[str, float]], key: str) -> float:
    """Return the slope of log time against log size over the upper half of the sizes."""
    size = sorted(rows)[len(rows) // 2 :]
    return float(np.polyfit(np.log(size), np.log([rows[n][key] for n in size]), 1)[0])


def bench_pareto(model: ModalModel) -> list[dict[str, Any]]:
    """Return time and error at the focusing instant, samples x modes x bits x law, and the peers' predictions."""
    points = []
    for n_samples in (12_500, 25_000, 62_500, 125_000):
        for selection in (3, 6, 9):
            for law in ("exact", "paper"):
                for bits in NAMES:
                    if (law, bits) != ("paper", "14 settled"):
                        points.append(design_point(model, n_samples, selection, law, bits))
    for n_samples in (12_500, 62_500, 125_000):
        points += prediction_points(model, n_samples)
    return points


def design_point(model: ModalModel, n_samples: int, selection: int, law: Any, bits: int | str) -> dict[str, Any]:
    """Return time and error of making the voltages of a stimulus, or its codes."""
    timing, wish = Timing(n_samples=n_samples), Wish(selection=selection)
    rounding: Any = "settled" if bits == "14 settled" else "plain"

    def make() -> Stimulus:
        stimulus = design_stimulus(model, wish, timing, AMPLIFIER, law=law, rounding=rounding)
        stimulus.drive if bits == "unrounded" else stimulus.burst  # noqa: B018
        return stimulus

    error = make().drive.residual if bits == "unrounded" else rounded_error(make(), bits)
    return {
        "who": f"{law}, {NAMES[bits]}",
        "n_samples": n_samples,
        "n_selected": selection,
        "bits": bits,
        "time_ms": milliseconds(make, 0.05, 3),
        "error": error / 0.2,
    }


def rounded_error(stimulus: Stimulus, bits: int | str) -> float:
    """Return the worst modal error at the focus of codes of some bits [m/s]."""
    if bits in (14, "14 settled"):
        return stimulus.worst_modal_error(0.2)
    unit = stimulus.peak_voltage / (2 ** (int(bits) - 1) - 1)
    voltage = np.rint(stimulus.voltage / unit[:, None]) * unit[:, None]
    states = states_by_channel(stimulus.system, voltage, stimulus.timing, 0.025).sum(axis=0)
    reached, still = (stimulus.system.velocity @ states).real, (stimulus.system.displacement @ states).real
    return float(max(np.abs(reached - stimulus.target).max(), np.abs(still).max()))


def prediction_points(model: ModalModel, n_samples: int) -> list[dict[str, Any]]:
    """Return time and error of predicting the modal velocities at t_F from the voltages, by every means."""
    whole = state_space(model)
    state_space_whole = control.ss(*whole)
    timing = Timing(n_samples=n_samples)
    stimulus = design(model, timing=timing)
    system = stimulus.system
    n = stimulus.drive.n_before + 1
    voltage = np.ascontiguousarray(stimulus.voltage[:, :n])
    inputs, instants = np.ascontiguousarray(voltage.T), np.arange(n) * timing.hold

    def by_state() -> Any:
        return (system.velocity @ states_by_channel(system, voltage, timing, 0.025).sum(axis=0)).real

    def by_forced_response() -> Any:
        return control.forced_response(state_space_whole, instants, voltage).outputs[:, -1]

    means: dict[str, Callable[[], Any]] = {
        "engine, state alone": by_state,
        "engine, history": lambda: modal_history(model, voltage, timing)[:, -1],
        "lsim": lambda: signal.lsim(whole, inputs, instants, interp=False)[1][-1],
        "forced_response": by_forced_response,
        "lfilter": lambda: nine_lfilters(model, voltage, timing.hold)[:, -1],
        "plain numpy": lambda: plain_prediction(model, voltage[:, :-1], timing.hold),
    }
    return [
        {
            "who": who,
            "n_samples": n_samples,
            "error": float(np.abs(work() - stimulus.target).max()) / 0.2,
            "time_ms": milliseconds(work, 0.2, 3),
        }
        for who, work in means.items()
    ]


def plain_prediction(model: ModalModel, voltage: Any, hold: float) -> Any:
    """Return the modal velocities after the last sample by the plain convolution sum."""
    s = model.exponent
    powers = np.exp(s[:, None] * (hold * np.arange(voltage.shape[1] - 1, -1, -1)))
    state = ((model.modal_gain @ voltage) * powers).sum(axis=1) * np.expm1(s * hold) / s
    return ((1 - 1j * s.real / s.imag) * state).real


def front_of(points: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the points that no other beats in both time and error, by time."""
    front, best = [], math.inf
    for point in sorted(points, key=lambda p: (p["time_ms"], p["error"])):
        if point["error"] < best:
            front.append(point)
            best = point["error"]
    return front


def times_and_errors(points: list[dict[str, Any]]) -> tuple[list[float], list[float]]:
    """Return the times and the errors of points, an error of nothing shown as 1e-18."""
    return [p["time_ms"] for p in points], [max(p["error"], 1e-18) for p in points]


def draw(points: list[dict[str, Any]], path: Path) -> None:
    """Draw error against run time, one mark to each means, and the front of each task."""
    mpl.use("svg")
    mpl.rcParams["svg.hashsalt"] = "modaltouch"
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(11, 4.6), sharey=True, layout="constrained")
    titles = ("Making the voltages: what the beam misses at t_F", "Predicting the beam at t_F from voltages")
    for axis, title, making in zip(axes, titles, (True, False), strict=True):
        own = [p for p in points if ("bits" in p) == making]
        for who in dict.fromkeys(p["who"] for p in own):
            some = [p for p in own if p["who"] == who]
            axis.loglog(*times_and_errors(some), "o", label=who, ms=5)
        # Voltages before rounding are no design yet: no generator plays them.
        playable = [p for p in own if p.get("bits") != "unrounded"]
        axis.step(*times_and_errors(front_of(playable)), "k-", where="post", lw=0.8, label="best of both")
        axis.set(title=title, xlabel="run time [ms]")
        axis.grid(which="major", alpha=0.3)
        axis.legend(fontsize=8)
    axes[0].set_ylabel("worst error over the peak [1]")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def main() -> int:
    """Run the benchmark and write its figures."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    model = shipped_model()
    with threadpool_limits(1):
        results: dict[str, Any] = {
            "machine": {
                "processor": platform.processor() or platform.machine(),
                "cores": os.cpu_count(),
                "load_average_at_start": os.getloadavg()[0],
                "python": platform.python_version(),
                "numpy": np.__version__,
                "scipy": scipy.__version__,
                "control": control.__version__,
                "blas_threads": 1,
            },
            "synthesis": {n: bench_synthesis(model, n) for n in (65_536, 125_000, 131_072)},
            "forward": bench_forward(model),
            "preflight_ms": milliseconds(lambda: preflight(model), 1.0),
            "skips": bench_skips(model),
            "scaling": bench_scaling(),
            "pareto": bench_pareto(model),
        }
    results["machine"]["load_average_at_end"] = os.getloadavg()[0]
    (RESULTS / "stimulus.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    draw(results["pareto"], RESULTS / "stimulus.svg")
    summary = {k: results[k] for k in ("synthesis", "forward", "preflight_ms", "skips")}
    summary["exponents"] = results["scaling"]["exponents"]
    print(json.dumps(summary, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
