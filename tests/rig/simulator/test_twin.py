"""Amplifier, true beam and fingers behind the simulated generator, against the forward model and closed forms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from modaltouch.apparatus import Apparatus, Fingers, TrueAmplifier, UnlistedMode
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.afg import Playback
from modaltouch.rig.simulator.course import Drive, Motion
from modaltouch.rig.simulator.response import state_at
from modaltouch.rig.simulator.true_beam import generator_gains, true_beam
from modaltouch.rig.simulator.twin import Twin
from modaltouch.stimulus.design import design_stimulus
from modaltouch.stimulus.timing import Timing
from modaltouch.stimulus.wish import Wish


def playback(amplitude: float = 4.0, *, n: int = 2000, hertz: float = 229.0, code: int = 8191) -> Playback:
    """Return a windowed sine of 50 ms every 1/7 s."""
    time = np.arange(n) * 0.05 / n
    wave = np.sin(2 * np.pi * hertz * time) * np.sin(np.pi * time / 0.05) ** 2
    record = np.round(8191 + 8191 * wave).astype(">u2").tobytes()
    return Playback(record, amplitude, 0.0, 0.05, 1 / 7, code)


@pytest.fixture
def twin(apparatus: Apparatus) -> Twin:
    """Return a twin."""
    return Twin(apparatus, seed=1)


def with_twin(apparatus: Apparatus, **values: Any) -> Apparatus:
    """Return an apparatus whose twin differs as stated, and in nothing else."""
    spreads = ("natural_frequency_mismatch", "damping_ratio_mismatch", "gain_mismatch", "generator_gain_mismatch")
    zero = dict.fromkeys((*spreads, "cross_gain"), 0.0) | {"unlisted_modes": (), "amplifier": TrueAmplifier()}
    return apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update=zero | values)})


def test_beam_without_mismatch_is_the_identified_one(apparatus: Apparatus) -> None:
    """All mismatches zero: every parameter of the table, exactly."""
    beam, table = true_beam(with_twin(apparatus), seed=5), apparatus.modal_model()
    assert (beam.natural_frequency == table.natural_frequency).all()
    assert (beam.damping_ratio == table.damping_ratio).all()
    assert (beam.modal_gain == table.modal_gain).all()


def test_mismatch_has_the_stated_spread(apparatus: Apparatus) -> None:
    """Over 400 seeds and nine modes the logarithms spread by the stated value, within 5 %."""
    known = with_twin(apparatus, natural_frequency_mismatch=0.02, damping_ratio_mismatch=0.1, gain_mismatch=0.05)
    beams = [true_beam(known, seed) for seed in range(400)]
    table = apparatus.modal_model()
    for name, spread in (("natural_frequency", 0.02), ("damping_ratio", 0.1), ("modal_gain", 0.05)):
        reference = getattr(table, name)
        logs = [np.log(getattr(beam.table, name)[reference != 0] / reference[reference != 0]) for beam in beams]
        assert np.std(logs) == pytest.approx(spread, rel=0.05)


def test_equal_seeds_give_equal_beams_and_one_mismatch_leaves_the_others(apparatus: Apparatus) -> None:
    """Streams are separate: another damping mismatch changes neither frequencies nor gains."""
    first = true_beam(with_twin(apparatus, natural_frequency_mismatch=0.01, gain_mismatch=0.02), 3)
    again = true_beam(with_twin(apparatus, natural_frequency_mismatch=0.01, gain_mismatch=0.02), 3)
    other = true_beam(
        with_twin(apparatus, natural_frequency_mismatch=0.01, gain_mismatch=0.02, damping_ratio_mismatch=0.3), 3
    )
    for beam in (again, other):
        assert (beam.natural_frequency == first.natural_frequency).all()
        assert (beam.modal_gain == first.modal_gain).all()
    assert not np.allclose(other.damping_ratio, first.damping_ratio)


def test_cross_gain_fills_what_the_table_leaves_empty(apparatus: Apparatus) -> None:
    """A set that does not drive a mode drives it by the stated part of the one that does."""
    beam, table = true_beam(with_twin(apparatus, cross_gain=0.1), 1), apparatus.modal_model()
    for row, known in zip(beam.modal_gain, table.modal_gain, strict=True):
        driven = known[known != 0][0]
        assert row[known == 0] == pytest.approx(0.1 * driven)


def test_sine_at_a_resonance_reaches_the_closed_form(apparatus: Apparatus) -> None:
    """Steady state at resonance: speed = G V / (2 xi w) per modal shape (erratum 1); mode 1 alone, 2 s of sine."""
    mode = next(mode for mode in apparatus.modes if mode.label == 1)
    alone = with_twin(apparatus).model_copy(update={"modes": (mode,)})
    twin = Twin(alone, seed=1)
    n, cycles = 100_000, 458
    duration = cycles / 229.0
    wave = np.round(8191 + 8191 * np.sin(2 * np.pi * cycles * np.arange(n) / n)).astype(">u2").tobytes()
    sine = Playback(wave, 2.0, 0.0, duration, duration, 8191)
    volts = 1.0 * apparatus.amplifier.gain_V_per_V
    expected = 114e-3 * volts / (2 * 0.0437 * 2 * np.pi * 229)
    assert twin.felt([sine, None], [0.0])[0] == pytest.approx(expected, rel=2e-3)


def test_speed_is_linear_and_computed_once(twin: Twin) -> None:
    """Another level of the same records is a scale factor: no second computation."""
    one = twin.felt([playback(2.0), playback(1.0)], [0.0, -0.04])
    two = twin.felt([playback(4.0), playback(2.0)], [0.0, -0.04])
    assert two == pytest.approx(2 * one, rel=1e-12)
    assert twin.n_computed == 1
    twin.felt([playback(4.0), playback(1.0)], [0.0])
    assert twin.n_computed == 2


def test_only_the_places_asked_for_are_computed(twin: Twin) -> None:
    """A new place of the same setting is computed, a known one is not."""
    twin.felt([playback(), None], [0.0])
    twin.felt([playback(), None], [0.0])
    assert twin.n_computed == 1
    twin.felt([playback(), None], [0.0, 0.02])
    assert twin.n_computed == 2


def test_nothing_is_computed_while_nobody_measures(simulator: Simulator) -> None:
    """An idle simulator computes nothing, and so does a question about a beam at rest."""
    simulator.felt_velocity(["A", "B", "C"])
    assert simulator.twin.n_computed == 0


def test_amplifier_saturates(twin: Twin, apparatus: Apparatus) -> None:
    """20 Vpp at a gain of 25 are 250 V: more amplitude than that adds no volt at the beam."""
    (held,) = twin.held_of([playback(40.0), None])
    assert np.abs(held.voltage[0]).max() == pytest.approx(apparatus.amplifier.limit_V)
    at_limit = twin.felt([playback(20.0), None], [0.0])[0]
    beyond = twin.felt([playback(40.0), None], [0.0])[0]
    assert at_limit < beyond < 2 * at_limit


def test_amplifier_pole_slows_the_fast_modes(apparatus: Apparatus) -> None:
    """A first-order pole at the drive's own frequency leaves 1/sqrt(2) of it, within 2 %."""
    hertz = 2553.0
    mode = next(mode for mode in apparatus.modes if mode.label == 3)
    alone = with_twin(apparatus).model_copy(update={"modes": (mode,)})
    slow = alone.model_copy(
        update={"amplifier": apparatus.amplifier.model_copy(update={"bandwidth_kHz": hertz * 1e-3})}
    )
    drive = playback(4.0, n=50_000, hertz=hertz)
    ratio = Twin(slow, 1).felt([drive, None], [0.0]) / Twin(alone, 1).felt([drive, None], [0.0])
    assert ratio[0] == pytest.approx(1 / np.sqrt(2), rel=0.02)


