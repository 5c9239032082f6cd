"""Response of the beam: from sampled voltages to velocity histories and peak speeds.

Each state has one pole, x' = exponent x + input_gain v, and the samples are held. Within a short block of samples,
every output is one matrix product of the block's voltages and its initial state; the initial states follow from a
second level of blocks. Histories are written in chunks, so that memory does not grow with the burst. Only blocks whose
upper bound exceeds the peak found so far are searched for a higher one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.blocks import SHORT, BlockKernel, PeakBound
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import DiagonalSystem, clock_inputs
from modaltouch.stimulus.quantities import ComplexArray, FloatArray
from modaltouch.stimulus.synthesis import BLOCK, decay, exponential_tables

_OUTPUTS = 256
"""Number of outputs per batch in the search for peaks, which bounds the memory."""

_DENSE = 0.25
"""Fraction of candidate blocks above which computing all samples is cheaper than selecting blocks [1]."""


@dataclass(frozen=True, eq=False)
class BlockStates:
    """States at the starts of long blocks during a burst from rest; short blocks are computed only to find peaks.

    Attributes
    ----------
    system : DiagonalSystem
        The beam behind its amplifier.
    timing : Timing
        Clock of the samples.
    blocks : (n_inputs, n_blocks, BLOCK) array
        Voltages, then the steps times powers of their clock delay; the last block is padded with zeros.
    pushed : (n_states, n_blocks, SHORT) complex array
        Contribution of each of the SHORT short blocks in a block to the states at the end of the short block.
    begin : (n_states, n_blocks + 1) complex array
        States at the starts of the blocks, and after the last.
    """

    system: DiagonalSystem
    timing: Timing
    blocks: FloatArray
    pushed: ComplexArray
    begin: ComplexArray

    @classmethod
    def of(cls, system: DiagonalSystem, voltage: FloatArray, timing: Timing) -> BlockStates:
        """Return the states for held samples at the beam, (n_channels, n_samples) array [V]."""
        push = system.clock_gain(timing)
        inputs = clock_inputs(voltage, timing, 0, voltage.shape[1], push.shape[1])
        beyond = -inputs.shape[1] % BLOCK
        filled = np.pad(inputs, ((0, 0), (0, beyond))) if beyond else inputs
        blocks = filled.reshape(len(inputs), -1, BLOCK)
        kernel = BlockKernel(system.exponent, push, np.empty((0, system.exponent.size), complex), timing.hold)
        pushed = kernel.pushed(blocks.reshape(len(inputs), -1, SHORT)).reshape(-1, blocks.shape[1], SHORT)
        rest = np.zeros(system.exponent.size, dtype=complex)
        begin, left = kernel.scan.follow(kernel.scan.total(pushed), rest, 1)
        return cls(system, timing, blocks, pushed, np.concatenate([begin, left[:, None]], axis=1))

    @cached_property
    def _peak_bound(self) -> PeakBound:
        return PeakBound.of(self.blocks, self.begin[:, :-1])

    def peak(self, output: ComplexArray, floor: float = 0.0) -> FloatArray:
        """Return the largest magnitude of each output until the start of the next burst, (n_outputs,) array.

        The outputs are ``Re(output @ state)``. `floor` is the smallest value returned; a higher floor means fewer
        blocks to compute.
        """
        if len(output) > _OUTPUTS:
            starts = range(0, len(output), _OUTPUTS)
            return np.concatenate([self.peak(output[start : start + _OUTPUTS], floor) for start in starts])
        some, places = self._different(output)
        kernel = BlockKernel(self.system.exponent, self._push, some, self.timing.hold)
        # The outputs at the starts of the blocks are lower bounds of the peaks, which rule out most blocks.
        peak = np.maximum(np.abs((some @ self.begin).real).max(axis=1), floor)
        fine, _ = exponential_tables(self.system.exponent, self.timing.hold, 1)
        bound = self._peak_bound.of_outputs(some, self._push, fine[:, ::-1])
        which = np.flatnonzero((bound > peak[:, None]).any(axis=0))
        if which.size > _DENSE * bound.shape[1]:
            peak = np.maximum(peak, kernel.peaks(self.blocks, self.pushed, self.begin[:, :-1]))
        else:
            self._evaluate_blocks(which, kernel, peak)
        period = int(self.timing.sampling_rate / self.timing.repetition_rate)
        silence = max(0, period - BLOCK * bound.shape[1])
        return self._peak_of_decay(some * self.begin[:, -1], silence, peak)[places]

    @cached_property
    def _push(self) -> ComplexArray:
        """Contribution of a unit of each input to the states at the end of its sample, (n_states, n_inputs) array."""
        return self.system.clock_gain(self.timing)

    def _evaluate_blocks(self, which: NDArray[np.intp], kernel: BlockKernel, peak: FloatArray) -> None:
        """Raise the peaks, in place, to the maxima of the outputs within some blocks."""
        if which.size == 0:
            return
        blocks = self.blocks[:, which].reshape(len(self.blocks), -1, SHORT)
        pushed = self.pushed[:, which]
        begin = np.empty_like(pushed)
        kernel.scan.within(pushed, self.begin[:, which], begin)
        short = begin.reshape(len(begin), -1)
        bounds = PeakBound.of(blocks, short).of_outputs(kernel.output, self._push, kernel.powers)
        for place, bound in enumerate(bounds):
            peak[place] = kernel.peak(place, blocks, short, bound, float(peak[place]))

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


def history(system: DiagonalSystem, output: ComplexArray, voltage: FloatArray, timing: Timing) -> FloatArray:
    """Return the outputs at the starts of the samples of a burst from rest, (n_outputs, n_samples) array.

    Parameters
    ----------
    system : DiagonalSystem
        The beam behind its amplifier.
    output : (n_outputs, n_states) complex array
        The outputs are the real part of ``output @ state``.
    voltage : (n_channels, n_samples) array
        Held samples at the beam [V].
    timing : Timing
        Their clock.
    """
    kernel = BlockKernel(system.exponent, system.clock_gain(timing), output, timing.hold)
    n_inputs, course = kernel.push.shape[1], np.empty((output.shape[0], voltage.shape[1]))
    kernel.write(lambda start, stop: clock_inputs(voltage, timing, start, stop, n_inputs), course)
    return course
