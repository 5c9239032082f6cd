"""What a response cannot pass within a block: its envelope, by which most blocks need no closer look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class PeakBound:
    """What bounds a response within each block.

    Attributes
    ----------
    size : (n_states, n_blocks) array
        Magnitudes of the states at the starts.
    mean : (n_inputs, n_blocks) array
        Magnitude of the mean input.
    swing : (n_inputs, n_blocks) array
        Root of the energy of what remains.
    """

    size: FloatArray
    mean: FloatArray
    swing: FloatArray

    @classmethod
    def of(cls, blocks: FloatArray, begin: ComplexArray) -> PeakBound:
        """Return the effort of inputs.

        Parameters
        ----------
        blocks : (n_inputs, n_blocks, n) array
            The inputs, n samples to a block.
        begin : (n_states, n_blocks) complex array
            States at the starts.
        """
        n = blocks.shape[2]
        size = np.sqrt(begin.real**2 + begin.imag**2)
        mean = blocks @ np.full(n, 1 / n)
        energy = np.einsum("cji,cji->cj", blocks, blocks)
        return cls(size, np.abs(mean), np.sqrt(np.maximum(energy * (1 + 1e-12) - n * mean**2, 0.0)))


def bound_weights(output: ComplexArray, push: ComplexArray, powers: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return what steady inputs and inputs of unit energy do to outputs at most within a block.

    Parameters
    ----------
    output : (n_outputs, n_states) complex array
        The outputs are the real part of ``output @ state``.
    push : (n_states, n_inputs) complex array
        What a unit of each input leaves in the states at the end of its sample.
    powers : (n_states, n) complex array
        Decays over 0 to n - 1 samples, n of them to a block [1].

    Returns
    -------
    steady, worst : (n_outputs, n_inputs) arrays
        Per unit of the mean, and per root of the energy of what remains.
    """
    impulse = ((output[:, None, :] * push.T) @ powers).real
    return np.abs(impulse.cumsum(axis=2)).max(axis=2), np.sqrt((impulse**2).sum(axis=2))
