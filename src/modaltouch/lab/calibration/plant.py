r"""The rig as a calibration identifies it: amplifier, clock, vibrometer and modes; and states read off free decays.

The drive measured at the beam is the commanded one behind an amplifier of first order,
:math:`T \dot u = g v(t - \tau) - u`, sampled by a clock that may run fast. The vibrometer is a delay and a lag too,
:math:`V(s) = e^{-s \tau} / (1 + s T)`: a mode's response to a known drive, but for a real gain, has its phase.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from modaltouch.lab.arrays import ComplexArray, FloatArray
from modaltouch.lab.calibration.decay import SLIP_NOISE, Decay, missed_swing
from modaltouch.rig import Recording
from modaltouch.stimulus import Amplifier, DiagonalSystem, ModalModel, Timing

LONGEST = 100e-6
"""Longest delay, and lag, that is looked for [s]."""

INTERVAL = 1.96
"""Half width of a 95 % interval, in standard errors [1]."""

DISAGREEMENT = 1.3
"""Standard error by what eight points disagree by over that of the noise, up to which it may be noise (95 %) [1]."""

SHORTEST_LAG = 20e-9
"""Lag below which the amplifier counts as following at once [s]."""


@dataclass(frozen=True)
class DriveDelay:
    """How the measured drive follows the commanded one.

    Attributes
    ----------
    gain : tuple of float
        Of each channel, relative to what the apparatus file says [1].
    delay : float
        From the generator's output to the beam [s].
    lag : float
        Time constant of the amplifier [s].
    clock : float
        By what part the scope's clock runs fast against the generator's [1].
    rest : float
        Root mean square of measured less predicted drive, over that of the drive [1].
    """

    gain: tuple[float, ...]
    delay: float
    lag: float
    clock: float
    rest: float

    @property
    def bandwidth(self) -> float | None:
        """Corner of the amplifier's pole [Hz]; None where it follows at once."""
        return None if self.lag <= SHORTEST_LAG else 1 / (2 * np.pi * self.lag)


def fit_drive(recordings: list[Recording], commanded: FloatArray, timing: Timing) -> DriveDelay:
    """Return gain, delay, lag and clock from drives measured in different parts of a burst.

    Parameters
    ----------
    recordings : list of Recording
        Each with a drive to every commanded channel; the further apart in time, the better the clock is told.
    commanded : (n_channels, n_samples) array
        Voltages at the beam that the burst commands, by the apparatus file's gain [V].
    timing : Timing
        Clock of the samples.
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
    """Return the drive to be measured where the amplifier is linear, (n_channels, n_times) array [V].

    Parameters
    ----------
    drive : DriveDelay
        How it follows what is commanded.
    commanded : (n_channels, n_samples) array
        Voltages at the beam, by the apparatus file's gain [V].
    time : (n_times,) array
        By the scope's clock, from the generator's first sample [s].
    timing : Timing
        Clock of the samples.
    """
    course = _Lagged(commanded, timing.hold, drive.lag).at(time / (1 + drive.clock) - drive.delay)
    return np.asarray(np.array(drive.gain)[:, None] * course)


class _Lagged:
    """Held samples behind a first-order lag, exact at every instant."""

    def __init__(self, voltage: FloatArray, hold: float, lag: float) -> None:
        from scipy.signal import lfilter

        self._hold, self._lag = hold, max(lag, 1e-9)
        self._target = np.pad(voltage, ((0, 0), (0, 1)))
        kept = np.exp(-hold / self._lag)
        self._before = lfilter([0.0, -np.expm1(-hold / self._lag)], [1.0, -kept], self._target)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the voltages at instants since the first sample arrived, (n_channels, n_times) array [V]."""
        index = np.clip((time / self._hold).astype(np.intp), 0, self._target.shape[1] - 1)
        faded = np.exp(-np.maximum(time - index * self._hold, 0.0) / self._lag)
        target = self._target[:, index]
        return np.asarray(np.where(time < 0, 0.0, target + (self._before[:, index] - target) * faded))


@dataclass(frozen=True)
class VibrometerDelay:
    """How the vibrometer follows the motion.

    Attributes
    ----------
    delay : float
        Pure delay [s].
    lag : float
        Time constant of its low-pass [s].
    rest : float
        Root mean square of the phases that delay and lag leave unexplained, each weighted by its certainty [rad].
    covariance : (2, 2) array
        Of delay and lag, by the fit and what it leaves over [s^2].
    """

    delay: float
    lag: float
    rest: float
    covariance: FloatArray = field(default_factory=lambda: np.zeros((2, 2)), compare=False)

    def response(self, pole: ComplexArray) -> ComplexArray:
        """Return what the vibrometer makes of a decay e^{st}, (n_poles,) complex array [1]."""
        return np.asarray(np.exp(-pole * self.delay) / (1 + pole * self.lag))

    def spread(self, pole: ComplexArray) -> FloatArray:
        """Return the standard error of the response, as a part of it, (n_poles,) array [1]."""
        slope = np.stack([-pole, -pole / (1 + pole * self.lag)], axis=1)
        variance = np.einsum("ki,ij,kj->k", slope, self.covariance, slope.conj()).real
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


