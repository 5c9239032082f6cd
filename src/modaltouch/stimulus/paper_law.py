r"""The drive law of the paper, equations (6) and (7), kept to show what the exact law is for.

Corrected are these errata:

1. the gain of section III-B is printed with :math:`\omega^2`; at resonance
   :math:`|\dot\eta| = G|v|/(2\xi\omega)`;
2. equation (7) is printed with the factor :math:`4a^2/b`; inserting (6) in (5) gives
   :math:`\psi = 4a\,\dot\eta`;
4. equation (6) has :math:`e^{ct}`, equation (7) :math:`e^{a(t-t_F)}` with the same amplitude; the latter is
   meant;

and one kept, since its miss is the reason for the exact law:

3. the orbit (6) does not start at rest; begun from rest, mode 1 ends 4 % short.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.drive import Drive, Release, brake, check_drivable
from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.synthesis import synthesise
from modaltouch.stimulus.timing import Timing
from modaltouch.stimulus.vibration import states_by_channel

FloatArray = NDArray[np.float64]


def assigned_channel(model: ModalModel) -> NDArray[np.intp]:
    """Return the channel that drives each mode best, (n_modes,) array of indices: the paper's assignment."""
    return np.asarray(np.argmax(np.abs(model.modal_gain), axis=1))


def paper_drive(
    model: ModalModel, system: DiagonalSystem, timing: Timing, target: FloatArray, release: Release
) -> Drive:
    r"""Return the voltages of the paper, :math:`v = \sum_k 4 a_k \dot\eta_k(t) / G_k` until the focus.

    With :math:`\dot\eta_k = \dot\eta_k(t_F) e^{a_k (t - t_F)} \cos b_k (t - t_F)`, each mode on the channel
    that drives it best, sampled at the middle of each hold. Sample 0 is set to 0 V, where the generator idles.

    Parameters
    ----------
    model : ModalModel
        The modelled modes; those with target 0 are left alone.
    system : DiagonalSystem
        Their equations behind the amplifier, of which the paper takes no account.
    timing : Timing
        Clock of the samples.
    target : (n_modes,) array
        Modal velocities at the focusing instant [m/s].
    release : str
        ``braked`` (steered to rest at the end of the burst) or ``free`` (zero volts after the focus).

    References
    ----------
    Section II-C, equations (6) and (7), errata in the docstring of this module.
    """
    check_drivable(model, target, timing)
    asked = np.flatnonzero(target)
    channel = assigned_channel(model)[asked]
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
    state = states_by_channel(system, voltage, timing, instant).sum(axis=0)
    if release == "braked":
        late = abs(arrival - instant) > 1e-9 * timing.hold
        begin = states_by_channel(system, voltage, timing, arrival).sum(axis=0) if late else state
        brake(model, system, timing, voltage, n_before, begin)
    miss = np.concatenate([(system.velocity @ state).real - target, (system.displacement @ state).real])
    return Drive(voltage, 1.0, float(np.abs(miss).max()), n_before)
