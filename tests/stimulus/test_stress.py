"""Stress tests of the whole engine: energy balance, reciprocity, many modes, extreme values, invalid numbers."""

import math

import numpy as np
import pytest
from forward import modal_history
from hypothesis import given, settings
from hypothesis import strategies as st

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.stimulus import design_stimulus
from modaltouch.stimulus.target_field import TargetField

NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)


@settings(max_examples=25, deadline=None)
@given(
    frequency=st.floats(20.0, 90e3),
    ratio=st.floats(1e-6, 0.99),
    gain=st.floats(1e-6, 1e6),
    seed=st.integers(0, 10_000),
)
def test_work_is_stored_or_dissipated(frequency, ratio, gain, seed):
    """Work is force times path over each hold; (eta'^2 + w^2 eta^2)/2 is stored and 2 a eta'^2 dissipated."""
    model = ModalModel((1,), [frequency], [ratio], [[gain]], 0.1)
    timing = Timing(AFG3022B.converter, n_samples=40, duration=40 * 4e-7, focusing_instant=4e-7)
    voltage = np.random.default_rng(seed).normal(size=(1, 40))
    system, w, a = DiagonalSystem.of(model), model.angular_frequency[0], ratio * model.angular_frequency[0]

    def read(instant):
        state = system.states_by_channel(voltage, timing, instant)[0]
        return (system.velocity @ state).real[0], (system.displacement @ state).real[0] / w

    ends = [read(n * timing.hold) for n in range(41)]
    paths = np.diff([path for _, path in ends])
    work = gain * voltage[0] @ paths
    lost = sum(
        timing.hold / 2 * weight * 2 * a * read((n + (1 + node) / 2) * timing.hold)[0] ** 2
        for n in range(40)
        for node, weight in zip(NODES, WEIGHTS, strict=True)
    )
    velocity, path = ends[-1]
    stored = (velocity**2 + (w * path) ** 2) / 2
    # The terms are signed, so their sum may be much smaller than they are.
    assert work == pytest.approx(stored + lost, abs=1e-9 * (np.abs(gain * voltage[0] * paths).sum() + lost))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), n_samples=st.integers(3, 700))
def test_time_reversal_swaps_drive_and_reading(seed, n_samples, crossed_model):
    """For any drive, the final velocity is the impulse response times the time-reversed drive."""
    duration = n_samples * 4e-7
    timing = Timing(AFG3022B.converter, n_samples=n_samples, duration=duration, focusing_instant=duration)
    one, impulse = np.zeros((2, 2, n_samples))
    one[1] = np.random.default_rng(seed).normal(size=n_samples)
    impulse[1, 0] = 1.0
    response = modal_history(crossed_model, impulse, timing)[:, 1:]
    found = modal_history(crossed_model, one, timing)[:, -1]
    terms = np.abs(response) @ np.abs(one[1, :-1][::-1])
    assert (np.abs(response @ one[1, :-1][::-1] - found) <= 1e-12 * terms).all()


def test_a_thousand_modes_are_right_to_their_own_peak(rng):
    """Frequencies up to half the sampling rate, gains over twelve decades: 1e-11 of the peak by 80-bit steps."""
    n_modes, hold = 1000, 4e-7
    frequency = np.geomspace(20.0, 1.2e6, n_modes)
    ratio = 10 ** rng.uniform(-6, math.log10(0.99), n_modes)
    gain = 10 ** rng.uniform(-6, 6, (n_modes, 1))
    model = ModalModel(tuple(range(1, n_modes + 1)), frequency, ratio, gain, 0.1)
    timing = Timing(AFG3022B.converter, n_samples=500, duration=500 * hold, focusing_instant=hold)
    voltage = rng.normal(size=(1, 500))
    wide = 2 * np.longdouble("3.14159265358979323846264338327950288") * frequency.astype(np.longdouble)
    xi = ratio.astype(np.longdouble)
    s = -xi * wide + 1j * wide * np.sqrt((1 - xi) * (1 + xi))
    grown = np.exp(s * np.longdouble(hold))
    push = (grown - 1) / s * gain[:, 0]
    state, expected = np.zeros(n_modes, dtype=np.clongdouble), np.empty((n_modes, 500))
    for n in range(500):
        expected[:, n] = (state.real + s.real / s.imag * state.imag).astype(float)
        state = grown * state + push * voltage[0, n]
    error = np.abs(modal_history(model, voltage, timing) - expected).max(axis=1)
    assert (error <= 1e-11 * np.abs(expected).max(axis=1)).all()


@settings(max_examples=20, deadline=None)
@given(apart=st.floats(-1e-6, 1e-6).filter(lambda x: abs(x) > 1e-9), ratio=st.floats(1e-3, 0.1))
def test_nearly_repeated_modes_are_met_within_their_condition(apart, ratio):
    """Two modes at most 1e-6 apart, both driven by both channels: residual within 10 eps times the condition number."""
    gain = np.array([[5.0, 1.0], [1.0, 5.0]])
    model = ModalModel((1, 3), [4000.0, 4000.0 * (1 + apart)], [ratio, ratio], gain, 0.1)
    stimulus = design_stimulus(
        model,
        TargetField(selection=(1, 3)),
        Timing(AFG3022B.converter, n_samples=12_500),
        Amplifier(gain=25.0, limit=1e9),
        rounding="plain",
    )
    assert stimulus.drive.condition_number < 1e6
    assert stimulus.drive.residual <= 10 * np.finfo(float).eps * stimulus.drive.condition_number * 0.2


