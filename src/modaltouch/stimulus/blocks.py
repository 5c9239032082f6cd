"""A response block by block: within a block matrix products, from block to block a scan of the states.

Each state decays over a sample and is then pushed by the sample's inputs. A block of outputs is one product of the
block's inputs and the states at its start; those follow from the blocks' pushes by the same method one level up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.peak_bound import PeakBound, bound_weights
from modaltouch.stimulus.recursion import SHORT, BlockRecursion
from modaltouch.stimulus.synthesis import decay

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

__all__ = ["SHORT", "BlockKernel", "filled_blocks"]

_CHUNK = 32_768
"""Samples per chunk: bounds the memory, and keeps a chunk of voltages in the second-level cache."""

LIKELIEST = 64
"""Blocks looked at first where a peak is sought: what they reach spares most of the others."""


def filled_blocks(inputs: FloatArray) -> FloatArray:
    """Return inputs as blocks, the last filled up with zeros, (n_inputs, n_blocks, SHORT) array.

    Parameters
    ----------
    inputs : (n_inputs, n_samples) array
        Of consecutive samples.
    """
    beyond = -inputs.shape[1] % SHORT
    filled = np.pad(inputs, ((0, 0), (0, beyond))) if beyond else inputs
    return filled.reshape(len(inputs), -1, SHORT)


@dataclass(frozen=True, eq=False)
class BlockKernel:
    """What a block of inputs and the states at its start do to the outputs and to the states at its end.

    Everything is computed when first needed: bounds need no tables, states no outputs.

    Attributes
    ----------
    exponent : (n_states,) complex array
        Exponents [1/s].
    push : (n_states, n_inputs) complex array
        What a unit of each input leaves in the states at the end of its sample.
    output : (n_outputs, n_states) complex array
        The outputs are the real part of ``output @ state``.
    hold : float
        Length of a sample [s].
    """

    exponent: ComplexArray
    push: ComplexArray
    output: ComplexArray
    hold: float

    @classmethod
    def of(cls, system: DiagonalSystem, output: ComplexArray, hold: float) -> BlockKernel:
        """Return the kernel of held voltages, and of outputs that are the real part of ``output @ state``.

        Parameters
        ----------
        system : DiagonalSystem
            The beam behind its amplifier.
        output : (n_outputs, n_states) complex array
            What is read off the states.
        hold : float
            Length of a sample [s].
        """
        return cls(system.exponent, system.held_gain(hold), output, hold)

    @cached_property
    def powers(self) -> ComplexArray:
        """Decays over 0 to SHORT - 1 samples, (n_states, SHORT) array [1]."""
        return decay(self.exponent, self.hold, np.arange(SHORT))

    @cached_property
    def scan(self) -> BlockRecursion:
        """How the states go on from block to block."""
        return BlockRecursion.of(self.exponent, self.hold)

    @cached_property
    def _into_state(self) -> list[tuple[NDArray[np.intp], ComplexArray]]:
        """For each input the states that it pushes, and what the samples of a block leave in them."""
        pushes = []
        for column in self.push.T:
            pushed = np.flatnonzero(column)
            pushes.append((pushed, column[pushed, None] * self.powers[pushed, ::-1]))
        return pushes

    @cached_property
    def _tables(self) -> list[tuple[tuple[int, ...], tuple[int, ...], FloatArray]]:
        """For each output its inputs, its states, and the right side of its product; what it does not hear is left out.

        The rows of a right side are the samples of the inputs, then the real and the imaginary parts of the states.
        """
        # Sample i of a block hears what an input did i - m - 1 samples ago, and none that is still to come.
        heard = np.zeros((self.output.shape[0], self.push.shape[1], 2 * SHORT))
        heard[:, :, SHORT + 1 :] = ((self.output[:, None, :] * self.push.T) @ self.powers[:, :-1]).real
        toeplitz = np.lib.stride_tricks.sliding_window_view(heard, SHORT, axis=2)[:, :, SHORT:0:-1]
        acts = np.abs(self.output) @ np.abs(self.push) > 0
        tables = []
        for row, hears, which in zip(self.output, toeplitz, acts, strict=True):
            states, inputs = np.flatnonzero(row), np.flatnonzero(which)
            weighted = row[states, None] * self.powers[states]
            right = np.concatenate([hears[inputs].reshape(-1, SHORT), weighted.real, -weighted.imag])
            tables.append((tuple(inputs.tolist()), tuple(states.tolist()), right))
        return tables

    def write(self, inputs: Callable[[int, int], FloatArray], out: FloatArray) -> None:
        """Write the outputs at the starts of the samples from rest, chunk by chunk: no memory grows with their number.

        Parameters
        ----------
        inputs : callable
            Returns the inputs of the samples from a first one up to, without it, a last, (n_inputs, n) array.
        out : (n_outputs, n_samples) array
            Where they go; each row contiguous.
        """
        state = np.zeros(self.exponent.size, dtype=complex)
        for start in range(0, out.shape[1], _CHUNK):
            stop = min(start + _CHUNK, out.shape[1])
            blocks = filled_blocks(inputs(start, stop))
            begin, state = self.states(blocks, state)
            self.respond(blocks, begin, out[:, start:stop])

    def states(self, blocks: FloatArray, state: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the states at the starts of the blocks, and after the last.

        Parameters
        ----------
        blocks : (n_inputs, n_blocks, SHORT) array
            Their inputs.
        state : (n_states,) complex array
            At the start of the first.

        Returns
        -------
        begin : (n_states, n_blocks) complex array
            At the starts.
        after : (n_states,) complex array
            After the last.
        """
        return self.scan.follow(self.pushed(blocks), state)

    def pushed(self, blocks: FloatArray) -> ComplexArray:
        """Return what each block leaves in the states at its end, (n_states, n_blocks) array.

        Parameters
        ----------
        blocks : (n_inputs, n_blocks, SHORT) array
            Their inputs.
        """
        together = np.zeros((self.exponent.size, blocks.shape[1]), dtype=complex)
        for (states, column), rows in zip(self._into_state, blocks, strict=True):
            parts = np.concatenate([column.real, column.imag]) @ rows.T
            together.real[states] += parts[: states.size]
            together.imag[states] += parts[states.size :]
        return together

    def respond(self, blocks: FloatArray, begin: ComplexArray, out: FloatArray) -> None:
        """Write the outputs at the starts of the samples.

        Parameters
        ----------
        blocks : (n_inputs, n_blocks, SHORT) array
            Their inputs.
        begin : (n_states, n_blocks) complex array
            From `states`.
        out : (n_outputs, n_samples) array
            Where they go, at most the samples of the blocks; each row contiguous.
        """
        n_whole, rest = divmod(out.shape[1], SHORT)
        sides: dict[tuple[tuple[int, ...], int], FloatArray] = {}
        for (inputs, states, table), row in zip(self._tables, out, strict=True):
            # Outputs of the same inputs share one left side; only its states are written anew.
            key = (inputs, len(states))
            if key not in sides:
                sides[key] = _inputs_beside(blocks, inputs, len(states))
            side = sides[key]
            _write_states(side, begin, states)
            np.matmul(side[:n_whole], table, out=row[: n_whole * SHORT].reshape(n_whole, SHORT))
            if rest:
                row[n_whole * SHORT :] = side[n_whole] @ table[:, :rest]

    def respond_one(self, place: int, blocks: FloatArray, begin: ComplexArray) -> FloatArray:
        """Return one output at the starts of the samples of some blocks, (n_blocks, SHORT) array.

        Parameters
        ----------
        place : int
            Which output.
        blocks : (n_inputs, n_blocks, SHORT) array
            Their inputs.
        begin : (n_states, n_blocks) complex array
            The states at their starts.
        """
        inputs, states, table = self._tables[place]
        side = _inputs_beside(blocks, inputs, len(states))
        _write_states(side, begin, states)
        return np.asarray(side @ table)

    def bounds(self, blocks: FloatArray, begin: ComplexArray) -> FloatArray:
        """Return what each output cannot pass within each block, (n_outputs, n_blocks) array.

        The states bound the free part; the forced part is bounded by the block's mean input, of which a fast mode
        feels little, and by the energy of what remains.

        Parameters
        ----------
        blocks, begin
            As for `respond`.
        """
        steady, worst = self._bound_weights
        effort = PeakBound.of(blocks, begin)
        return np.asarray(np.abs(self.output) @ effort.size + steady @ effort.mean + worst @ effort.swing)

    @cached_property
    def _bound_weights(self) -> tuple[FloatArray, FloatArray]:
        return bound_weights(self.output, self.push, self.powers)

    def peak(self, place: int, blocks: FloatArray, begin: ComplexArray, bound: FloatArray, least: float) -> float:
        """Return the largest magnitude of one output within the blocks, or `least` where that is higher.

        Only blocks whose bound is higher are computed, the likeliest first.

        Parameters
        ----------
        place, blocks
            As for `respond_one`.
        begin : (n_states, n_blocks) complex array
            From `states`.
        bound : (n_blocks,) array
            From `bounds`.
        least : float
            Value that the output is known to reach.
        """
        if bound.max() <= least:
            return least
        order = np.argsort(-bound)
        for some in (order[:LIKELIEST], order[LIKELIEST:]):
            higher = some[bound[some] > least]
            if higher.size:
                part = self.respond_one(place, blocks[:, higher], begin[:, higher])
                least = max(least, float(part.max()), -float(part.min()))
        return least


def _inputs_beside(blocks: FloatArray, inputs: tuple[int, ...], n_states: int) -> FloatArray:
    """Return the left side of a product: the inputs' samples, and room for the states beside them."""
    side = np.empty((blocks.shape[1], SHORT * len(inputs) + 2 * n_states))
    for place, which in enumerate(inputs):
        side[:, place * SHORT : (place + 1) * SHORT] = blocks[which]
    return side


def _write_states(side: FloatArray, begin: ComplexArray, states: tuple[int, ...]) -> None:
    """Write the states into the last columns of a left side."""
    n_states = len(states)
    side[:, -2 * n_states : -n_states] = begin.real[states, :].T
    side[:, -n_states:] = begin.imag[states, :].T
