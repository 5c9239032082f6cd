"""A response block by block: within a block matrix products, from block to block a scan of the states.

Each state is a one-pole, x' = exponent x + input_gain v, of held samples. A block of outputs is one product of the
block's voltages and the states at its start; those follow from the blocks' pushes by the same method one level up.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.synthesis import decay

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

SHORT = 32
"""Samples per block: the work per sample is least where a block is about as long as a product is efficient."""

LIKELIEST = 64
"""Blocks looked at first where a peak is sought: what they reach spares most of the others."""

LEVELS = 3
"""Blocks, groups of blocks, groups of groups: a chunk of 32^4 samples would need no more."""


@dataclass(frozen=True, eq=False)
class Scan:
    """Follows states from block to block, x[j + 1] = ratio x[j] + pushed[j], by groups of SHORT blocks.

    Attributes
    ----------
    power : (n_states, LEVELS, SHORT + 1) complex array
        Decays over 0 to SHORT blocks, groups of blocks, and so on [1].
    triangle : (LEVELS, n_states, SHORT, SHORT) complex array
        What each push of a group (rows) leaves in the states before the later members (columns).
    """

    power: ComplexArray
    triangle: ComplexArray

    @classmethod
    def of(cls, exponent: ComplexArray, hold: float) -> Scan:
        """Return the scan of blocks of SHORT samples.

        Parameters
        ----------
        exponent : (n_states,) complex array
            Exponents [1/s].
        hold : float
            Length of a sample [s].
        """
        steps = np.outer(SHORT ** np.arange(1, LEVELS + 1), np.arange(SHORT + 1))
        power = decay(exponent, hold, steps.ravel()).reshape(exponent.size, LEVELS, SHORT + 1)
        later = np.zeros((LEVELS, exponent.size, 2 * SHORT), dtype=complex)
        later[:, :, SHORT + 1 :] = power[:, :, : SHORT - 1].transpose(1, 0, 2)
        return cls(power, np.lib.stride_tricks.sliding_window_view(later, SHORT, axis=2)[:, :, SHORT:0:-1])

    def follow(self, pushed: ComplexArray, state: ComplexArray, level: int = 0) -> tuple[ComplexArray, ComplexArray]:
        """Return the states before each block and after all.

        Parameters
        ----------
        pushed : (n_states, n_blocks) complex array
            What each block adds.
        state : (n_states,) complex array
            Before the first block.
        level : int
            0 for blocks, 1 for groups of them, and so on.

        Returns
        -------
        begin : (n_states, n_blocks) complex array
            Before each block.
        after : (n_states,) complex array
            After the last.
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
        power = self.power[:, level]
        groups = pushed[:, : n_groups * SHORT].reshape(n_states, n_groups, SHORT)
        total = np.matmul(groups, power[:, SHORT - 1 :: -1, None])[:, :, 0]
        starts, state = self.follow(total, state, level + 1)
        begin = np.empty((n_states, n_blocks), dtype=complex)
        within = begin[:, : n_groups * SHORT].reshape(n_states, n_groups, SHORT)
        np.matmul(groups, self.triangle[level], out=within)
        within += starts[:, :, None] * power[:, None, :SHORT]
        if rest:
            begin[:, n_groups * SHORT :], state = self.follow(pushed[:, n_groups * SHORT :], state, level)
        return begin, state


