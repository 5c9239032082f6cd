"""Designs for the beam with fingers: error of the level, voltage, numerical error and cost.

Writes ``results/benchmarks/fingers.json`` and ``fingers.png``. Forty placements of two fingers, drawn from the wide
range of the literature, on each of three pairs of zones; the beam has even modes and cross gains that its table lacks,
and its values are off by 0.1 % in frequency, 2 % in damping and 2 % in gain. Each design is judged on that beam.
"""

import sys
from dataclasses import replace
from typing import Any

import numpy as np
from bars import RESULTS, at_most, write
from peers import race
from threadpoolctl import threadpool_limits

from modaltouch.preflight import examine
from modaltouch.protocol import Apparatus, Source
from modaltouch.stimulus import Finger, ModalModel, Stimulus
from modaltouch.stimulus.fingers import CoupledModes

PAIRS = {"A-C": (-0.04, 0.0), "B-D": (-0.02, 0.02), "C-E": (0.0, 0.04)}
N_DRAWS, LEVEL, LIMIT = 40, 0.2, 250.0
TYPICAL = (0.08e-3, 0.5, 500.0)
CRITICAL = 0.15e-3
"""Mass of the finger whose damping is made critical [kg]."""


def whole_table(apparatus: Apparatus) -> ModalModel:
    """Return the table of modes with its even ones and cross gains, as `identify --modes all` finds it on the twin."""
    table, twin = apparatus.modal_model(), apparatus.twin
    unlisted = [mode for mode in twin.unlisted_modes if mode.family == "bending"]
    further = np.zeros((len(unlisted), table.n_channels))
    for row, mode in zip(further, unlisted, strict=True):
        for name, gain in mode.gain_mm_s2_per_V.items():
            row[apparatus.actuator_sets[name].channel - 1] = gain * 1e-3
    strongest = np.take_along_axis(table.modal_gain, np.abs(table.modal_gain).argmax(axis=1)[:, None], axis=1)
    gain = np.concatenate([np.where(table.modal_gain == 0, twin.cross_gain * strongest, table.modal_gain), further])
    label = np.append(table.label, [mode.label for mode in unlisted])
    order = np.argsort(label)
    return replace(
        table,
        label=tuple(label[order].tolist()),
        natural_frequency=np.append(table.natural_frequency, [m.natural_frequency_Hz for m in unlisted])[order],
        damping_ratio=np.append(table.damping_ratio, [m.damping_ratio for m in unlisted])[order],
        modal_gain=gain[order],
    )


def true_beam(table: ModalModel, rng: np.random.Generator) -> ModalModel:
    """Return a beam whose values deviate from those of the table."""
    off = np.exp(rng.standard_normal((4, table.n_modes)) * np.array([[1e-3], [0.02], [0.02], [0.02]]))
    return replace(
        table,
        natural_frequency=table.natural_frequency * off[0],
        damping_ratio=table.damping_ratio * off[1],
        modal_gain=table.modal_gain * off[2:].T,
    )


def draw_fingers(pair: tuple[float, float], rng: np.random.Generator) -> tuple[Finger, ...]:
    """Return two fingers that are alike within 20 %, displaced by 2 mm."""
    mass, damping = np.exp(rng.uniform(np.log([2e-5, 0.1]), np.log([3e-4, 2.0])))
    base = np.array([mass, damping, rng.uniform(0.0, 2000.0)])
    return tuple(
        Finger(place + 2e-3 * rng.standard_normal(), *(base * np.exp(0.2 * rng.standard_normal(3)))) for place in pair
    )


def design(stimulus: Stimulus, model: ModalModel, fingers: tuple[Finger, ...], **how: Any) -> Stimulus:
    """Return the stimulus designed for fingers on a beam."""
    return replace(stimulus, model=model.touched(fingers), **how)


def judge(designed: Stimulus, beam: ModalModel, fingers: tuple[Finger, ...]) -> dict[str, float]:
    """Return the results of a design on the true beam with fingers, over the level, and its voltage [V]."""
    played = replace(designed.touched(()), model=beam.touched(fingers))
    unit, target = designed.volts_per_code(LEVEL), designed.projection.field(np.array([-0.04, -0.02, 0, 0.02, 0.04]))
    reached = played.velocity_at_focus([-0.04, -0.02, 0.0, 0.02, 0.04], unit)
    return {
        "at_C": float(reached[2]) / LEVEL,
        "worst_zone": float(np.abs(reached - target).max()) / LEVEL,
        "peak_V": float(designed.peak_voltage.max()),
    }


def summary(rows: list[dict[str, float]]) -> dict[str, float]:
    """Return the summary of forty placements, in per cent of the level."""
    level, zones, volts = (np.array([row[key] for row in rows]) for key in ("at_C", "worst_zone", "peak_V"))
    return {
        "level_mean_percent": 100 * level.mean(),
        "level_sd_percent": 100 * level.std(ddof=1),
        "level_missed_p95_percent": 100 * float(np.quantile(np.abs(level - 1), 0.95)),
        "worst_zone_median_percent": 100 * float(np.median(zones)),
        "peak_median_V": float(np.median(volts)),
        "peak_p95_V": float(np.quantile(volts, 0.95)),
        "attainable_median_mm_s": 1e3 * LEVEL * float(np.median(np.minimum(level, level * LIMIT / volts))),
    }


