r"""Identification of amplifier, clock, vibrometer and modes of a rig, and modal states from free decays.

The drive measured at the beam is the commanded one behind a first-order amplifier,
:math:`T \dot u = g v(t - \tau) - u`, sampled by a clock that may run fast. The vibrometer is likewise a delay and a
lag, :math:`V(s) = e^{-s \tau} / (1 + s T)`; since modal gains are real, it accounts for the phases that remain in the
modes' responses to a known drive.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from modaltouch.lab.calibration.decay import SLIP_NOISE, Decay, missed_swing
from modaltouch.lab.common import NORMAL_95, ComplexArray, FloatArray
from modaltouch.rig import Recording
from modaltouch.stimulus import Amplifier, DiagonalSystem, ModalModel, Timing

LONGEST = 100e-6
"""Longest delay, and lag, that is searched for [s]."""

DISAGREEMENT = 1.3
"""Ratio of the standard error from the disagreement of eight points to that from noise, below which it is noise [1]."""

SHORTEST_LAG = 20e-9
"""Lag below which the amplifier is treated as instantaneous [s]."""


@dataclass(frozen=True)
class DriveDelay:
    """Gain, delay, lag and clock of the measured drive relative to the commanded one."""

    gain: tuple[float, ...]  # gain of each channel, relative to that in the apparatus file [1]
    delay: float  # delay from the generator's output to the beam [s]
    lag: float  # time constant of the amplifier [s]
    clock: float  # relative amount by which the scope's clock runs faster than the generator's [1]
    rest: float  # root mean square of measured minus predicted drive, relative to that of the measured drive [1]

    @property
    def bandwidth(self) -> float | None:
        """Corner frequency of the amplifier [Hz]; None if it is instantaneous."""
        return None if self.lag <= SHORTEST_LAG else 1 / (2 * np.pi * self.lag)


def fit_drive(recordings: list[Recording], commanded: FloatArray, timing: Timing) -> DriveDelay:
    """Fit gain, delay, lag and clock to drives measured in different parts of a burst.

    Parameters
    ----------
    recordings : list of Recording
        Each with the drive of every commanded channel; the further apart in time, the better the clock is determined.
    commanded : (n_channels, n_samples) array
        Commanded voltages at the beam, with the gain in the apparatus file [V].
    """
    from scipy.optimize import least_squares

    measured = [recording.drive.mean(axis=0) for recording in recordings]
    size = np.concatenate([each.ravel() for each in measured])
    scale = float(np.sqrt(np.mean(size**2)))
    if scale == 0:
        return DriveDelay((0.0,) * commanded.shape[0], 0.0, 0.0, 0.0, 1.0)

    @lru_cache(maxsize=1)
    def lagged(lag: float) -> _Lagged:
        return _Lagged(commanded, timing.hold, lag)

    def predicted(delay: float, lag: float, clock: float) -> list[FloatArray]:
        held = lagged(lag)
        return [held.at(recording.time / (1 + clock) - delay) for recording in recordings]

    def gains(courses: list[FloatArray]) -> FloatArray:
        top = sum(np.einsum("cn,cn->c", course, each) for course, each in zip(courses, measured, strict=True))
        bottom = sum(np.einsum("cn,cn->c", course, course) for course in courses)
        return np.asarray(top / np.maximum(bottom, 1e-300))

    def rest(values: FloatArray) -> FloatArray:
        courses = predicted(values[0] * 1e-6, abs(values[1]) * 1e-6, values[2] * 1e-6)
        gain = gains(courses)[:, None]
        return np.concatenate([(each - gain * c).ravel() for c, each in zip(courses, measured, strict=True)]) / scale

    tried = [
        (float(np.sum(rest(np.array([delay, 0.5, 0.0])) ** 2)), delay) for delay in np.arange(-1.0, LONGEST * 1e6, 1.0)
    ]
    begin = np.array([min(tried)[1], 0.5, 0.0])
    found = least_squares(rest, begin, diff_step=1e-3, x_scale=[1.0, 1.0, 5.0], xtol=1e-9, ftol=1e-12)
    delay, lag, clock = found.x[0] * 1e-6, abs(found.x[1]) * 1e-6, found.x[2] * 1e-6
    return DriveDelay(
        gain=tuple(float(g) for g in gains(predicted(delay, lag, clock))),
        delay=float(max(delay, 0.0)),
        lag=float(lag if lag > SHORTEST_LAG else 0.0),
        clock=float(clock),
        rest=float(np.sqrt(np.mean(found.fun**2))),
    )


def predicted_drive(drive: DriveDelay, commanded: FloatArray, time: FloatArray, timing: Timing) -> FloatArray:
    """Predict the drive at the beam for a linear amplifier, (n_channels, n_times) array [V].

    Parameters
    ----------
    commanded : (n_channels, n_samples) array
        Commanded voltages at the beam, with the gain in the apparatus file [V].
    time : (n_times,) array
        Times by the scope's clock, from the generator's first sample [s].
    """
    course = _Lagged(commanded, timing.hold, drive.lag).at(time / (1 + drive.clock) - drive.delay)
    return np.asarray(np.array(drive.gain)[:, None] * course)


def peak_shortfall(predicted: FloatArray, measured: FloatArray) -> FloatArray:
    """Return the relative shortfall of a drive's peaks [V] with respect to its lower half, (n_channels,) array [1]."""
    lacking = np.zeros(len(predicted))
    for channel, (want, have) in enumerate(zip(predicted, measured, strict=True)):
        size = np.abs(want) / np.abs(predicted).max()
        # Below a quarter of the range the converter's steps are too coarse.
        if size.max() > 0.25:
            high, low = size > 0.9 * size.max(), (size < 0.5 * size.max()) & (size > 0.1 * size.max())
            gains = [float(have[part] @ want[part] / (want[part] @ want[part])) for part in (high, low)]
            lacking[channel] = max(0.0, 1 - gains[0] / gains[1])
    return lacking


