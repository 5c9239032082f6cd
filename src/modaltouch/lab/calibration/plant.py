"""The rig as a calibration identifies it: modes, amplifier, vibrometer, clock; and states read off free decays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modaltouch.lab.arrays import ComplexArray, FloatArray
from modaltouch.lab.calibration.decay import Decay
from modaltouch.lab.calibration.delays import DriveDelay, VibrometerDelay, fit_vibrometer
from modaltouch.stimulus import Amplifier, ModalModel, Timing, modal_system, states_by_channel


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
    """

    velocity: FloatArray
    displacement: FloatArray
    spread: FloatArray

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
    """

    model: ModalModel
    amplifier: Amplifier
    drive: DriveDelay
    vibrometer: VibrometerDelay
    unlisted: ComplexArray
    certainty: FloatArray

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
        n = self.model.n_modes
        swing = modal_swings(decay, shapes) / self.vibrometer.response(self.model.exponent)
        spread = decay.spread[:n] / np.sqrt((shapes**2).sum(axis=1))
        turned = self.model.angular_frequency * swing / self.model.exponent
        return ModalState(swing.real, turned.real, spread)


def modal_swings(decay: Decay, shapes: FloatArray) -> ComplexArray:
    """Return each listed mode's complex amplitude over all points, by least squares, (n_modes,) array [m/s]."""
    n = shapes.shape[0]
    return np.asarray((decay.residue[:n] * shapes).sum(axis=1) / (shapes**2).sum(axis=1))


def unit_responses(model: ModalModel, drive: DriveDelay, voltage: FloatArray, timing: Timing) -> ComplexArray:
    """Return what a mode of unit gain would swing with after a burst, extrapolated back to the focusing instant."""
    unit = replace(model, modal_gain=np.ones_like(model.modal_gain))
    amplifier = Amplifier(gain=1.0, limit=1.0, bandwidth=drive.bandwidth, delay=drive.delay)
    system = modal_system(unit, amplifier)
    # Late enough for the last of the drive to have passed.
    later = drive.delay + 20 * drive.lag + timing.hold
    instant = min(timing.focusing_instant + later, timing.duration)
    state = states_by_channel(system, voltage, timing, instant)[:, : model.n_modes].T
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
    vibrometer = fit_vibrometer(pole, ratio, spread, np.sign(model.modal_gain))
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
