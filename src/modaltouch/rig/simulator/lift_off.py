"""Fingers that lift off: skin and beam separate where the tension exceeds the contact force.

A contact consists of a few points along two lines of the beam, each with a share of the finger and of its contact
force. A point that has lifted off no longer loads the beam; its masses, dampers and springs move freely under its share
of the force until it lands, without a rebound. Between such events the system is linear and is integrated from instant
to instant with matrix exponentials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.simulator.true_beam import FloatArray, TrueBeam
from modaltouch.stimulus import Amplifier, Finger

Touching = tuple[bool, ...]

NODES = 5
"""Points of a contact along each of two lines, for an error below 1e-5 in a mode of 88 kHz."""

LEAST_MASS = 1e-7
"""Smallest mass of a point [kg]; after lift-off it follows its damper and spring within microseconds."""


@dataclass(frozen=True, eq=False)
class PressedBeam:
    """A beam, its amplifier, and points of fingers that press on it from above.

    Attributes
    ----------
    omega, damping : (n_modes,) array
        Natural angular frequencies, and twice their products with the damping ratios [rad/s].
    gain : (n_modes, n_channels) array
        Modal accelerations per volt at the beam [m/s^2 per V].
    pole : float or None
        Pole of the amplifier [rad/s]; None for an amplifier without one.
    mass : float
        Moving mass of the beam [kg].
    shape : (n_modes, n_points) array
        Mode shapes at the points [1].
    points : sequence of (Finger, float)
        Share of a finger, and of its contact force [N], of each point.
    """

    omega: FloatArray
    damping: FloatArray
    gain: FloatArray
    pole: float | None
    mass: float
    shape: FloatArray
    points: Sequence[tuple[Finger, float]]

    @classmethod
    def of(
        cls, beam: TrueBeam, amplifier: Amplifier, fingers: Sequence[Finger], press: float, stretch: float = 1.0
    ) -> PressedBeam:
        """Return a beam under fingers that each `press` [N]; `stretch` scales its natural frequencies [1]."""
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        along = np.array([np.tile(each.position + each.width / 2 * nodes, 2) for each in fingers])
        across = beam.width / np.sqrt(12.0) * np.repeat([-1.0, 1.0], NODES)
        half = beam.table.length / 2
        omega = 2 * np.pi * stretch * beam.natural_frequency
        return cls(
            omega=omega,
            damping=2 * beam.damping_ratio * omega,
            gain=beam.modal_gain,
            pole=None if amplifier.bandwidth is None else 2 * np.pi * amplifier.bandwidth,
            mass=beam.mass,
            shape=beam.shapes(np.clip(along, -half, half).ravel(), np.tile(across, len(fingers))),
            points=[(_share(each, share), press * share) for each in fingers for share in np.tile(weights / 4, 2)],
        )

    def velocities(self, voltage: FloatArray, hold: float) -> FloatArray:
        """Return modal velocities at the end of each sample, from rest, (n_modes, n_samples) array [m/s].

        Parameters
        ----------
        voltage : (n_channels, n_samples) array
            Before the amplifier's pole [V].
        hold : float
            Length of a sample [s].
        """
        n, touching = self.omega.size, (True,) * len(self.points)
        steps = {touching: self._step(touching, hold)}
        step, signals = steps[touching]
        # The states, then the inputs: voltages, and 1 for the contact force.
        values = np.zeros(step.shape[1])
        values[-1], n_states = 1.0, len(step)
        velocity = np.empty((voltage.shape[1], n))
        for sample, volts in enumerate(voltage.T):
            values[n_states:-1] = volts
            values[:n_states] = step @ values
            velocity[sample] = values[n : 2 * n]
            turned = signals @ values < 0
            if turned.any():
                touching = self._turned(touching, turned, values)
                if touching not in steps:
                    steps[touching] = self._step(touching, hold)
                step, signals = steps[touching]
        return velocity.T

    def _places(self) -> tuple[list[slice], int, slice]:
        """Return slices of the states of each point, the number of states, and the slice of voltages at the beam."""
        n, n_channels = self.gain.shape
        start = 2 * n + (0 if self.pole is None else n_channels)
        places = []
        for finger, _ in self.points:
            places.append(slice(start, start + len(_own(finger)[1])))
            start = places[-1].stop
        volts = start if self.pole is None else 2 * n
        return places, start, slice(volts, volts + n_channels)

    def _step(self, touching: Touching, hold: float) -> tuple[FloatArray, FloatArray]:
        """Return the matrix that advances all states, and that of signals negative if a point lifts off or lands."""
        from scipy.linalg import expm

        n, n_channels = self.gain.shape
        places, n_states, volts = self._places()
        rate, force = np.zeros((n_states + n_channels + 1,) * 2), np.zeros((n, n_states + n_channels + 1))
        rate[:n, n : 2 * n] = np.diag(self.omega)
        if self.pole is not None:
            rate[volts, volts], rate[volts, n_states:-1] = (
                -self.pole * np.eye(n_channels),
                self.pole * np.eye(n_channels),
            )
        force[:, :n], force[:, n : 2 * n], force[:, volts] = -np.diag(self.omega), -np.diag(self.damping), self.gain
        for (finger, press), own, shape, touches in zip(self.points, places, self.shape.T, touching, strict=True):
            rate[own, own], holding = _own(finger)
            if touches:
                force[:, own] -= np.outer(shape, holding) / self.mass
            else:
                force[:, -1] += shape * press / self.mass
        rate[n : 2 * n] = np.linalg.solve(self._inertia(touching), force)
        signals = np.zeros((len(self.points), len(rate)))
        for row, (finger, press), own, shape, touches in zip(
            signals, self.points, places, self.shape.T, touching, strict=True
        ):
            holding, speed = _own(finger)[1], own.start + 1
            if touches:
                rate[speed] = shape @ rate[n : 2 * n]
                row[:] = finger.mass * rate[speed]
                row[own] += holding
                row[-1] += press
            else:
                rate[speed, own], rate[speed, -1] = -holding / finger.mass, -press / finger.mass
                row[own.start], row[:n] = 1.0, -shape / self.omega
        return expm(rate * hold)[:n_states], signals

    def _inertia(self, touching: Touching) -> FloatArray:
        loads = np.array([finger.mass * touches for (finger, _), touches in zip(self.points, touching, strict=True)])
        return np.asarray(np.eye(self.omega.size) + (self.shape * loads / self.mass) @ self.shape.T)

    def _turned(self, touching: Touching, turned: NDArray[np.bool_], values: FloatArray) -> Touching:
        """Return the points in contact after some have lifted off or landed; momentum is conserved on landing."""
        n, (places, *_) = self.omega.size, self._places()
        after = tuple(bool(was ^ turns) for was, turns in zip(touching, turned, strict=True))
        stays = tuple(was and is_on for was, is_on in zip(touching, after, strict=True))
        momentum = self._inertia(stays) @ values[n : 2 * n]
        for (finger, _), own, shape, was, turns in zip(
            self.points, places, self.shape.T, touching, turned, strict=True
        ):
            if turns and not was:
                momentum += shape * finger.mass * values[own.start + 1] / self.mass
                values[own.start] = shape @ (values[:n] / self.omega)
        values[n : 2 * n] = np.linalg.solve(self._inertia(after), momentum)
        for own, shape, touches in zip(places, self.shape.T, after, strict=True):
            if touches:
                values[own.start + 1] = shape @ values[n : 2 * n]
        return after


def _share(finger: Finger, share: float) -> Finger:
    second = finger.second_mass
    return replace(
        finger,
        mass=max(finger.mass * share, LEAST_MASS),
        damping=finger.damping * share,
        stiffness=finger.stiffness * share,
        maxwell=tuple((stiffness * share, time) for stiffness, time in finger.maxwell),
        second_mass=None if second is None else (second[0] * share, second[1] * share, second[2] * share),
    )


def _own(finger: Finger) -> tuple[FloatArray, FloatArray]:
    """Return the rate matrix of a finger's states, without its acceleration, and the row of the force against it.

    The states are displacement, velocity, the forces of the Maxwell terms, the extension of the spring to a second
    mass, and the velocity of that mass.
    """
    n = 2 + len(finger.maxwell) + (0 if finger.second_mass is None else 2)
    rate, holding = np.zeros((n, n)), np.zeros(n)
    rate[0, 1], holding[0], holding[1] = 1.0, finger.stiffness, finger.damping
    for place, (stiffness, time) in enumerate(finger.maxwell, 2):
        rate[place, 1], rate[place, place], holding[place] = stiffness, -1 / time, 1.0
    if finger.second_mass is not None:
        mass, stiffness, damping = finger.second_mass
        rate[n - 2, 1], rate[n - 2, n - 1], holding[n - 2] = 1.0, -1.0, stiffness
        rate[n - 1, n - 2], rate[n - 1, n - 1] = stiffness / mass, -damping / mass
    return rate, holding
