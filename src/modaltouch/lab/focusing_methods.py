r"""The compared methods of focusing, each of which computes the voltages of a burst from the same training data.

**Time reversal.** Each output plays its own impulse response at the focus backwards. With :math:`h_c(x_0, t)` the
velocity at the focus after an impulse from output c, the drive :math:`v_c(t) = A\, h_c(x_0, t_F - t)` produces

.. math:: \dot w(x, t_F) = A \sum_c \int h_c(x, \tau)\, h_c(x_0, \tau)\, d\tau

at the focusing instant: at the focus all contributions add up as an autocorrelation, elsewhere they do not. It is the
matched filter: no drive of equal energy produces more velocity there. The other points are not constrained.

**Inverse filter.** At every frequency the responses of the M control points to the C outputs form a matrix H, the
target velocities a vector U. The drives are given by the Tikhonov-regularised inverse,
:math:`V = (H^* H + \beta I)^{-1} H^* U`, transformed back into time. The target is a pulse in the shape of the target
field at the focusing instant, and rest at every other time; a few outputs can only approximate this.

References
----------
C. Hudin, J. Lozada, V. Hayward, "Localized Tactile Feedback on a Transparent Surface through Time-Reversal Wave
Focusing", IEEE Trans. Haptics 8(2), 188-198, 2015, doi 10.1109/TOH.2015.2411267; L. Pantera, C. Hudin, "Sparse Actuator
Array Combined with Inverse Filter for Multitouch Vibrotactile Stimulation", IEEE World Haptics Conference, 2019; the
same, "Multitouch Vibrotactile Feedback on a Tactile Screen by the Inverse Filter Technique: Vibration Amplitude and
Spatial Resolution", IEEE Trans. Haptics 13(3), 493-503, 2020; M. Tanter, J.-L. Thomas, M. Fink, "Time reversal and the
inverse filter", J. Acoust. Soc. Am. 108, 223, 2000; O. Kirkeby et al., "Fast deconvolution of multichannel systems
using regularization", IEEE Trans. Speech Audio Process. 6(2), 1998.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from modaltouch.lab.common import ComplexArray, FloatArray
from modaltouch.stimulus import Amplifier, Burst, Law, ModalModel, Release, TargetField, Timing, design_stimulus

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
    """Frequency responses at points of the beam to each generator output."""

    frequency: FloatArray  # (n_bins,): evenly spaced, increasing [Hz]
    # (n_channels, n_points, n_bins): velocity per volt at the beam, 0 outside the band of the modes [m/s per V]
    response: ComplexArray
    position: FloatArray  # (n_points,): control points, origin at mid-beam [m]

    def in_time(self, spectrum: ComplexArray, first: float, step: float, n: int) -> FloatArray:
        r"""Return the real signal of a one-sided spectrum at evenly spaced instants.

        :math:`h(t) = 2 \Delta f \,\mathrm{Re} \sum_b H_b e^{i 2 \pi f_b t}`, by the chirp z-transform: the time step
        need not divide the period of the bins.

        Parameters
        ----------
        spectrum : (..., n_bins) complex array
            Spectrum at `frequency` [unit per Hz]; the n instants start at `first`, one `step` apart [s].
        """
        spacing = float(self.frequency[1] - self.frequency[0])
        turn = 2 * np.pi * spacing
        transform = _transform(self.frequency.size, n, turn * first, turn * step)
        carrier = np.exp(2j * np.pi * self.frequency[0] * (first + step * np.arange(n)))
        return np.asarray(2 * spacing * (carrier * transform(spectrum)).real)


@dataclass(frozen=True, eq=False)
class TrainingData:
    """All data available to a method."""

    model: ModalModel  # the modes, identified from the same recordings as `responses`
    responses: TransferFunctions  # the recordings
    target_field: TargetField  # the target field; its velocity is the level
    timing: Timing  # clock of the burst
    amplifier: Amplifier  # the amplifier, whose limit applies to all methods
    # behaviour of the drive laws after the focusing instant; it does not affect the other methods
    release: Release = "braked"
    load_factor: float = 1.0  # fraction of the generator's open-circuit voltage that reaches the amplifier's input [1]
    delay: float = 0.0  # delay of the recordings, already removed from `responses` [s]
    quality: tuple[str, ...] = ()  # quality of the identified modes, a sentence each

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
        """Predict the field at the focusing instant from the recordings, (n_points,) array [m/s].

        The steps are the voltages before that instant, (n_channels, n_before) array [V].
        """
        return np.asarray(np.einsum("cmj,cj->m", self.towards, steps[:, ::-1]))

    def to_level(self, steps: FloatArray, after: FloatArray | None = None) -> FloatArray:
        """Scale voltages to the level at the focus predicted from the recordings, or else to the voltage limit.

        Parameters
        ----------
        steps, after : (n_channels, n_before) and (n_channels, n_after) array
            Voltages before and after the focusing instant, of one arbitrary scale; 0 V after it if not given.

        Returns
        -------
        (n_channels, n_samples) array
            Voltages of the whole burst at the beam; 0 V in the first and last sample, where the generator idles [V].
        """
        whole = steps if after is None else np.concatenate([steps, after], axis=1)
        reached = float(self.expected(steps)[self.focus])
        highest = float(np.abs(whole).max())
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


def time_reversal(known: TrainingData) -> FloatArray:
    """Return the time-reversed impulse responses at the focus as voltages at the level or the limit [V]."""
    return known.to_level(known.towards[:, known.focus, ::-1])


PULSES = (44e-6, 88e-6, 176e-6, 352e-6)
"""Trial widths of the raised-cosine target pulse; at 88 us it is above 90 % for as long as the paper's focus [s]."""