@settings(max_examples=15, deadline=None)
@given(levels=st.lists(st.sampled_from([0.01, 0.05, 0.08, 0.1, 0.125, 0.15, 0.2]), min_size=1, max_size=4, unique=True))
def test_one_record_serves_every_level(levels, design):
    """The codes do not depend on the levels used or on their order; only amplitudes differ."""
    stimulus = design(timing=Timing(AFG3022B.converter, n_samples=12_500), levels=(0.2,))
    first = stimulus.burst.codes.tobytes()
    for level in levels:
        stimulus.achieved(level)
        ratio = np.divide(stimulus.burst.amplitude_for(level), stimulus.burst.amplitude)
        assert ratio == pytest.approx(level / 0.2, rel=6e-3)
    assert stimulus.burst.codes.tobytes() == first


@pytest.mark.parametrize("n_samples", [131_072, 65_536, 100_000, 44_100])
def test_any_clock_is_met_at_the_focus(design, n_samples):
    """On even and uneven clocks the codes meet every state within 1e-6 of the peak (1e-5 in the steady state)."""
    stimulus = design(timing=Timing(AFG3022B.converter, n_samples=n_samples))
    assert stimulus.worst_modal_error(0.2) <= 1e-6 * 0.2
    steady, displacement = stimulus.achieved(0.2, steady=True)
    assert max(np.abs(steady - stimulus.target).max(), np.abs(displacement).max()) <= 1e-5 * 0.2


STRANGE = (1e-9, 1e-3, 1.0, 1e3, 1e9, 1e12)
"""Extreme values that an apparatus or a protocol may hold."""


def mostly(usual, below=math.inf):
    """Return a usual value most of the time, a strange one below a bound otherwise."""
    return st.one_of(*[st.just(usual)] * 9, st.sampled_from([each for each in STRANGE if each < below]))


@settings(max_examples=400, deadline=None)
@given(data=st.data(), law=st.sampled_from(["exact", "paper"]), release=st.sampled_from(["braked", "free"]))
def test_results_are_finite_or_a_clear_error_is_raised(data, law, release):
    """The engine returns no NaN; an impossible design raises a ValueError of our own, not one of a library."""
    several = [data.draw(mostly(each)) for each in (229.0, 2553.0, 7137.0)]
    several += [data.draw(mostly(0.02, 1.0)) for _ in range(3)] + [data.draw(mostly(each)) for each in (0.1, -0.2, 0.3)]
    beam = {"length": data.draw(mostly(0.1)), "modal_gain": [[each, 0.5] for each in several[6:]]}
    times = {"duration": 0.05, "focusing_instant": 0.025, "repetition_rate": 7.0}
    wished = {"base": 0.056, "centre": 0.0, "velocity": 0.2}
    behind = {"gain": 25.0, "limit": 250.0, "bandwidth": 1e5, "delay": 0.0}
    try:
        model = ModalModel((1, 3, 5), several[:3], several[3:6], **beam)
        timing = Timing(
            AFG3022B.converter,
            data.draw(st.sampled_from([2, 20, 1000])),
            **{k: data.draw(mostly(v)) for k, v in times.items()},
        )
        target_field = TargetField(selection=2, **{k: data.draw(mostly(v)) for k, v in wished.items()})
        amplifier = Amplifier(**{k: data.draw(mostly(v)) for k, v in behind.items()})
        stimulus = design_stimulus(model, target_field, timing, amplifier, law=law, release=release)
        level = target_field.velocity
        found = [stimulus.voltage, *stimulus.achieved(level), *stimulus.achieved(level, steady=True)]
        found += [stimulus.peak_velocity([0.0], level), stimulus.velocity_at_focus([0.0], level)]
        found += [stimulus.projection.width(0.5), stimulus.projection.reconstruction_error, stimulus.burst.amplitude]
    except ValueError as error:
        refusal: ValueError | None = error
    else:
        refusal = None
        assert all(np.isfinite(each).all() for each in found)
    assert not isinstance(refusal, np.linalg.LinAlgError)
    # The message has the given value, or says that it must be finite.
    assert refusal is None or any(letter.isdigit() for letter in str(refusal)) or "finite" in str(refusal)


def test_a_mode_lost_in_rounding_is_reported():
    """The message identifies a mode whose motion would be lost in rounding."""
    model = ModalModel((1, 3), [1e-20, 2553.0], [0.02, 0.02], [[0.1], [0.1]], 0.1)
    with pytest.raises(ValueError, match=r"mode 1 has .* on the diagonal of the Gramian, which must be above 0"):
        _ = design_stimulus(
            model, TargetField(selection=2), Timing(AFG3022B.converter, 1000), Amplifier(gain=25.0, limit=250.0)
        ).voltage


@pytest.mark.parametrize("factor", [0.5, 2.0, 1024.0])
def test_scaling_a_field_by_two_scales_every_state_exactly(design, factor):
    """Multiplying by a power of two causes no rounding."""
    one = design(timing=Timing(AFG3022B.converter, n_samples=12_500))
    other = design(timing=Timing(AFG3022B.converter, n_samples=12_500), target_field=TargetField(velocity=0.2 * factor))
    assert (other.voltage == factor * one.voltage).all()
    assert other.drive.condition_number == one.drive.condition_number