@dataclass(frozen=True, eq=False)
class BlockKernel:
    """What a block of voltages and the states at its start do to the outputs and to the states at its end.

    Attributes
    ----------
    scan : Scan
        How the states go on from block to block.
    into_state : (n_channels, 2 n_states, SHORT) array
        What a block's voltages leave in the states, real parts then imaginary parts.
    used : tuple of (channels, states)
        For each output the channels and states that it depends on; the others cost nothing.
    table : tuple of arrays
        For each output the product's right side: its channels' samples, then its states' parts.
    """

    scan: Scan
    into_state: FloatArray
    used: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]
    table: tuple[FloatArray, ...]

    @classmethod
    def of(cls, system: DiagonalSystem, output: ComplexArray, hold: float) -> BlockKernel:
        """Return the kernel of outputs that are the real part of ``output @ state``.

        Parameters
        ----------
        system : DiagonalSystem
            The beam behind its amplifier.
        output : (n_outputs, n_states) complex array
            What is read off the states.
        hold : float
            Length of a sample [s].
        """
        held = system.held_gain(hold)
        powers = decay(system.exponent, hold, np.arange(SHORT))
        into_state = held.T[:, :, None] * powers[:, ::-1]
        # Sample i of a block hears what a volt did i - m - 1 samples ago, and no volt that is still to come.
        heard = np.zeros((output.shape[0], held.shape[1], 2 * SHORT))
        heard[:, :, SHORT + 1 :] = ((output[:, None, :] * held.T) @ powers[:, :-1]).real
        toeplitz = np.lib.stride_tricks.sliding_window_view(heard, SHORT, axis=2)[:, :, SHORT:0:-1]
        acts = np.abs(output) @ np.abs(held) > 0
        used, table = [], []
        for row, hears, which in zip(output, toeplitz, acts, strict=True):
            states, channels = np.flatnonzero(row), np.flatnonzero(which)
            weighted = row[states, None] * powers[states]
            used.append((tuple(channels.tolist()), tuple(states.tolist())))
            table.append(np.concatenate([hears[channels].reshape(-1, SHORT), weighted.real, -weighted.imag]))
        return cls(
            scan=Scan.of(system.exponent, hold),
            into_state=np.concatenate([into_state.real, into_state.imag], axis=1),
            used=tuple(used),
            table=tuple(table),
        )

    def states(self, blocks: FloatArray, state: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the states at the starts of the blocks, and after the last.

        Parameters
        ----------
        blocks : (n_channels, n_blocks, SHORT) array
            Their voltages [V].
        state : (n_states,) complex array
            At the start of the first.

        Returns
        -------
        begin : (n_states, n_blocks) complex array
            At the starts.
        after : (n_states,) complex array
            After the last.
        """
        pushed = np.matmul(self.into_state, blocks.transpose(0, 2, 1)).sum(axis=0)
        together = np.empty((state.size, blocks.shape[1]), dtype=complex)
        together.real, together.imag = pushed[: state.size], pushed[state.size :]
        return self.scan.follow(together, state)

    def respond(self, blocks: FloatArray, begin: ComplexArray, out: FloatArray) -> None:
        """Write the outputs at the starts of the samples.

        Parameters
        ----------
        blocks : (n_channels, n_blocks, SHORT) array
            Their voltages [V].
        begin : (n_states, n_blocks) complex array
            From `states`.
        out : (n_outputs, n_samples) array
            Where they go, at most the samples of the blocks; each row contiguous.
        """
        n_whole, rest = divmod(out.shape[1], SHORT)
        sides: dict[tuple[tuple[int, ...], int], FloatArray] = {}
        for (channels, states), table, row in zip(self.used, self.table, out, strict=True):
            # Outputs of the same channels share one left side; only its states are written anew.
            key = (channels, len(states))
            if key not in sides:
                sides[key] = _voltages_beside(blocks, channels, len(states))
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
        blocks : (n_channels, n_blocks, SHORT) array
            Their voltages [V].
        begin : (n_states, n_blocks) complex array
            The states at their starts.
        """
        channels, states = self.used[place]
        side = _voltages_beside(blocks, channels, len(states))
        _write_states(side, begin, states)
        return np.asarray(side @ self.table[place])

    def bounds(self, blocks: FloatArray, begin: ComplexArray) -> FloatArray:
        """Return what each output cannot pass within each block, (n_outputs, n_blocks) array.

        The states bound the free part; the forced part is bounded by the block's mean voltage, of which a fast mode
        feels little, and by the energy of what remains.

        Parameters
        ----------
        blocks : (n_channels, n_blocks, SHORT) array
            Their voltages [V].
        begin : (n_states, n_blocks) complex array
            From `states`.
        """
        free, steady, worst = self._bound_weights
        mean = blocks @ np.full(SHORT, 1 / SHORT)
        energy = np.einsum("cji,cji->cj", blocks, blocks)
        swing = np.sqrt(np.maximum(energy * (1 + 1e-12) - SHORT * mean**2, 0.0))
        return np.asarray(free @ np.abs(begin) + steady @ np.abs(mean) + worst @ swing)

    @cached_property
    def _bound_weights(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What a state, a steady volt and a block of unit energy can do to each output at most."""
        n_channels, n_states = self.into_state.shape[0], self.into_state.shape[1] // 2
        free = np.zeros((len(self.used), n_states))
        steady, worst = np.zeros((2, len(self.used), n_channels))
        for place, ((channels, states), table) in enumerate(zip(self.used, self.table, strict=True)):
            width = SHORT * len(channels)
            impulse = table[:width].reshape(len(channels), SHORT, SHORT)
            free[place, states] = np.hypot(table[width : -len(states), 0], table[-len(states) :, 0])
            steady[place, channels] = np.abs(impulse.sum(axis=1)).max(axis=1)
            worst[place, channels] = np.sqrt((impulse**2).sum(axis=1).max(axis=1))
        return free, steady, worst

    def peak(self, place: int, blocks: FloatArray, begin: ComplexArray, bound: FloatArray, least: float) -> float:
        """Return the largest magnitude of one output within the blocks, or `least` where that is higher.

        Only blocks whose bound is higher are computed, the likeliest first.

        Parameters
        ----------
        place : int
            Which output.
        blocks : (n_channels, n_blocks, SHORT) array
            Their voltages [V].
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


def _voltages_beside(blocks: FloatArray, channels: tuple[int, ...], n_states: int) -> FloatArray:
    """Return the left side of a product: the channels' samples, and room for the states beside them."""
    side = np.empty((blocks.shape[1], SHORT * len(channels) + 2 * n_states))
    for place, channel in enumerate(channels):
        side[:, place * SHORT : (place + 1) * SHORT] = blocks[channel]
    return side


def _write_states(side: FloatArray, begin: ComplexArray, states: tuple[int, ...]) -> None:
    """Write the states into the last columns of a left side."""
    n_states = len(states)
    side[:, -2 * n_states : -n_states] = begin.real[states, :].T
    side[:, -n_states:] = begin.imag[states, :].T
