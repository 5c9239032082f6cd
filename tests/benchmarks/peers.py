"""Implementations that the stimulus engine is compared with, and the models and timers of the benchmarks."""

import math
import time
from collections.abc import Callable
from typing import Any

import control
import numpy as np
from scipy import signal

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.stimulus import Stimulus, design_stimulus
from modaltouch.stimulus.target_field import TargetField
from modaltouch.stimulus.vibration import BlockStates, history

ZONES = (-0.04, -0.02, 0.0, 0.02, 0.04)
LEVELS = (0.08, 0.1, 0.15, 0.2)
AMPLIFIER = Amplifier(gain=25.0, limit=250.0)
FREQUENCY = (229, 2553, 7137, 12701, 22810, 29390, 58303, 68543, 87855)
RATIO = (0.0437, 0.0165, 0.0265, 0.0168, 0.0112, 0.0166, 0.0101, 0.0176, 0.0147)
CENTRE = (114, 654, 0, 0, 0, -6285, -41448, 0, 0)
SIDE = (0, 0, 6500, -8346, 10414, 0, 0, -166030, 134615)
_TURN = 0.01


def shipped_model() -> ModalModel:
    """Return Table I on the centre and the side set."""
    gain = np.array([CENTRE, SIDE], dtype=float).T * 1e-3
    return ModalModel(tuple(range(1, 18, 2)), np.array(FREQUENCY, float), np.array(RATIO), gain, 0.1)


def many_modes(n_modes: int) -> ModalModel:
    """Return modes spread from 200 Hz to 90 kHz, every one on both channels."""
    rng = np.random.default_rng(n_modes)
    frequency, ratio = np.geomspace(200.0, 90e3, n_modes), rng.uniform(0.01, 0.03, n_modes)
    return ModalModel(tuple(range(1, n_modes + 1)), frequency, ratio, rng.normal(size=(n_modes, 2)), 0.1)


def design(model: ModalModel, **options: Any) -> Stimulus:
    """Return the shipped stimulus with changed options."""
    timing = options.pop("timing", Timing(AFG3022B.converter))
    return design_stimulus(
        model, options.pop("target_field", TargetField()), timing, AMPLIFIER, levels=LEVELS, **options
    )


def modal_history(model: ModalModel, voltage: Any, timing: Timing) -> Any:
    """Return the modal velocities at the start of each sample."""
    system = DiagonalSystem.of(model)
    return history(system, system.velocity, voltage, timing)


def velocity_history(model: ModalModel, voltage: Any, timing: Timing, positions: Any) -> Any:
    """Return the velocity at points of the beam at the start of each sample."""
    system = DiagonalSystem.of(model)
    return history(system, model.shapes(positions).T @ system.velocity, voltage, timing)


def peak_velocity(model: ModalModel, voltage: Any, timing: Timing, positions: Any) -> Any:
    """Return the peak velocity at points of the beam until the next burst would begin."""
    system = DiagonalSystem.of(model)
    return BlockStates.of(system, voltage, timing).peak(model.shapes(positions).T @ system.velocity)


