"""Both drive laws, checked by an extended-precision integration that shares no code with the engine."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest
from forward import modal_history
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.drive import FALL, RISE, Drive, Release, Steering, exact_drive
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.target_field import TargetField

EPS = np.finfo(float).eps
PI = np.longdouble("3.14159265358979323846264338327950288")


def states_at(model, voltage, hold, n_until):
    """Return (velocity, w eta) after `n_until` held samples from rest, in 80-bit arithmetic.

    Every change of the force starts a step response, (1 - e^-at (cos bt + a/b sin bt)) / w^2.
    """
    w = 2 * PI * model.natural_frequency.astype(np.longdouble)
    xi = model.damping_ratio.astype(np.longdouble)
    a, b = xi * w, w * np.sqrt((1 - xi) * (1 + xi))
    force = model.modal_gain.astype(np.longdouble) @ voltage[:, :n_until].astype(np.longdouble)
    steps = np.diff(force, axis=1, prepend=0.0)
    ago = np.arange(n_until, 0, -1).astype(np.longdouble) * np.longdouble(hold)
    velocity, displacement = np.zeros_like(w), np.zeros_like(w)
    for k in range(w.size):
        fade = np.exp(-a[k] * ago)
        cosine, sine = np.cos(b[k] * ago), np.sin(b[k] * ago)
        velocity[k] = (steps[k] * fade * sine).sum() / b[k]
        displacement[k] = (steps[k] * (1 - fade * (cosine + a[k] / b[k] * sine))).sum() / w[k]
    return velocity.astype(float), displacement.astype(float)


def driven(model: ModalModel, timing: Timing, target: np.ndarray, release: Release) -> Drive:
    """Return the exact drive to modal velocities, without an amplifier."""
    return exact_drive(Steering(model, DiagonalSystem.of(model), timing, release, target, np.zeros_like(target)))


@pytest.mark.parametrize("n_samples", [125_000, 62_500, 25_000])
def test_exact_law_meets_every_state_to_rounding(design, n_samples):
    """All states at t_F are within 1e-13 of the peak, by an extended-precision reference."""
    stimulus = design(timing=Timing(AFG3022B.converter, n_samples=n_samples))
    n_before, hold = stimulus.drive.n_before, stimulus.timing.hold
    velocity, displacement = states_at(stimulus.model, stimulus.voltage, hold, n_before)
    assert np.abs(velocity - stimulus.target).max() <= 1e-13 * 0.2
    assert np.abs(displacement).max() <= 1e-13 * 0.2


def test_exact_law_meets_every_state_with_all_channels_driving_all_modes(design, crossed_model):
    """The states at t_F are within 1e-13 of the peak if both channels drive all modes."""
    stimulus = design(crossed_model)
    n_before, hold = stimulus.drive.n_before, stimulus.timing.hold
    velocity, displacement = states_at(crossed_model, stimulus.voltage, hold, n_before)
    assert np.abs(velocity - stimulus.target).max() <= 1e-13 * 0.2
    assert np.abs(displacement).max() <= 1e-13 * 0.2


def test_exact_law_is_well_conditioned(shipped):
    """The scaled Gramian's condition number is of order one."""
    assert 1.0 <= shipped.drive.condition_number < 2.0


def test_braked_burst_ends_at_rest(shipped):
    """Release `braked`: all modes are at rest at 50 ms, with less than a quarter of the peak voltage."""
    velocity, displacement = states_at(shipped.model, shipped.voltage, shipped.timing.hold, 125_000)
    assert np.abs(velocity).max() <= 1e-13 * 0.2
    assert np.abs(displacement).max() <= 1e-13 * 0.2
    after = np.abs(shipped.voltage[:, shipped.drive.n_before :]).max()
    assert after < 0.25 * shipped.peak_voltage.max()


@pytest.mark.parametrize("delay", [4e-6, 7.1e-6])
def test_braked_burst_ends_at_rest_behind_a_delay(design, delay):
    """With a delay on or off the sample grid, the modes are at rest by the last delayed sample."""
    stimulus = design(amplifier=Amplifier(gain=25.0, limit=250.0, delay=delay))
    velocity, displacement = states_at(stimulus.model, stimulus.voltage, stimulus.timing.hold, 125_000)
    assert np.abs(velocity).max() <= 1e-12 * 0.2
    assert np.abs(displacement).max() <= 1e-12 * 0.2


