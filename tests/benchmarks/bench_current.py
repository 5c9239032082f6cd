"""Bounds for estimates of fingers from the current of an actuator set instead of the vibrometer.

Writes ``results/benchmarks/current.json``. A set draws the current of its capacitance and, by reciprocity, that of the
motion: ``I = k m_b G_s^T Y G + s C``. For twelve placements on each of three pairs, the Cramer-Rao bound limits how
precisely any unbiased estimator could find the level at C from the velocity of a point, and from the current of either
set, recorded by a scope of 8, 12 or 14 bits. The current is recorded in five frequency bands, each in a separate range.
Fingers are estimated from the change of the current, so that a constant capacitance cancels; it changes by 0.1 %
meanwhile. It is assumed that the capacitance is 10 nF and that only it and the motion draw current.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from bars import at_most, write
from bench_fingers import LEVEL, PAIRS, draw_fingers, true_beam
from bench_probe import DENSITY, Bench
from threadpoolctl import threadpool_limits

from modaltouch.lab.probe_excitation import N_RECORDS, N_SAMPLES, SPACING
from modaltouch.preflight import examine
from modaltouch.protocol import Apparatus
from modaltouch.stimulus import Finger, ModalModel

CAPACITANCE, DRIFT, N_TERMS = 10e-9, 1e-3, 5
"""Capacitance of a set [F], its relative change between two probes [1], terms of its dependence on log frequency."""

N_DRAWS, N_BANDS = 12, 5
"""Placements on each pair; frequency bands that are recorded one by one."""

BITS = (8, 12, 14)
HEADROOM, STEPS, RATE = 1.5, 0.7, 2e6
"""Range over the peak of the current, noise of a converter in its steps, samples per second."""

PRIOR = {"frequency": 0.005, "damping": 0.1, "gain": 0.02, "coupling": 0.1}
"""Prior standard deviations of the beam's parameters: of logarithms, but of gains over the largest of the mode."""

FINGER_PRIOR = np.array([1.0, 1.0, 1.5, 2.5])
"""Standard deviations of the logarithms of mass, damping and stiffness, and of the position [mm]."""

_STEP = 1e-4