class _Lagged:
    """Held samples filtered by a first-order lag, exact at every instant."""

    def __init__(self, voltage: FloatArray, hold: float, lag: float) -> None:
        from scipy.signal import lfilter

        self._hold, self._lag = hold, max(lag, 1e-9)
        self._target = np.pad(voltage, ((0, 0), (0, 1)))
        kept = np.exp(-hold / self._lag)
        self._before = lfilter([0.0, -np.expm1(-hold / self._lag)], [1.0, -kept], self._target)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the voltages at times since the first sample's arrival, (n_channels, n_times) array [V]."""
        index = np.clip((time / self._hold).astype(np.intp), 0, self._target.shape[1] - 1)
        faded = np.exp(-np.maximum(time - index * self._hold, 0.0) / self._lag)
        target = self._target[:, index]
        return np.asarray(np.where(time < 0, 0.0, target + (self._before[:, index] - target) * faded))


@dataclass(frozen=True)
class VibrometerDelay:
    """Delay and low-pass of the vibrometer."""

    delay: float  # pure delay [s]
    lag: float  # time constant of its low-pass [s]
    rest: float  # weighted root mean square of the phases not explained by delay and lag [rad]
    # (2, 2): covariance of delay and lag, from the fit and its residual [s^2]
    covariance: FloatArray = field(default_factory=lambda: np.zeros((2, 2)), compare=False)

    def response(self, pole: ComplexArray) -> ComplexArray:
        """Return the vibrometer's response to a decay e^{st}, (n_poles,) complex array [1]."""
        return np.asarray(np.exp(-pole * self.delay) / (1 + pole * self.lag))

    def spread(self, pole: ComplexArray) -> FloatArray:
        """Return the relative standard error of the response, (n_poles,) array [1]."""
        slope = np.stack([-pole, -pole / (1 + pole * self.lag)], axis=1)
        variance = np.einsum("ki,ij,kj->k", slope, self.covariance, slope.conj()).real
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


DATA_SHEET = 0.2
"""Relative standard deviation of a vibrometer's corner frequency from its data sheet [1]."""


