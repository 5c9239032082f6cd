"""Forward response of the beam, against 80-bit steps and invariants of a linear system."""

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from forward import modal_history, peak_velocity, velocity_history
from hypothesis import given, settings
from hypothesis import strategies as st

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Converter, Timing
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem
from modaltouch.stimulus.modes import ModalModel

PI = np.longdouble("3.14159265358979323846264338327950288")


def clocked(rate: float) -> Converter:
    """Return a converter with another clock rate [Hz]."""
    return replace(AFG3022B.converter, clock_rate=rate)


def stepped(model, voltage, hold):
    """Return modal velocities at the start of each sample, stepped in 80-bit complex numbers."""
    w = 2 * PI * model.natural_frequency.astype(np.longdouble)
    xi = model.damping_ratio.astype(np.longdouble)
    s = (-xi * w + 1j * w * np.sqrt((1 - xi) * (1 + xi))).astype(np.clongdouble)
    ratio = np.exp(s * np.longdouble(hold))
    held = (ratio - 1) / s
    force = model.modal_gain.astype(np.longdouble) @ voltage.astype(np.longdouble)
    state, states = np.zeros(s.size, dtype=np.clongdouble), np.empty(force.shape, dtype=np.clongdouble)
    for n, push in enumerate(force.T):
        states[:, n] = state
        state = ratio * state + held * push
    velocity = states.real + (s.real / s.imag)[:, None] * states.imag
    return velocity.astype(float)


@pytest.mark.parametrize("n_samples", [1, 31, 32, 33, 1056, 65_536])
def test_every_mode_is_right_to_its_own_peak(model, rng, n_samples):
    """For Table I and random samples, each mode is within 1e-12 of its own peak."""
    length = max(2, n_samples) * 7.6e-7
    timing = Timing(AFG3022B.converter, n_samples=max(2, n_samples), duration=length, focusing_instant=length)
    voltage = rng.normal(size=(2, n_samples))
    expected = stepped(model, voltage, timing.hold)
    error = np.abs(modal_history(model, voltage, timing) - expected).max(axis=1)
    assert (error <= 1e-12 * np.maximum(np.abs(expected).max(axis=1), 1e-300)).all()


def test_light_damping_keeps_its_phase(model, rng):
    """At a damping ratio of 1e-6 each mode is within 1e-11 of its own peak."""
    light = replace(model, damping_ratio=np.full(9, 1e-6))
    timing = Timing(clocked(65_536 * 20 * 190), n_samples=65_536)
    voltage = rng.normal(size=(2, 65_536))
    expected = stepped(light, voltage, timing.hold)
    error = np.abs(modal_history(light, voltage, timing) - expected).max(axis=1)
    assert (error <= 1e-11 * np.abs(expected).max(axis=1)).all()


@settings(max_examples=20, deadline=None)
@given(
    frequency=st.floats(1.0, 90e3),
    ratio=st.floats(1e-6, 0.99),
    n_samples=st.integers(2, 3000),
    seed=st.integers(0, 10_000),
)
def test_any_mode_is_right(frequency, ratio, n_samples, seed):
    """Damping ratios from 1e-6 to 0.99, against 80-bit steps."""
    model = ModalModel((1,), [frequency], [ratio], [[1.0]], 0.1)
    timing = Timing(AFG3022B.converter, n_samples=n_samples, duration=n_samples * 4e-7, focusing_instant=4e-7)
    voltage = np.random.default_rng(seed).normal(size=(1, n_samples))
    expected = stepped(model, voltage, timing.hold)
    assert modal_history(model, voltage, timing) == pytest.approx(
        expected, abs=1e-11 * max(np.abs(expected).max(), 1e-30)
    )


