"""The level of a burst under fingers that have drifted since their probe: accuracy and coverage of its estimate.

Writes ``results/benchmarks/delivered.json``. Forty placements of two fingers on A and C, and the beam, as in
``bench_probe.py``. Until the burst is played, mass, damping and stiffness change by 20 %, the place by 0.3 mm, and each
channel's gain by 2 %; the vibrometer's noise is that of the twin. The truth is the peak velocity of the coupled beam.
"""

import sys
import time
from dataclasses import replace

import numpy as np
from bars import at_least, at_most, write
from bench_fingers import N_DRAWS, PAIRS, draw_fingers, true_beam
from bench_probe import DENSITY, Bench
from threadpoolctl import threadpool_limits

from modaltouch.lab.probe_excitation import BurstRecord
from modaltouch.preflight import examine
from modaltouch.protocol import Apparatus
from modaltouch.rig import Recording
from modaltouch.stimulus import BlockKernel, DiagonalSystem, Finger, ModalModel, Stimulus
from modaltouch.stimulus.probe import ProbedBeam

LEVEL, EVERY, NORMAL_95 = 0.05, 2, 1.96
"""Level [m/s], samples of the generator per sample of the scope, half a 95 % interval [standard deviations]."""


def later(finger: Finger, rng: np.random.Generator) -> Finger:
    """Return a finger some time after its probe."""
    mass, damping, stiffness = np.exp(0.2 * rng.standard_normal(3))
    return replace(
        finger,
        position=finger.position + 3e-4 * rng.standard_normal(),
        mass=finger.mass * mass,
        damping=finger.damping * damping,
        stiffness=finger.stiffness * stiffness,
    )


def recorded(beam: ModalModel, stimulus: Stimulus, laser: float, rng: np.random.Generator) -> Recording:
    """Return the vibrometer's record of a burst and of most of the silence after it."""
    system, timing = DiagonalSystem.of(beam, stimulus.amplifier), stimulus.timing
    voltage = stimulus.voltage_played(LEVEL)
    n_samples = round(0.95 * timing.sampling_rate / timing.repetition_rate)
    velocity = np.empty((1, n_samples))
    kernel = BlockKernel.of(system, beam.shapes([laser]).T @ system.velocity, timing.hold)
    padded = np.pad(voltage, ((0, 0), (0, n_samples - voltage.shape[1])))
    kernel.write(lambda start, stop: padded[:, start:stop], velocity)
    rate, seen = timing.sampling_rate / EVERY, velocity[:, ::EVERY]
    seen = seen + DENSITY * np.sqrt(rate / 2) * rng.standard_normal(seen.shape)
    return Recording(laser, np.arange(seen.shape[1]) / rate, seen, np.empty((1, 0, 0)), rate, ())


def judged(bench: Bench, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the estimates for both fingers of a placement, over the true peak velocities [1]; and the time [s]."""
    places = tuple(finger.position for finger in bench.expected)
    beam, fingers = true_beam(bench.table, rng), draw_fingers(places, rng)
    found = bench.probe(beam.touched(fingers), rng).touched(
        bench.probe(beam, rng).untouched(bench.table), bench.expected
    )
    designed = replace(bench.stimulus, model=found.model)
    drifted = replace(beam, modal_gain=beam.modal_gain * (1 + 0.02 * rng.standard_normal(2)))
    drifted = drifted.touched(tuple(later(finger, rng) for finger in fingers))
    played, unit = designed.touched(()), designed.volts_per_code(LEVEL)

    def peaks(model: ModalModel) -> np.ndarray:
        return replace(played, model=model).peak_velocity([finger.position for finger in model.fingers], unit)

    def slopes(probed: ProbedBeam, known: np.ndarray | None = None) -> np.ndarray:
        places = [finger.position for finger in probed.model.fingers]
        instants = replace(played, model=probed.model).peak_instants(places, unit)

        def speeds(model: ModalModel) -> np.ndarray:
            places = [finger.position for finger in model.fingers]
            return np.abs(replace(played, model=model).velocity_at(places, instants, unit))

        return probed.slopes(speeds, known)

    known = slopes(found)
    record = recorded(drifted, designed, bench.laser, rng)
    begun = time.process_time()
    seen = BurstRecord(designed, LEVEL, bench.table.natural_frequency).probe(record, None).later(found)
    told, half = peaks(seen.model), NORMAL_95 * seen.spread(slopes(seen, known))
    took, true = time.process_time() - begun, peaks(drifted)
    return {
        "predicted": peaks(found.model) / true - 1,
        "delivered": told / true - 1,
        "half_width": half / true,
        "took_s": np.array([took]),
    }


def main() -> int:
    """Measure and write."""
    _, stimulus = examine("differentiated_stimulation").sound
    bench, rng = Bench.of(stimulus, Apparatus.read("beam_100x6x2"), PAIRS["A-C"]), np.random.default_rng(16)
    with threadpool_limits(1):
        rows = [judged(bench, rng) for _ in range(N_DRAWS)]
    predicted, delivered, half, took = (np.concatenate([row[name] for row in rows]) for name in rows[0])
    found = {
        "n_placements": N_DRAWS,
        "predicted_missed_p95_percent": 100 * float(np.quantile(np.abs(predicted), 0.95)),
        "delivered_missed_median_percent": 100 * float(np.median(np.abs(delivered))),
        "delivered_missed_p95_percent": 100 * float(np.quantile(np.abs(delivered), 0.95)),
        "covered": float((np.abs(delivered) <= half).mean()),
        "width_median_percent": 200 * float(np.median(half)),
        "took_median_s": float(np.median(took)),
    }
    bars = [
        at_most(
            "error of the delivered speed, 95th percentile over fingers",
            found["delivered_missed_p95_percent"],
            2.5,
            "%",
        ),
        at_least("coverage of the 95 % interval over fingers", found["covered"], 0.9, ""),
        at_most("time to evaluate a recorded burst", found["took_median_s"], 0.5, "s"),
    ]
    return write("delivered", found, bars)


if __name__ == "__main__":
    sys.exit(main())
