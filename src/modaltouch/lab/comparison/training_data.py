"""Data on the beam available to every method: the recorded responses, and the modes identified from them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.lab.arrays import ComplexArray, FloatArray
from modaltouch.stimulus import Amplifier, ModalModel, TargetField, Timing

if TYPE_CHECKING:
    from scipy.signal import CZT

STEP = 0.8e-6
"""Approximate time step of the model-free methods: 14 steps per period of the highest mode of Table I [s]."""


@lru_cache(maxsize=4)
def _transform(n_bins: int, n: int, begin: float, turn: float) -> CZT:
    """Return the chirp z-transform from bins to n instants, with the phase of the first and the phase step [rad]."""
    from scipy.signal import CZT

    return CZT(n_bins, n, w=np.exp(1j * turn), a=np.exp(-1j * begin))


@dataclass(frozen=True, eq=False)
class TransferFunctions:
    """Frequency responses at points of the beam to each generator output.

    Attributes
    ----------
    frequency : (n_bins,) array
        Evenly spaced, increasing [Hz].
    response : (n_channels, n_points, n_bins) complex array
        Velocity per volt at the beam, 0 outside the band of the modes [m/s per V].
    position : (n_points,) array
        Control points, origin at mid-beam [m].
    variance : (n_channels, n_bins) array
        Variance of the noise in `response` [(m/s per V)^2].
    """

    frequency: FloatArray
    response: ComplexArray
    position: FloatArray
    variance: FloatArray

    @property
    def spacing(self) -> float:
        """Bin spacing [Hz]."""
        return float(self.frequency[1] - self.frequency[0])

    def in_time(self, spectrum: ComplexArray, first: float, step: float, n: int) -> FloatArray:
        r"""Return the real signal of a one-sided spectrum at evenly spaced instants.

        :math:`h(t) = 2 \Delta f \,\mathrm{Re} \sum_b H_b e^{i 2 \pi f_b t}`, by the chirp z-transform: the time step
        need not divide the period of the bins.

        Parameters
        ----------
        spectrum : (..., n_bins) complex array
            Spectrum at `frequency` [unit per Hz].
        first, step : float
            First instant and time step [s].
        n : int
            Number of instants.
        """
        turn = 2 * np.pi * self.spacing
        transform = _transform(self.frequency.size, n, turn * first, turn * step)
        carrier = np.exp(2j * np.pi * self.frequency[0] * (first + step * np.arange(n)))
        return np.asarray(2 * self.spacing * (carrier * transform(spectrum)).real)

    def noise_towards(self, step: float) -> FloatArray:
        """Return the noise variance of each element of `TrainingData.towards`, (n_channels,) array [(m/s per V)^2]."""
        return np.asarray(2 * self.spacing**2 * self.variance.sum(axis=1) * step**2)


@dataclass(frozen=True, eq=False)
class TrainingData:
    """All data available to a method.

    Attributes
    ----------
    model : ModalModel
        The modes, identified from the same recordings as `responses`.
    responses : TransferFunctions
        The recordings.
    target_field : TargetField
        The target field; its velocity is the level.
    timing : Timing
        Clock of the burst.
    amplifier : Amplifier
        The amplifier, whose limit applies to all methods.
    """

    model: ModalModel
    responses: TransferFunctions
    target_field: TargetField
    timing: Timing
    amplifier: Amplifier

    @property
    def stride(self) -> int:
        """Number of samples per step of the model-free methods; one step ends at the focusing instant."""
        return max(1, round(STEP / self.timing.hold))

    @property
    def step(self) -> float:
        """Time step of the model-free methods [s]."""
        return self.stride * self.timing.hold

    @property
    def n_before(self) -> int:
        """Number of steps before the focusing instant."""
        return self.timing.samples_until(self.timing.focusing_instant)[0] // self.stride

    @cached_property
    def towards(self) -> FloatArray:
        """Velocity at the control points at the focusing instant per volt in each step before it, latest step first.

        (n_channels, n_points, n_before) array [m/s per V]: the impulse response at the middle of each step times the
        step.
        """
        step, responses = self.step, self.responses
        return responses.in_time(responses.response, step / 2, step, self.n_before) * step

    @property
    def focus(self) -> int:
        """Index of the control point nearest to the focus."""
        return int(np.abs(self.responses.position - self.target_field.centre).argmin())

    def target(self) -> FloatArray:
        """Return the target field at the control points, (n_points,) array [m/s]."""
        return self.target_field.velocity * self.target_field.profile(self.responses.position)

    def expected(self, steps: FloatArray) -> FloatArray:
        """Predict the field at the focusing instant from the recordings for given voltages, (n_points,) array [m/s].

        Parameters
        ----------
        steps : (n_channels, n_before) array
            Voltages before the focusing instant, in the order in which they are played [V].
        """
        return np.asarray(np.einsum("cmj,cj->m", self.towards, steps[:, ::-1]))

    def to_level(self, steps: FloatArray, after: FloatArray | None = None) -> FloatArray:
        """Scale voltages to the level at the focus predicted from the recordings, or else to the voltage limit.

        Parameters
        ----------
        steps : (n_channels, n_before) array
            Voltages before the focusing instant, of arbitrary scale [V].
        after : (n_channels, n_after) array, optional
            Voltages after the focusing instant, of the same scale; 0 V if not given [V].

        Returns
        -------
        (n_channels, n_samples) array
            Voltages of the whole burst at the beam; 0 V in the first and last sample, where the generator idles [V].
        """
        whole = steps if after is None else np.concatenate([steps, after], axis=1)
        reached = float(self.expected(steps)[self.focus])
        highest = float(np.abs(whole).max())
        if reached == 0 or highest == 0:
            raise ValueError("the drives do not move the focus: record a point that moves, or choose another focus")
        factor = self.target_field.velocity / reached
        factor = float(np.sign(factor)) * min(abs(factor), self.amplifier.limit / highest)
        voltage = np.zeros((whole.shape[0], self.timing.n_samples))
        held = np.repeat(whole * factor, self.stride, axis=1)[:, : self.timing.n_samples]
        # The steps end at the focusing instant; any remaining samples precede the first step.
        start = max(0, self.timing.samples_until(self.timing.focusing_instant)[0] - self.n_before * self.stride)
        held = held[:, : self.timing.n_samples - start]
        voltage[:, start : start + held.shape[1]] = held
        voltage[:, 0] = voltage[:, -1] = 0.0
        return voltage


def band(frequency: ArrayLike, lowest: float, highest: float) -> FloatArray:
    """Return a window over frequency with raised-cosine flanks [1].

    Parameters
    ----------
    frequency : array_like
        Frequencies [Hz].
    lowest, highest : float
        The window is 1 between them; it rises from half of `lowest`, and falls to 0 at 1.1 times `highest` [Hz].
    """
    f = np.asarray(frequency, dtype=float)
    rise = np.clip((f - lowest / 2) / (lowest / 2), 0, 1)
    fall = np.clip((1.1 * highest - f) / (0.1 * highest), 0, 1)
    return np.asarray((0.5 - 0.5 * np.cos(np.pi * rise)) * (0.5 - 0.5 * np.cos(np.pi * fall)))
