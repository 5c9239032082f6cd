"""Fingers that lose contact: against an integrator that locates each event, and in limiting cases."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.apparatus_sections import FingerSection, MaxwellSection, SecondMassSection
from modaltouch.rig.simulator.lift_off import PressedBeam
from modaltouch.rig.simulator.timeline import Playback
from modaltouch.rig.simulator.twin import Twin

FloatArray = NDArray[np.float64]
HERTZ, DAMPING, GAIN, MASS, PRESS = 229.0, 0.0437, 114e-3, 3.3e-3, 0.008
PLAIN: dict[str, Any] = {"mass_g": 0.4, "damping_N_s_per_m": 0.3, "stiffness_N_per_mm": 0.2}
COMPOSED = PLAIN | {
    "maxwell": (MaxwellSection(stiffness_N_per_mm=0.8, relaxation_ms=0.3),),
    "second_mass": SecondMassSection(mass_g=0.3, stiffness_N_per_mm=1.0, damping_N_s_per_m=0.2),
}


class Pressed:
    """One mode of shape 1 and a finger on it: 6 states in contact, 8 without contact.

    Beam's displacement and velocity, Maxwell force, stretch to the second mass, its velocity; then those of the finger.
    """

    def __init__(self, finger: FingerSection, volts: Callable[[float], float]) -> None:
        self.volts, w = volts, 2 * np.pi * HERTZ
        self.beam = w**2, 2 * DAMPING * w
        self.mass, self.damping = finger.mass_g * 1e-3, finger.damping_N_s_per_m
        self.stiffness = finger.stiffness_N_per_mm * 1e3
        self.maxwell = [(each.stiffness_N_per_mm * 1e3, each.relaxation_ms * 1e-3) for each in finger.maxwell]
        self.second = None if finger.second_mass is None else finger.second_mass.values

    def holding(self, place: float, speed: float, y: FloatArray) -> float:
        """Force of springs and dampers on the finger's mass, downwards."""
        second = 0.0 if self.second is None else self.second[1] * y[3]
        return float(self.damping * speed + self.stiffness * place + y[2] + second)

    def inner(self, speed: float, y: FloatArray) -> list[float]:
        """Rates of the Maxwell force, and of the second mass."""
        maxwell = sum(stiffness * speed - y[2] / time for stiffness, time in self.maxwell)
        if self.second is None:
            return [maxwell, 0.0, 0.0]
        mass, stiffness, damping = self.second
        return [maxwell, speed - y[4], (stiffness * y[3] - damping * y[4]) / mass]

    def beam_pushed(self, t: float, y: FloatArray) -> float:
        """Acceleration of the beam alone."""
        return float(GAIN * self.volts(t) - self.beam[0] * y[0] - self.beam[1] * y[1])

    def touching(self, t: float, y: FloatArray) -> list[float]:
        """Rates while the finger moves with the beam."""
        pushed = self.beam_pushed(t, y) - self.holding(y[0], y[1], y) / MASS
        return [y[1], pushed / (1 + self.mass / MASS), *self.inner(y[1], y), y[1], pushed / (1 + self.mass / MASS)]

    def apart(self, t: float, y: FloatArray) -> list[float]:
        """Rates while it has lost contact."""
        falls = -(self.holding(y[5], y[6], y) + PRESS) / self.mass
        return [y[1], self.beam_pushed(t, y) + PRESS / MASS, *self.inner(y[6], y), y[6], falls]

    def contact_force(self, t: float, y: FloatArray) -> float:
        """Force on the beam; the finger loses contact where it would become tensile."""
        return PRESS + self.mass * self.touching(t, y)[1] + self.holding(y[0], y[1], y)

    def speeds(self, times: FloatArray) -> tuple[FloatArray, int]:
        """Velocity of the beam at given instants, and how often the finger loses contact."""
        y, start, n_lifted, found = np.zeros(7), 0.0, 0, np.zeros(times.size)
        touches = True
        while start < times[-1]:

            def ends(t: float, y: FloatArray, touches: bool = touches) -> float:
                return self.contact_force(t, y) if touches else float(y[5] - y[0])

            ends.terminal, ends.direction = True, -1  # type: ignore[attr-defined]
            rates, span = self.touching if touches else self.apart, (start, float(times[-1]))
            part = solve_ivp(rates, span, y, events=ends, dense_output=True, rtol=1e-7, atol=1e-11, max_step=3e-4)
            here = (times >= start) & (times <= part.t[-1])
            found[here] = part.sol(times[here])[1]
            start, y = part.t[-1], part.y[:, -1].copy()
            if touches:
                n_lifted += part.status
            else:
                y[1] = y[6] = (y[1] * MASS + y[6] * self.mass) / (MASS + self.mass)
                y[5] = y[0]
            touches = not touches and self.contact_force(start, y) >= 0
        return found, n_lifted


@pytest.mark.parametrize("values", [PLAIN, COMPOSED], ids=["plain", "composed"])
def test_loss_of_contact_and_landing_follow_the_equations(
    with_twin: Callable[..., Apparatus], apparatus: Apparatus, playback: Callable[..., Playback], values: dict[str, Any]
) -> None:
    """Mode 1 alone, by an adaptive integrator with events; landing shares the momentum. Within 0.2 % of the peak."""
    finger, sine = FingerSection(**values), playback(20.0, n=20_000, hertz=180.0)
    mode = next(mode for mode in apparatus.modes if mode.label == 1)
    known = with_twin(apparatus, fingers=finger, finger_press_N=PRESS, beam_mass_g=MASS * 1e3)
    twin = Twin(known.model_copy(update={"modes": (mode,)}), 1)
    (held,) = twin.held_of([sine, None])
    reference = Pressed(finger, lambda t: 250 * np.sin(2 * np.pi * 180 * t) * np.sin(20 * np.pi * t) ** 2)
    expected, n_lifted = reference.speeds(held.hold * np.arange(1, 20_001))
    assert n_lifted >= 4
    pressed = PressedBeam.of(twin.beam, twin.amplifier, twin.fingers(0.0), PRESS)
    (found,) = pressed.velocities(held.voltage, held.hold)
    # At an event the velocity may jump one sample early or late.
    off = np.sort(np.abs(found - expected))[: -2 * n_lifted]
    assert off.max() < 2e-3 * np.abs(expected).max()
    assert twin.felt([sine, None], [0.0])[0] == pytest.approx(np.abs(found).max(), rel=1e-12)
    (never,) = PressedBeam.of(twin.beam, twin.amplifier, twin.fingers(0.0), 1e3).velocities(held.voltage, held.hold)
    assert np.abs(found - never).max() > 0.05 * np.abs(found).max()


def test_a_finger_that_presses_hard_never_loses_contact(
    with_twin: Callable[..., Apparatus], apparatus: Apparatus, playback: Callable[..., Playback]
) -> None:
    """All modes, torsion and the amplifier's pole: as by the coupled equations, except for the few contact points."""
    finger = FingerSection(**PLAIN)
    twins = [
        Twin(apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update={"fingers": finger, **press})}), 1)
        for press in ({}, {"finger_press_N": 1e3})
    ]
    drive = [playback(n=5_000, hertz=7137.0), playback(n=5_000, hertz=2553.0)]
    free, hard = (twin.felt(drive, [-0.04, 0.0, 0.02], touched=twin.fingers(0.0)) for twin in twins)
    assert hard == pytest.approx(free, rel=5e-3)
