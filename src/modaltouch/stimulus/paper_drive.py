"""The drive law of the paper, corrected where it contradicts itself; the errata stand in `drive`."""

from __future__ import annotations

import numpy as np

from modaltouch.stimulus.drive import Drive, Steering, check_drivable
from modaltouch.stimulus.synthesis import synthesise


def paper_drive(steering: Steering) -> Drive:
    r"""Return the voltages of the paper, :math:`v = \sum_k 4 a_k \dot\eta_k(t) / G_k` until the focus.

    With :math:`\dot\eta_k = \dot\eta_k(t_F) e^{a_k (t - t_F)} \cos b_k (t - t_F)`, each mode on the channel
    that drives it best, sampled at the middle of each hold. Sample 0 is set to 0 V, where the generator idles.
    The amplifier is not taken into account.

    Parameters
    ----------
    steering : Steering
        Modes with a velocity of 0 are left alone; displacements have no meaning.

    References
    ----------
    Section II-C, equations (6) and (7), errata in the docstring of `drive`.
    """
    model, system, timing, target = steering.model, steering.system, steering.timing, steering.velocity
    check_drivable(model, target, timing)
    asked = np.flatnonzero(target)
    # Each mode by the channel that drives it best, the paper's assignment.
    channel = np.abs(model.modal_gain).argmax(axis=1)[asked]
    exponent = model.exponent[asked]
    n_before = min(int(timing.focusing_instant * timing.sampling_rate + 0.5), timing.n_samples - 1)
    to_focus = timing.focusing_instant - (n_before - 0.5) * timing.hold
    amplitude = np.zeros((model.n_channels, asked.size), dtype=complex)
    force = -4 * exponent.real * target[asked] * np.exp(exponent * to_focus)
    amplitude[channel, np.arange(asked.size)] = force / model.modal_gain[asked, channel]
    voltage = np.zeros((model.n_channels, timing.n_samples))
    synthesise(amplitude, exponent, timing.hold, voltage[:, :n_before])
    voltage[:, 0] = 0.0
    instant, arrival = timing.focusing_instant, n_before * timing.hold + system.delay
    state = system.state_at(voltage, timing, instant)
    if steering.release == "braked":
        late = abs(arrival - instant) > 1e-9 * timing.hold
        steering.brake(voltage, n_before, system.state_at(voltage, timing, arrival) if late else state)
    reached, displacement = system.read(state)
    return Drive(voltage, 1.0, float(np.abs([reached - target, displacement]).max()), n_before)