def test_constant_level_moves_nothing(twin: Twin) -> None:
    """An offset, or an idle level that the record does not leave, is a constant volt: no velocity."""
    flat = replace(playback(), record=(8500).to_bytes(2, "big") * 100, idle_code=8500, offset=1.0)
    assert twin.felt([flat, None], [0.0])[0] == pytest.approx(0, abs=1e-15)


def test_first_point_off_zero_kicks_the_beam(twin: Twin) -> None:
    """Where the output rests at the offset, a record that begins elsewhere starts with a step."""
    step = replace(playback(), record=(8500).to_bytes(2, "big") * 100, idle_code=8191)
    assert twin.felt([step, None], [0.0])[0] > 1e-4


def test_unequal_rates_add_their_peaks(twin: Twin) -> None:
    """Channels of different period slide past each other: the peaks meet."""
    left, right = playback(), replace(playback(), period=0.2)
    together = twin.felt([left, right], [0.0])[0]
    alone = twin.felt([left, None], [0.0])[0] + twin.felt([None, right], [0.0])[0]
    assert together == pytest.approx(alone)


def test_tripped_amplifier_moves_nothing(twin: Twin) -> None:
    """Its output is cut."""
    twin.tripped = True
    assert twin.felt([playback(), playback()], [0.0]).tolist() == [0.0]


