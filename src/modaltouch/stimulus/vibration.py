"""Response of the beam to held samples: velocity histories and peak speeds, computed in blocks of samples.

Over a sample each state decays, and the inputs of the sample add to it (the push). The outputs of a short block are one
matrix product of its inputs and the states at its start; those states follow from the pushes of the blocks by the same
recursion one level up. Histories are written in chunks of bounded memory. If only a peak is needed, an upper bound
rules out most of the blocks; in few samples of a fast mode it is sought at several instants of each.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import DiagonalSystem, clock_inputs
from modaltouch.stimulus.quantities import ComplexArray, FloatArray
from modaltouch.stimulus.synthesis import BLOCK, decay, exponential_tables

SHORT = 16
"""Samples per block; this number needs the least work per sample."""

LEVELS = 3
"""Blocks, groups of blocks, groups of groups: three levels step over 16^4 samples, twice the longest chunk."""

Sides = dict[tuple[tuple[int, ...], int], tuple[tuple[int, ...], FloatArray]]
"""Left factors of the products, keyed by inputs and number of states, each with the states last written into it."""

_CHUNK = 32_768
"""Samples per chunk: bounds the memory and keeps a chunk of voltages in the second-level cache."""

_OUTPUTS = 32
"""Number of outputs per batch in the search for peaks, which bounds the memory."""

_DENSE = 0.25
"""Fraction of candidate blocks above which computing all of them is cheaper than copying these [1]."""

TURN = 0.3
"""Largest turn or decay of the fastest mode in a sample at whose start alone a peak is sought [rad]. Of a motion of
this mode alone the starts miss at most 1.1 %, of the shipped stimuli 3e-4. In longer samples it is sought three times
as often as this; in all, that would triple the time of the search."""


@dataclass(frozen=True, eq=False)
class BlockRecursion:
    """Recursion of the states from block to block, x[j + 1] = ratio x[j] + pushed[j], in groups of SHORT blocks."""

    # (n_states, LEVELS, SHORT + 1) complex: decays over 0 to SHORT blocks, groups of blocks, and so on [1]
    power: ComplexArray
    # (LEVELS, n_states, SHORT, SHORT) complex: contribution of each push of a group (rows) to the states before the
    # later blocks of the group (columns)
    triangle: ComplexArray

    @classmethod
    def of(cls, exponent: ComplexArray, hold: float) -> BlockRecursion:
        """Return the recursion of blocks of SHORT samples, each held for `hold` seconds."""
        steps = np.outer(SHORT ** np.arange(1, LEVELS + 1), np.arange(SHORT + 1))
        power = decay(exponent, hold, steps.ravel()).reshape(exponent.size, LEVELS, SHORT + 1)
        later = np.zeros((LEVELS, exponent.size, 2 * SHORT), dtype=complex)
        later[:, :, SHORT + 1 :] = power[:, :, : SHORT - 1].transpose(1, 0, 2)
        return cls(power, np.lib.stride_tricks.sliding_window_view(later, SHORT, axis=2)[:, :, SHORT:0:-1])

    def follow(self, pushed: ComplexArray, state: ComplexArray, level: int = 0) -> tuple[ComplexArray, ComplexArray]:
        """Return the states before each block, (n_states, n_blocks) array, and after the last, (n_states,) array.

        Level 0 steps over blocks, 1 over groups of them, and so on; `state` is the one before the first block.
        """
        n_states, n_blocks = pushed.shape
        n_groups, rest = divmod(n_blocks, SHORT)
        if n_groups == 0 or level == LEVELS - 1:
            ratio = self.power[:, level, 1]
            begin = np.empty((n_blocks, n_states), dtype=complex)
            for row, push in zip(begin, pushed.T, strict=True):
                row[:] = state
                state = ratio * state + push
            return begin.T, state
        groups = pushed[:, : n_groups * SHORT].reshape(n_states, n_groups, SHORT)
        starts, state = self.follow(self.total(groups, level), state, level + 1)
        begin = np.empty((n_states, n_blocks), dtype=complex)
        self.within(groups, starts, begin[:, : n_groups * SHORT].reshape(n_states, n_groups, SHORT), level)
        if rest:
            begin[:, n_groups * SHORT :], state = self.follow(pushed[:, n_groups * SHORT :], state, level)
        return begin, state

    def total(self, groups: ComplexArray, level: int = 0) -> ComplexArray:
        """Return the push of each group of blocks, (n_states, n_groups, SHORT) array, on the states at its end."""
        return np.asarray(np.matmul(groups, self.power[:, level, SHORT - 1 :: -1, None])[:, :, 0])

    def within(self, pushed: ComplexArray, starts: ComplexArray, out: ComplexArray, level: int = 0) -> None:
        """Write the states before each block, (n_states, n_groups, SHORT) array, from those before each group."""
        np.matmul(pushed, self.triangle[level], out=out)
        out += starts[:, :, None] * self.power[:, level, None, :SHORT]


@dataclass(frozen=True, eq=False)
class BlockKernel:
    """Effect of a block of inputs and of its initial states on its outputs and final states; tables on first use.

    Attributes
    ----------
    exponent : (n_states,) complex array
        Exponents [1/s].
    push : (n_states, n_inputs) complex array
        Contribution of a unit of each input to the states at the end of its sample.
    output : (n_outputs, n_states) complex array
        The outputs are the real part of ``output @ state``, with the state at the start of the sample, plus `direct`.
    direct : (n_outputs, n_inputs) array
        Contribution of a unit of each input of the same sample to the outputs.
    hold : float
        Length of a sample [s].
    """

    exponent: ComplexArray
    push: ComplexArray
    output: ComplexArray
    direct: FloatArray
    hold: float

    @classmethod
    def of(cls, system: DiagonalSystem, output: ComplexArray, hold: float) -> BlockKernel:
        """Return the kernel of a system without `direct`, for evenly held voltages."""
        push = system.held_gain(hold)
        return cls(system.exponent, push, output, np.zeros((len(output), push.shape[1])), hold)

    @classmethod
    def within(
        cls,
        system: DiagonalSystem,
        output: ComplexArray,
        timing: Timing,
        late: float,
        at_once: FloatArray | float = 0.0,
    ) -> BlockKernel:
        """Return the kernel of the outputs at a time `late` [s] after the start of each sample on the clock.

        `at_once` is a further contribution of each input to the outputs while it lasts, (n_outputs, n_inputs) array.
        """
        push, exponent = system.clock_gain(timing, timing.hold), system.exponent
        direct = np.broadcast_to(at_once, (len(output), push.shape[1]))
        direct = direct + (output @ system.clock_gain(timing, late)).real if late else direct
        return cls(exponent, push, output * np.exp(exponent * late), direct, timing.hold)

    @staticmethod
    def blocks(inputs: FloatArray, length: int = SHORT) -> FloatArray:
        """Split samples into blocks, the last padded with zeros, (n_inputs, n_blocks, length) array."""
        beyond = -inputs.shape[1] % length
        filled = np.pad(inputs, ((0, 0), (0, beyond))) if beyond else inputs
        return filled.reshape(len(inputs), -1, length)

    @cached_property
    def powers(self) -> ComplexArray:
        """Decays over 0 to SHORT - 1 samples, (n_states, SHORT) array [1]."""
        return decay(self.exponent, self.hold, np.arange(SHORT))

    @cached_property
    def scan(self) -> BlockRecursion:
        """Recursion of the states from block to block."""
        return BlockRecursion.of(self.exponent, self.hold)

    @cached_property
    def _into_state(self) -> list[tuple[NDArray[np.intp], ComplexArray]]:
        """For each input, the states that it drives and the contribution of each sample of a block to them."""
        pushes = []
        for column in self.push.T:
            pushed = np.flatnonzero(column)
            pushes.append((pushed, column[pushed, None] * self.powers[pushed, ::-1]))
        return pushes

    @cached_property
    def _tables(self) -> list[tuple[tuple[int, ...], tuple[int, ...], FloatArray]]:
        """For each output, the inputs and states that affect it and the right factor of its matrix product.

        The rows of a right factor are the samples of the inputs, then the real and the imaginary parts of the states.
        """
        # Sample i of a block responds to sample m of an input after i - m - 1 samples of decay, if m < i.
        heard = np.zeros((*self.direct.shape, 2 * SHORT))
        heard[:, :, SHORT] = self.direct
        heard[:, :, SHORT + 1 :] = ((self.output[:, None, :] * self.push.T) @ self.powers[:, :-1]).real
        toeplitz = np.lib.stride_tricks.sliding_window_view(heard, SHORT, axis=2)[:, :, SHORT:0:-1]
        acts = np.abs(self.output) @ np.abs(self.push) + np.abs(self.direct) > 0
        tables = []
        for row, hears, which in zip(self.output, toeplitz, acts, strict=True):
            states, inputs = np.flatnonzero(row), np.flatnonzero(which)
            weighted = row[states, None] * self.powers[states]
            right = np.concatenate([hears[inputs].reshape(-1, SHORT), weighted.real, -weighted.imag])
            tables.append((tuple(inputs.tolist()), tuple(states.tolist()), right))
        return tables

    def write(self, inputs: Callable[[int, int], FloatArray], out: FloatArray) -> None:
        """Write the outputs at the starts of the samples, from rest, in chunks of bounded memory.

        Parameters
        ----------
        inputs : callable
            Returns the inputs of the samples from `start` up to but excluding `stop`, (n_inputs, n) array.
        out : (n_outputs, n_samples) array
            Receives the outputs; each row contiguous.
        """
        state = np.zeros(self.exponent.size, dtype=complex)
        for start in range(0, out.shape[1], _CHUNK):
            stop = min(start + _CHUNK, out.shape[1])
            blocks = self.blocks(inputs(start, stop))
            begin, state = self.states(blocks, state)
            self.respond(blocks, begin, out[:, start:stop])

    def peaks(self, blocks: FloatArray, pushed: ComplexArray, starts: ComplexArray) -> FloatArray:
        """Return the largest magnitude of each output, (n_outputs,) array.

        Parameters
        ----------
        blocks : (n_inputs, n_groups, SHORT**2) array
            Inputs of groups of SHORT blocks.
        pushed : (n_states, n_groups, SHORT) complex array
            Push of each block on the states at its end.
        starts : (n_states, n_groups) complex array
            States at the start of each group.
        """
        peak, some = np.zeros(len(self.output)), np.empty((len(self.output), _CHUNK))
        for start in range(0, starts.shape[1], _CHUNK // SHORT**2):
            groups = slice(start, start + _CHUNK // SHORT**2)
            part, first = blocks[:, groups].reshape(len(blocks), -1, SHORT), starts[:, groups]
            begin = np.empty((*first.shape, SHORT), dtype=complex)
            self.scan.within(pushed[:, groups], first, begin)
            course = some[:, : part.shape[1] * SHORT]
            self.respond(part, begin.reshape(len(first), -1), course)
            peak = np.maximum(peak, np.maximum(course.max(axis=1), -course.min(axis=1)))
        return peak

    def states(self, blocks: FloatArray, state: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the states at the starts of blocks, (n_states, n_blocks) array, and after the last, (n_states,) array.

        The inputs are the `blocks`, (n_inputs, n_blocks, SHORT) array; `state` is the one before the first.
        """
        return self.scan.follow(self.pushed(blocks), state)

    def pushed(self, blocks: FloatArray) -> ComplexArray:
        """Return the push of each block of inputs on the states at its end, (n_states, n_blocks) array."""
        together = np.zeros((self.exponent.size, blocks.shape[1]), dtype=complex)
        for (states, column), rows in zip(self._into_state, blocks, strict=True):
            parts = np.concatenate([column.real, column.imag]) @ rows.T
            together.real[states] += parts[: states.size]
            together.imag[states] += parts[states.size :]
        return together

    def respond(self, blocks: FloatArray, begin: ComplexArray, out: FloatArray, sides: Sides | None = None) -> None:
        """Write the outputs at the starts of the samples; `blocks` and `begin` as in `states`.

        Parameters
        ----------
        out : (n_outputs, n_samples) array
            Receives the outputs of the samples, at most as many as the blocks hold; each row contiguous.
        sides : dict, optional
            Left factors from earlier calls with the same blocks and states; new ones are added.
        """
        n_whole, rest = divmod(out.shape[1], SHORT)
        sides = {} if sides is None else sides
        for (inputs, states, table), row in zip(self._tables, out, strict=True):
            # Outputs with the same inputs share one left factor; only its states are rewritten, if they differ.
            key = (inputs, len(states))
            written, side = sides.get(key) or (None, _inputs_beside(blocks, inputs, len(states)))
            if written != states:
                _write_states(side, begin, states)
                sides[key] = states, side
            np.matmul(side[:n_whole], table, out=row[: n_whole * SHORT].reshape(n_whole, SHORT))
            if rest:
                row[n_whole * SHORT :] = side[n_whole] @ table[:, :rest]


