"""Designs that are not offered: robust over a population of fingers, and of maximum contrast.

Writes ``results/benchmarks/rivals.json``. The population, the placements and the true beams are those of
`bench_fingers`; each design is scaled to the amplifier's limit, and judged by the peak over the whole burst.
"""

import sys
from dataclasses import replace

import numpy as np
from bars import at_least, at_most, write
from bench_fingers import LIMIT, PAIRS, TYPICAL, draw_fingers, true_beam, whole_table
from threadpoolctl import threadpool_limits

from modaltouch.preflight import examine
from modaltouch.protocol import Apparatus, Source
from modaltouch.stimulus import DiagonalSystem, Finger, ModalModel, Stimulus, Timing
from modaltouch.stimulus.reachability import Taper
from modaltouch.stimulus.touched import TouchedStimulus
from modaltouch.stimulus.vibration import BlockKernel

ZONES = (-0.04, -0.02, 0.0, 0.02, 0.04)
N_TRAINED, N_JUDGED = 9, 40
SLOW = 1e3
"""Fingertips are sensitive below this frequency [Hz]."""

SLOW_SHARE = 0.3
"""Motion below that frequency by the exact law on the untouched beam, over the level [1]."""


def rows_of(model: ModalModel, timing: Timing, n_before: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the effect of each sample before the focus on the zones, and on the slow part at C, one row each."""
    system = DiagonalSystem.of(model)
    slow = np.abs(system.exponent) < 2 * np.pi * SLOW
    output = model.shapes(ZONES).T @ system.velocity
    output = np.concatenate([output, output[2:3] * slow])
    rows = []
    for channel in range(model.n_channels):
        pulse, response = np.zeros((model.n_channels, n_before + 1)), np.empty((len(output), n_before + 1))
        pulse[channel, 0] = 1.0
        kernel = BlockKernel.of(system, output, timing.hold)
        kernel.write(lambda start, stop, pulse=pulse: pulse[:, start:stop], response)
        rows.append(response[:, :0:-1])
    whole = np.concatenate(rows, axis=1)
    return whole[:-1], whole[-1]


def robust(beams: list[ModalModel], timing: Timing, slow_weight: float) -> np.ndarray:
    """Return voltages of least energy that give C the same level on every beam, with the least motion of other zones.

    With a weight, the slow part should equal that of the exact law on every beam as well.
    """
    n_before, _ = timing.samples_until(timing.focusing_instant)
    rows, goal, weight = [], [], []
    for beam in beams:
        zones, slow = rows_of(beam, timing, n_before)
        rows += [zones[2], *zones[[0, 1, 3, 4]]]
        goal += [1.0, *np.zeros(4)]
        weight += [1e4, *np.ones(4)]
        if slow_weight:
            rows, goal, weight = [*rows, slow], [*goal, SLOW_SHARE], [*weight, slow_weight]
    matrix, taper = np.array(rows), np.ones((1, n_before))
    Taper.fitting(n_before, 1e-3 / timing.hold, 0.4e-3 / timing.hold).apply(taper)
    tapered = matrix * np.tile(taper[0], beams[0].n_channels)
    gram = tapered @ matrix.T
    solved = np.linalg.solve(gram + np.diag(np.trace(gram) / len(gram) / np.array(weight)), np.array(goal))
    return np.pad((tapered.T @ solved).reshape(-1, n_before), ((0, 0), (0, timing.n_samples - n_before)))


def judge(voltage: np.ndarray, timing: Timing, stimulus: Stimulus, beams: list[ModalModel]) -> dict[str, float]:
    """Return the results of a drive at the amplifier's limit over many beams: medians, and spreads over the means."""
    at_limit, unit = voltage * (LIMIT / np.abs(voltage).max()), np.ones(len(voltage))
    found = []
    for beam in beams:
        played = TouchedStimulus(beam, stimulus.amplifier, timing, at_limit)
        peak = played.peak_velocity([0.0], unit)[0]
        found.append((played.velocity_at_focus([0.0], unit)[0], peak, played.peak_below(SLOW, 0.0, unit)))
    values = np.array(found)
    spread = 100 * values.std(axis=0, ddof=1) / values.mean(axis=0)
    names = "at_focus", "peak", "peak_below_1_kHz"
    medians = dict(zip((f"{name}_mm_s" for name in names), (1e3 * np.median(values, axis=0)).tolist(), strict=True))
    return medians | dict(zip((f"{name}_spread_percent" for name in names), spread.tolist(), strict=True))


def population(stimulus: Stimulus, complete: ModalModel) -> dict[str, dict[str, dict[str, float]]]:
    """Return the results of each design over forty placements of each pair."""
    timing, results = replace(stimulus.timing, n_samples=12_500), {}
    for pair in ("A-C", "B-D"):
        places, rng, drawn = PAIRS[pair], np.random.default_rng(16), np.random.default_rng(17)
        judged = [true_beam(complete, rng).touched(draw_fingers(places, rng)) for _ in range(N_JUDGED)]
        trained = [complete.touched(draw_fingers(places, drawn)) for _ in range(N_TRAINED)]
        typical = replace(
            stimulus, timing=timing, model=complete.touched(tuple(Finger(place, *TYPICAL) for place in places))
        )
        drives = {
            "typical": typical.voltage,
            "typical, level first": replace(typical, priority="level").voltage,
            "robust": robust(trained, timing, 0.0),
            "robust, slow part kept": robust(trained, timing, 1e3),
        }
        results[pair] = {name: judge(drive, timing, stimulus, judged) for name, drive in drives.items()}
    return results


def contrasts(stimulus: Stimulus, table: ModalModel, complete: ModalModel) -> dict[str, dict[str, dict[str, float]]]:
    """Return the peak at C over that within 5 mm of A: as designed and at its maximum, on beams ever less known."""
    places = PAIRS["A-C"]
    typical = tuple(Finger(place, *TYPICAL) for place in places)
    points, results = [0.0, *np.linspace(-0.045, -0.035, 5)], {}
    for name, model in (("untouched", table), ("typical fingers, all modes", complete.touched(typical))):
        rng, designed = np.random.default_rng(16), replace(stimulus, model=model)
        level = stimulus.target_field.velocity
        beam = designed.touched(model.fingers)
        best, bound = beam.highest_contrast(0.0, np.array([-0.044, -0.04, -0.036]), level)
        off = [true_beam(complete, rng) for _ in range(10)]
        judged = {
            "as modelled": [model],
            "true beam": [each.touched(model.fingers) for each in off],
            "true beam and fingers": [each.touched(draw_fingers(places, rng)) for each in off],
        }
        for drive, played, unit in (("exact", beam, designed.volts_per_code(level)), ("contrast", best, np.ones(2))):
            row = {"peak_V": float((np.abs(played.codes).max(axis=1) * unit).max())}
            for known, models in judged.items():
                peaks = np.array([replace(played, model=each).peak_velocity(points, unit) for each in models])
                row[known] = float(np.median(peaks[:, 0] / peaks[:, 1:].max(axis=1)))
            results.setdefault(name, {})[drive] = row
        results[name]["contrast"]["bound"] = bound
    return results


def main() -> int:
    """Measure and write."""
    _, stimulus = examine("differentiated_stimulation").sound
    apparatus = Apparatus.read(Source.find("apparatus", "beam_100x6x2").path)
    table, complete = apparatus.modal_model(), whole_table(apparatus)
    with threadpool_limits(1):
        designs, contrast = population(stimulus, complete), contrasts(stimulus, table, complete)
    pair = designs["A-C"]
    bars = [
        at_least("highest contrast on the beam as modelled", contrast["untouched"]["contrast"]["as modelled"], 9.0),
        at_most(
            "share of the spread below 1 kHz that a robust design removes",
            1
            - pair["robust, slow part kept"]["peak_below_1_kHz_spread_percent"]
            / pair["typical"]["peak_below_1_kHz_spread_percent"],
            0.25,
            "",
        ),
    ]
    return write(
        "rivals", {"n_trained": N_TRAINED, "n_judged": N_JUDGED, "robust": designs, "contrast": contrast}, bars
    )


if __name__ == "__main__":
    sys.exit(main())