def placements(stimulus: Stimulus, apparatus: Apparatus) -> dict[str, dict[str, list[dict[str, float]]]]:
    """Return the results of each design in each of forty placements, by pair."""
    found: dict[str, dict[str, list[dict[str, float]]]] = {}
    table, complete = apparatus.modal_model(), whole_table(apparatus)
    for pair, places in PAIRS.items():
        rng = np.random.default_rng(16)
        typical = tuple(Finger(place, *TYPICAL) for place in places)
        blind = {
            "free": stimulus,
            "typical": design(stimulus, complete, typical),
            "typical, listed modes alone": design(stimulus, table, typical),
        }
        rows: dict[str, list[dict[str, float]]] = {}
        for _ in range(N_DRAWS):
            beam, fingers = true_beam(complete, rng), draw_fingers(places, rng)
            # For a known beam all its modes enter the design, including even ones.
            known = {
                "known": design(stimulus, beam, fingers),
                "known, level first": design(stimulus, beam, fingers, priority="level"),
            }
            for name, each in {**blind, **known}.items():
                rows.setdefault(name, []).append(judge(each, beam, fingers))
        found[pair] = rows
    return found


def critical_damping(table: ModalModel) -> float:
    """Return the damping of two fingers, on A and C, at which a pair of exponents coincides [N s/m]."""

    def n_real(damping: float) -> int:
        model = table.touched(tuple(Finger(place, CRITICAL, damping) for place in PAIRS["A-C"]))
        given = model.angular_frequency, model.damping_ratio, model.modal_gain, model.loads
        return int((np.linalg.eigvals(CoupledModes.of(*given).matrix).imag == 0).sum())

    low, high = 3.0, 10.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if n_real(middle) == n_real(high) else (middle, high)
    return low


def exactness(stimulus: Stimulus, table: ModalModel) -> dict[str, dict[str, float]]:
    """Return the error of the loaded plant's target, with floats and codes, and the cost over that without fingers."""
    critical = critical_damping(table)
    plants = {
        "typical": TYPICAL,
        "0.15 g, 0.7 N s/m, 0.5 N/mm": (0.15e-3, 0.7, 500.0),
        "0.3 g, 2 N s/m, 2 N/mm": (0.3e-3, 2.0, 2000.0),
        "overdamped, 10 N s/m": (CRITICAL, 10.0, 0.0),
        "overdamped, 30 N s/m": (CRITICAL, 30.0, 0.0),
        "critically damped": (CRITICAL, critical, 0.0),
    }
    rows = {}
    for name, values in plants.items():
        fingers = tuple(Finger(place, *values) for place in PAIRS["A-C"])
        loaded = design(stimulus, table, fingers)
        largest = float(np.abs(loaded.target).max())
        times = race(
            {
                "free_ms": lambda: replace(stimulus).drive,
                "loaded_ms": lambda fingers=fingers: design(stimulus, table, fingers).drive,
            },
            seconds=2.0,
        )
        rows[name] = {
            **times,
            "free_designs": times["loaded_ms"] / times["free_ms"],
            "float_miss": loaded.drive.residual / largest,
            "codes_miss": loaded.worst_modal_error(LEVEL) / LEVEL,
            "peak_V": float(loaded.peak_voltage.max()),
            "eigenvectors": float(loaded.system.real is None),
        }
    return rows


def main() -> int:
    """Measure, draw and write."""
    _, stimulus = examine("differentiated_stimulation").sound
    # The preflight's values are independent of the twin's true beam.
    apparatus = Apparatus.read(Source.find("apparatus", "beam_100x6x2").path)
    table = apparatus.modal_model()
    with threadpool_limits(1):
        exact = exactness(stimulus, table)
        rows = placements(stimulus, apparatus)
    designs = {pair: {name: summary(each) for name, each in by_name.items()} for pair, by_name in rows.items()}
    plain = [row for name, row in exact.items() if row["eigenvectors"]]
    known = [each for by_name in rows.values() for each in by_name["known, level first"]]
    bars = [
        at_most(
            "deviation from the target with fingers on the beam, before rounding",
            max(r["float_miss"] for r in exact.values()),
            1e-12,
            "",
        ),
        at_most("the same for the rounded codes", max(r["codes_miss"] for r in exact.values()), 1e-6, ""),
        at_most("time of a design with fingers, relative to one without", max(r["free_designs"] for r in plain), 3.0),
        at_most("the same where the eigenvectors are nearly parallel", exact["critically damped"]["free_designs"], 8.0),
        at_most(
            "priority: level with known fingers, error of the level", max(abs(r["at_C"] - 1) for r in known), 1e-3, ""
        ),
        at_most(
            "priority: level with known fingers, peak voltage", max(r["peak_V"] for r in known), LIMIT * (1 + 1e-9), "V"
        ),
    ]
    from fingers_figure import draw

    draw(stimulus, table, rows, RESULTS / "fingers.png")
    return write("fingers", {"n_placements": N_DRAWS, "exactness": exact, "designs": designs}, bars)


if __name__ == "__main__":
    sys.exit(main())