def test_zone_is_felt_at_its_centre(simulator: Simulator) -> None:
    """A zone's name and its centre in metres are one place; another name is refused with the names there are."""
    simulator.afg.user[1] = playback().record
    simulator.front_panel("SOUR1:FUNC USER1;FREQ 20;:OUTP1 ON")
    assert simulator.felt_velocity(["A"]) == simulator.felt_velocity([-0.04])
    with pytest.raises(ValueError, match="'F' is not a zone of this beam: name one of A, B, C, D, E"):
        simulator.felt_velocity(["F"])


def test_rig_time_of_a_session_is_under_a_second(apparatus: Apparatus) -> None:
    """24 levels of one record and the speeds at two zones each: the bar is 1 s altogether (here the twin's part)."""
    import time

    twin = Twin(apparatus, seed=1)
    drive = playback(n=125_000)
    twin.felt([drive, drive], [0.0, -0.04])
    started = time.perf_counter()
    for trial in range(24):
        level = replace(drive, amplitude=1.0 + trial % 4)
        twin.felt([level, level], [0.0, -0.04, 0.04])
    assert time.perf_counter() - started < 0.5


EVEN = UnlistedMode(label=4, natural_frequency_Hz=4550.0, damping_ratio=0.02, gain_mm_s2_per_V={"side": 80.0})
TWIST = UnlistedMode(
    family="torsion", label=1, natural_frequency_Hz=8700.0, damping_ratio=0.01, gain_mm_s2_per_V={"centre": 150.0}
)


@pytest.fixture(scope="module")
def shipped_burst(apparatus: Apparatus) -> list[Playback]:
    """Return what both channels send for the shipped stimulus at 200 mm/s."""
    design = design_stimulus(apparatus.modal_model(), Wish(), Timing(), apparatus.amplifier_values())
    burst = design.burst
    return [
        Playback(codes.astype(">u2").tobytes(), amplitude, 0.0, burst.duration, 1 / 7, 8191)
        for codes, amplitude in zip(burst.codes, burst.amplitude_for(0.2), strict=True)
    ]


def test_true_shapes_have_unit_mean_square_and_are_orthogonal(apparatus: Apparatus) -> None:
    """Gram matrix over the area by Gauss-Legendre: the identity, bending and torsion alike (physics.md, 1)."""
    beam = true_beam(with_twin(apparatus, unlisted_modes=(EVEN, TWIST)), 1)
    along, weight = np.polynomial.legendre.leggauss(120)
    x, z = np.meshgrid(0.05 * along, 0.003 / np.sqrt(3) * np.array([-1.0, 1.0]))
    shapes = beam.shapes(x.ravel(), z.ravel())
    gram = (shapes * np.tile(weight, 2) / 4) @ shapes.T
    np.testing.assert_allclose(gram, np.eye(beam.n_modes), atol=1e-12)