def test_velocity_is_the_sum_of_the_modes(crossed_model, rng):
    """Equation (3): w' = sum of phi_k eta'_k."""
    timing = Timing(AFG3022B.converter, n_samples=5000, duration=0.002, focusing_instant=0.001)
    voltage = rng.normal(size=(2, 5000))
    places = [-0.04, 0.013, 0.05]
    summed = crossed_model.shapes(places).T @ modal_history(crossed_model, voltage, timing)
    assert velocity_history(crossed_model, voltage, timing, places) == pytest.approx(
        summed, abs=1e-13 * np.abs(summed).max()
    )


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), shift=st.integers(1, 500))
def test_superposition_and_delay_hold(seed, shift, crossed_model):
    """The system is linear and time-invariant."""
    rng = np.random.default_rng(seed)
    timing = Timing(AFG3022B.converter, n_samples=1500, duration=0.0006, focusing_instant=0.0003)
    one, two = rng.normal(size=(2, 2, 1500))
    together = modal_history(crossed_model, one + two, timing)
    apart = modal_history(crossed_model, one, timing) + modal_history(crossed_model, two, timing)
    scale = np.abs(together).max(axis=1, keepdims=True)
    assert np.abs((together - apart) / scale).max() < 1e-12
    later = np.zeros_like(one)
    later[:, shift:] = one[:, :-shift]
    delayed = modal_history(crossed_model, later, timing)[:, shift:]
    assert np.abs((delayed - modal_history(crossed_model, one, timing)[:, :-shift]) / scale).max() < 1e-12


def test_time_reversal_swaps_drive_and_reading(crossed_model, rng):
    """The final velocity is the impulse response times the time-reversed drive."""
    timing = Timing(AFG3022B.converter, n_samples=2000, duration=0.001, focusing_instant=0.0005)
    one = rng.normal(size=2000)
    voltage = np.zeros((2, 2000))
    voltage[0] = one
    impulse = np.zeros((2, 2000))
    impulse[0, 0] = 1.0
    response = modal_history(crossed_model, impulse, timing)
    last = modal_history(crossed_model, voltage, timing)[:, -1]
    assert response[:, 1:] @ one[:-1][::-1] == pytest.approx(last, rel=1e-10, abs=1e-12 * np.abs(last).max())


def test_free_decay_follows_its_exponent():
    """After the drive ends, a mode decays as e^-at."""
    model = ModalModel((1,), [1000.0], [0.01], [[1.0]], 0.1)
    timing = Timing(AFG3022B.converter, n_samples=50_000, duration=0.05, focusing_instant=0.025)
    voltage = np.zeros((1, 50_000))
    voltage[0, :500] = 1.0
    velocity = modal_history(model, voltage, timing)[0]
    b = 2 * np.pi * 1000 * np.sqrt(1 - 0.01**2)
    period = 2 * np.pi / b
    ratio = np.interp(0.02 + 5 * period, np.arange(50_000) * 1e-6, velocity) / velocity[20_000]
    assert ratio == pytest.approx(np.exp(-5 * period * 0.01 * 2 * np.pi * 1000), rel=1e-3)


def test_resonance_gain_is_the_corrected_one():
    """Erratum 1 (section III-B): at resonance |eta'| = G |v| / (2 xi w), not / (2 xi w^2)."""
    model = ModalModel((1,), [1000.0], [0.01], [[5.0]], 0.1)
    timing = Timing(AFG3022B.converter, n_samples=125_000, duration=0.14, focusing_instant=0.1)
    time = np.arange(125_000) * timing.hold
    velocity = modal_history(model, np.sin(2 * np.pi * 1000 * time)[None], timing)[0]
    expected = 5.0 / (2 * 0.01 * 2 * np.pi * 1000)
    assert np.abs(velocity[100_000:]).max() == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("amplifier", [None, Amplifier(gain=1.0, limit=1.0, bandwidth=20e3)])
def test_peak_is_the_largest_of_the_whole_history(crossed_model, rng, amplifier):
    """Skipping blocks that cannot hold the peak changes nothing, nor does skipping none where nearly all may."""
    timing = Timing(AFG3022B.converter, n_samples=125_000, duration=0.05)
    fade = np.hanning(125_000)
    noise, walk = rng.normal(size=(2, 125_000)), rng.normal(size=(2, 125_000)).cumsum(axis=1)
    for voltage in (noise, noise * fade, walk * fade):
        places = [-0.04, 0.0, 0.02, 0.049]
        history = velocity_history(crossed_model, voltage, timing, places, amplifier)
        peak = peak_velocity(crossed_model, voltage, timing, places, amplifier)
        assert peak == pytest.approx(np.abs(history).max(axis=1), rel=1e-12)