def fit_vibrometer(
    pole: ComplexArray, ratio: ComplexArray, spread: FloatArray, sign: FloatArray, bandwidth: float | None = None
) -> VibrometerDelay:
    """Fit the vibrometer's delay and lag to ratios that would be real without it.

    Parameters
    ----------
    pole : (n_modes,) complex array
        Poles [1/s].
    ratio : (n_modes, n_channels) complex array
        Measured response divided by that of a mode of unit gain to the same drive [m/s^2 per V].
    spread : (n_modes, n_channels) array
        Standard errors of the ratios; infinite where nothing was measured [m/s^2 per V].
    sign : (n_modes, n_channels) array
        Sign of the listed gain; 0 where it is unknown.
    bandwidth : float, optional
        Corner of its low-pass from the data sheet [Hz]; without it, the phases hardly distinguish lag from delay.
    """
    from scipy.optimize import least_squares

    size = np.maximum(np.abs(ratio), 1e-30)
    # The model limits the accuracy of every response to a thousandth.
    weight = 1 / np.hypot(spread, 1e-3 * size + 1e-30)

    def turned(values: FloatArray) -> ComplexArray:
        lag = VibrometerDelay(values[0] * 1e-6, abs(values[1]) * 1e-6, 0.0)
        return np.asarray(ratio / lag.response(pole)[:, None])

    expected = 0.5 if bandwidth is None else 1e6 / (2 * np.pi * bandwidth)
    doubt = 1.0 if bandwidth is None else DATA_SHEET * expected

    def rest(values: FloatArray) -> FloatArray:
        return np.append((turned(values).imag * weight).ravel(), (abs(values[1]) - expected) / doubt)

    def astray(delay: float) -> float:
        # An inverted signal must not be mistaken for a delayed one.
        straight = turned(np.array([delay, 0.0]))
        straight = straight * np.sign(np.sum(np.where(sign != 0, sign * straight.real / size, 0.0)))
        known = sign != 0
        return float(np.sum((np.abs(straight - sign * np.abs(straight)) / size)[known] ** 2))

    tried = np.arange(0.0, LONGEST * 1e6, 0.2)
    together = tried[int(np.argmin([astray(float(delay)) for delay in tried]))]
    # The effects of delay and lag differ only in third order of lag times frequency, so search from several lags.
    starts = [(max(together - lag, 0.0), lag) for lag in np.arange(0.05, min(together, 5.0) + 0.1, 0.25)]
    each = [least_squares(rest, start, x_scale=[0.1, 0.1], xtol=1e-12, ftol=1e-12) for start in starts]
    found = min(each, key=lambda one: float(one.cost))
    phase = (turned(found.x).imag / size)[np.isfinite(spread)]
    certainty = (weight * size)[np.isfinite(spread)] ** 2
    n_left = max(1, phase.size - 2)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * max(1.0, 2 * float(found.cost) / n_left) * 1e-12
    unexplained = float(np.sqrt(np.sum(certainty * phase**2) / np.sum(certainty)))
    return VibrometerDelay(float(found.x[0]) * 1e-6, abs(float(found.x[1])) * 1e-6, unexplained, covariance)


