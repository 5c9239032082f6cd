r"""The compared methods, each of which computes the voltages of a burst from the same training data.

**Time reversal.** Each output plays its own impulse response at the focus backwards. With :math:`h_c(x_0, t)` the
velocity at the focus after an impulse from output c, the drive :math:`v_c(t) = A\, h_c(x_0, t_F - t)` produces

.. math:: \dot w(x, t_F) = A \sum_c \int h_c(x, \tau)\, h_c(x_0, \tau)\, d\tau

at the focusing instant: at the focus all contributions add up as an autocorrelation, elsewhere they do not. It is the
matched filter: no drive of equal energy produces more velocity there. The other points are not constrained. The 1-bit
variant plays only the sign, for more velocity per volt of peak but a less accurate field.

**Inverse filter.** At every frequency the responses of the M control points to the C outputs form a matrix H, the
target velocities a vector U. The drives are given by the Tikhonov-regularised inverse,
:math:`V = (H^* H + \beta I)^{-1} H^* U`, transformed back into time. The target is a pulse in the shape of the target
field at the focusing instant, and rest at every other time; a few outputs can only approximate this.

**Inverse filter at one instant.** With R the recorded responses at the focusing instant to a volt in each step before
it, the drive :math:`v = R^T (R R^T + \beta I)^{-1} f` produces the target field at the control points with the least
energy, up to the error that :math:`\beta` allows. It is the exact law without a model: motion between and beyond the
points, and displacement at that instant, are not constrained.

References
----------
C. Hudin, J. Lozada, V. Hayward, "Localized Tactile Feedback on a Transparent Surface through Time-Reversal Wave
Focusing", IEEE Trans. Haptics 8(2), 188-198, 2015, doi 10.1109/TOH.2015.2411267; A. Derode, A. Tourin, M. Fink,
"Ultrasonic pulse compression with one-bit time reversal through multiple scattering", J. Appl. Phys. 85, 6343, 1999;
L. Pantera, C. Hudin, "Sparse Actuator Array Combined with Inverse Filter for Multitouch Vibrotactile Stimulation",
IEEE World Haptics Conference, 2019; the same, "Multitouch Vibrotactile Feedback on a Tactile Screen by the Inverse
Filter Technique: Vibration Amplitude and Spatial Resolution", IEEE Trans. Haptics 13(3), 493-503, 2020; M. Tanter,
J.-L. Thomas, M. Fink, "Time reversal and the inverse filter", J. Acoust. Soc. Am. 108, 223, 2000; O. Kirkeby et al.,
"Fast deconvolution of multichannel systems using regularization", IEEE Trans. Speech Audio Process. 6(2), 1998.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from modaltouch.lab.arrays import ComplexArray, FloatArray
from modaltouch.lab.comparison.training_data import TrainingData
from modaltouch.stimulus import (
    Burst,
    Law,
    Release,
    design_stimulus,
)


def time_reversal(known: TrainingData) -> FloatArray:
    """Return the time-reversed impulse responses at the focus as voltages at the level or the limit [V]."""
    return known.to_level(known.towards[:, known.focus, ::-1])


def one_bit_reversal(known: TrainingData) -> FloatArray:
    """Return the signs of the voltages of `time_reversal`, at the level or the limit [V]."""
    return known.to_level(np.sign(known.towards[:, known.focus, ::-1]))


PULSES = (44e-6, 88e-6, 176e-6, 352e-6)
"""Trial widths of the raised-cosine target pulse; at 88 us it is above 90 % for as long as the paper's focus [s]."""

STRENGTHS = 10.0 ** np.arange(-5.0, 0.01, 0.5)
"""Trial regularisations, relative to the largest squared singular value [1]."""

ABOVE_NOISE = 10.0
"""Minimum strength of a direction used by the inverse filter at one instant, relative to the noise [1]."""

STRONGER = 8
"""Number of trial values for that threshold, each ten times the previous one."""