STRENGTHS = 10.0 ** np.arange(-5.0, 0.01, 0.5)
"""Trial regularisations, relative to the largest squared singular value [1]."""


def inverse_filter(known: TrainingData) -> FloatArray:
    """Return the drives of the inverse filter at the level or the limit, (n_channels, n_samples) array at the beam [V].

    The pulse from `PULSES` and the regularisation from `STRENGTHS` are those for which the recordings predict the
    field closest to the target at the focusing instant within the voltage limit; if none is within the limit, those
    with the lowest voltage.
    """
    from scipy.signal.windows import tukey

    step, n_before = known.step, known.n_before
    n_after = (known.timing.n_samples - n_before * known.stride) // known.stride
    # The burst fades over a millisecond at either end.
    taper = tukey(n_before + n_after, 2e-3 / step / (n_before + n_after))
    # The drive is linear in the spectrum of the pulse, which is the same for all control points.
    target = np.broadcast_to(known.target()[:, None], known.responses.response.shape[1:]).astype(complex)
    candidates = []
    for strength in STRENGTHS:
        unit = regularised_inverse(known.responses.response, target, strength)
        for width in PULSES:
            spectrum = unit * _pulse(known.responses.frequency, width, known.timing.focusing_instant)
            drive = known.responses.in_time(spectrum, step / 2, step, n_before + n_after) * taper
            field = known.expected(drive[:, :n_before])
            if field[known.focus] <= 0:
                continue
            factor = known.target_field.velocity / float(field[known.focus])
            missed = float(np.sqrt(np.mean((field * factor - known.target()) ** 2)))
            needed = float(np.abs(drive).max()) * factor
            beyond = needed > known.amplifier.limit
            candidates.append((beyond, needed if beyond else missed, drive))
    best = min(candidates, key=lambda each: each[:2])[2]
    return known.to_level(best[:, :n_before], best[:, n_before:])


def _pulse(frequency: FloatArray, width: float, instant: float) -> ComplexArray:
    """Return the spectrum of a raised cosine of height 1 and given width at an instant, (n_bins,) array [1/Hz]."""
    turns = frequency * width
    # The spectrum of a raised cosine is a sinc plus two shifted ones.
    height = width / 2 * (np.sinc(turns) + 0.5 * np.sinc(turns - 1) + 0.5 * np.sinc(turns + 1))
    return np.asarray(height * np.exp(-2j * np.pi * frequency * instant))