@dataclass(frozen=True, eq=False)
class ModalState:
    """The state of the modelled modes at an instant."""

    velocity: FloatArray  # (n_modes,): modal velocities [m/s]
    displacement: FloatArray  # (n_modes,): modal displacements times natural angular frequency, w eta [m/s]
    spread: FloatArray  # (n_modes,): standard error of each, from the noise of the records [m/s]
    # (n_modes,): half-width of the 95 % interval of each, excluding the vibrometer's sensitivity: noise, or the
    # disagreement of the points where noise does not explain it, in quadrature with the uncertainties of vibrometer,
    # trigger and natural frequencies [m/s]
    half_width: FloatArray = field(default_factory=lambda: np.zeros(1))
    # (n_modes,): relative deviation of the natural frequencies from the identified ones [1]
    change: FloatArray = field(default_factory=lambda: np.zeros(1))
    # (n_modes,): standard error of each, from the disagreement of the points [m/s]
    disagreement: FloatArray = field(default_factory=lambda: np.zeros(1))
    # (n_modes,): effect of a changed natural frequency and damping on each: amplitude times error of the pole, divided
    # by the decay rate [m/s]
    slip: FloatArray = field(default_factory=lambda: np.zeros(1))
    sensitivity_doubt: float = 0.0  # relative half-width of the 95 % interval of the vibrometer's sensitivity [1]

    @property
    def true_half_width(self) -> FloatArray:
        """Half-widths of the 95 % intervals of the true velocity and w eta, (2, n_modes) array [m/s]."""
        return np.hypot(self.half_width, self.sensitivity_doubt * np.stack([self.velocity, self.displacement]))

    @property
    def significant_slip(self) -> FloatArray:
        """Slip that noise does not explain, (n_modes,) array [m/s]."""
        return np.maximum(self.slip - SLIP_NOISE * self.spread, 0.0)

    def error(self, target: FloatArray) -> tuple[float, float]:
        """Return the largest errors of the velocities from their targets, and of w eta from zero [m/s]."""
        return float(np.abs(self.velocity - target).max()), float(np.abs(self.displacement).max())


@dataclass(frozen=True, eq=False)
class Plant:
    """An identified rig."""

    model: ModalModel  # modes, with gains per volt at the beam, referred to the amplifier gain of the strongest channel
    amplifier: Amplifier  # the identified amplifier; its limit applies to the actual voltage at the beam
    drive: DriveDelay  # gain, delay, lag and clock of the drive
    vibrometer: VibrometerDelay  # delay and low-pass of the vibrometer
    unlisted: ComplexArray  # (n_unlisted,): poles of modes that are not in the table [1/s]
    certainty: FloatArray  # (n_modes,): amplitude of each mode relative to its standard error at identification [1]
    latency_doubt: float = 0.0  # half-width of the 95 % interval of the trigger latency [s]
    sensitivity_doubt: float = 0.0  # relative half-width of the 95 % interval of the vibrometer's sensitivity [1]

    @property
    def pole(self) -> ComplexArray:
        """Poles of all modes, listed ones first, (n_modes + n_unlisted,) complex array [1/s]."""
        return np.concatenate([self.model.exponent, self.unlisted])

    def decay_time(self, recording_time: FloatArray, timing: Timing) -> FloatArray:
        """Convert times by the scope's clock to times since the focusing instant by the generator's clock [s]."""
        return recording_time / (1 + self.drive.clock) - timing.focusing_instant

    def state(self, decay: Decay, shapes: FloatArray) -> ModalState:
        """Return the state of the modes at the focusing instant.

        Parameters
        ----------
        decay : Decay
            Fitted with the poles in `pole`, over the times of `decay_time`.
        shapes : (n_modes, n_records) array
            Mode shapes at the points of its records [1].
        """
        n, size, pole = self.model.n_modes, np.sqrt((shapes**2).sum(axis=1)), self.model.exponent
        seen = modal_swings(decay, shapes)
        swing = seen / self.vibrometer.response(pole)
        spread = decay.spread[:n] / size
        disagreement = (np.abs(decay.residue[:n] - seen[:, None] * shapes) ** 2).sum(axis=1)
        by_points = np.sqrt(disagreement / (2 * max(1, shapes.shape[1] - 1))) / size
        shown = np.where(by_points > DISAGREEMENT * spread, by_points, spread)
        either = np.hypot(shown, np.abs(swing) * self.vibrometer.spread(pole))
        # An error in trigger latency turns velocity into displacement and vice versa.
        late = self.model.angular_frequency * np.abs(swing) * self.latency_doubt
        error = decay.pole_error[:n]
        turned = self.model.angular_frequency * swing / pole
        missed = missed_swing(swing, spread, pole, error)
        return ModalState(
            velocity=swing.real,
            displacement=turned.real,
            spread=spread,
            half_width=np.sqrt((NORMAL_95 * either) ** 2 + late**2 + missed**2),
            change=error.imag / pole.imag,
            disagreement=by_points,
            slip=np.abs(swing * error / pole.real),
            sensitivity_doubt=self.sensitivity_doubt,
        )