ENDS = 1e-3
"""Length of the taper at either end of a burst [s]."""


def inverse_filter(known: TrainingData) -> FloatArray:
    """Return the drives of the inverse filter at the level or the limit, (n_channels, n_samples) array at the beam [V].

    The pulse from `PULSES` and the regularisation from `STRENGTHS` are those for which the recordings predict the
    field closest to the target at the focusing instant within the voltage limit; if none is within the limit, those
    with the lowest voltage.
    """
    from scipy.signal.windows import tukey

    step, n_before = known.step, known.n_before
    n_after = (known.timing.n_samples - n_before * known.stride) // known.stride
    taper = tukey(n_before + n_after, 2 * ENDS / step / (n_before + n_after))
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
    if not candidates:
        raise ValueError("no inverse filter can move the focus: record a point that moves, or choose another focus")
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


def inverse_filter_at_instant(known: TrainingData) -> FloatArray:
    r"""Return the least-energy drives for the target field at the focusing instant, at the level or the limit.

    On average, noise adds only to the diagonal of :math:`R R^T`; its variance, known from the scatter of the records,
    is the regularisation. Directions below `ABOVE_NOISE` times the noise are left out, since a drive
    that uses them depends on noise; further ones are left out while the drive exceeds the voltage limit.
    """
    noise = float(known.responses.noise_towards(known.step).sum()) * known.n_before
    target, towards = known.target(), known.towards
    strength, direction = np.linalg.eigh(np.einsum("cmj,cnj->mn", towards, towards, optimize=True))
    for floor in noise * ABOVE_NOISE * 10.0 ** np.arange(STRONGER):
        # Always keep the strongest direction.
        kept = direction[:, (strength > floor) | (strength == strength.max())]
        steps = least_energy(towards, target, noise, kept)[:, ::-1]
        reached = float(known.expected(steps)[known.focus])
        if reached > 0 and float(np.abs(steps).max()) * known.target_field.velocity / reached <= known.amplifier.limit:
            break
    return known.to_level(steps)


def least_energy(towards: FloatArray, target: FloatArray, beta: float, kept: FloatArray | None = None) -> FloatArray:
    r"""Return :math:`R^T (R R^T + \beta I)^{-1} f`, (n_channels, n_steps) array [V].

    Parameters
    ----------
    towards : (n_channels, n_points, n_steps) array
        R [m/s per V].
    target : (n_points,) array
        f [m/s].
    beta : float
        Regularisation, which trades accuracy for energy [(m/s per V)^2].
    kept : (n_points, n_kept) array, optional
        Orthonormal directions in which the field is controlled; all if not given [1].
    """
    kept = np.eye(target.size) if kept is None else kept
    within = np.einsum("mk,cmj->ckj", kept, towards, optimize=True)
    gram = np.einsum("ckj,clj->kl", within, within, optimize=True)
    weight = np.linalg.lstsq(gram + beta * np.eye(gram.shape[0]), kept.T @ target, rcond=None)[0]
    return np.asarray(np.einsum("ckj,k->cj", within, weight))


@dataclass(frozen=True)
class Method:
    """A method of computing the voltages from the training data.

    Attributes
    ----------
    key : str
        Short name for tables and JSON.
    name : str
        Printed name.
    idea : str
        Principle and origin, in a sentence.
    needs : str
        Required data: ``modes`` (one identification for all focuses), ``focus`` (recordings at each focus) or
        ``field`` (recordings at all control points).
    design : callable
        Returns the voltages at the beam, (n_channels, n_samples) array [V].
    """

    key: str
    name: str
    idea: str
    needs: str
    design: Callable[[TrainingData, Release], FloatArray]

    def recordings(self, n_points: int, n_channels: int) -> int:
        """Return the number of recordings needed for the first focus."""
        return n_channels * (1 if self.needs == "focus" else n_points)

    def further_recordings(self, n_channels: int) -> int:
        """Return the number of additional recordings for each further focus."""
        return n_channels if self.needs == "focus" else 0


