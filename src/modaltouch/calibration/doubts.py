"""What a calibration does not believe: a drive that does not follow, a mode that is not there, another beam's table."""

from __future__ import annotations

import numpy as np

from modaltouch.calibration.lag import DriveLag
from modaltouch.calibration.plant import Plant
from modaltouch.rig.interface import RigError
from modaltouch.stimulus.modes import ModalModel

GAINS = (0.67, 1.5)
"""Measured over commanded drive that is believed [1]: beyond, a probe or a switch is not as the file says."""

NOTHING = 0.02
"""Measured over commanded drive below which there is none [1]."""

LARGEST_REST = 0.3
"""Part of the measured drive that delay, lag and gain may leave unexplained [1]: noise alone leaves a twentieth."""

LEAST_CERTAINTY = 8.0
"""Standard errors by which a mode's swing must stand out of the noise [1]."""

FURTHEST = 0.05
"""How far a natural frequency may lie from the listed one [1]: further, it may be another mode's."""

LARGEST_PHASE = 0.2
"""Phase that the vibrometer's delay and lag may leave unexplained [rad]."""


def refuse_doubtful_drive(drive: DriveLag) -> None:
    """Refuse a measured drive that is not the commanded one behind an amplifier.

    Raises
    ------
    RigError
        With what was found, what is allowed and what to look at.
    """
    believed = drive.rest <= LARGEST_REST
    for number, gain in enumerate(drive.gain, start=1):
        if (believed or abs(gain) < NOTHING) and not GAINS[0] <= gain <= GAINS[1]:
            raise RigError(
                f"the drive measured at the beam is {gain:.2f} times what output {number} commands: allowed "
                f"{GAINS[0]:g} to {GAINS[1]:g}; the outputs are off; see whether the amplifier is on and its gain as "
                "in the apparatus file, the probe at its output, and `acquisition.probe_attenuation` right"
            )
    if not believed:
        raise RigError(
            f"of the drive measured at the beam, {drive.rest:.0%} is not the commanded one behind a delay and a lag: "
            f"allowed at most {LARGEST_REST:.0%}; the outputs are off; see whether the probes are at the amplifier's "
            "outputs and it does not saturate"
        )


def refuse_doubtful_plant(plant: Plant, listed: ModalModel, margin: float) -> None:
    """Refuse modes that are not seen, or are not those of the table.

    Parameters
    ----------
    plant : Plant
        As identified.
    listed : ModalModel
        The table.
    margin : float
        From the focusing instant to the first sample of a decay [s].

    Raises
    ------
    RigError
        With the mode, what was found, what is listed, and what to do.
    """
    found = plant.model
    for row, label in enumerate(listed.label):
        if not plant.certainty[row] >= LEAST_CERTAINTY:
            raise RigError(
                f"mode {label} at {listed.natural_frequency[row]:.0f} Hz is not seen: it stands out of the noise by "
                f"{plant.certainty[row]:.1f} standard errors, needed are {LEAST_CERTAINTY:g}; the outputs are off; see "
                "whether the vibrometer is focused on the beam and its signal reaches the scope"
            )
        moved = found.natural_frequency[row] / listed.natural_frequency[row] - 1
        if abs(moved) > FURTHEST:
            raise RigError(
                f"mode {label} was found at {found.natural_frequency[row]:.0f} Hz, {moved:+.1%} from the listed "
                f"{listed.natural_frequency[row]:.0f} Hz: allowed {FURTHEST:.0%}; the outputs are off; identify the "
                "beam anew with `modaltouch identify`"
            )
    _refuse_phases(plant, margin)
    known = listed.modal_gain != 0
    ratio = np.where(known, found.modal_gain / np.where(known, listed.modal_gain, 1.0), 1.0)
    if (ratio[known] < 0).all():
        raise RigError(
            "every mode moves against the sign of its listed gain: the vibrometer's signal or the drive is inverted; "
            "the outputs are off; turn the signal round"
        )
    for row, channel in np.argwhere((ratio < 0.4) | (ratio > 2.5)).tolist():
        raise RigError(
            f"the gain of mode {listed.label[row]} by output {channel + 1} was found as "
            f"{found.modal_gain[row, channel] * 1e3:.4g} mm/s^2 per V, listed is "
            f"{listed.modal_gain[row, channel] * 1e3:.4g}: allowed 0.4 to 2.5 times that; the outputs are off; see "
            "whether the sets are wired as listed, or identify the beam anew with `modaltouch identify`"
        )


def _refuse_phases(plant: Plant, margin: float) -> None:
    """Refuse a vibrometer that is no delay and low-pass, or so late that the records begin before its signal."""
    sight = plant.sight
    if sight.rest > LARGEST_PHASE:
        raise RigError(
            f"the modes' phases differ by {sight.rest:.2f} rad from those of a delay and a low-pass: allowed "
            f"{LARGEST_PHASE:g} rad; the outputs are off; see which filters the vibrometer has switched on"
        )
    if sight.delay + 10 * sight.lag > margin:
        raise RigError(
            f"the vibrometer is {sight.delay * 1e6:.0f} us late, with a low-pass of {sight.lag * 1e6:.1f} us: allowed "
            f"together with ten times the latter {margin * 1e6:.0f} us; the outputs are off; switch on a faster filter"
        )