@pytest.mark.parametrize(("n_samples", "ratio"), [(62_500, 0.01), (12_500, 0.01), (11_000, 0.01), (11_000, 0.999)])
def test_peaks_between_samples_are_found(crossed_model, rng, n_samples, ratio):
    """With as few samples as a protocol may have, 2.5 a cycle, the peak is rarely at the start of one."""
    timing, places = Timing(clocked(1e9), n_samples=n_samples), [-0.04, 0.0, 0.02]
    voltage = rng.normal(size=(2, n_samples)).cumsum(axis=1) * np.hanning(n_samples)
    beam = replace(crossed_model, damping_ratio=np.full(9, ratio))
    times = math.ceil(2 * np.pi * beam.natural_frequency.max() * timing.hold / 0.1)
    fine = Timing(replace(clocked(1e9), max_points=10**6), n_samples=n_samples * times)
    history = np.abs(velocity_history(beam, np.repeat(voltage, times, axis=1), fine, places))
    peak = peak_velocity(beam, voltage, timing, places)
    assert peak == pytest.approx(history.max(axis=1), rel=1e-12)
    assert peak.max() > history[:, ::times].max() * 1.0001


def test_peaks_between_samples_play_an_uneven_clock(crossed_model, rng):
    """Samples of 178.6 clocks, against a history of the clocks: at every quarter of even samples."""
    uneven, places = Timing(AFG3022B.converter, n_samples=1400, duration=1e-3, focusing_instant=1e-3), [-0.04, 0.02]
    voltage = rng.normal(size=(2, 1400)).cumsum(axis=1) * np.hanning(1400)
    by_clock = replace(uneven, converter=replace(AFG3022B.converter, max_points=10**6), n_samples=250_000)
    played = voltage[:, np.arange(250_000) * 1400 // 250_000]
    history = np.abs(velocity_history(crossed_model, played, by_clock, places))
    quarters = np.round(np.arange(5600) * 250_000 / 5600).astype(int)
    assert peak_velocity(crossed_model, voltage, uneven, places) == pytest.approx(
        history[:, quarters].max(axis=1), rel=1e-4
    )


def test_peak_of_the_shipped_burst_is_exact(shipped, zones):
    """After a braked burst the beam is at rest, so the peak is that of the history."""
    voltage = shipped.voltage_played(0.2)
    history = velocity_history(shipped.model, voltage, shipped.timing, zones)
    assert shipped.peak_velocity(zones, 0.2) == pytest.approx(np.abs(history).max(axis=1), rel=1e-12)


def test_no_points_have_no_peaks(shipped):
    """As with no finger on the beam."""
    assert peak_velocity(shipped.model, shipped.voltage_played(0.2), shipped.timing, []).shape == (0,)


def test_a_point_that_does_not_move_has_a_peak_of_zero():
    """At mid-beam under a rotation; printed as 0, not -0."""
    model, timing = ModalModel((2,), [300.0], [0.02], [[1.0]], 0.1), Timing(AFG3022B.converter, n_samples=1000)
    assert str(peak_velocity(model, np.ones((1, 1000)), timing, [0.0])[0]) == "0.0"


def test_peak_reaches_into_the_silence_after_the_burst():
    """A burst that ends with a kick peaks after its last sample."""
    model = ModalModel((1,), [100.0], [0.001], [[1.0]], 0.1)
    timing = Timing(AFG3022B.converter, n_samples=1000, duration=0.001, focusing_instant=0.0005)
    voltage = np.zeros((1, 1000))
    voltage[0, -1] = 1.0
    peak = peak_velocity(model, voltage, timing, [0.0])[0]
    assert peak == pytest.approx(1e-6, rel=1e-3)
    assert np.abs(velocity_history(model, voltage, timing, [0.0])).max() == 0


def test_state_between_samples_agrees_with_finer_samples(crossed_model, rng):
    """At an instant within a hold, the state agrees with that of a clock ten times as fine."""
    timing = Timing(AFG3022B.converter, n_samples=1000, duration=0.0004, focusing_instant=0.0002)
    fine = Timing(AFG3022B.converter, n_samples=10_000, duration=0.0004, focusing_instant=0.0002)
    voltage = rng.normal(size=(2, 1000))
    instant = 0.0004 * 0.5003
    system = DiagonalSystem.of(crossed_model)
    assert system.states_by_channel(voltage, timing, instant) == pytest.approx(
        system.states_by_channel(np.repeat(voltage, 10, axis=1), fine, instant), abs=1e-15
    )


def test_states_follow_an_uneven_clock(crossed_model, rng):
    """131,072 points over 50 ms are held for 95 or 96 clocks; reference: a sum over the actual edges."""
    timing = Timing(AFG3022B.converter, n_samples=131_072)
    voltage = rng.normal(size=(2, 131_072))
    clocks = np.ceil(np.arange(131_073) * 12_500_000 / 131_072 - 1e-6)
    assert set(np.unique(np.diff(clocks))) == {95.0, 96.0}
    edge = np.minimum(clocks / 250e6, 0.025)
    system = DiagonalSystem.of(crossed_model)
    expected = np.zeros((2, 9), dtype=complex)
    for k, s in enumerate(system.exponent):
        powers = np.exp(s * (0.025 - edge))
        expected[:, k] = voltage @ ((powers[:-1] - powers[1:]) / s) * system.input_gain[k]
    found = system.states_by_channel(voltage, timing, 0.025)
    assert found == pytest.approx(expected, abs=1e-11 * np.abs(expected).max())
    even = system.states_by_channel(voltage, replace(timing, converter=clocked(131_072 * 20 * 16)), 0.025)
    assert np.abs(even - expected).max() > 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize("n_samples", [131_072, 65_536, 44_100])
def test_histories_follow_an_uneven_clock(crossed_model, rng, n_samples):
    """Modal velocities agree with a sum over the actual edges within 1e-11 of each mode's peak."""
    timing = Timing(AFG3022B.converter, n_samples=n_samples)
    voltage = rng.normal(size=(2, n_samples))
    history = modal_history(crossed_model, voltage, timing)
    peak = np.abs(history).max(axis=1)
    system = DiagonalSystem.of(crossed_model)
    for sample in (1, 2, n_samples // 3, n_samples - 1):
        edge = np.minimum(np.ceil(np.arange(sample + 1) * 12_500_000 / n_samples - 1e-6) / 250e6, sample * timing.hold)
        powers = np.exp(system.exponent[:, None] * (sample * timing.hold - edge))
        pushed = (powers[:, :-1] - powers[:, 1:]) / system.exponent[:, None]
        state = (system.input_gain[:, :, None] * voltage[:, :sample] * pushed[:, None]).sum(axis=(1, 2))
        # The reference sums up to 1e5 terms with phases of up to 3e4 rad.
        assert (np.abs(history[:, sample] - (system.velocity @ state).real) <= 1e-11 * peak).all()


def test_peaks_follow_an_uneven_clock(crossed_model, rng):
    """131,072 points are held for 95 or 96 clocks: the peak is that of the history and differs from an even clock's."""
    timing, places = Timing(AFG3022B.converter, n_samples=131_072), [-0.04, 0.0, 0.04]
    voltage = rng.normal(size=(2, 131_072)) * np.hanning(131_072)
    peak = peak_velocity(crossed_model, voltage, timing, places)
    history = velocity_history(crossed_model, voltage, timing, places)
    assert peak == pytest.approx(np.abs(history).max(axis=1), rel=1e-12)
    even = peak_velocity(crossed_model, voltage, replace(timing, converter=clocked(131_072 * 20 * 16)), places)
    assert np.abs(even / peak - 1).max() > 1e-5


def test_memory_is_bounded_for_many_points(shipped):
    """The field at 100,001 points needs less than four times its own memory and equals that at a few points."""
    many = np.linspace(-0.05, 0.05, 100_001)
    few = shipped.velocity_at_focus(many[::10_000], 0.2)
    tracemalloc.start()
    field = shipped.velocity_at_focus(many, 0.2)
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose(field[::10_000], few, rtol=0, atol=1e-15)
    assert taken < 4 * field.nbytes


def test_peaks_at_many_points_equal_those_at_single_points(shipped):
    """Points are processed in groups; the peak at each equals that computed alone."""
    many, voltage = np.linspace(-0.05, 0.05, 601), shipped.voltage_played(0.2)
    together = peak_velocity(shipped.model, voltage, shipped.timing, many)
    for place in (0, 255, 256, 300, 600):
        alone = peak_velocity(shipped.model, voltage, shipped.timing, many[place : place + 1])
        assert together[place] == pytest.approx(alone[0], rel=1e-12)