DATA_SHEET = 0.2
"""Part by which a vibrometer's corner may differ from its data sheet, one standard deviation [1]."""


def fit_vibrometer(
    pole: ComplexArray, ratio: ComplexArray, spread: FloatArray, sign: FloatArray, bandwidth: float | None = None
) -> VibrometerDelay:
    """Return the vibrometer's delay and lag from responses that without it would be real.

    Parameters
    ----------
    pole : (n_modes,) complex array
        Poles [1/s].
    ratio : (n_modes, n_channels) complex array
        Measured response over the response to the same drive of a mode of unit gain [m/s^2 per V].
    spread : (n_modes, n_channels) array
        Their standard errors; infinite where there is none [m/s^2 per V].
    sign : (n_modes, n_channels) array
        Sign of the gain as listed; 0 where it is not known.
    bandwidth : float, optional
        Corner of its low-pass by its data sheet, without which phases hardly tell lag from delay [Hz].
    """
    from scipy.optimize import least_squares

    size = np.maximum(np.abs(ratio), 1e-30)
    # No response is known better than a thousandth: what the fit leaves out is larger.
    weight = 1 / np.hypot(spread, 1e-3 * size + 1e-30)

    def turned(values: FloatArray) -> ComplexArray:
        lag = VibrometerDelay(values[0] * 1e-6, abs(values[1]) * 1e-6, 0.0)
        return np.asarray(ratio / lag.response(pole)[:, None])

    expected = 0.5 if bandwidth is None else 1e6 / (2 * np.pi * bandwidth)
    doubt = 1.0 if bandwidth is None else DATA_SHEET * expected

    def rest(values: FloatArray) -> FloatArray:
        return np.append((turned(values).imag * weight).ravel(), (abs(values[1]) - expected) / doubt)

    def astray(delay: float) -> float:
        # A signal that is inverted as a whole is no later for it.
        straight = turned(np.array([delay, 0.0]))
        straight = straight * np.sign(np.sum(np.where(sign != 0, sign * straight.real / size, 0.0)))
        known = sign != 0
        return float(np.sum((np.abs(straight - sign * np.abs(straight)) / size)[known] ** 2))

    tried = np.arange(0.0, LONGEST * 1e6, 0.2)
    together = tried[int(np.argmin([astray(float(delay)) for delay in tried]))]
    # Delay and lag differ in the third power of lag times frequency only: a search from one lag may not see it.
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
    """What the modelled modes do at an instant.

    Attributes
    ----------
    velocity : (n_modes,) array
        Modal velocities [m/s].
    displacement : (n_modes,) array
        Modal displacements times natural angular frequency, w eta [m/s].
    spread : (n_modes,) array
        Standard error of each, from the noise of the records [m/s].
    half_width : (n_modes,) array
        Of the 95 % interval of each as this vibrometer shows it: noise, or what the points disagree by where noise does
        not explain that, with what vibrometer, trigger and natural frequencies leave unknown, in quadrature [m/s].
    change : (n_modes,) array
        How far the natural frequencies lie from the identified ones, as a part of them [1].
    disagreement : (n_modes,) array
        Standard error of each by what the points disagree by [m/s].
    slip : (n_modes,) array
        What that, and another damping, do to each: swing times error of the pole, over its decay rate [m/s].
    sensitivity_doubt : float
        Half width of the 95 % interval of the vibrometer's sensitivity, as a part of it [1].
    """

    velocity: FloatArray
    displacement: FloatArray
    spread: FloatArray
    half_width: FloatArray = field(default_factory=lambda: np.zeros(1))
    change: FloatArray = field(default_factory=lambda: np.zeros(1))
    disagreement: FloatArray = field(default_factory=lambda: np.zeros(1))
    slip: FloatArray = field(default_factory=lambda: np.zeros(1))
    sensitivity_doubt: float = 0.0

    @property
    def true_half_width(self) -> FloatArray:
        """Half widths of the 95 % intervals of the true velocity and w eta, (2, n_modes) array [m/s]."""
        return np.hypot(self.half_width, self.sensitivity_doubt * np.stack([self.velocity, self.displacement]))

    @property
    def shown_slip(self) -> FloatArray:
        """Slip that noise does not explain, (n_modes,) array [m/s]."""
        return np.maximum(self.slip - SLIP_NOISE * self.spread, 0.0)

    def error(self, target: FloatArray) -> tuple[float, float]:
        """Return the largest errors of velocity and of w eta against target velocities and rest [m/s]."""
        return float(np.abs(self.velocity - target).max()), float(np.abs(self.displacement).max())