def race(
    works: dict[str, Callable[[], object]],
    seconds: float,
    least: int = 5,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Return the best time of each task [ms]; tasks run in rotation, so that disturbances affect all of them."""
    best = dict.fromkeys(works, math.inf)
    for work in works.values():
        work()
    start, rounds = time.perf_counter(), 0
    while rounds < least or time.perf_counter() - start < seconds:
        rounds += 1
        for who, work in works.items():
            # A few in a row: the first one meets the caches of the task before.
            turn = time.perf_counter()
            for _ in range(10):
                before = clock()
                work()
                best[who] = min(best[who], clock() - before)
                if time.perf_counter() - turn > _TURN:
                    break
    return {who: value * 1e3 for who, value in best.items()}


def milliseconds(work: Callable[[], object], seconds: float = 0.4, least: int = 5) -> float:
    """Return the best time of a task that is repeated for a while [ms]."""
    return race({"work": work}, seconds, least)["work"]


def plain_synthesis(amplitude: Any, exponent: Any, ago: Any, out: Any) -> None:
    """Write the sums by the direct vectorised expression."""
    envelope = np.exp(exponent.real[:, None] * ago)
    phase = exponent.imag[:, None] * ago
    np.matmul(amplitude.real, envelope * np.cos(phase), out=out)
    out -= amplitude.imag @ (envelope * np.sin(phase))


def plain_prediction(model: ModalModel, voltage: Any, hold: float) -> Any:
    """Return the modal velocities after the last sample by direct convolution."""
    s = model.exponent
    powers = np.exp(s[:, None] * (hold * np.arange(voltage.shape[1] - 1, -1, -1)))
    state = ((model.modal_gain @ voltage) * powers).sum(axis=1) * np.expm1(s * hold) / s
    return ((1 - 1j * s.real / s.imag) * state).real


def state_space(model: ModalModel) -> tuple[Any, Any, Any, Any]:
    """Return (A, B, C, D) of the whole system in the states (w eta, eta'), with output eta'."""
    n = model.n_modes
    A, B, C = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2)), np.zeros((n, 2 * n))
    for k, (w, ratio) in enumerate(zip(model.angular_frequency, model.damping_ratio, strict=True)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0, w], [-w, -2 * ratio * w]]
        B[2 * k + 1] = model.modal_gain[k]
        C[k, 2 * k + 1] = 1
    return A, B, C, np.zeros((n, 2))


def one_by_one(model: ModalModel) -> list[ModalModel]:
    """Return each mode as a separate model."""
    rows = zip(model.label, model.natural_frequency, model.damping_ratio, model.modal_gain, strict=True)
    return [ModalModel((k,), np.array([f]), np.array([r]), g[None, :], model.length) for k, f, r, g in rows]


def lsim(systems: list[Any], voltage: Any, hold: float) -> Any:
    """Return the modal velocities by one `scipy.signal.lsim` call per system."""
    instants, inputs = np.arange(voltage.shape[1]) * hold, np.ascontiguousarray(voltage.T)
    outputs = [signal.lsim(system, inputs, instants, interp=False)[1] for system in systems]
    return np.hstack([each.reshape(len(inputs), -1) for each in outputs]).T


def forced_response(systems: list[Any], voltage: Any, hold: float) -> Any:
    """Return the modal velocities by one `control.forced_response` call per system.

    It interpolates the input linearly between the samples, while the generator holds them.
    """
    instants = np.arange(voltage.shape[1]) * hold
    outputs = [control.forced_response(system, instants, voltage).outputs for system in systems]
    return np.vstack([np.atleast_2d(each) for each in outputs])


def nine_lfilters(model: ModalModel, voltage: Any, hold: float) -> Any:
    """Return the modal velocities by one second-order section per mode."""
    s = model.exponent
    ratio, held = np.exp(s * hold), np.expm1(s * hold) / s * (1 - 1j * s.real / s.imag)
    force = model.modal_gain @ voltage
    velocity = np.empty_like(force)
    for k, (z, h) in enumerate(zip(ratio, held, strict=True)):
        numerator = [0.0, h.real, -(h * z.conjugate()).real]
        velocity[k] = signal.lfilter(numerator, [1.0, -2 * z.real, abs(z) ** 2], force[k])
    return velocity


def compiled_recursion(model: ModalModel, hold: float) -> Callable[[Any], Any]:
    """Return a recursion over the samples for every mode, compiled by numba; its argument is the voltages."""
    # Slow to import, and installed only where benchmarks are run.
    import numba

    system = DiagonalSystem.of(model)
    ratio, read = np.exp(system.exponent * hold), np.diag(system.velocity)
    push = ((ratio - 1) / system.exponent)[:, None] * system.input_gain

    @numba.njit
    def run(ratio: Any, push: Any, read: Any, voltage: Any, out: Any) -> None:
        for mode in range(ratio.size):
            a, b, real, imaginary = ratio[mode].real, ratio[mode].imag, 0.0, 0.0
            for n in range(voltage.shape[1]):
                out[mode, n] = read[mode].real * real - read[mode].imag * imaginary
                x, y = 0.0, 0.0
                for channel in range(voltage.shape[0]):
                    x += push[mode, channel].real * voltage[channel, n]
                    y += push[mode, channel].imag * voltage[channel, n]
                real, imaginary = a * real - b * imaginary + x, a * imaginary + b * real + y

    def respond(voltage: Any) -> Any:
        out = np.empty((ratio.size, voltage.shape[1]))
        run(ratio, push, read, voltage, out)
        return out

    return respond


def eighty_bits(model: ModalModel, voltage: Any, hold: float) -> Any:
    """Return the modal velocities, stepped in 80-bit complex numbers: the reference."""
    pi = np.longdouble("3.14159265358979323846264338327950288")
    w, xi = 2 * pi * model.natural_frequency.astype(np.longdouble), model.damping_ratio.astype(np.longdouble)
    s = -xi * w + 1j * w * np.sqrt((1 - xi) * (1 + xi))
    grown = np.exp(s * np.longdouble(hold))
    push = ((grown - 1) / s)[:, None] * (model.modal_gain.astype(np.longdouble) @ voltage.astype(np.longdouble))
    state, velocity = np.zeros(s.size, dtype=np.clongdouble), np.empty(push.shape)
    for n in range(push.shape[1]):
        velocity[:, n] = (state.real + s.real / s.imag * state.imag).astype(float)
        state = grown * state + push[:, n]
    return velocity
