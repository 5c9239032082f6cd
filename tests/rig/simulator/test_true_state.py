"""The true motion of the simulated beam and its amplifier over time, against exact states and closed forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.apparatus_sections import TrueAmplifier
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.simulator.motion import DriveVoltage, Motion, state_at
from modaltouch.rig.simulator.scope import drive_voltage, motions_of
from modaltouch.rig.simulator.timeline import Playback
from modaltouch.rig.simulator.twin import Twin
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.stimulus import design_stimulus
from modaltouch.stimulus.target_field import TargetField


def test_a_twin_without_mismatch_reaches_the_design_targets(
    with_twin: Callable[..., Apparatus], apparatus: Apparatus, shipped_burst: list[Playback]
) -> None:
    """True state at the focusing instant: the targets and w eta = 0, to the 1e-3 mm/s that 14 bits permit."""
    design = design_stimulus(
        apparatus.modal_model(), TargetField(), Timing(AFG3022B.converter), apparatus.amplifier_values()
    )
    state = Twin(with_twin(apparatus), 1).true_state(shipped_burst, 0.025, first=True)
    np.testing.assert_allclose(state.velocity, design.target, atol=1e-6)
    np.testing.assert_allclose(state.displacement, 0.0, atol=1e-6)


def test_the_shipped_twin_has_errors_like_those_in_the_paper(
    apparatus: Apparatus, shipped_burst: list[Playback]
) -> None:
    """Section IV of the paper: worst modal coefficient off by 6 mm/s; here 1 to 12 mm/s of 200 over five seeds."""
    design = design_stimulus(
        apparatus.modal_model(), TargetField(), Timing(AFG3022B.converter), apparatus.amplifier_values()
    )
    for seed in range(5):
        twin = Twin(apparatus, seed)
        state = twin.true_state(shipped_burst, 0.025 + twin.amplifier.delay)
        miss = np.abs(np.concatenate([state.velocity - design.target, state.displacement])).max()
        assert 1e-3 < miss < 12e-3


def test_the_delay_of_the_amplifier_shifts_the_true_state(
    with_twin: Callable[..., Apparatus], apparatus: Apparatus, shipped_burst: list[Playback]
) -> None:
    """The state is that without a delay, later by the delay."""
    late = Twin(with_twin(apparatus, amplifier=TrueAmplifier(delay_us=5.0)), 1)
    prompt = Twin(with_twin(apparatus), 1)
    shifted, plain = late.true_state(shipped_burst, 0.025 + 5e-6), prompt.true_state(shipped_burst, 0.025)
    np.testing.assert_allclose(shifted.velocity, plain.velocity, atol=1e-9)
    np.testing.assert_allclose(shifted.displacement, plain.displacement, atol=1e-9)


def test_repeated_bursts_start_from_a_residual_motion(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """Bursts every 50 ms without a pause: mode 1 keeps e^(-a T) of its motion from one to the next (closed form)."""
    mode = next(mode for mode in apparatus.modes if mode.label == 1)
    twin = Twin(with_twin(apparatus).model_copy(update={"modes": (mode,)}), 1)
    drive = replace(playback(), period=0.05)
    first, steady = (twin.true_state([drive, None], 0.05, first=first) for first in (True, False))
    exponent = twin.system().exponent[0]
    gain = 1 / (1 - np.exp(exponent * 0.05))
    read, shown = twin.system().velocity[0, 0], twin.system().displacement[0, 0]
    z = np.linalg.solve(
        [[read.real, -read.imag], [shown.real, -shown.imag]], [first.velocity[0], first.displacement[0]]
    )
    expected = read * (z[0] + 1j * z[1]) * gain
    assert steady.velocity[0] == pytest.approx(expected.real, rel=1e-9)
    assert abs(steady.velocity[0] / first.velocity[0] - 1) > 0.01


@pytest.mark.parametrize("bandwidth", [None, 300e3])
def test_motion_between_samples_agrees_with_the_exact_state(
    with_twin: Callable[..., Apparatus],
    apparatus: Apparatus,
    shipped_burst: list[Playback],
    bandwidth: float | None,
    rng: np.random.Generator,
) -> None:
    """Cubics against exact states at 60 random instants of burst and decay: within 1e-5 of the peak."""
    known = with_twin(apparatus, amplifier=TrueAmplifier(bandwidth_kHz=bandwidth and bandwidth * 1e-3))
    twin = Twin(known, 1)
    (motion,) = motions_of(twin, shipped_burst, 0.0, offset=0.0, bandwidth=None, touched=(), span=(0.0, 1.0))
    instants = np.sort(rng.uniform(0.023, 0.06, 60))
    system, (held,) = twin.system(), twin.held_of(shipped_burst)
    row = twin.beam.shapes(0.0)[:, 0] @ system.velocity
    exact = [(row @ state_at(system, held, t, first=False)).real for t in instants]
    np.testing.assert_allclose(motion.at(instants), exact, atol=1e-5 * 0.2)
    np.testing.assert_allclose(motion.at(instants + held.period), exact, atol=1e-5 * 0.2)


def test_the_low_pass_of_the_vibrometer_is_first_order(
    with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """Steady sine at its corner: 1/sqrt(2) of the amplitude, an eighth of a period later."""
    mode = next(mode for mode in apparatus.modes if mode.label == 3)
    twin = Twin(with_twin(apparatus).model_copy(update={"modes": (mode,)}), 1)
    n, cycles, hertz = 50_000, 100, 2000.0
    wave = np.round(8191 + 8000 * np.sin(2 * np.pi * cycles * np.arange(n) / n)).astype(">u2").tobytes()
    sine = Playback(wave, 2.0, 0.0, cycles / hertz, cycles / hertz, 8191)
    time = np.arange(2000) * (1 / hertz / 200)
    tones = []
    for corner in (None, hertz):
        (motion,) = motions_of(twin, [sine, None], 0.0, offset=0.0, bandwidth=corner, touched=(), span=(0.0, 1.0))
        tones.append(np.mean(motion.at(time) * np.exp(-2j * np.pi * hertz * time)))
    assert tones[1] / tones[0] == pytest.approx(1 / (1 + 1j), rel=1e-4)


def test_amplifier_and_vibrometer_may_have_equal_poles(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """The result differs from that for a corner 0.1 % higher by no more than 0.1 %."""
    twin = Twin(with_twin(apparatus, amplifier=TrueAmplifier(bandwidth_kHz=250.0)), 1)
    time = np.linspace(0.01, 0.04, 500)
    courses: list[Motion] = []
    for corner in (250e3, 250.25e3):
        courses += motions_of(
            twin, [playback(n=20_000), None], 0.0, offset=0.0, bandwidth=corner, touched=(), span=(0.0, 0.05)
        )
    same, beside = (course.at(time) for course in courses)
    np.testing.assert_allclose(same, beside, atol=1e-3 * np.abs(beside).max())


def test_the_drive_is_a_staircase_or_filtered_by_the_pole(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """Without a pole a staircase; with one, the closed form of the step V (1 - e^(-p t)) from the idle level."""
    step = replace(playback(), record=(16382).to_bytes(2, "big") * 100, idle_code=8191)
    time = np.array([0.0, 1e-6, 5e-6, 0.02, 0.051, 0.1])
    volts = 2.0 * 25
    held = drive_voltage(Twin(with_twin(apparatus), 1), [step, None], 0)
    assert isinstance(held, DriveVoltage)
    np.testing.assert_allclose(held.at(time), volts * np.array([1, 1, 1, 1, 0, 0]), rtol=1e-12)
    slow = drive_voltage(Twin(with_twin(apparatus, amplifier=TrueAmplifier(bandwidth_kHz=50.0)), 1), [step, None], 0)
    assert slow is not None
    pole = 2 * np.pi * 50e3
    expected = volts * (1 - np.exp(-pole * time))
    expected[4:] = volts * np.exp(-pole * (time[4:] - 0.05))
    np.testing.assert_allclose(slow.at(time), expected, atol=1e-9 * volts)