def _inputs_beside(blocks: FloatArray, inputs: tuple[int, ...], n_states: int) -> FloatArray:
    """Return the left factor of a product: the samples of the inputs, and free columns for the states."""
    side = np.empty((blocks.shape[1], SHORT * len(inputs) + 2 * n_states))
    for place, which in enumerate(inputs):
        side[:, place * SHORT : (place + 1) * SHORT] = blocks[which]
    return side


def _write_states(side: FloatArray, begin: ComplexArray, states: tuple[int, ...]) -> None:
    """Write the states into the last columns of a left factor."""
    n_states = len(states)
    side[:, -2 * n_states : -n_states] = begin.real[states, :].T
    side[:, -n_states:] = begin.imag[states, :].T


@dataclass(frozen=True, eq=False)
class BlockStates:
    """States at the starts of long blocks during a burst from rest; short blocks are computed only to find peaks.

    Attributes
    ----------
    system : DiagonalSystem
        The beam behind its amplifier.
    timing : Timing
        Clock of the samples.
    push : (n_states, n_inputs) complex array
        Contribution of a unit of each input to the states at the end of its sample.
    blocks : (n_inputs, n_blocks, BLOCK) array
        Voltages, then the steps times powers of their clock delay; the last block is padded with zeros.
    pushed : (n_states, n_blocks, SHORT) complex array
        Contribution of each of the SHORT short blocks in a block to the states at the end of the short block.
    begin : (n_states, n_blocks + 1) complex array
        States at the starts of the blocks, and after the last.
    """

    system: DiagonalSystem
    timing: Timing
    push: ComplexArray
    blocks: FloatArray
    pushed: ComplexArray
    begin: ComplexArray

    @classmethod
    def of(cls, system: DiagonalSystem, voltage: FloatArray, timing: Timing) -> BlockStates:
        """Return the states for held samples at the beam, (n_channels, n_samples) array [V]."""
        push = system.clock_gain(timing, timing.hold)
        inputs = clock_inputs(voltage, timing, 0, voltage.shape[1], push.shape[1])
        blocks = BlockKernel.blocks(inputs, BLOCK)
        kernel = BlockKernel.within(system, np.empty((0, len(push)), dtype=complex), timing, 0.0)
        pushed = kernel.pushed(blocks.reshape(len(inputs), -1, SHORT)).reshape(-1, blocks.shape[1], SHORT)
        rest = np.zeros(system.exponent.size, dtype=complex)
        begin, left = kernel.scan.follow(kernel.scan.total(pushed), rest, 1)
        return cls(system, timing, push, blocks, pushed, np.concatenate([begin, left[:, None]], axis=1))

    @cached_property
    def _magnitudes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of each block, the magnitudes of the states at its start and of its mean inputs, and how far inputs deviate.

        The deviation is the root of the sum of squared deviations from the mean.
        """
        mean = self.blocks @ np.full(BLOCK, 1 / BLOCK)
        energy = np.einsum("cji,cji->cj", self.blocks, self.blocks)
        deviation = np.sqrt(np.maximum(energy * (1 + 1e-12) - BLOCK * mean**2, 0.0))
        return np.abs(self.begin[:, :-1]), np.abs(mean), deviation

    def _bound(self, kernel: BlockKernel) -> FloatArray:
        """Return upper bounds of the outputs of a kernel in each block, (n_outputs, n_blocks) array."""
        fine, _ = exponential_tables(kernel.exponent, kernel.hold, 1)
        later = ((kernel.output[:, None, :] * kernel.push.T) @ fine[:, ::-1]).real
        impulse = np.concatenate([kernel.direct[:, :, None], later], axis=2)
        steady, worst = np.abs(impulse.cumsum(axis=2)).max(axis=2), np.sqrt((impulse**2).sum(axis=2))
        size, mean, deviation = self._magnitudes
        return np.asarray(np.abs(kernel.output) @ size + steady @ mean + worst @ deviation)

    def peak(self, output: ComplexArray, at_once: FloatArray | None = None) -> FloatArray:
        """Return the largest magnitude of each output until the start of the next burst, (n_outputs,) array.

        Parameters
        ----------
        output : (n_outputs, n_states) complex array
            The outputs are ``Re(output @ state)``.
        at_once : (n_outputs, n_inputs) array, optional
            Further contribution of each input to the outputs while it lasts.
        """
        if at_once is not None:
            return self._different_peaks(output, at_once)
        if len(output) > _OUTPUTS:
            starts = range(0, len(output), _OUTPUTS)
            return np.concatenate([self.peak(output[start : start + _OUTPUTS]) for start in starts])
        some, places = self._different(output)
        return self._different_peaks(some, np.zeros((len(some), self.push.shape[1])))[places]

    def _different_peaks(self, output: ComplexArray, at_once: FloatArray) -> FloatArray:
        """Return the peaks of different outputs, at the starts of the samples and at instants between them."""
        # The outputs at the starts of the blocks are lower bounds of the peaks, which rule out most blocks.
        starts = (output @ self.begin).real
        starts[:, :-1] += at_once @ self.blocks[:, :, 0]
        peak = np.abs(starts).max(axis=1)
        for late in search_instants(self.system, self.timing, jumps=bool(at_once.any())).tolist():
            peak = self._peak_of_instants(BlockKernel.within(self.system, output, self.timing, late, at_once), peak)
        return np.asarray(peak + 0.0)  # not -0, the peak of a point that does not move

    def _peak_of_instants(self, kernel: BlockKernel, peak: FloatArray) -> FloatArray:
        """Return the peaks, raised where the outputs of a kernel exceed them."""
        bound = self._bound(kernel)
        which = np.flatnonzero((bound > peak[:, None]).any(axis=0))
        some = which if which.size <= _DENSE * bound.shape[1] else slice(bound.shape[1])
        peak = np.maximum(peak, kernel.peaks(self.blocks[:, some], self.pushed[:, some], self.begin[:, some]))
        period = int(self.timing.sampling_rate / self.timing.repetition_rate)
        silence = max(0, period - BLOCK * bound.shape[1])
        return self._peak_of_decay(kernel.output * self.begin[:, -1], silence, peak)

    def _different(self, output: ComplexArray) -> tuple[ComplexArray, list[int]]:
        """Return the outputs unique up to sign, and for each output the index of its representative.

        States that are not driven are ignored: symmetric zones share one output if only symmetric modes are driven.
        """
        driven = output * self.system.input_gain.any(axis=1)
        first = np.take_along_axis(driven, (driven != 0).argmax(axis=1)[:, None], axis=1)
        upright = driven * np.where(first.real < 0, -1.0, 1.0) + 0.0
        seen: dict[bytes, int] = {}
        places = [seen.setdefault(row.tobytes(), len(seen)) for row in upright]
        return upright[[places.index(place) for place in range(len(seen))]], places

    def _peak_of_decay(self, amplitude: ComplexArray, n_samples: int, peak: FloatArray) -> FloatArray:
        """Return the peaks including the decay after the burst, computed only while it could exceed them."""
        exponent, hold = self.system.exponent, self.timing.hold
        for start in range(0, n_samples, BLOCK):
            now = amplitude * decay(exponent, hold, np.array([start]))[:, 0]
            if (np.abs(now).sum(axis=1) <= peak).all():
                break
            steps = np.arange(min(BLOCK, n_samples - start))
            speed = np.abs((now @ decay(exponent, hold, steps)).real)
            peak = np.maximum(peak, speed.max(axis=1))
        return peak


def search_instants(system: DiagonalSystem, timing: Timing, *, jumps: bool = False) -> FloatArray:
    """Return the times from the start of each sample at which peaks are sought, (n_instants,) array [s].

    Peaks of outputs that jump with the voltage are sought twice as often as TURN in every sample, and at its end.
    """
    # A strongly damped oscillation passes its peak in the time of its decay.
    turn = float(np.abs(system.exponent[system.exponent.imag > 0].view(float)).max(initial=0.0)) * timing.hold
    n_instants = 1 if turn <= TURN * (not jumps) or timing.at_samples else math.ceil((3 - jumps) * turn / TURN)
    return np.asarray(np.arange(n_instants + jumps) * timing.hold / n_instants)


def history(
    system: DiagonalSystem, output: ComplexArray, voltage: FloatArray, timing: Timing, late: float = 0.0
) -> FloatArray:
    """Return the outputs ``Re(output @ state)`` at the same time of each sample of a burst from rest.

    Parameters
    ----------
    system, output, timing
        As in `BlockKernel.of`; the clock of the samples.
    voltage : (n_channels, n_samples) array
        Held samples at the beam [V].
    late : float
        Time from the start of each sample [s].
    """
    kernel, course = BlockKernel.within(system, output, timing, late), np.empty((output.shape[0], voltage.shape[1]))
    n_inputs = kernel.push.shape[1]
    kernel.write(lambda start, stop: clock_inputs(voltage, timing, start, stop, n_inputs), course)
    return course