def regularised_inverse(response: ComplexArray, target: ComplexArray, strength: float) -> ComplexArray:
    r"""Return :math:`(H^* H + \beta I)^{-1} H^* U` at every frequency, (n_channels, n_bins) array."""
    H = np.moveaxis(response, 2, 0).swapaxes(1, 2)
    adjoint = H.conj().swapaxes(1, 2)
    gram = adjoint @ H
    beta = strength * float(np.linalg.norm(gram, 2, axis=(1, 2)).max())
    right = (adjoint @ target.T[:, :, None])[:, :, 0]
    return np.asarray(np.linalg.solve(gram + beta * np.eye(gram.shape[1]), right[:, :, None])[:, :, 0].T)


@dataclass(frozen=True)
class Method:
    """A method of computing the voltages from the training data."""

    key: str  # short name for tables and JSON
    name: str  # printed name
    idea: str  # principle and origin, in a sentence
    # required data: ``modes`` (one identification for all focuses), ``focus`` (recordings at each focus) or ``field``
    # (recordings at all control points)
    needs: str
    design: Callable[[TrainingData], FloatArray]  # returns the voltages at the beam, (n_channels, n_samples) array [V]


def _by_law(law: Law, known: TrainingData) -> FloatArray:
    field, timing, amplifier = known.target_field, known.timing, known.amplifier
    stimulus = design_stimulus(known.model, field, timing, amplifier, law=law, release=known.release, rounding="plain")
    # As for the other methods, a drive above the voltage limit is scaled down to it.
    return stimulus.voltage * min(1.0, amplifier.limit / float(stimulus.peak_voltage.max()))


METHODS = (
    Method(
        "exact",
        "exact law",
        "brings every identified mode from rest to its target with the least weighted energy, then brakes it (this "
        "program)",
        "modes",
        partial(_by_law, "exact"),
    ),
    Method(
        "paper",
        "paper's law",
        "drives each selected mode along its reversed free decay by the output that drives it best (the paper, eq. "
        "6, 7)",
        "modes",
        partial(_by_law, "paper"),
    ),
    Method(
        "time_reversal",
        "time reversal",
        "plays each output's impulse response at the focus backwards (Hudin, Lozada & Hayward, IEEE Trans. Haptics "
        "8(2), 2015)",
        "focus",
        time_reversal,
    ),
    Method(
        "inverse_filter",
        "inverse filter",
        "regularised least squares at every frequency towards a pulse of the target field and rest at every other time "
        "(Pantera & Hudin, World Haptics 2019 and IEEE Trans. Haptics 13(3), 2020)",
        "field",
        inverse_filter,
    ),
)
"""The methods, in the order of every table and figure."""


@dataclass(frozen=True, eq=False)
class MethodDrive:
    """The drive of a method."""

    method: Method
    voltage: FloatArray  # (n_channels, n_samples): voltages at the beam, before rounding [V]
    burst: Burst  # the burst as the generator plays it

    @property
    def peak_voltage(self) -> float:
        """Highest absolute voltage of any channel [V]."""
        return float(np.abs(self.voltage).max())

    @property
    def energy(self) -> float:
        """Integral of the squared voltages over the burst, summed over the channels [V^2 s]."""
        hold = self.burst.duration / int(self.voltage.shape[1])
        return float((self.voltage**2).sum()) * hold


def design_all(known: TrainingData) -> list[MethodDrive]:
    """Design the drive of every method from the same data."""
    timing, level = known.timing, known.target_field.velocity
    to_beam, designed = known.amplifier.gain * known.load_factor, []
    for method in METHODS:
        voltage = method.design(known)
        burst = Burst.holding(voltage, to_beam, level, timing.converter, timing.duration, timing.repetition_rate)
        designed.append(MethodDrive(method, voltage, burst))
    return designed