def _by_law(law: Law) -> Callable[[TrainingData, Release], FloatArray]:
    def design(known: TrainingData, release: Release) -> FloatArray:
        stimulus = design_stimulus(
            known.model, known.target_field, known.timing, known.amplifier, law=law, release=release, rounding="plain"
        )
        # As for the other methods, a drive above the voltage limit is scaled down to it.
        return stimulus.voltage * min(1.0, known.amplifier.limit / float(stimulus.peak_voltage.max()))

    return design


METHODS = (
    Method(
        "exact",
        "exact law",
        "brings every identified mode from rest to its target with the least weighted energy, then brakes it (this "
        "program)",
        "modes",
        _by_law("exact"),
    ),
    Method(
        "paper",
        "paper's law",
        "drives each selected mode along its reversed free decay by the output that drives it best (the paper, eq. "
        "6, 7)",
        "modes",
        _by_law("paper"),
    ),
    Method(
        "time_reversal",
        "time reversal",
        "plays each output's impulse response at the focus backwards (Hudin, Lozada & Hayward, IEEE Trans. Haptics "
        "8(2), 2015)",
        "focus",
        lambda known, _: time_reversal(known),
    ),
    Method(
        "one_bit",
        "1-bit time reversal",
        "plays only the signs of the same (Derode, Tourin & Fink, J. Appl. Phys. 85, 1999)",
        "focus",
        lambda known, _: one_bit_reversal(known),
    ),
    Method(
        "inverse_filter",
        "inverse filter",
        "regularised least squares at every frequency towards a pulse of the target field and rest at every other time "
        "(Pantera & Hudin, World Haptics 2019 and IEEE Trans. Haptics 13(3), 2020)",
        "field",
        lambda known, _: inverse_filter(known),
    ),
    Method(
        "inverse_instant",
        "inverse filter at t_F",
        "regularised least squares towards the target field at the focusing instant alone, a law without a model",
        "field",
        lambda known, _: inverse_filter_at_instant(known),
    ),
)
"""The methods, in the order of every table and figure."""


@dataclass(frozen=True, eq=False)
class MethodDrive:
    """The drive of a method.

    Attributes
    ----------
    method : Method
        The method.
    voltage : (n_channels, n_samples) array
        Voltages at the beam, before rounding [V].
    burst : Burst
        The burst as the generator plays it.
    computing_time : float
        Time to compute the voltages from the training data [s].
    """

    method: Method
    voltage: FloatArray
    burst: Burst
    computing_time: float

    @property
    def peak_voltage(self) -> float:
        """Highest absolute voltage of any channel [V]."""
        return float(np.abs(self.voltage).max())

    @property
    def energy(self) -> float:
        """Integral of the squared voltages over the burst, summed over the channels [V^2 s]."""
        hold = self.burst.duration / int(self.voltage.shape[1])
        return float((self.voltage**2).sum()) * hold


def design_all(known: TrainingData, release: Release, load_factor: float) -> list[MethodDrive]:
    """Design the drive of every method.

    Parameters
    ----------
    known : TrainingData
        The data available to each method.
    release : str
        Behaviour of the drive laws after the focusing instant; it does not affect the other methods.
    load_factor : float
        Fraction of the generator's open-circuit voltage that reaches the amplifier's input [1].
    """
    timing, to_beam, level = known.timing, known.amplifier.gain * load_factor, known.target_field.velocity
    # Part of the recordings and shared by the methods, so not included in the computing time.
    _ = known.towards
    designed = []
    for method in METHODS:
        started = time.perf_counter()
        voltage = method.design(known, release)
        took = time.perf_counter() - started
        burst = Burst.holding(voltage, to_beam, level, timing.converter, timing.duration, timing.repetition_rate)
        designed.append(MethodDrive(method, voltage, burst, took))
    return designed