def test_torsion_does_not_show_on_the_mid_line(apparatus: Apparatus) -> None:
    """Its shape vanishes on the mid-line and has opposite signs beside it."""
    beam = true_beam(with_twin(apparatus, unlisted_modes=(TWIST,)), 1)
    assert beam.shapes([0.03])[-1] == 0
    assert beam.shapes([0.05], 0.003)[-1] == pytest.approx(np.sqrt(24) / 2)
    assert beam.shapes([0.05], -0.003)[-1] == pytest.approx(-np.sqrt(24) / 2)


def test_unlisted_modes_are_in_the_twin_and_not_in_the_table(apparatus: Apparatus) -> None:
    """The shipped twin has even, torsion and higher modes; what the project plans with has the nine of Table I."""
    beam = true_beam(apparatus, 1)
    families = {(mode.family, mode.label % 2 == 0, mode.label > 17) for mode in beam.unlisted}
    assert {("bending", True, False), ("torsion", False, False), ("bending", False, True)} <= families
    assert apparatus.modal_model().label == (1, 3, 5, 7, 9, 11, 13, 15, 17)
    assert beam.n_modes == 9 + len(beam.unlisted)


def test_even_mode_makes_left_and_right_unlike(apparatus: Apparatus) -> None:
    """A drive at its resonance: antisymmetric, so A and E differ, while the table's modes alone move both alike."""
    drive = playback(hertz=4550.0)
    odd = Twin(with_twin(apparatus), 1).felt([None, drive], [-0.04, 0.04])
    both = Twin(with_twin(apparatus, unlisted_modes=(EVEN,)), 1).felt([None, drive], [-0.04, 0.04])
    assert odd[0] == pytest.approx(odd[1], rel=1e-9)
    assert abs(both[0] - both[1]) > 0.02 * both.max()


def test_twin_without_differences_does_what_the_design_predicts(
    apparatus: Apparatus, shipped_burst: list[Playback]
) -> None:
    """True state at the focusing instant: the targets and w eta = 0, to the 1e-3 mm/s that 14 bits leave."""
    design = design_stimulus(apparatus.modal_model(), Wish(), Timing(), apparatus.amplifier_values())
    state = Twin(with_twin(apparatus), 1).true_state(shipped_burst, 0.025, first=True)
    np.testing.assert_allclose(state.velocity, design.target, atol=1e-6)
    np.testing.assert_allclose(state.displacement, 0.0, atol=1e-6)


def test_shipped_twin_misses_like_the_paper(apparatus: Apparatus, shipped_burst: list[Playback]) -> None:
    """Section IV of the paper: worst modal coefficient off by 6 mm/s; here 1 to 12 mm/s of 200 over five seeds."""
    design = design_stimulus(apparatus.modal_model(), Wish(), Timing(), apparatus.amplifier_values())
    for seed in range(5):
        twin = Twin(apparatus, seed)
        state = twin.true_state(shipped_burst, 0.025 + twin.amplifier.delay)
        miss = np.abs(np.concatenate([state.velocity - design.target, state.displacement])).max()
        assert 1e-3 < miss < 12e-3


def test_delay_of_the_amplifier_shifts_the_true_state(apparatus: Apparatus, shipped_burst: list[Playback]) -> None:
    """The same state as without a delay, later by it."""
    late = Twin(with_twin(apparatus, amplifier=TrueAmplifier(delay_us=5.0)), 1)
    prompt = Twin(with_twin(apparatus), 1)
    shifted, plain = late.true_state(shipped_burst, 0.025 + 5e-6), prompt.true_state(shipped_burst, 0.025)
    np.testing.assert_allclose(shifted.velocity, plain.velocity, atol=1e-9)
    np.testing.assert_allclose(shifted.displacement, plain.displacement, atol=1e-9)


def test_repeated_bursts_leave_a_residue_that_the_first_has_not(apparatus: Apparatus) -> None:
    """Undamped by silence: a burst every 50 ms finds mode 1 still moving by e^(-a T) of its speed (closed form)."""
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


