"""From block to block: states that decay over each block and are pushed by it, followed by groups of blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.synthesis import decay

ComplexArray = NDArray[np.complex128]

SHORT = 16
"""Samples per block: the work per sample is least where a block is about as long as a product is efficient."""

LEVELS = 3
"""Blocks, groups of blocks, groups of groups: three levels step over 16^4 samples, twice the longest chunk."""


@dataclass(frozen=True, eq=False)
class BlockRecursion:
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
    def of(cls, exponent: ComplexArray, hold: float, length: int = SHORT) -> BlockRecursion:
        """Return the scan of blocks of equal length.

        Parameters
        ----------
        exponent : (n_states,) complex array
            Exponents [1/s].
        hold : float
            Length of a sample [s].
        length : int
            Samples per block.
        """
        steps = np.outer(length * SHORT ** np.arange(LEVELS), np.arange(SHORT + 1))
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
