r"""The modal equations and the amplifier before them as uncoupled complex first-order equations.

With :math:`s = -a + ib` the state :math:`z = \dot\eta - \bar s \eta` of a mode obeys
:math:`\dot z = s z + \psi`, from which :math:`\dot\eta = \mathrm{Re}[(1 + ia/b) z]` and
:math:`\omega\eta = \mathrm{Re}[-i (\omega/b) z]`. No difference of nearly equal numbers appears, where a
second-order section sees :math:`1 - \cos(b\,dt)`.

An amplifier of first order, :math:`\dot u = p (v - u)`, leaves the equations uncoupled: the state
:math:`y = z + \sum_c G_c u_c / (p + s)` obeys :math:`\dot y = s y + \frac{p}{p+s} \sum_c G_c v_c`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.bounds import require_positive
from modaltouch.stimulus.modes import ModalModel

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Amplifier:
    """What stands between generator and beam, the same for every channel.

    Attributes
    ----------
    gain : float
        Voltage at the beam per volt at the amplifier's input [V/V].
    limit : float
        Highest voltage at the beam [V].
    bandwidth : float or None
        Corner frequency of the amplifier's first-order pole [Hz]; None where it does not matter.
    delay : float
        From the generator's output to the beam [s].
    """

    gain: float
    limit: float
    bandwidth: float | None = None
    delay: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no amplifier."""
        require_positive("the gain of the amplifier", self.gain, "V/V", "measure it")
        require_positive("the limit of the amplifier", self.limit, "V", "read it off its data sheet")
        if self.bandwidth is not None:
            require_positive("the bandwidth of the amplifier", self.bandwidth, "Hz", "give none if unknown")
        if not (math.isfinite(self.delay) and self.delay >= 0):
            raise ValueError(f"the delay of the amplifier is {self.delay} s; it must be 0 s or above: measure it")


@dataclass(frozen=True, eq=False)
class DiagonalSystem:
    """Uncoupled first-order equations x' = exponent * x + input_gain @ voltage, and what is read off them.

    Attributes
    ----------
    exponent : (n_states,) complex array
        One per mode, then one per channel where the amplifier has a pole [1/s].
    input_gain : (n_states, n_channels) complex array
        What a volt does to each state [m/s^2 per V; V/s per V for the amplifier's states].
    velocity : (n_modes, n_states) complex array
        Modal velocities [m/s] are the real part of `velocity @ state`.
    displacement : (n_modes, n_states) complex array
        Modal displacements times angular frequency [m/s] are the real part of `displacement @ state`.
    delay : float
        From the generator's output to the beam [s].
    """

    exponent: ComplexArray
    input_gain: ComplexArray
    velocity: ComplexArray
    displacement: ComplexArray
    delay: float

    @property
    def n_modes(self) -> int:
        """Number of modes; their states come first."""
        return int(self.velocity.shape[0])

    def held_gain(self, hold: float) -> ComplexArray:
        """Return what one volt held for a while leaves in each state, (n_states, n_channels) array.

        Parameters
        ----------
        hold : float
            How long the volt is held [s].
        """
        return np.asarray((np.expm1(self.exponent * hold) / self.exponent)[:, None] * self.input_gain)


def modal_system(model: ModalModel, amplifier: Amplifier | None = None) -> DiagonalSystem:
    """Return the equations of a beam behind an amplifier.

    Parameters
    ----------
    model : ModalModel
        The modes.
    amplifier : Amplifier, optional
        Its pole and delay count; its gain does not, since voltages are those at the beam. None for neither.
    """
    s = model.exponent
    gain = model.modal_gain
    read_velocity = 1 - 1j * s.real / s.imag
    read_displacement = -1j * model.angular_frequency / s.imag
    if amplifier is None or amplifier.bandwidth is None:
        return DiagonalSystem(
            exponent=s,
            input_gain=gain.astype(complex),
            velocity=np.diag(read_velocity),
            displacement=np.diag(read_displacement),
            delay=0.0 if amplifier is None else amplifier.delay,
        )
    pole = 2 * np.pi * amplifier.bandwidth
    share = 1 / (pole + s)
    from_mode = np.eye(model.n_modes)
    from_pole = -share[:, None] * gain
    return DiagonalSystem(
        exponent=np.concatenate([s, np.full(model.n_channels, -pole, dtype=complex)]),
        input_gain=np.concatenate([(pole * share)[:, None] * gain, pole * np.eye(model.n_channels)]),
        velocity=read_velocity[:, None] * np.concatenate([from_mode, from_pole], axis=1),
        displacement=read_displacement[:, None] * np.concatenate([from_mode, from_pole], axis=1),
        delay=amplifier.delay,
    )