def modal_swings(decay: Decay, shapes: FloatArray) -> ComplexArray:
    """Return the least-squares complex amplitude of each listed mode over all points, (n_modes,) array [m/s]."""
    n = shapes.shape[0]
    return np.asarray((decay.residue[:n] * shapes).sum(axis=1) / (shapes**2).sum(axis=1))


def unit_responses(model: ModalModel, drive: DriveDelay, voltage: FloatArray, timing: Timing) -> ComplexArray:
    """Return the complex amplitudes of modes of unit gain after a burst, extrapolated back to the focusing instant."""
    unit = replace(model, modal_gain=np.ones_like(model.modal_gain))
    amplifier = Amplifier(gain=1.0, limit=1.0, bandwidth=drive.bandwidth, delay=drive.delay)
    system = DiagonalSystem.of(unit, amplifier)
    # Evaluate after the drive has ended.
    later = drive.delay + 20 * drive.lag + timing.hold
    instant = min(timing.focusing_instant + later, timing.duration)
    state = system.states_by_channel(voltage, timing, instant)[:, : model.n_modes].T
    s = model.exponent[:, None]
    return np.asarray((1 - 1j * s.real / s.imag) * state * np.exp(-s * (instant - timing.focusing_instant)))


def identify_plant(
    model: ModalModel,
    amplifier: Amplifier,
    drive: DriveDelay,
    decay: Decay,
    shapes: FloatArray,
    voltages: list[FloatArray],
    timing: Timing,
    vibrometer_bandwidth: float | None = None,
) -> Plant:
    """Identify the rig from the decays after probe bursts, one on each channel.

    Parameters
    ----------
    model, amplifier, drive
        Listed modes, whose shapes are kept, listed amplifier, and the measured drive.
    decay : Decay
        Joint fit of the records of all probes, one probe after the other.
    shapes : (n_modes, n_points) array
        Mode shapes at the points of each probe's records [1].
    voltages : list of (n_channels, n_samples) arrays
        Commanded voltages at the beam of each probe, on one channel [V].
    vibrometer_bandwidth : float, optional
        Corner of the vibrometer's low-pass from the data sheet [Hz].
    """
    n_modes, n_points = shapes.shape
    pole = decay.pole[:n_modes]
    refined = replace(
        model,
        natural_frequency=np.abs(pole) / (2 * np.pi),
        damping_ratio=np.clip(-pole.real / np.abs(pole), 1e-9, 0.999),
    )
    ratio = np.zeros((n_modes, model.n_channels), dtype=complex)
    spread = np.full((n_modes, model.n_channels), np.inf)
    for number, voltage in enumerate(voltages):
        channel = int(np.abs(voltage).max(axis=1).argmax())
        of_probe = slice(number * n_points, (number + 1) * n_points)
        swing = modal_swings(replace(decay, residue=decay.residue[:, of_probe]), shapes)
        unit = unit_responses(refined, drive, voltage, timing)[:, channel]
        ratio[:, channel] = swing / unit
        spread[:, channel] = decay.spread[:n_modes] / np.sqrt((shapes**2).sum(axis=1)) / np.abs(unit)
    vibrometer = fit_vibrometer(pole, ratio, spread, np.sign(model.modal_gain), vibrometer_bandwidth)
    strongest = max(drive.gain)
    gain = (ratio / vibrometer.response(pole)[:, None]).real
    return Plant(
        # Identified gains are per commanded volt, those of the model per actual volt.
        model=replace(refined, modal_gain=gain / strongest),
        amplifier=replace(amplifier, gain=amplifier.gain * strongest, bandwidth=drive.bandwidth, delay=drive.delay),
        drive=drive,
        vibrometer=vibrometer,
        unlisted=decay.pole[n_modes:],
        certainty=np.asarray((np.abs(ratio) / np.maximum(spread, 1e-300)).max(axis=1)),
    )
