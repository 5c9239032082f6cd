"""Measurements of the twin with one fault each: every result outside its interval must have a mark.

``python tests/lab/spoilt.py --cases 1000 --out results/benchmarks/spoilt.json``

A *mark* is a refusal, or a sentence among the warnings of the result. An identification is *silently wrong* if it has
none and a natural frequency, damping ratio or gain of modes 1 to 11 is further from the twin's than twice the
half-width of its 95 % interval (natural frequencies and damping ratios of one impact, if a record is clipped); a
calibration, if the velocity or w eta of a mode is further from the twin's true state. A calibration that misses its
limits counts as refused. A refusal is *right* if it contains one of the words of `CAUSES` for the true cause.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from intervals import PROTOCOL, calibrated

from modaltouch.lab.calibration.plausibility import mark_of
from modaltouch.lab.identification.command import check_gains
from modaltouch.lab.identification.files import read_responses
from modaltouch.lab.identification.joint_fit import identify, identify_each
from modaltouch.lab.identification.modal_parameters import Identification
from modaltouch.lab.identification.responses import FrequencyResponses
from modaltouch.lab.identification.verdict import check_all, check_modes, warnings
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator.true_beam import TrueBeam, true_beam

APPARATUS = Path(__file__).parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"
LENGTH, PERIOD = 0.1, 131_072 / 500e3
N_POINTS, N_AVERAGES, HIGHEST = 21, 10, 33e3
DELAY, BANDWIDTH = 4e-6, 250e3
LABELS = (1, 3, 5, 7, 9, 11)
GRAVITY = 9.80665


def response_of(
    beam: TrueBeam, *, softening: float = 0.0, drift: float = 0.0, stretch: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies, and velocity responses of both sets at all points, (2, n_points, n_bins).

    Parameters
    ----------
    beam : TrueBeam
        The beam.
    softening : float
        How many half-power half-bandwidths each mode falls at its own highest velocity; its stiffness falls by the
        square of the velocity (Duffing).
    drift : float
        By which part the natural frequencies rise from the first point to the last.
    stretch : float
        How many times as far from mid-beam the points lie as their positions say.
    """
    frequency = np.arange(int(50 * PERIOD) + 1, int(HIGHEST * PERIOD)) / PERIOD
    places = np.linspace(-LENGTH / 2, LENGTH / 2, N_POINTS)
    omega, own, ratio = 2 * np.pi * frequency, 2 * np.pi * beam.natural_frequency[:, None], beam.damping_ratio[:, None]
    late = np.exp(-1j * omega * DELAY) / (1 + 1j * frequency / BANDWIDTH)
    shapes = beam.shapes(stretch * places, 0.2e-3)
    response = np.empty((2, N_POINTS, frequency.size), dtype=complex)
    for each, gain in zip(response, beam.modal_gain.T[:, :, None], strict=True):
        resistance = 2j * ratio * own * omega - omega**2
        power = np.zeros((own.size, omega.size))
        for _ in range(60 if softening else 0):
            stiffness = own**2 * (1 - 2 * ratio * softening * power)
            velocity = np.abs(omega * gain / (stiffness + resistance))
            highest = np.abs(beam.modal_gain).max(axis=1)[:, None] / (2 * ratio * own)
            power = 0.7 * power + 0.3 * (velocity / highest) ** 2
        for point, place in enumerate(np.linspace(-0.5, 0.5, N_POINTS)):
            if point == 0 or drift:
                stiffness = own**2 * (1 - 2 * ratio * softening * power) * (1 + drift * place) ** 2
                dynamic = 1j * omega * gain / (stiffness + resistance)
            each[point] = shapes[:, point] @ dynamic * late
    return frequency, response


def measured(frequency: np.ndarray, response: np.ndarray, seed: int, noise: float = 1.0) -> FrequencyResponses:
    """Return estimated responses with noise of 0.02 of the median response, or a multiple of it."""
    rng = np.random.default_rng(seed)
    power = (noise * 0.02 * np.median(np.abs(response))) ** 2 * N_AVERAGES
    scatter = rng.standard_normal(response.shape) + 1j * rng.standard_normal(response.shape)
    response = response + scatter * np.sqrt(power / 2 / N_AVERAGES)
    residual = rng.gamma(N_AVERAGES - 1, 1.0, response.shape) * power / N_AVERAGES
    signal = np.abs(response) ** 2
    places = np.linspace(-LENGTH / 2, LENGTH / 2, N_POINTS)
    coherence = signal / (signal + residual)
    return FrequencyResponses(frequency, response, places, ("centre", "side"), coherence, N_AVERAGES, BANDWIDTH)


Fault = Callable[[TrueBeam, np.random.Generator], tuple[np.ndarray, np.ndarray, float]]


