r"""The modal equations with the amplifier, as uncoupled complex first-order equations.

With :math:`s = -a + ib` the state :math:`z = \dot\eta - \bar s \eta` of a mode obeys
:math:`\dot z = s z + \psi`, from which :math:`\dot\eta = \mathrm{Re}[(1 + ia/b) z]` and
:math:`\omega\eta = \mathrm{Re}[-i (\omega/b) z]`. A second-order section would suffer from the cancellation in
:math:`1 - \cos(b\,dt)`; this form does not.

A first-order amplifier, :math:`\dot u = p (v - u)`, leaves the equations uncoupled: the state
:math:`y = z + \sum_c G_c u_c / (p + s)` obeys
:math:`\dot y = s y + \frac{p}{p+s} \sum_c G_c v_c`.

A voltage step played late by d contributes :math:`e^{-sd}` instead of 1 to a state of exponent s. The power series of
this factor in d becomes further inputs, the steps times powers of d. A few terms suffice: between two edges of a
250 MHz clock the phase of a 90 kHz mode advances by only 0.002 rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantities import ComplexArray, FloatArray
from modaltouch.stimulus.synthesis import BLOCK, CHUNK, decay, exponential_tables

if TYPE_CHECKING:
    from modaltouch.stimulus.fingers import CoupledModes, Load

_SERIES_REST = 1e-12
"""Remainder of the series in d relative to its first term [1]; four terms reach it at 90 kHz and 250 MHz."""


@dataclass(frozen=True)
class Amplifier:
    """The amplifier between generator and beam, the same for every channel.

    Attributes
    ----------
    gain : float
        Voltage at the beam per volt at the amplifier's input [V/V].
    limit : float
        Highest voltage at the beam [V].
    bandwidth : float or None
        Corner frequency of the amplifier's first-order pole [Hz]; None if negligible.
    delay : float
        Delay from the generator's output to the beam [s].
    """

    gain: float
    limit: float
    bandwidth: float | None = None
    delay: float = 0.0


@dataclass(frozen=True, eq=False)
class DiagonalSystem:
    """Uncoupled first-order equations x' = exponent * x + input_gain @ voltage and their outputs.

    Attributes
    ----------
    exponent : (n_states,) complex array
        One per mode, then one per channel if the amplifier has a pole [1/s].
    input_gain : (n_states, n_channels) complex array
        Rate of each state per volt [m/s^2 per V; V/s per V for the amplifier's states].
    velocity : (n_modes, n_states) complex array
        Modal velocities [m/s] are ``Re(velocity @ state)``.
    displacement : (n_modes, n_states) complex array
        Modal displacements times angular frequency [m/s] are ``Re(displacement @ state)``.
    delay : float
        Delay from the generator's output to the beam [s].
    n_poles : int
        Number of states of the amplifier, which come last.
    real : CoupledModes, optional
        The coupled equations, if fingers were perturbed slightly because their eigenvectors are ill-conditioned.
    """

    exponent: ComplexArray
    input_gain: ComplexArray
    velocity: ComplexArray
    displacement: ComplexArray
    delay: float
    n_poles: int = 0
    real: CoupledModes | None = None

    @classmethod
    def of(cls, model: ModalModel, amplifier: Amplifier | None = None) -> DiagonalSystem:
        """Return the equations of a beam behind an amplifier.

        Parameters
        ----------
        model : ModalModel
            The modes.
        amplifier : Amplifier, optional
            Its pole and delay are used, but not its gain, since voltages are those at the beam. None: no pole or delay.
        """
        return cls.of_modes(model.angular_frequency, model.damping_ratio, model.modal_gain, model.loads, amplifier)

    @classmethod
    def of_modes(
        cls,
        omega: FloatArray,
        damping_ratio: FloatArray,
        gain: FloatArray,
        loads: Sequence[Load] = (),
        amplifier: Amplifier | None = None,
    ) -> DiagonalSystem:
        """Return the equations of modes, coupled by fingers if there are loads.

        Parameters
        ----------
        omega, damping_ratio : (n_modes,) array
            Angular frequencies [rad/s] and damping ratios [1] of the free modes.
        gain : (n_modes, n_channels) array
            Modal accelerations per volt at the beam [m/s^2 per V].
        loads : sequence of Load
            Contact over the beam's moving mass, (n_modes, n_modes) array [1/kg], and finger, for each finger.
        amplifier : Amplifier, optional
            As in `of`.
        """
        if not loads:
            s = omega * (-damping_ratio + 1j * np.sqrt((1 - damping_ratio) * (1 + damping_ratio)))
            read_velocity, read_displacement = np.diag(1 - 1j * s.real / s.imag), np.diag(-1j * omega / s.imag)
            return cls.behind(amplifier, s, gain.astype(complex), read_velocity, read_displacement)
        from modaltouch.stimulus.fingers import uncouple

        uncoupled, real = uncouple(omega, damping_ratio, gain, loads)
        if real is not None and amplifier is not None:
            real = real.behind(amplifier.bandwidth, amplifier.delay)
        return replace(cls.behind(amplifier, *uncoupled), real=real)

    @classmethod
    def behind(
        cls,
        amplifier: Amplifier | None,
        exponent: ComplexArray,
        input_gain: ComplexArray,
        velocity: ComplexArray,
        displacement: ComplexArray,
    ) -> DiagonalSystem:
        """Return the equations of a beam behind an amplifier, uncoupled like those of the beam alone.

        Parameters
        ----------
        amplifier : Amplifier or None
            Its pole and delay are used.
        exponent, input_gain, velocity, displacement
            As the attributes, of the beam alone.
        """
        delay = 0.0 if amplifier is None else amplifier.delay
        if amplifier is None or amplifier.bandwidth is None:
            return cls(exponent, input_gain, velocity, displacement, delay)
        pole, n_channels = 2 * np.pi * amplifier.bandwidth, input_gain.shape[1]
        share = 1 / (pole + exponent)
        from_beam = np.concatenate([np.eye(exponent.size), -share[:, None] * input_gain], axis=1)
        return cls(
            exponent=np.concatenate([exponent, np.full(n_channels, -pole, dtype=complex)]),
            input_gain=np.concatenate([(pole * share)[:, None] * input_gain, pole * np.eye(n_channels)]),
            velocity=velocity @ from_beam,
            displacement=displacement @ from_beam,
            delay=delay,
            n_poles=n_channels,
        )

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return int(self.velocity.shape[0])

    @property
    def n_beam(self) -> int:
        """Number of states of the beam, which come first: one per mode, more if fingers add states or overdamp it."""
        return self.exponent.size - self.n_poles

    @property
    def coupled(self) -> bool:
        """Whether fingers couple modes, so that several modes respond to one state."""
        return bool(np.count_nonzero(self.velocity[:, : self.n_beam]) > self.n_modes)

    def held_gain(self, hold: float) -> ComplexArray:
        """Return the contribution of one volt held for a time [s] to each state, (n_states, n_channels) array."""
        return np.asarray((np.expm1(self.exponent * hold) / self.exponent)[:, None] * self.input_gain)

    def clock_gain(self, timing: Timing, held: float) -> ComplexArray:
        """Return the contribution of unit `clock_inputs` to the states after a time [s], (n_states, n_inputs) array.

        The time is measured from the start of the sample, is longer than its delay and ends by the end of the sample.
        """
        return np.concatenate([self.held_gain(held), *self._late_gains(timing, held)], axis=1)

    def _late_gains(self, timing: Timing, held: float) -> list[ComplexArray]:
        """Return the gains of ``step * d**k``, k from 1, for steps late by d; empty if the clock is never late."""
        if timing.clock_error is None:
            return []
        s = self.exponent
        turn = float(np.abs(s).max() * timing.clock_error.max())
        gain = (np.exp(s * held) / s)[:, None] * self.input_gain
        gains: list[ComplexArray] = []
        left = 1.0
        while left > _SERIES_REST:
            term = len(gains) + 1
            gain = gain * (-s / term)[:, None]
            gains.append(gain)
            left *= turn / (term + 1)
        return gains

    def held_states(self, voltage: FloatArray, hold: float) -> ComplexArray:
        """Return the states at the end of evenly held samples of each channel, from rest, (n_channels, n_states) array.

        Parameters
        ----------
        voltage : (n_channels, n_samples) array
            Voltages at the beam [V].
        hold : float
            Length of a sample [s].
        """
        return np.asarray(moments(voltage, self.exponent, hold) * self.held_gain(hold).T)

    def states_by_channel(self, voltage: FloatArray, timing: Timing, instant: float) -> ComplexArray:
        """Return the states due to each channel alone at an instant, from rest, on the generator's clock.

        Parameters
        ----------
        voltage : (n_channels, n_samples) array
            Held samples at the beam from the start of the burst [V].
        timing : Timing
            Clock of the samples.
        instant : float
            Time from the start of the burst, up to its end plus the delay [s].

        Returns
        -------
        (n_channels, n_states) complex array
            States; their sum over the channels is the state of the beam.
        """
        if instant <= self.delay:
            # Nothing has arrived yet.
            return np.zeros((voltage.shape[0], self.exponent.size), dtype=complex)
        n_whole, remainder = timing.samples_until(instant - self.delay)
        n_whole = min(n_whole, voltage.shape[1])
        hold = timing.hold
        played = voltage[:, :n_whole]
        driven = self.input_gain.T != 0
        states = moments(played, self.exponent, hold, driven) * self.held_gain(hold).T
        for gain, late in zip(self._late_gains(timing, hold), timing.late_steps(played, 0, n_whole), strict=False):
            states += moments(late, self.exponent, hold, driven) * gain.T
        if remainder:
            states = states * np.exp(self.exponent * remainder)
            if n_whole < min(voltage.shape[1], timing.n_samples):
                wait = 0.0 if timing.clock_error is None else min(float(timing.clock_error[n_whole]), remainder)
                begun = self.held_gain(remainder - wait)
                states = states + voltage[:, n_whole, None] * begun.T
                if wait and n_whole:
                    # The previous sample is held until the clock begins this one.
                    states = states + voltage[:, n_whole - 1, None] * (self.held_gain(remainder) - begun).T
        return np.asarray(states)

    def state_at(self, voltage: FloatArray, timing: Timing, instant: float) -> ComplexArray:
        """Return the state at an instant, from rest, (n_states,) array; arguments as in `states_by_channel`."""
        return np.asarray(self.states_by_channel(voltage, timing, instant).sum(axis=0))

    def read(self, state: ComplexArray) -> tuple[FloatArray, FloatArray]:
        """Return modal velocities, and displacements times angular frequency, two (n_modes,) arrays [m/s]."""
        return (self.velocity @ state).real, (self.displacement @ state).real


def moments(
    voltage: FloatArray, exponent: ComplexArray, hold: float, driven: NDArray[np.bool_] | None = None
) -> ComplexArray:
    """Return sums of voltage * exp(exponent * time until the end of the last sample), (n_channels, n_states) array [V].

    If `driven`, (n_channels, n_states) array, is given, only the selected sums are computed; the others are 0.
    """
    n_samples = voltage.shape[1]
    sums = np.zeros((voltage.shape[0], exponent.size), dtype=complex)
    for stop in range(n_samples, 0, -CHUNK * BLOCK):
        part = _chunk_moments(voltage[:, max(0, stop - CHUNK * BLOCK) : stop], exponent, hold, driven)
        sums += part if stop == n_samples else part * decay(exponent, hold, np.array([n_samples - stop]))[:, 0]
    return sums


def _chunk_moments(
    voltage: FloatArray, exponent: ComplexArray, hold: float, driven: NDArray[np.bool_] | None
) -> ComplexArray:
    """Return the moments of at most `CHUNK` blocks."""
    n_blocks, head = divmod(voltage.shape[1], BLOCK)
    fine, coarse = exponential_tables(exponent, hold, n_blocks)
    sums = np.zeros((voltage.shape[0], exponent.size), dtype=complex)
    for channel, row in enumerate(voltage):
        asked = slice(None) if driven is None else np.flatnonzero(driven[channel])
        some = fine[asked]
        n_some = len(some)
        fine_real = np.concatenate([some.real, some.imag]).T
        blocks = np.empty((n_blocks + 1, 2 * n_some))
        blocks[0] = row[:head] @ fine_real[BLOCK - head :]
        np.matmul(row[head:].reshape(n_blocks, BLOCK), fine_real, out=blocks[1:])
        per_block = blocks[:, :n_some] + 1j * blocks[:, n_some:]
        sums[channel, asked] = np.einsum("je,je->e", per_block, coarse[:, asked])
    return sums


def clock_inputs(voltage: FloatArray, timing: Timing, start: int, stop: int, n_inputs: int) -> FloatArray:
    """Return the inputs of a range of samples for the columns of `DiagonalSystem.clock_gain`.

    They are the voltages, (n_channels, n_samples) array [V], then steps times their delay on the clock [s], times its
    square, and so on, (n_inputs, stop - start) array.
    """
    if timing.clock_error is None:
        return voltage[:, start:stop]
    inputs = np.empty((n_inputs, stop - start))
    n_channels = len(voltage)
    inputs[:n_channels] = voltage[:, start:stop]
    rows = range(n_channels, n_inputs, n_channels)
    for row, term in zip(rows, timing.late_steps(voltage, start, stop), strict=False):
        inputs[row : row + n_channels] = term
    return inputs