@dataclass(frozen=True, eq=False)
class Plant:
    """An identified rig.

    Attributes
    ----------
    model : ModalModel
        Modes, with gains per volt at the beam of the strongest channel's amplifier.
    amplifier : Amplifier
        As identified; its limit holds for the voltage that really reaches the beam.
    drive : DriveDelay
        How the drive follows what is commanded.
    vibrometer : VibrometerDelay
        How the vibrometer follows the motion.
    unlisted : (n_unlisted,) complex array
        Poles of modes that the table lacks [1/s].
    certainty : (n_modes,) array
        How far each mode's swing stood out of the noise when it was identified, in standard errors [1].
    latency_doubt : float
        Half width of the 95 % interval of the time from the generator's first sample to the scope's [s].
    sensitivity_doubt : float
        The same of the vibrometer's sensitivity, as a part of it [1].
    """

    model: ModalModel
    amplifier: Amplifier
    drive: DriveDelay
    vibrometer: VibrometerDelay
    unlisted: ComplexArray
    certainty: FloatArray
    latency_doubt: float = 0.0
    sensitivity_doubt: float = 0.0

    @property
    def pole(self) -> ComplexArray:
        """Poles of all modes, the listed first, (n_modes + n_unlisted,) complex array [1/s]."""
        return np.concatenate([self.model.exponent, self.unlisted])

    def decay_time(self, recording_time: FloatArray, timing: Timing) -> FloatArray:
        """Return times since the focusing instant by the generator's clock, of instants by the scope's [s]."""
        return recording_time / (1 + self.drive.clock) - timing.focusing_instant

    def state(self, decay: Decay, shapes: FloatArray) -> ModalState:
        """Return the modes' state at the focusing instant.

        Parameters
        ----------
        decay : Decay
            Fitted with the poles of `pole`, at time 0 of `decay_time`.
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
        # Another time of the trigger turns velocity into displacement and back.
        late = self.model.angular_frequency * np.abs(swing) * self.latency_doubt
        error = decay.pole_error[:n]
        turned = self.model.angular_frequency * swing / pole
        missed = missed_swing(swing, spread, pole, error)
        return ModalState(
            velocity=swing.real,
            displacement=turned.real,
            spread=spread,
            half_width=np.sqrt((INTERVAL * either) ** 2 + late**2 + missed**2),
            change=error.imag / pole.imag,
            disagreement=by_points,
            slip=np.abs(swing * error / pole.real),
            sensitivity_doubt=self.sensitivity_doubt,
        )


def modal_swings(decay: Decay, shapes: FloatArray) -> ComplexArray:
    """Return each listed mode's complex amplitude over all points, by least squares, (n_modes,) array [m/s]."""
    n = shapes.shape[0]
    return np.asarray((decay.residue[:n] * shapes).sum(axis=1) / (shapes**2).sum(axis=1))


def unit_responses(model: ModalModel, drive: DriveDelay, voltage: FloatArray, timing: Timing) -> ComplexArray:
    """Return what a mode of unit gain would swing with after a burst, extrapolated back to the focusing instant."""
    unit = replace(model, modal_gain=np.ones_like(model.modal_gain))
    amplifier = Amplifier(gain=1.0, limit=1.0, bandwidth=drive.bandwidth, delay=drive.delay)
    system = DiagonalSystem.of(unit, amplifier)
    # Late enough for the last of the drive to have passed.
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
    """Return the rig behind the decays of probes, one on each channel.

    Parameters
    ----------
    model : ModalModel
        As listed; its shapes are kept.
    amplifier : Amplifier
        As listed.
    drive : DriveDelay
        From the measured drive.
    decay : Decay
        Of all probes together, probe after probe.
    shapes : (n_modes, n_points) array
        Mode shapes at the points of every probe's records [1].
    voltages : list of (n_channels, n_samples) arrays
        What each probe commands at the beam [V]; one channel in each.
    timing : Timing
        Clock of the samples.
    vibrometer_bandwidth : float, optional
        Corner of the vibrometer's low-pass by its data sheet [Hz].
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
        # What is identified is per commanded volt; the model counts real ones.
        model=replace(refined, modal_gain=gain / strongest),
        amplifier=replace(amplifier, gain=amplifier.gain * strongest, bandwidth=drive.bandwidth, delay=drive.delay),
        drive=drive,
        vibrometer=vibrometer,
        unlisted=decay.pole[n_modes:],
        certainty=np.asarray((np.abs(ratio) / np.maximum(spread, 1e-300)).max(axis=1)),
    )