def _clean(beam: TrueBeam, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    return (*response_of(beam), 1.0)


def _offset(beam: TrueBeam, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    frequency, response = response_of(beam)
    return frequency, response * np.exp(-2j * np.pi * frequency * rng.uniform(0, 5e-3)), 1.0


def _nonlinear(beam: TrueBeam, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    return (*response_of(beam, softening=float(np.exp(rng.uniform(np.log(0.1), np.log(3))))), 1.0)


def _drift(beam: TrueBeam, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    return (*response_of(beam, drift=float(np.exp(rng.uniform(np.log(5e-4), np.log(1e-2))))), 1.0)


def _point(factor: Callable[[np.random.Generator], float]) -> Fault:
    def fault(beam: TrueBeam, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
        frequency, response = response_of(beam)
        response[:, rng.integers(N_POINTS)] *= factor(rng)
        return frequency, response, 1.0

    return fault


def _incoherent(beam: TrueBeam, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    return (*response_of(beam), float(rng.uniform(20, 100)))


def _units(beam: TrueBeam, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    frequency, response = response_of(beam)
    return frequency, response * rng.choice([GRAVITY, 1 / GRAVITY, 1e3, 1e-3]), 1.0


def _misplaced(beam: TrueBeam, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    return (*response_of(beam, stretch=float(rng.uniform(0.92, 0.98))), 1.0)


def _stepped(beam: TrueBeam, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    frequency, response = response_of(beam)
    response[:, rng.integers(5, N_POINTS - 5) :] *= rng.choice([0.9, 1.05, 1.1])
    return frequency, response, 1.0


def _mixed_units(beam: TrueBeam, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    frequency, response = response_of(beam)
    some = rng.permutation(N_POINTS)[: rng.integers(2, N_POINTS - 1)]
    response[:, some] *= rng.choice([GRAVITY, 1 / GRAVITY, 1e3, 1e-3])
    return frequency, response, 1.0


def _wrong_digit(beam: TrueBeam, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    frequency, response = response_of(beam)
    row = response[rng.integers(2), rng.integers(N_POINTS)]
    row[np.abs(row).argmax()] *= rng.choice([0.1, 5.0, 10.0])
    return frequency, response, 1.0


FAULTS: dict[str, Fault] = {
    "clean": _clean,
    "offset": _offset,
    "nonlinear": _nonlinear,
    "drift": _drift,
    "inverted point": _point(lambda rng: -1.0),
    "scaled point": _point(lambda rng: float(rng.choice([0.1, 0.5, 2.0, GRAVITY]))),
    "low coherence": _incoherent,
    "wrong units": _units,
    "misplaced points": _misplaced,
    "a step in the scan": _stepped,
    "mixed units": _mixed_units,
    "wrong digit": _wrong_digit,
}


def saturated(apparatus: Apparatus, needed: float, rng: np.random.Generator) -> Apparatus:
    """Return an apparatus whose amplifier saturates at 30 to 100 % of the stimulus's need."""
    amplifier = apparatus.twin.amplifier.model_copy(update={"limit_V": needed * rng.uniform(0.3, 1.0)})
    return apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update={"amplifier": amplifier})})


def hysteretic(apparatus: Apparatus, needed: float, rng: np.random.Generator) -> Apparatus:
    """Return an apparatus whose actuators have hysteresis of 2 to 60 % of their force."""
    share = float(np.exp(rng.uniform(np.log(0.02), np.log(0.6))))
    return apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update={"hysteresis": share})})


RIGS: dict[str, Callable[[Apparatus, float, np.random.Generator], Apparatus]] = {
    "saturation": saturated,
    "hysteresis": hysteretic,
}
"""What is wrong with a rig that is calibrated."""


@cache
def paper() -> Preflight:
    """Return the paper's protocol, checked."""
    return examine(PROTOCOL).require()


def calibration_of(name: str, seed: int) -> dict[str, bool]:
    """Return the outcome of calibrating a rig with a fault."""
    preflight, rng = paper(), np.random.default_rng(seed)
    listed = preflight.experiment.apparatus
    rig = RIGS[name](listed, float(preflight.stimulus.peak_voltage.max()), rng)
    try:
        outcome, off, _ = calibrated(preflight, rig, int(rng.integers(1 << 31)), listed)
    except RigError as error:
        return refused(name, str(error))
    mark = mark_of(outcome, preflight.experiment.protocol)
    if mark["missed"]:
        return refused(name, "; ".join(mark["causes"]))
    wrong = bool((np.abs(off) > 2 * outcome.best.state.true_half_width).any())
    return {"marked": False, "refused": False, "right": False, "silently_wrong": wrong}


LOW = (1, 3)
"""Modes that a hammer excites."""


def clipped(seed: int, apparatus: Apparatus) -> dict[str, bool]:
    """Return the outcome for an impact record clipped at 30 to 99 % of its highest acceleration."""
    rng = np.random.default_rng(seed)
    beam = true_beam(apparatus, int(rng.integers(1 << 31)))
    rate, n = 20e3, 16_384
    time, pulse = np.arange(n) / rate, 2e-4
    force = np.where(time % 1 < pulse, 100 * np.sin(np.pi * time / pulse), 0.0)
    force = np.roll(force, 200)
    motion = np.zeros(n)
    for k in (beam.table.label.index(label) for label in LOW):
        pole = 2 * np.pi * beam.table.natural_frequency[k]
        decay, damped = beam.table.damping_ratio[k] * pole, pole * np.sqrt(1 - beam.table.damping_ratio[k] ** 2)
        displacement = np.convolve(force, np.exp(-decay * time) * np.sin(damped * time) / damped)[:n] / rate
        motion += np.gradient(np.gradient(displacement, 1 / rate), 1 / rate)
    motion += 3e-4 * motion.max() * rng.standard_normal(n)
    end = rng.uniform(0.3, 0.99) * np.abs(motion).max()
    head = "***End_of_Header***\nY_Unit_Label\tm/s^2\tN\nDelta_X\t5E-5\t5E-5\n***End_of_Header***\nX\ta\tf\n"
    rows = (f"\t{a:.9g}\t{f:.9g}" for a, f in zip(np.clip(motion, -end, end), force, strict=True))
    try:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "blow.lvm"
            path.write_text(head + "\n".join(rows), encoding="utf-8")
            found = identify_each(read_responses([path]).between(60, 4e3))
        check_all(found)
    except ValueError as error:
        return refused("clipping", str(error))
    wrong = any(_is_off(found, beam, label) for label in LOW)
    marked = bool(warnings(found))
    return {"marked": marked, "refused": False, "right": False, "silently_wrong": wrong and not marked}


def _is_off(found: Identification, beam: TrueBeam, label: int) -> bool:
    k = beam.table.label.index(label)
    true = beam.table.natural_frequency[k], beam.table.damping_ratio[k]
    mode = min(found.modes, key=lambda each: abs(each.natural_frequency.value - true[0]))
    numbers = mode.natural_frequency, mode.damping_ratio
    return any(abs(a.value - b) > 2 * (a.high - a.value) for a, b in zip(numbers, true, strict=True))


KINDS = (*FAULTS, *RIGS, "clipping")

CAUSES = {
    "saturation": "saturate",
    "hysteresis": "hysteresis",
    "clipping": "saturated",
    "offset": "ms",
    "nonlinear": "nonlinearity",
    "drift": "drift",
    "inverted point": "inverted",
    "scaled point": "times too",
    "low coherence": "average more",
    "wrong units": "times those of",
    "misplaced points": "as far from mid-beam",
    "a step in the scan": "alike in all modes",
    "mixed units": "as large as those at the other points",
    "wrong digit": "one value",
}
"""What a right refusal says, by the fault."""


def is_wrong(found: Identification, beam: TrueBeam) -> bool:
    """Return whether a number differs from the truth by more than twice the half-width of its interval."""
    for label in LABELS:
        mode, k = found.by_label[label], beam.table.label.index(label)
        numbers = (mode.natural_frequency, mode.damping_ratio, *mode.gain)
        true = (beam.table.natural_frequency[k], beam.table.damping_ratio[k], *beam.table.modal_gain[k])
        if any(abs(a.value - b) > 2 * (a.high - a.value) for a, b in zip(numbers, true, strict=True)):
            return True
    return False


def refused(name: str, said: str) -> dict[str, bool]:
    """Return the outcome for a refusal."""
    return {"marked": True, "refused": True, "right": CAUSES.get(name, "\0") in said, "silently_wrong": False}


def outcome(name: str, seed: int, apparatus: Apparatus) -> dict[str, bool]:
    """Return the outcome of one case: marked, refused, refused with the true cause, silently wrong."""
    if name in RIGS:
        return calibration_of(name, seed)
    if name == "clipping":
        return clipped(seed, apparatus)
    rng = np.random.default_rng(seed)
    beam = true_beam(apparatus, int(rng.integers(1 << 31)))
    frequency, response, noise = FAULTS[name](beam, rng)
    responses = measured(frequency, response, seed, noise)
    try:
        found = identify(responses, LENGTH)
        check_modes(found, LABELS)
        check_gains(found, apparatus)
    except ValueError as error:
        return refused(name, str(error))
    marked = bool(warnings(found))
    return {
        "marked": marked,
        "refused": False,
        "right": False,
        "silently_wrong": not marked and is_wrong(found, beam),
    }


def main() -> None:
    """Run the cases, with all faults in turn, and write the counts of marked, refused and right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    apparatus = Apparatus.read(APPARATUS)
    kinds: dict[str, dict[str, int]] = {name: {"n": 0} for name in KINDS}
    for seed in range(options.cases):
        name = KINDS[seed % len(KINDS)]
        kinds[name]["n"] += 1
        came = outcome(name, seed, apparatus)
        if came["silently_wrong"] or (came["refused"] and not came["right"]):
            print(seed, name, came, flush=True)
        for key, value in came.items():
            kinds[name][key] = kinds[name].get(key, 0) + value
        spoilt = [each for fault, each in kinds.items() if fault != "clean"]
        refused = sum(each.get("refused", 0) for each in spoilt)
        right = sum(each.get("right", 0) for each in spoilt)
        totals = {
            "n": seed + 1,
            "n_silently_wrong": sum(each.get("silently_wrong", 0) for each in kinds.values()),
            "right_of_refusals": right / refused if refused else None,
            "kinds": kinds,
        }
        options.out.write_text(json.dumps(totals, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
