"""Coupled equations in real form, which give the residual of the law if the eigenvectors are ill-conditioned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier, late_steps
from modaltouch.stimulus.fingers import CoupledModes
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantities import FloatArray

_BLOCK = 256
"""Samples per matrix product."""

_TERMS = 5
"""Number of powers of the clock delay of a step; the remainder is below 1e-12 at 90 kHz with a 250 MHz clock."""


@dataclass(frozen=True, eq=False)
class RealSystem:
    """Real first-order equations x' = matrix @ x + force @ voltage, including the amplifier's states.

    Attributes
    ----------
    matrix : (n_states, n_states) array
        System matrix; the state consists of displacements times angular frequency, velocities, Maxwell terms and
        second masses, and the amplifier.
    force : (n_states, n_channels) array
        Rate of each state per volt.
    n_modes : int
        Number of modes.
    delay : float
        Delay from the generator's output to the beam [s].
    """

    matrix: FloatArray
    force: FloatArray
    n_modes: int
    delay: float
    # Decays and effects already computed, by time.
    _known: dict[float, tuple[FloatArray, FloatArray]] = field(default_factory=dict, init=False)

    @classmethod
    def of(cls, model: ModalModel, amplifier: Amplifier | None) -> RealSystem:
        """Return the equations of a beam with fingers on it, behind an amplifier."""
        given = model.angular_frequency, model.damping_ratio, model.modal_gain, model.loads
        modes = CoupledModes.of(*given)
        if amplifier is None or amplifier.bandwidth is None:
            delay = 0.0 if amplifier is None else amplifier.delay
            return cls(modes.matrix, modes.force, modes.n_modes, delay)
        pole, (n, n_channels) = 2 * np.pi * amplifier.bandwidth, modes.force.shape
        matrix = np.block([[modes.matrix, modes.force], [np.zeros((n_channels, n)), -pole * np.eye(n_channels)]])
        force = np.concatenate([np.zeros((n, n_channels)), pole * np.eye(n_channels)])
        return cls(matrix, force, modes.n_modes, amplifier.delay)

    def reached(self, voltage: FloatArray, timing: Timing, instant: float) -> FloatArray:
        """Return modal velocities, then displacements times angular frequency, from rest, (2 n_modes,) array [m/s].

        Parameters
        ----------
        voltage : (n_channels, n_samples) array
            Held samples at the beam from the start of the burst [V].
        timing : Timing
            Clock of the samples.
        instant : float
            Time from the start of the burst [s].
        """
        n_whole, remainder = timing.samples_until(instant - self.delay)
        n_whole = min(n_whole, voltage.shape[1])
        over, held = self._held(timing.hold)
        state = np.zeros(len(self.matrix))
        for effect, samples in self._inputs(voltage[:, :n_whole], timing, over, held):
            state = state + _summed(samples, over, effect)
        if remainder:
            rest, begun = self._held(remainder)
            state = rest @ state
            if n_whole < min(voltage.shape[1], timing.n_samples):
                wait = 0.0 if timing.clock_error is None else min(float(timing.clock_error[n_whole]), remainder)
                late = self._held(remainder - wait)[1]
                state = state + late @ voltage[:, n_whole]
                if wait and n_whole:
                    state = state + (begun - late) @ voltage[:, n_whole - 1]
        n = self.n_modes
        return np.concatenate([state[n : 2 * n], state[:n]])

    def _held(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return the decay matrix over a time [s] and the contribution of 1 V held for that time to the states."""
        if time not in self._known:
            from scipy.linalg import expm

            n, n_channels = self.force.shape
            whole = np.zeros((n + n_channels, n + n_channels))
            whole[:n, :n], whole[:n, n:] = self.matrix * time, self.force * time
            grown = expm(whole)
            self._known[time] = grown[:n, :n], grown[:n, n:]
        return self._known[time]

    def _inputs(
        self, voltage: FloatArray, timing: Timing, over: FloatArray, held: FloatArray
    ) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield effects and inputs: the voltages, then the steps times powers of their clock delay."""
        yield held, voltage
        effect = over @ self.force
        for term, steps in zip(range(1, _TERMS + 1), late_steps(voltage, timing, 0, voltage.shape[1]), strict=False):
            effect = -effect / term if term == 1 else -(self.matrix @ effect) / term
            yield effect, steps


def _summed(samples: FloatArray, over: FloatArray, effect: FloatArray) -> FloatArray:
    """Return the sum of ``over**(samples after it) @ effect @ sample``, (n_states,) array."""
    rows, power = effect[None], over
    while len(rows) < _BLOCK:
        rows, power = np.concatenate([rows, power @ rows]), power @ power
    filled = np.pad(samples, ((0, 0), (-samples.shape[1] % _BLOCK, 0)))
    # Transpose the small array rather than the long one, and copy no channel.
    turned = np.ascontiguousarray(rows[::-1].transpose(2, 0, 1))
    state = np.zeros(len(over))
    for push in (filled.reshape(len(samples), -1, _BLOCK) @ turned).sum(axis=0):
        state = power @ state + push
    return state