def test_finger_lowers_the_first_mode_as_a_mass_does(apparatus: Apparatus) -> None:
    """Closed form of one mode under a finger: f0 / sqrt(1 + m_f/m) and a = (2 xi w m + c) / (2 (m + m_f)), phi = 1."""
    mode = next(mode for mode in apparatus.modes if mode.label == 1)
    fingers = Fingers(mass_g=0.33, damping_N_s_per_m=0.4)
    known = with_twin(apparatus, fingers=fingers, beam_mass_g=3.3).model_copy(update={"modes": (mode,)})
    twin = Twin(known, 1)
    exponent = twin.system((0.02,)).exponent[0]
    frequency, mass = 229 / np.sqrt(1.1), 1.1 * 3.3e-3
    assert abs(exponent) / (2 * np.pi) == pytest.approx(frequency, rel=1e-9)
    damping = 2 * 0.0437 * 2 * np.pi * 229 * 3.3e-3 + 0.4
    assert -exponent.real == pytest.approx(damping / (2 * mass), rel=1e-9)
    assert twin.system().exponent[0] == pytest.approx(apparatus.modal_model().exponent[0], rel=1e-12)


def test_two_fingers_load_the_beam_for_each_other(apparatus: Apparatus) -> None:
    """What a finger at C feels depends on whether another lies at A; without load it does not."""
    drive = [playback(), playback(hertz=7137.0)]
    loaded = Twin(with_twin(apparatus, fingers=Fingers(mass_g=0.1, damping_N_s_per_m=0.5)), 1)
    free = Twin(with_twin(apparatus), 1)
    assert free.felt(drive, [0.0])[0] == free.felt(drive, [0.0, -0.04])[0]
    assert loaded.felt(drive, [0.0])[0] > 1.01 * loaded.felt(drive, [0.0, -0.04])[0]
    assert loaded.felt(drive, [0.0])[0] < free.felt(drive, [0.0])[0]


def test_fingers_that_stop_the_beam_from_swinging_are_no_failure(apparatus: Apparatus) -> None:
    """50 N s/m make mode 1 overdamped: two real exponents, and a speed that is finite and lower."""
    heavy = Twin(with_twin(apparatus, fingers=Fingers(mass_g=0.1, damping_N_s_per_m=50.0)), 1)
    assert np.sum(heavy.system((0.0,)).exponent.imag == 0) >= 2
    assert (
        0 < heavy.felt([playback(), None], [0.0])[0] < Twin(with_twin(apparatus), 1).felt([playback(), None], [0.0])[0]
    )


def test_generator_gain_error_scales_the_drive_alone(apparatus: Apparatus) -> None:
    """Each output is off by a factor of its own, seeded, of the stated spread; the beam is none the other."""
    known = with_twin(apparatus, generator_gain_mismatch=0.02)
    logs = np.log([generator_gains(known, seed) for seed in range(400)])
    assert np.std(logs) == pytest.approx(0.02, rel=0.1)
    twin, plain = Twin(known, 3), Twin(with_twin(apparatus), 3)
    factor = generator_gains(known, 3)[0]
    assert factor != 1
    assert twin.felt([playback(), None], [0.0]) == pytest.approx(factor * plain.felt([playback(), None], [0.0]))


def test_true_amplifier_has_values_of_its_own(apparatus: Apparatus) -> None:
    """Gain and limit in the twin's section count for the twin, and what is left out is as identified."""
    other = Twin(with_twin(apparatus, amplifier=TrueAmplifier(gain_V_per_V=30.0, limit_V=100.0)), 1)
    (held,) = other.held_of([playback(4.0), None])
    assert np.abs(held.voltage[0]).max() == pytest.approx(60, rel=1e-3)
    (held,) = other.held_of([playback(20.0), None])
    assert np.abs(held.voltage[0]).max() == pytest.approx(100)
    assert (other.amplifier.bandwidth, other.amplifier.delay) == (None, 0)