@dataclass(frozen=True)
class Placement:
    """Two fingers on a true beam, with the estimated quantities as a vector of steps away from the truth."""

    bench: Bench
    beam: ModalModel
    fingers: tuple[Finger, ...]

    @property
    def prior(self) -> np.ndarray:
        """Standard deviations of beam, coupling and fingers."""
        n, n_channels = self.beam.modal_gain.shape
        own = [PRIOR["frequency"], PRIOR["damping"], PRIOR["gain"], PRIOR["coupling"]]
        return np.concatenate([np.repeat(own, [n, n, n * n_channels, 1]), np.tile(FINGER_PRIOR, len(self.fingers))])

    def moved(self, step: np.ndarray) -> tuple[ModalModel, float]:
        """Return beam and fingers one step away, and the coupling of the current."""
        n, n_channels = self.beam.modal_gain.shape
        frequency, damping, gain, coupling, fingers = np.split(step, np.cumsum([n, n, n * n_channels, 1]))
        strongest = np.abs(self.beam.modal_gain).max(axis=1, keepdims=True)
        beam = replace(
            self.beam,
            natural_frequency=self.beam.natural_frequency * np.exp(frequency),
            damping_ratio=self.beam.damping_ratio * np.exp(damping),
            modal_gain=self.beam.modal_gain + gain.reshape(n, -1) * strongest,
        )
        laid = tuple(
            Finger(f.position + x * 1e-3, f.mass * np.exp(m), f.damping * np.exp(c), f.stiffness * np.exp(k))
            for f, (m, c, k, x) in zip(self.fingers, fingers.reshape(-1, 4), strict=True)
        )
        return beam.touched(laid), float(np.exp(coupling[0]))

    def response(self, step: np.ndarray, sensed: int | None) -> np.ndarray:
        """Return velocity per volt without and with fingers, or motional current of a set, (2, n_lines) array."""
        model, coupling = self.moved(step)
        frequency, channel = self.bench.excitation.bins * SPACING, self.bench.excitation.channel
        s, rows = 2j * np.pi * frequency[:, None], np.arange(model.n_modes)
        dynamics = np.zeros((frequency.size, rows.size, rows.size), dtype=complex)
        omega = model.angular_frequency
        dynamics[:, rows, rows] = s + 2 * model.damping_ratio * omega + omega**2 / s
        loaded = dynamics + sum(finger.impedance(s)[:, :, None] * contact for contact, finger in model.loads)
        assert model.mass is not None
        read = model.shapes([self.bench.laser])[:, 0]
        if sensed is not None:
            read = coupling * model.mass * model.modal_gain[:, sensed]
        force = model.modal_gain[:, channel].T[:, :, None]
        return np.array([np.linalg.solve(each, force)[:, :, 0] @ read for each in (dynamics, loaded)])

    def level(self, step: np.ndarray, drive: Callable[[ModalModel], float]) -> float:
        """Return the level at C that a drive produces."""
        return drive(self.moved(step)[0])

    def bounds(self, sensed: int | None, drive: Callable[[ModalModel], float]) -> dict[int, float]:
        """Return the least relative standard deviation of the level from a probe, by the scope's bits."""
        slopes, level = self._slopes(sensed, drive)
        truth, weight, size = self.response(np.zeros(self.prior.size), sensed), self.prior, 1.0
        rows = [slopes[0], slopes[1]]
        if sensed is not None:
            charging = self._charging(sensed)
            both, size = np.concatenate([charging, 1j * charging], axis=1), np.sqrt(2)
            # Untouched: the capacitance is unknown. Fingers: the difference, including the change of the capacitance.
            rows = [np.concatenate([slopes[0], both, 0 * both], axis=1)]
            rows += [np.concatenate([slopes[1] - slopes[0], 0 * both, both], axis=1)]
            weight = np.concatenate([weight, [1e3 * CAPACITANCE] * 2 * N_TERMS, [DRIFT * CAPACITANCE] * 2 * N_TERMS])
            level = np.append(level, np.zeros(4 * N_TERMS))
        bounds = {}
        for bits in BITS:
            deviation = self._noise(truth[0], sensed, bits)[:, None]
            whitened = np.concatenate([rows[0] / deviation, rows[1] / (size * deviation)])
            real = np.concatenate([whitened.real, whitened.imag]) * weight
            information = real.T @ real + np.eye(weight.size)
            bounds[bits] = float(np.sqrt((weight * level) @ np.linalg.solve(information, weight * level)))
        return bounds

    def _slopes(self, sensed: int | None, drive: Callable[[ModalModel], float]) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of both responses and of the level by each parameter."""
        steps = _STEP * np.eye(self.prior.size)
        ends = [(self.response(step, sensed), self.response(-step, sensed)) for step in steps]
        levels = [self.level(step, drive) - self.level(-step, drive) for step in steps]
        return np.moveaxis([(a - b) / (2 * _STEP) for a, b in ends], 0, 2), np.array(levels) / (2 * _STEP)

    def _charging(self, sensed: int) -> np.ndarray:
        """Return the current per farad of each term of the capacitance, (n_lines, N_TERMS) array."""
        frequency, own = self.bench.excitation.bins * SPACING, self.bench.excitation.channel == sensed
        place = np.log(frequency / frequency[0]) / np.log(frequency[-1] / frequency[0])
        return 2j * np.pi * (frequency * own)[:, None] * np.polynomial.chebyshev.chebvander(2 * place - 1, N_TERMS - 1)

    def _noise(self, response: np.ndarray, sensed: int | None, bits: int) -> np.ndarray:
        """Return the standard deviation of the noise of each response per volt, equal for real and imaginary part."""
        line, bins, density = self.bench.line, self.bench.excitation.bins, np.full(self.bench.line.size, DENSITY)
        if sensed is not None:
            whole = (response + CAPACITANCE * self._charging(sensed)[:, 0]) * line
            whole = whole * np.exp(1j * np.pi * np.arange(line.size) ** 2 / line.size)
            band = (np.log(bins / bins[0]) / np.log(bins[-1] / bins[0]) * N_BANDS * (1 - 1e-9)).astype(int)
            for number in range(N_BANDS):
                spectrum = np.zeros(N_SAMPLES // 2 + 1, dtype=complex)
                spectrum[bins[band == number]] = whole[band == number]
                step = HEADROOM * np.abs(np.fft.irfft(spectrum, N_SAMPLES) * N_SAMPLES).max() / 2 ** (bits - 1)
                density[band == number] = STEPS * step / np.sqrt(RATE / 2) * np.sqrt(1.5)
        return np.asarray(density * np.sqrt(SPACING / 2 / N_RECORDS) / line)


def judged(bench: Bench, pair: str) -> dict[str, list[float]]:
    """Return the bound for every placement of a pair, by the measured quantity [% of the level]."""
    rng, found = np.random.default_rng(16), dict[str, list[float]]()
    for _ in range(N_DRAWS):
        placement = Placement(bench, true_beam(bench.table, rng), draw_fingers(PAIRS[pair], rng))
        designed = replace(bench.stimulus, model=placement.beam.touched(placement.fingers))
        unit, played = designed.volts_per_code(LEVEL), designed.touched(())

        def drive(model: ModalModel, played=played, unit=unit) -> float:
            return float(replace(played, model=model).velocity_at_focus([0.0], unit)[0]) / LEVEL

        found.setdefault("velocity", []).append(100 * placement.bounds(None, drive)[8])
        for sensed in (0, 1):
            for bits, bound in placement.bounds(sensed, drive).items():
                found.setdefault(f"current of set {sensed + 1}, {bits} bits", []).append(100 * bound)
    return found


def main() -> int:
    """Measure and write."""
    _, stimulus = examine("differentiated_stimulation").sound
    apparatus, found = Apparatus.read("beam_100x6x2"), dict[str, dict[str, float]]()
    with threadpool_limits(1):
        for pair, places in PAIRS.items():
            rows = judged(Bench.of(stimulus, apparatus, places), pair)
            found[pair] = {name: float(np.median(each)) for name, each in rows.items()}
            print(pair, {name: round(value, 2) for name, value in found[pair].items()}, flush=True)
    velocity = max(each["velocity"] for each in found.values())
    return write(
        "current",
        {"bound_of_level_median_percent": found},
        [at_most("half-width of the level by the vibrometer, median over placements", velocity, 0.25, "%")],
    )


if __name__ == "__main__":
    sys.exit(main())
