r"""Identification of a beam and the fingers on it from a probe: frequencies, damping, gains, impedances, positions.

A probe is the velocity of one point per volt at discrete frequencies. With the impedance :math:`Z` of each finger,

.. math:: H_c = e^{-s\tau}\,\varphi(x_0)^T Y G_c, \qquad
   Y = \left[s + 2\xi\omega + \omega^2/s + \sum Z W / m_b\right]^{-1}, \qquad
   dH_c = -e^{-s\tau}\,\varphi^T Y\, d(Y^{-1})\, Y G_c.

It is fitted by least squares over the parameters of the beam and, for each finger, the position and the logarithms of
mass, damping and stiffness, all with wide priors. The estimates for the untouched beam, with their covariance, are the
prior of the fit with fingers, so that the covariance of any prediction with fingers includes every uncertainty.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.fingers import Finger
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantities import ComplexArray, FloatArray

_BEAM_SPREAD = (0.005, 0.1, 0.1, 20.0)
"""Prior standard deviations: logarithms of frequency and damping, gain [strongest of its mode], delay [us]."""

_FINGER_SPREAD = (1.0, 1.0, 1.5, 2.5)
"""Prior standard deviations: logarithms of mass, damping and stiffness, position [mm]."""

_RELAXATION = (1e-5, 1e-4, 1e-3)
"""Relaxation times of the Maxwell terms [s]."""

_TERM_DAMPING, _TERM_SPREAD = 0.1, 2.5
"""Prior of a Maxwell term: stiffness times relaxation time [N s/m] and the standard deviation of its logarithm."""

_SHIFT = 3e-3
"""Offset from the expected positions, to either side, of the starts of further fits until one is good [m]."""

_MODEL_ERROR = 1e-3
"""Smallest assumed model error, relative to each response [1]."""

_STEP = 1e-3
"""Step of a finger parameter for numerical derivatives [unit of the parameter]."""

_FINGER_DRIFT, _TERM_DRIFT = (0.3, 0.3, 0.5, 1.0), 0.5
"""Standard deviations of the change of a finger between a probe and a burst, in the units of the priors."""

_GAIN_DRIFT, _DELAY_DRIFT = 0.03, 1.0
"""The same for the gain of a channel [1], and for the instant of a record relative to its trigger [us]."""

_SCALE_DRIFT, _MOST_DRIFT = 0.002, 0.01
"""Standard deviation of the change of all gains between the probes with hands off and on, and largest one accepted [1].
Without it, fingers would make up for a changed sensitivity, at the cost of the level; a wide one misleads the fit."""

_DELAYS = np.arange(0.0, 60e-6, 0.25e-6)
"""Grid of delays of the velocity [s]."""

_MOST_EVALUATIONS, _MORE_EVALUATIONS, _PROMISING = 40, 160, 50.0
"""Limit of the evaluations of a fit (a good one takes 5 to 15), of further ones without Maxwell terms, and of the
misfit for which these are made [1]."""

_GOOD, _FAIR, _WORST = 1.3, 5.0, 10.0
"""Misfits up to which no Maxwell terms (relative to that of the untouched beam, if above 1) and no other starts are
tried, and above which the fit is rejected [1]."""

_FELT = 3.0
"""Ratio of the misfits without and with a finger up to which it counts as absent; 190 for 0.02 g with 0.1 N s/m."""

_TERMS_MUST_GAIN = 1.2
"""Smallest ratio of the misfits without and with Maxwell terms for which the terms are used [1]."""

_TERMS_DOUBT = 3.0
"""Ratio of intervals with Maxwell terms to those from the residuals [1]; the terms only approximate the true form."""

_OUTLIER, _MOST_OUTLIERS = 4.0, 0.1
"""Deviation above which a line is an outlier [standard deviations], and largest fraction of outliers excluded [1]."""

_WEAK = 0.1
"""Median ratio of noise to response above which a probe is too weak [1]."""

_MOVED = 3.0
"""Ratio of the variance between records to the noise variance above which something moved [1]."""

_SHRUNK = 0.05
"""Step of a parameter for `slopes`, relative to its standard deviation; small enough to be linear [1]."""


@dataclass(frozen=True, eq=False)
class ProbedBeam:
    """A beam identified by probes, with the covariance of its parameters.

    Attributes
    ----------
    model : ModalModel
        The beam, with its fingers.
    delay : float
        Delay of the velocity relative to the drive, in addition to that of the vibrometer's low-pass [s].
    covariance : (n_parameters, n_parameters) array
        Covariance of natural frequencies and damping ratios (logarithms), gains (relative to the strongest of each
        mode) and delay [us]; then, for each finger, of mass, damping and stiffness (logarithms), position [mm] and
        Maxwell terms (logarithms).
    misfit : float
        Mean square of the residuals of the fit, relative to that of the noise [1].
    trusted : (n_lines,) array of bool
        Mask of the lines that the listed modes explain.
    """

    model: ModalModel
    delay: float
    covariance: FloatArray
    misfit: float
    trusted: NDArray[np.bool_]

    @property
    def n_beam(self) -> int:
        """Number of parameters of the untouched beam."""
        return self.model.n_modes * (2 + self.model.n_channels) + 1

    def slopes(self, figures: Callable[[ModalModel], FloatArray], known: FloatArray | None = None) -> FloatArray:
        """Return the derivatives of figures with respect to the parameters, (n_parameters, n_figures) array.

        Derivatives with respect to parameters of the untouched beam are taken from `known`, if given: the derivatives
        with other fingers on the beam.
        """
        middle, steps = figures(self.model), np.diag(_SHRUNK * np.sqrt(np.diag(self.covariance)))
        start = 0 if known is None else self.n_beam
        own = [(figures(self.moved(step).model) - middle) / step.sum() for step in steps[start:]]
        return np.array(own) if known is None else np.concatenate([known[:start], own])

    def spread(self, slopes: FloatArray) -> FloatArray:
        """Return the standard deviations of figures from their derivatives, (n_figures,) array."""
        return np.asarray(np.sqrt(((np.linalg.cholesky(self.covariance).T @ slopes) ** 2).sum(axis=0)))

    def moved(self, step: FloatArray) -> ProbedBeam:
        """Return the beam with its parameters changed by `step`, in the units of the covariance."""
        model, n = self.model, self.model.n_modes
        ratio = np.exp(step[: 2 * n])
        fingers, start = [], self.n_beam
        for finger in model.fingers:
            stop = start + 4 + len(finger.maxwell)
            fingers.append(_moved(finger, step[start:stop], model.length))
            start = stop
        moved = replace(
            model,
            natural_frequency=model.natural_frequency * ratio[:n],
            damping_ratio=np.minimum(model.damping_ratio * ratio[n:], 0.99),
            modal_gain=model.modal_gain + step[2 * n : self.n_beam - 1].reshape(n, -1) * _strongest(model),
            fingers=tuple(fingers),
        )
        return replace(self, model=moved, delay=self.delay + float(step[self.n_beam - 1]) * 1e-6)

    def under(self, fingers: Sequence[Finger]) -> ProbedBeam:
        """Return the same beam with other fingers, which have wide priors, and an uncertain scale of all gains."""
        spreads = [[*_FINGER_SPREAD, *[_TERM_SPREAD] * len(finger.maxwell)] for finger in fingers]
        n, sizes = self.n_beam, np.concatenate(spreads)
        covariance = np.diag(np.append(np.zeros(n), sizes**2))
        covariance[:n, :n] = self.covariance[:n, :n]
        gains = _SCALE_DRIFT * (self.model.modal_gain / _strongest(self.model)).ravel()
        covariance[n - 1 - gains.size : n - 1, n - 1 - gains.size : n - 1] += np.outer(gains, gains)
        return replace(self, model=self.model.touched(tuple(fingers)), covariance=covariance)

    def with_drift(self) -> ProbedBeam:
        """Return the beam some time later, with more uncertain fingers, channel gains and trigger."""
        model, n, covariance = self.model, self.n_beam, self.covariance.copy()
        gains = model.modal_gain / _strongest(model)
        of_channel = (gains[:, :, None] * np.eye(model.n_channels)).reshape(-1, model.n_channels) * _GAIN_DRIFT
        covariance[2 * model.n_modes : n - 1, 2 * model.n_modes : n - 1] += of_channel @ of_channel.T
        drifts = [_DELAY_DRIFT]
        for finger in model.fingers:
            drifts += [*_FINGER_DRIFT, *[_TERM_DRIFT] * len(finger.maxwell)]
        covariance[n - 1 :, n - 1 :] += np.diag(np.square(drifts))
        return replace(self, covariance=covariance)


@dataclass(frozen=True, eq=False)
class Probe:
    """Velocity of a point of a beam under known voltages at single frequencies.

    Attributes
    ----------
    position : float
        Measured point, origin at mid-beam [m].
    frequency : (n_lines,) array
        Frequencies [Hz].
    drive : (n_lines, n_channels) array
        Voltage at each frequency: 1 V on one channel in a probe, the spectrum of a burst in its record [V or V s].
    response : (n_lines,) complex array
        Velocity at each frequency [m/s or m].
    deviation : (n_lines,) array
        Standard deviation of the noise in the real and in the imaginary part of each response [m/s or m].
    """

    position: float
    frequency: FloatArray
    drive: ComplexArray | FloatArray
    response: ComplexArray
    deviation: FloatArray

    @classmethod
    def averaged(cls, probes: Sequence[Probe]) -> Probe:
        """Return the mean of records of the same lines.

        Raises
        ------
        ValueError
            If they differ by more than their noise, for instance because a finger moved, or hold no velocity.
        """
        if not probes[0].deviation.all():
            raise ValueError(
                "the velocity is zero throughout: check that the vibrometer is on and its signal reaches the scope, "
                "and probe again"
            )
        response = np.array([probe.response for probe in probes])
        mean, n = response.mean(axis=0), len(probes)
        scatter = float((np.abs(response - mean) ** 2 / probes[0].deviation ** 2).mean()) * n / (n - 1) / 2
        if scatter > _MOVED:
            raise ValueError(
                f"the records of the probe differ by {scatter:.0f} times the variance of their noise, at most "
                f"{_MOVED:g} is allowed: something moved, or there is mains hum; keep the fingers still, or off, check "
                "the earth of the instruments, and probe again"
            )
        return replace(probes[0], response=mean, deviation=probes[0].deviation / np.sqrt(n))

    def untouched(self, model: ModalModel) -> ProbedBeam:
        """Return the untouched beam, fitted to this probe.

        Parameters
        ----------
        model : ModalModel
            The identified beam, with all its modes.

        Raises
        ------
        ValueError
            If the mode table does not describe the beam, or the probe is too weak.
        """
        noise = float(np.median(self.deviation / np.abs(self.response)))
        if noise > _WEAK:
            raise ValueError(
                f"the probe is too weak: half of its responses contain more than {noise:.0%} of noise, allowed: "
                f"{_WEAK:.0%}; check that the vibrometer sees the beam, or give `fingers probe` a higher --speed-mm-s"
            )
        n = model.n_modes
        prior = np.diag(np.repeat(_BEAM_SPREAD, [n, n, n * model.n_channels, 1]) ** 2)
        start = ProbedBeam(model.touched(()), 0.0, prior, np.inf, np.ones(0, dtype=bool))
        turned = self._responses(start)[0] * np.exp(-2j * np.pi * np.outer(_DELAYS, self.frequency))
        missed = (np.abs((turned - self.response) / self.deviation) ** 2).sum(axis=1)
        start = replace(start, delay=float(_DELAYS[missed.argmin()]), trusted=np.ones(self.frequency.size, dtype=bool))
        found = self._fitted(start)
        trusted = self._missed(found) <= _OUTLIER
        if 1 - _MOST_OUTLIERS <= trusted.mean() < 1:
            # Only for the untouched beam: with fingers, outliers may show that their impedance has another form.
            found = self._fitted(replace(start, trusted=trusted))
        if found.misfit > _WORST:
            raise ValueError(
                f"the modes of the table do not describe the untouched beam: misfit {found.misfit:.1f}, at most "
                f"{_WORST:g} is allowed; take all hands off, check sign, spot and trigger of the vibrometer, and enter "
                "the corner of a slow amplifier as `amplifier.bandwidth_kHz`; if that does not help, run `modaltouch "
                "identify --modes all`"
            )
        return found

    def touched(self, free: ProbedBeam, fingers: Sequence[Finger]) -> ProbedBeam:
        """Return the beam with the fingers on it, fitted to this probe.

        Parameters
        ----------
        free : ProbedBeam
            The same beam untouched, from a probe of the same lines.
        fingers : sequence of Finger
            The expected fingers, the start of the fit.

        Raises
        ------
        ValueError
            If a finger is not detected, or the fit is not acceptable.
        """
        terms = tuple((_TERM_DAMPING / time, time) for time in _RELAXATION)
        found = replace(free, misfit=np.inf)
        middle = (0.0,) * len(fingers)
        for shift in [middle, *itertools.product((_SHIFT, -_SHIFT), repeat=len(fingers))]:
            near = [replace(each, position=each.position + by) for each, by in zip(fingers, shift, strict=True)]
            for start in (near, [replace(each, maxwell=terms) for each in near]):
                if found.misfit > (_GOOD * max(free.misfit, 1.0) if shift == middle else _FAIR):
                    found = min(found, self._fitted(free.under(start)), key=_rank)
        if found.misfit > _WORST:
            raise ValueError(
                f"no combination of mass, damper and springs describes the fingers: misfit {found.misfit:.1f}, at "
                f"most {_WORST:g} is allowed; check that each finger lies on its zone, that nothing else touches the "
                "beam, and that spot, range and trigger of the vibrometer are those of the probe with hands off; probe "
                "again"
            )
        before, now = (beam.model.modal_gain / _strongest(free.model) for beam in (free, found))
        scale = float((before * now).sum() / (before**2).sum())
        doubt = _MOST_DRIFT * max(found.misfit, 1.0)
        if abs(scale - 1) > doubt:
            raise ValueError(
                f"all modes move {scale:.3f} times as fast as with hands off and these fingers: allowed "
                f"{1 - doubt:.3f} to {1 + doubt:.3f}; the vibrometer's sensitivity or the amplifier's gain "
                "changed: let both warm up and leave their settings; take the hands off and start over"
            )
        for expected, finger in zip(fingers, found.model.fingers, strict=True):
            others = tuple(each for each in found.model.fingers if each is not finger)
            missed = self._missed(replace(found, model=found.model.touched(others)))
            without = float((missed[found.trusted] ** 2).mean())
            if without <= _FELT * max(found.misfit, 1.0):
                raise ValueError(
                    f"no finger is detected at {expected.position * 1e3:+.0f} mm from mid-beam: the beam moves as "
                    f"without it (misfit {without:.1f}); place the finger there and probe again"
                )
        return found

    def later(self, known: ProbedBeam) -> ProbedBeam:
        """Return the beam and its fingers during a burst, fitted to this record of the burst.

        Parameters
        ----------
        known : ProbedBeam
            The same beam and fingers from a probe, at this placement.

        Raises
        ------
        ValueError
            If no drift of fingers and gains explains the record.
        """
        found = self._fitted(replace(known.with_drift(), trusted=np.ones(self.frequency.size, dtype=bool)))
        if found.misfit > _WORST:
            raise ValueError(
                f"no drift of the fingers explains the record: misfit {found.misfit:.1f}, at most {_WORST:g} is allowed"
            )
        return found

    def _missed(self, beam: ProbedBeam) -> FloatArray:
        """Return the residual of each response relative to its uncertainty, (n_lines,) array [1]."""
        missed = np.abs(self._responses(beam)[0] - self.response) / self._uncertainty
        return np.asarray(missed / np.sqrt(2))

    @property
    def _uncertainty(self) -> FloatArray:
        return np.hypot(self.deviation, _MODEL_ERROR * np.abs(self.response))

    def _fitted(self, prior: ProbedBeam) -> ProbedBeam:
        """Return the beam, with any fingers, fitted to the probe and the prior."""
        from scipy.optimize import least_squares

        deviation = np.where(prior.trusted, self._uncertainty, np.inf)
        whitened = np.linalg.inv(np.linalg.cholesky(prior.covariance))
        known: dict[bytes, tuple[FloatArray, FloatArray]] = {}

        def at(step: FloatArray) -> tuple[FloatArray, FloatArray]:
            key = step.tobytes()
            if key not in known:
                response, slope = self._responses(prior.moved(step))
                rest, slope = (response - self.response) / deviation, slope / deviation[:, None]
                known.clear()
                known[key] = (
                    np.concatenate([rest.real, rest.imag, whitened @ step]),
                    np.concatenate([slope.real, slope.imag, whitened]),
                )
            return known[key]

        step, misfit, relaxes = np.zeros(len(whitened)), 0.0, any(finger.maxwell for finger in prior.model.fingers)
        for most in (_MOST_EVALUATIONS, _MORE_EVALUATIONS):
            found = least_squares(lambda x: at(x)[0], step, lambda x: at(x)[1], method="lm", max_nfev=most)
            step = found.x
            rest, slope = at(step)
            misfit = float((rest[: -step.size] ** 2).sum()) / (2 * int(prior.trusted.sum()))
            if found.status != 0 or misfit > _PROMISING or relaxes:
                break
        # Errors of the model, unlike noise, do not average out over the lines.
        doubt = max(misfit, 1.0) * (_TERMS_DOUBT if relaxes else 1.0)
        covariance: FloatArray = np.linalg.inv(slope.T @ slope).astype(float) * doubt**2
        return replace(prior.moved(step), covariance=covariance, misfit=misfit)

    def _responses(self, beam: ProbedBeam) -> tuple[ComplexArray, ComplexArray]:
        """Return the responses of a beam, (n_lines,) array, and their derivatives, (n_lines, n_parameters) array."""
        model, n, rows = beam.model, beam.model.n_modes, np.arange(self.frequency.size)
        s: ComplexArray = (2j * np.pi * self.frequency[:, None]).astype(complex)
        omega, xi = model.angular_frequency, model.damping_ratio
        inverse = np.zeros((rows.size, n, n), dtype=complex)
        inverse[:, np.arange(n), np.arange(n)] = s + 2 * xi * omega + omega**2 / s
        for contact, finger in model.loads:
            inverse += finger.impedance(s)[:, :, None] * contact
        gain = self.drive @ model.modal_gain.T
        sides = np.stack([np.broadcast_to(model.shapes([self.position])[:, 0], gain.shape), gain], axis=2)
        left, right = np.moveaxis(np.linalg.solve(inverse, sides), 2, 0)
        left = left * np.exp(-s * beam.delay)
        response, through = (left * gain).sum(axis=1), -left * right
        gains = (left * _strongest(model)[:, 0])[:, :, None] * self.drive[:, None, :]
        slopes = [
            through * (2 * xi * omega + 2 * omega**2 / s),
            through * (2 * xi * omega),
            gains.reshape(rows.size, -1),
            -1e-6 * s * response[:, None],
        ]
        for finger in model.fingers:
            slopes += _slopes(model, finger, s, left, right)
        return response, np.concatenate(slopes, axis=1)


def _slopes(
    model: ModalModel, finger: Finger, s: ComplexArray, left: ComplexArray, right: ComplexArray
) -> Iterator[ComplexArray]:
    """Yield the derivatives with respect to each parameter of a finger, (n_lines, 1) arrays."""
    n = 4 + len(finger.maxwell)
    contact = model.touched((finger,)).loads[0][0]
    by_impedance = -((left @ contact) * right).sum(axis=1)[:, None]
    for number in range(n):
        low, high = (_moved(finger, side * _STEP * np.eye(n)[number], model.length) for side in (-1, 1))
        if number == 3:
            ends = [model.touched((each,)).loads[0][0] for each in (low, high)]
            turned = -((left @ (ends[1] - ends[0])) * right).sum(axis=1)[:, None]
            yield turned * finger.impedance(s) / (2 * _STEP)
        else:
            yield by_impedance * (high.impedance(s) - low.impedance(s)) / (2 * _STEP)


def _moved(finger: Finger, step: FloatArray, length: float) -> Finger:
    """Return a finger with its parameters changed by `step`, in the units of the covariance."""
    ratio = np.exp(np.clip(step, -20, 20)).tolist()
    return replace(
        finger,
        position=float(np.clip(finger.position + step[3] * 1e-3, -length / 2, length / 2)),
        mass=finger.mass * ratio[0],
        damping=finger.damping * ratio[1],
        stiffness=finger.stiffness * ratio[2],
        maxwell=tuple((spring * r, time) for (spring, time), r in zip(finger.maxwell, ratio[4:], strict=True)),
    )


def _rank(beam: ProbedBeam) -> float:
    """Return the misfit, penalised for Maxwell terms, which are used only if they improve the fit considerably."""
    return beam.misfit * (_TERMS_MUST_GAIN if any(finger.maxwell for finger in beam.model.fingers) else 1.0)


def _strongest(model: ModalModel) -> FloatArray:
    """Return the largest gain of each mode, (n_modes, 1) array; the median of the others for a mode without a gain."""
    size = np.abs(model.modal_gain).max(axis=1, keepdims=True)
    return np.asarray(np.where(size > 0, size, np.median(size[size > 0])))