@pytest.mark.parametrize("bandwidth", [None, 300e3])
def test_motion_between_samples_is_the_exact_state(
    apparatus: Apparatus, shipped_burst: list[Playback], bandwidth: float | None, rng: np.random.Generator
) -> None:
    """Cubics against the exact states at 60 random instants of burst and decay: within 1e-5 of the peak."""
    known = with_twin(apparatus, amplifier=TrueAmplifier(bandwidth_kHz=bandwidth and bandwidth * 1e-3))
    twin = Twin(known, 1)
    (motion,) = twin.motions(shipped_burst, 0.0, offset=0.0, bandwidth=None, touched=(), span=(0.0, 1.0))
    instants = np.sort(rng.uniform(0.023, 0.06, 60))
    system, (held,) = twin.system(), twin.held_of(shipped_burst)
    row = twin.beam.shapes(0.0)[:, 0] @ system.velocity
    exact = [(row @ state_at(system, held, t, first=False)).real for t in instants]
    np.testing.assert_allclose(motion.at(instants), exact, atol=1e-5 * 0.2)
    np.testing.assert_allclose(motion.at(instants + held.period), exact, atol=1e-5 * 0.2)


def test_low_pass_of_the_vibrometer_is_first_order(apparatus: Apparatus) -> None:
    """In a steady sine at its corner: 1/sqrt(2) of the amplitude, an eighth of a period later."""
    mode = next(mode for mode in apparatus.modes if mode.label == 3)
    twin = Twin(with_twin(apparatus).model_copy(update={"modes": (mode,)}), 1)
    n, cycles, hertz = 50_000, 100, 2000.0
    wave = np.round(8191 + 8000 * np.sin(2 * np.pi * cycles * np.arange(n) / n)).astype(">u2").tobytes()
    sine = Playback(wave, 2.0, 0.0, cycles / hertz, cycles / hertz, 8191)
    time = np.arange(2000) * (1 / hertz / 200)
    tones = []
    for corner in (None, hertz):
        (motion,) = twin.motions([sine, None], 0.0, offset=0.0, bandwidth=corner, touched=(), span=(0.0, 1.0))
        tones.append(np.mean(motion.at(time) * np.exp(-2j * np.pi * hertz * time)))
    assert tones[1] / tones[0] == pytest.approx(1 / (1 + 1j), rel=1e-4)


def test_equal_poles_of_amplifier_and_vibrometer_are_no_failure(apparatus: Apparatus) -> None:
    """A corner at that of the amplifier differs from one 0.1 % beside it by no more than that."""
    twin = Twin(with_twin(apparatus, amplifier=TrueAmplifier(bandwidth_kHz=250.0)), 1)
    time = np.linspace(0.01, 0.04, 500)
    courses: list[Motion] = []
    for corner in (250e3, 250.25e3):
        courses += twin.motions(
            [playback(n=20_000), None], 0.0, offset=0.0, bandwidth=corner, touched=(), span=(0.0, 0.05)
        )
    same, beside = (course.at(time) for course in courses)
    np.testing.assert_allclose(same, beside, atol=1e-3 * np.abs(beside).max())


def test_drive_is_held_or_follows_with_the_pole(apparatus: Apparatus) -> None:
    """Without a pole a staircase; with one, the step's closed form V (1 - e^(-p t)) above the level of rest."""
    step = replace(playback(), record=(16382).to_bytes(2, "big") * 100, idle_code=8191)
    time = np.array([0.0, 1e-6, 5e-6, 0.02, 0.051, 0.1])
    volts = 2.0 * 25
    held = Twin(with_twin(apparatus), 1).drive([step, None], 0)
    assert isinstance(held, Drive)
    np.testing.assert_allclose(held.at(time), volts * np.array([1, 1, 1, 1, 0, 0]), rtol=1e-12)
    slow = Twin(with_twin(apparatus, amplifier=TrueAmplifier(bandwidth_kHz=50.0)), 1).drive([step, None], 0)
    assert slow is not None
    pole = 2 * np.pi * 50e3
    expected = volts * (1 - np.exp(-pole * time))
    expected[4:] = volts * np.exp(-pole * (time[4:] - 0.05))
    np.testing.assert_allclose(slow.at(time), expected, atol=1e-9 * volts)


def test_trigger_during_a_burst_is_lost(twin: Twin) -> None:
    """A timer of 30 ms under a burst of 50 ms: every second trigger counts, so that bursts come every 60 ms."""
    (held,) = twin.held_of([replace(playback(), period=0.03), None])
    assert held.period == pytest.approx(0.06)