@pytest.mark.parametrize(("focus", "delay"), [(0.025, 0.0), (0.0123456, 0.0), (0.025, 7.1e-6)])
def test_braking_begins_with_the_first_sample_after_the_focus(model, focus, delay):
    """Braking starts with the first sample that, delayed, begins at the focusing instant or later."""
    timing = Timing(AFG3022B.converter, focusing_instant=focus)
    system = DiagonalSystem.of(model, Amplifier(gain=25.0, limit=250.0, delay=delay))
    steering = Steering(model, system, timing, "braked", np.full(9, 0.01), np.zeros(9))
    begins = steering.braked_from * timing.hold + delay
    assert focus - 1e-12 <= begins < focus + timing.hold * (1 - 1e-6)


def test_samples_are_counted_against_conditions_and_channels(crossed_model):
    """Eighteen conditions on two channels need nine free samples; the first and last samples are not free."""
    for count in (10, 4):
        timing = Timing(AFG3022B.converter, focusing_instant=count * 4e-7)
        words = f"{count} samples are fewer than 18 conditions on 2 channels need; at least 11 must lie before"
        with pytest.raises(ValueError, match=words):
            driven(crossed_model, timing, np.full(9, 0.01), "free")
    enough = Timing(AFG3022B.converter, focusing_instant=11 * 4e-7)
    assert driven(crossed_model, enough, np.full(9, 0.01), "free").n_before == 11


def test_free_release_is_silent_after_the_focus(design):
    """Release `free`: zero volts after the focus, to the bit."""
    stimulus = design(release="free")
    assert (stimulus.voltage[:, stimulus.drive.n_before :] == 0).all()


def test_exact_law_is_the_least_energy(shipped, rng):
    """The optimum is orthogonal, in weighted energy, to every voltage that leaves the states alone."""
    n = shipped.drive.n_before
    weight = np.ones(n)
    rise, fall = round(RISE / shipped.timing.hold), round(FALL / shipped.timing.hold)
    weight[:rise] = np.sin(np.arange(rise) * np.pi / 2 / rise) ** 2
    weight[n - fall :] = np.sin(np.arange(fall)[::-1] * np.pi / 2 / fall) ** 2
    free = slice(1, n - 1)
    ago = np.arange(n)[::-1]
    system = shipped.system
    powers = np.exp(system.exponent[:, None] * (shipped.timing.hold * ago))
    read = np.concatenate([system.velocity, system.displacement])
    held = system.held_gain(shipped.timing.hold)
    rows = np.concatenate([(read @ (held[:, [c]] * powers)).real[:, free] for c in range(2)], axis=1)
    other = rng.normal(size=rows.shape[1])
    other -= np.linalg.lstsq(rows.T, other, rcond=None)[0] @ rows
    voltage = shipped.voltage[:, :n][:, free] / weight[free]
    cosine = other @ voltage.ravel() / np.linalg.norm(other) / np.linalg.norm(voltage)
    assert abs(cosine) < 1e-12


def test_energy_balance_holds(shipped):
    """Work of the modal force = energy stored + dissipated, by (eta'^2 + w^2 eta^2)/2."""
    model, timing = shipped.model, Timing(AFG3022B.converter, n_samples=130_000, duration=0.013, focusing_instant=0.012)
    stimulus = replace(shipped, timing=timing)
    history = modal_history(model, stimulus.voltage, timing)[:, : stimulus.drive.n_before]
    force = model.modal_gain @ stimulus.voltage[:, : stimulus.drive.n_before]
    # The velocity at the middle of a hold, to second order.
    middle = (history[:, :-1] + history[:, 1:]) / 2
    a = model.damping_ratio * model.angular_frequency
    work = (force[:, :-1] * middle).sum(axis=1) * timing.hold
    lost = 2 * a * (middle**2).sum(axis=1) * timing.hold
    stored = 0.5 * stimulus.target**2
    selected = stimulus.target != 0
    assert (np.abs(work - lost - stored) < 2e-3 * work)[selected].all()


def test_peak_voltage_and_energy_trade_as_derived(design, shipped):
    """The peak is 184 V for the tapered triangle and 167 V for a half cosine of 40 mm."""
    assert shipped.peak_voltage.max() == pytest.approx(184, abs=1)
    assert design(target_field=TargetField(shape="half_cosine", base=0.04)).peak_voltage.max() == pytest.approx(
        167, abs=2
    )


def test_scaling_the_target_by_two_scales_every_voltage_exactly(design):
    """The law is linear in the level, and a power of two changes no rounding."""
    one, two = design(target_field=TargetField(velocity=0.125)), design(target_field=TargetField(velocity=0.25))
    assert (two.voltage == 2 * one.voltage).all()


@settings(max_examples=40, deadline=None)
@given(
    ratio=st.floats(1e-6, 0.99),
    frequency=st.floats(200.0, 90e3),
    gain=st.floats(1e-9, 1e3),
    focus=st.floats(1e-4, 0.05),
    n_samples=st.sampled_from([12_500, 62_500, 125_000]),
)
def test_a_single_mode_is_met_over_the_range_of_parameters(ratio, frequency, gain, focus, n_samples):
    """Damping ratios from 1e-6 to 0.99, gains over twelve decades, any t_F."""
    model = ModalModel((1,), [frequency], [ratio], [[gain]], 0.1)
    timing = Timing(AFG3022B.converter, n_samples=n_samples, focusing_instant=focus)
    drive = driven(model, timing, np.array([0.2]), "free")
    whole, remainder = timing.samples_until(focus)
    assert np.isfinite(drive.voltage).all()
    # If the taper removes the last samples, a fast mode must still be reached with the others.
    assert drive.residual <= 1e-13 * max(1.0, drive.condition_number) * 0.2
    if not remainder:
        velocity, displacement = states_at(model, drive.voltage, timing.hold, whole)
        phase = 2 * np.pi * frequency * focus
        bound = max(1e-13, 8 * EPS * phase) * max(1.0, drive.condition_number) * 0.2
        assert abs(velocity[0] - 0.2) <= bound
        assert abs(displacement[0]) <= bound


@pytest.mark.parametrize("apart", [1e-2, 1e-4, 1e-6])
def test_nearly_repeated_modes_are_met_within_their_condition_number(apart):
    """Modes down to 1e-6 apart: the residual is at most 10 eps times the condition number."""
    model = ModalModel((1, 3), [2553.0, 2553.0 * (1 + apart)], [0.0165, 0.0165], [[0.654], [0.7]], 0.1)
    timing = Timing(AFG3022B.converter, n_samples=12_500)
    drive = driven(model, timing, np.array([0.1, 0.1]), "free")
    assert drive.residual <= max(1e-13, 10 * EPS * drive.condition_number) * 0.1
    assert drive.condition_number > 0.1 / apart


def test_gains_spanning_twelve_decades_are_met():
    """The residual stays below 1e-13 with gains from 1e-9 to 1e3."""
    model = ModalModel((1, 3), [229.0, 2553.0], [0.0437, 0.0165], [[1e-9, 0], [1e-9, 1e3]], 0.1)
    drive = driven(model, Timing(AFG3022B.converter, n_samples=25_000), np.array([0.1, 0.1]), "braked")
    assert drive.residual <= 1e-13


def test_identical_modes_on_one_channel_leave_a_residual():
    """Two modes with equal poles on one channel move alike; least squares misses both targets by half."""
    model = ModalModel((1, 3), [2553.0, 2553.0], [0.0165, 0.0165], [[1.0], [1.0]], 0.1)
    drive = driven(model, Timing(AFG3022B.converter, n_samples=12_500), np.array([0.1, 0.0]), "free")
    assert drive.condition_number > 1e12
    assert np.isfinite(drive.voltage).all()
    assert drive.residual == pytest.approx(0.05, rel=1e-6)


def test_paper_law_is_equation_7_with_the_errata(shipped_paper):
    """The voltage is the sum of 4 a_k eta'_k(t) / G_k at the middle of each hold, by thirty-digit arithmetic."""
    mpmath.mp.dps = 30
    model, timing = shipped_paper.model, shipped_paper.timing
    for n in (1, 30_000, 62_000, 62_499):
        expected = [mpmath.mpf(0), mpmath.mpf(0)]
        time = (mpmath.mpf(n) + mpmath.mpf(1) / 2) * mpmath.mpf(timing.hold) - mpmath.mpf("0.025")
        for k, target in enumerate(shipped_paper.target):
            if target == 0:
                continue
            w = 2 * mpmath.pi * mpmath.mpf(model.natural_frequency[k])
            xi = mpmath.mpf(model.damping_ratio[k])
            a, b = xi * w, w * mpmath.sqrt(1 - xi**2)
            channel = int(np.argmax(np.abs(model.modal_gain[k])))
            velocity = mpmath.mpf(target) * mpmath.exp(a * time) * mpmath.cos(b * time)
            expected[channel] += 4 * a * velocity / mpmath.mpf(model.modal_gain[k, channel])
        assert shipped_paper.voltage[:, n] == pytest.approx([float(e) for e in expected], abs=2e-12)


def test_the_amplifier_pole_is_modelled(design):
    """Stepping the pole and the modes with matrix exponentials gives the target states."""
    amplifier = Amplifier(gain=25.0, limit=250.0, bandwidth=20e3)
    stimulus = design(
        timing=Timing(AFG3022B.converter, n_samples=12_500),
        amplifier=amplifier,
        target_field=TargetField(selection=(1, 3)),
    )
    model, hold = stimulus.model, stimulus.timing.hold
    for k in (0, 1, 5):
        w, a = model.angular_frequency[k], model.damping_ratio[k] * model.angular_frequency[k]
        pole, (g1, g2) = 2 * np.pi * 20e3, model.modal_gain[k]
        generator = np.zeros((6, 6))
        generator[0, 1] = 1
        generator[1, :4] = [-(w**2), -2 * a, g1, g2]
        generator[2, [2, 4]] = [-pole, pole]
        generator[3, [3, 5]] = [-pole, pole]
        step = expm(generator * hold)
        state = np.zeros(4)
        for sample in stimulus.voltage[:, : stimulus.drive.n_before].T:
            state = step[:4, :4] @ state + step[:4, 4:] @ sample
        assert state[1] == pytest.approx(stimulus.target[k], abs=1e-10)
        assert w * state[0] == pytest.approx(0, abs=1e-10)


def test_focus_on_the_last_sample_cannot_be_braked(design):
    """No sample is left for braking; the message suggests `free`."""
    timing = Timing(AFG3022B.converter, focusing_instant=0.05)
    with pytest.raises(ValueError, match=r"0 samples are fewer than 18 conditions .* or release it `free`"):
        _ = design(timing=timing).voltage
    assert design(timing=timing, release="free").worst_modal_error(0.2) < 1e-5


@pytest.mark.parametrize("duration", [0.05, 12.0])
def test_long_focus_does_not_overflow(duration):
    """A focus at 10 s, where e^(a t_F) would overflow, is met within 1e-13."""
    model = ModalModel((1, 3), [229.0, 2553.0], [0.0437, 0.0165], [[0.114], [0.654]], 0.1)
    timing = Timing(
        AFG3022B.converter,
        n_samples=131_072,
        duration=duration,
        focusing_instant=duration * 10 / 12,
        repetition_rate=0.08,
    )
    drive = driven(model, timing, np.array([0.1, 0.1]), "braked")
    assert np.isfinite(drive.voltage).all()
    assert drive.residual <= 1e-13 * 0.2


def test_sixty_modes_are_met_within_their_condition(rng):
    """Sixty modes on two channels: the residual is at most 10 eps times the condition number."""
    n = 60
    frequency = np.geomspace(200.0, 90e3, n)
    model = ModalModel(tuple(range(1, n + 1)), frequency, np.full(n, 0.01), rng.normal(size=(n, 2)), 0.1)
    target = rng.normal(size=n) * 0.01
    drive = driven(model, Timing(AFG3022B.converter, n_samples=25_000), target, "braked")
    assert drive.residual <= max(1e-13, 10 * EPS * drive.condition_number) * np.abs(target).max()


def test_delay_longer_than_the_focus_leaves_no_sample(design):
    """A delay of 30 ms puts every sample behind a focus at 25 ms."""
    with pytest.raises(ValueError, match=r"delay of the amplifier is 0\.03 s, past the focusing instant of 0\.025 s"):
        _ = design(amplifier=Amplifier(gain=25.0, limit=250.0, delay=0.03)).voltage


def test_the_steady_state_includes_all_earlier_bursts(design, model):
    """Reference: one burst followed for forty periods, at a rate at which the slowest mode never comes to rest."""
    timing = Timing(AFG3022B.converter, n_samples=12_500, repetition_rate=19.0)
    stimulus = design(model, timing=timing, release="free")
    voltage, system = stimulus.voltage_played(0.2), stimulus.system
    instants = timing.focusing_instant + np.arange(40) / timing.repetition_rate
    states = sum(system.state_at(voltage, timing, instant) for instant in instants)
    velocity, displacement = stimulus.achieved(0.2, steady=True)
    first, _ = stimulus.achieved(0.2)
    assert [velocity, displacement] == pytest.approx(np.array(system.read(states)), abs=1e-9)
    assert abs(velocity - first).max() > 1e-6
    assert stimulus.peak_drive(0.2) == pytest.approx(abs(voltage).max(axis=1))


def test_an_output_that_is_not_driven_has_a_peak_of_zero(design):
    """Modes 5, 7 and 9 have gains of the second output alone; printed as 0, not -0."""
    timing = Timing(AFG3022B.converter, n_samples=12_500)
    stimulus = design(target_field=TargetField(selection=(5, 7, 9)), timing=timing)
    assert str(stimulus.peak_drive(0.2)[0]) == "0.0"
