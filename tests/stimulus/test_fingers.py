"""Fingertips on the beam, checked by extended-precision matrix exponentials that share no code with the engine."""

from dataclasses import replace
from types import SimpleNamespace

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem
from modaltouch.stimulus.fingers import CoupledModes, Finger
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.shapes import gauss_legendre
from modaltouch.stimulus.tolerances import derivative
from modaltouch.stimulus.touched import TouchedStimulus

LONG = np.longdouble
MASS = 3.3e-3
LEVEL = 0.2
ZONE = {"A": -0.04, "B": -0.02, "C": 0.0, "D": 0.02, "E": 0.04}
PLAIN = Amplifier(gain=25.0, limit=250.0)
SLOW = Amplifier(gain=25.0, limit=250.0, bandwidth=300e3, delay=1e-6)
FINE, COARSE = Timing(AFG3022B.converter), Timing(AFG3022B.converter, n_samples=12_500)

FINGERS = [(0.15, 0.7, 0.5), (0.08, 0.45, 0.8), (0.3, 2.0, 2.0), (0.15, 10.0, 0.0), (0.15, 30.0, 0.0)]
"""Mass [g], damping [N s/m], stiffness [N/mm]; the last two overdamp mode 1."""

RELAXING = ((800.0, 1e-3), (3000.0, 2e-5))
"""Two Maxwell terms, stiffness [N/m] and relaxation time [s]."""


def pair(zones, mass_g, damping, stiffness, **options):
    """Return two identical fingers on two zones."""
    return tuple(Finger(ZONE[zone], mass_g * 1e-3, damping, stiffness * 1e3, **options) for zone in zones)


# The reference: the same physics from the textbook, in 64-bit mantissas.


def shapes_at(label, y):
    """Mode shapes of a free-free beam of unit length and unit mean square, positive at its right end."""
    if label <= 2:
        return np.ones_like(y) if label == 1 else np.sqrt(LONG(12)) * y
    root = LONG(2 * label - 3) * np.arctan2(LONG(0), LONG(-1)) / 2
    for _ in range(8):  # Newton's method on cos x = sech x
        root -= (np.cos(root) - 1 / np.cosh(root)) / (-np.sin(root) + np.tanh(root) / np.cosh(root))
    if label % 2:
        return np.cos(root * y) / np.cos(root / 2) + np.cosh(root * y) / np.cosh(root / 2)
    return np.sin(root * y) / np.sin(root / 2) + np.sinh(root * y) / np.sinh(root / 2)


def contact_of(model, finger):
    """Shapes at the points of a contact, and the weights of a mean over it."""
    left, right = max(finger.position - finger.width / 2, -0.05), min(finger.position + finger.width / 2, 0.05)
    nodes, weights = np.polynomial.legendre.leggauss(64)
    y = ((LONG(left) + LONG(right)) / 2 + (LONG(right) - LONG(left)) / 2 * nodes.astype(LONG)) / LONG(model.length)
    return np.array([shapes_at(label, y) for label in model.label]), weights.astype(LONG) / 2


def inverse(matrix):
    """Inverse in extended precision, by Newton's method from that in double."""
    found = np.linalg.inv(matrix.astype(float)).astype(LONG)
    for _ in range(3):
        found = found + found @ (np.eye(len(matrix), dtype=LONG) - matrix @ found)
    return found


def exponential(matrix):
    """Matrix exponential by Taylor's series and squaring."""
    halvings = max(0, int(np.ceil(np.log2(float(np.abs(matrix).sum(axis=1).max()) + 1e-30))) + 2)
    scaled = matrix / LONG(2) ** halvings
    total = term = np.eye(len(matrix), dtype=LONG)
    for k in range(1, 22):
        term = term @ scaled / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


class Coupled:
    """x' = matrix x + force u of the state (w eta, eta', Maxwell terms by mode, amplifier)."""

    def __init__(self, model, fingers, amplifier=PLAIN):
        w = 2 * np.arctan2(LONG(0), LONG(-1)) * model.natural_frequency.astype(LONG)
        n, n_channels = model.modal_gain.shape
        mass, damping, spring = np.eye(n, dtype=LONG), np.diag(2 * model.damping_ratio.astype(LONG) * w), np.diag(w)
        terms = []
        for finger in fingers:
            at, weights = contact_of(model, finger)
            spread = (at * weights) @ at.T / LONG(model.mass)
            mass = mass + LONG(finger.mass) * spread
            damping = damping + LONG(finger.damping) * spread
            spring = spring + LONG(finger.stiffness) * spread / w
            terms += [(LONG(stiffness) * spread, LONG(time)) for stiffness, time in finger.maxwell]
        size = 2 * n + n * len(terms)
        pole = amplifier.bandwidth is not None
        matrix = np.zeros((size + pole * n_channels,) * 2, dtype=LONG)
        force = np.zeros((len(matrix), n_channels), dtype=LONG)
        push = inverse(mass)
        matrix[:n, n : 2 * n] = np.diag(w)
        matrix[n : 2 * n, :n], matrix[n : 2 * n, n : 2 * n] = -push @ spring, -push @ damping
        for place, (spread, time) in enumerate(terms):
            own = slice((2 + place) * n, (3 + place) * n)
            matrix[n : 2 * n, own] = -push @ spread
            matrix[own, n : 2 * n], matrix[own, own] = np.eye(n), -np.eye(n) / time
        gain = push @ model.modal_gain.astype(LONG)
        if pole:
            corner = 2 * np.arctan2(LONG(0), LONG(-1)) * LONG(amplifier.bandwidth)
            matrix[n : 2 * n, size:] = gain
            matrix[size:, size:], force[size:] = -corner * np.eye(n_channels), corner * np.eye(n_channels)
        else:
            force[n : 2 * n] = gain
        self.n, self.matrix, self.force, self.delay = n, matrix, force, LONG(amplifier.delay)

    def held(self, time):
        """Transition matrix over a time, and the response to one volt held during it."""
        n, n_channels = self.force.shape
        whole = np.zeros((n + n_channels,) * 2, dtype=LONG)
        whole[:n, :n], whole[:n, n:] = self.matrix * time, self.force * time
        grown = exponential(whole)
        return grown[:n, :n], grown[:n, n:]

    def at(self, voltage, timing, instant):
        """Modal velocities and w eta at an instant, from rest, each (n_modes,)."""
        hold = LONG(timing.duration) / timing.n_samples
        steps = (LONG(instant) - self.delay) / hold
        n_whole = int(np.floor(steps + LONG(1e-9)))
        rest = max(LONG(0), steps - n_whole) * hold
        voltage = np.pad(voltage, ((0, 0), (0, max(0, n_whole + 1 - voltage.shape[1]))))
        decay, push = self.held(hold)
        state = self._stepped(voltage[:, :n_whole].astype(LONG), decay, push)
        if rest > 1e-9 * hold:
            decay, push = self.held(rest)
            state = decay @ state + push @ voltage[:, n_whole].astype(LONG)
        return state[self.n : 2 * self.n].astype(float), state[: self.n].astype(float)

    def on_clock(self, voltage, timing, instant):
        """The same if each sample begins at the first clock edge at or after its time."""
        period, n_samples = 1 / LONG(timing.converter.clock_rate), timing.n_samples
        n_clocks = round(timing.duration * timing.converter.clock_rate)
        begins = [-(-n * n_clocks // n_samples) for n in range(n_samples + 1)]
        until = round(instant * timing.converter.clock_rate)
        state, known = np.zeros(len(self.matrix), dtype=LONG), {}
        for n, begin in enumerate(begins[:-1]):
            clocks = min(begins[n + 1], until) - begin
            if clocks <= 0:
                break
            if clocks not in known:
                known[clocks] = self.held(clocks * period)
            decay, push = known[clocks]
            state = decay @ state + push @ voltage[:, n]
        return state[self.n : 2 * self.n].astype(float), state[: self.n].astype(float)

    @staticmethod
    def _stepped(voltage, decay, push, block=256):
        rows = [push]
        for _ in range(block - 1):
            rows.append(decay @ rows[-1])
        responses = np.stack(rows[::-1]).transpose(0, 2, 1).reshape(-1, len(decay))
        filled = np.pad(voltage, ((0, 0), (-voltage.shape[1] % block, 0)))
        pushed = filled.T.reshape(-1, block * len(voltage)) @ responses
        whole, state = decay, np.zeros(len(decay), dtype=LONG)
        for _ in range(block.bit_length() - 1):
            whole = whole @ whole
        for each in pushed:
            state = whole @ state + each
        return state

    def history(self, voltage, timing, block=256):
        """States as each sample begins, (n_states, n_samples) array, in double precision."""
        decay, push = (each.astype(float) for each in self.held(LONG(timing.duration) / timing.n_samples))
        n_samples = voltage.shape[1]
        filled = np.pad(voltage, ((0, 0), (0, -n_samples % block))).reshape(len(voltage), -1, block)
        state, starts = np.zeros((len(decay), filled.shape[1])), []
        for step in range(block):
            state = decay @ state + push @ filled[:, :, step]
        whole, begin = np.linalg.matrix_power(decay, block), np.zeros(len(decay))
        for ends in state.T:
            starts.append(begin)
            begin = whole @ begin + ends
        states = np.empty((len(decay), *filled.shape[1:]))
        state = np.array(starts).T
        for step in range(block):
            states[:, :, step] = state
            state = decay @ state + push @ filled[:, :, step]
        return states.reshape(len(decay), -1)[:, :n_samples]


def miss(stimulus, fingers, voltage, amplifier=PLAIN):
    """Largest deviation of a modal state from its target at the focusing instant [m/s]."""
    beam = Coupled(stimulus.model, fingers, amplifier)
    velocity, displacement = beam.at(voltage, stimulus.timing, stimulus.timing.focusing_instant)
    return max(np.abs(velocity - stimulus.target).max(), np.abs(displacement).max())


def left_over(stimulus, fingers, amplifier=PLAIN):
    """Largest modal state once the burst is over and the amplifier has come to rest [m/s]."""
    beam = Coupled(stimulus.model, fingers, amplifier)
    quiet = 0.0 if amplifier.bandwidth is None else 30e-6
    return np.abs(beam.at(stimulus.voltage, stimulus.timing, stimulus.timing.duration + amplifier.delay + quiet)).max()


def longer(timing, n_samples):
    """Return the timing of a burst with this number of samples and the same hold."""
    return replace(timing, n_samples=n_samples, duration=timing.hold * n_samples)


@pytest.fixture(scope="module")
def beam(model):
    """The shipped beam with its mass."""
    return replace(model, mass=MASS)


@pytest.fixture(scope="module")
def uneven_beam(beam):
    """The shipped beam with the even bending modes that its section `twin` lists."""
    twin = Apparatus.read("beam_100x6x2").twin
    listed = [mode for mode in twin.unlisted_modes if mode.family == "bending"]
    assert {mode.label % 2 for mode in listed} == {0, 1}
    names = ("centre", "side")
    rows = [[(mode.gain_mm_s2_per_V.get(name) or 0.0) * 1e-3 for name in names] for mode in listed]
    return ModalModel(
        label=(*beam.label, *(mode.label for mode in listed)),
        natural_frequency=[*beam.natural_frequency, *(mode.natural_frequency_Hz for mode in listed)],
        damping_ratio=[*beam.damping_ratio, *(mode.damping_ratio for mode in listed)],
        modal_gain=[*beam.modal_gain, *rows],
        length=beam.length,
        mass=MASS,
    )


@pytest.fixture(scope="module")
def critical(beam):
    """Damping at which the two real exponents of 0.15 g on A and C meet, by bisection [N s/m]."""

    def n_real(damping):
        matrix = Coupled(beam, pair("AC", 0.15, damping, 0.0)).matrix.astype(float)
        return int((np.linalg.eigvals(matrix).imag == 0).sum())

    below, above = 4.6, 4.9
    assert (n_real(below), n_real(above)) == (0, 2)
    for _ in range(60):
        middle = (below + above) / 2
        below, above = (middle, above) if n_real(middle) == 0 else (below, middle)
    assert below == pytest.approx(4.7448, abs=1e-4)
    return below


@pytest.mark.parametrize("amplifier", [PLAIN, SLOW], ids=["plain", "slow"])
@pytest.mark.parametrize("zones", ["AC", "BD"])
@pytest.mark.parametrize("values", FINGERS, ids=str)
def test_the_target_field_is_met_under_the_fingers(design, beam, values, zones, amplifier):
    """Modal states at the focus are met within 1e-12 of the level (codes: 1e-6); the burst ends at rest."""
    fingers = pair(zones, *values)
    stimulus = design(beam.touched(fingers), amplifier=amplifier)
    assert stimulus.system.real is None
    assert miss(stimulus, fingers, stimulus.voltage, amplifier) <= 1e-12 * LEVEL
    assert miss(stimulus, fingers, stimulus.voltage_played(LEVEL), amplifier) <= 1e-6 * LEVEL
    assert left_over(stimulus, fingers, amplifier) <= 1e-12 * LEVEL


def test_a_scaled_finger_has_its_damping_and_the_square_of_its_stiffness():
    """Like a mode whose frequency is doubled at the same damping ratio; the mass stays."""
    assert Finger(0.01, 1e-4, 0.5, 500.0).scaled(2) == Finger(0.01, 1e-4, 1.0, 2000.0)


def test_fingers_change_the_field_of_the_untouched_beam(design, beam):
    """A design for the untouched beam misses by more than a tenth of the level."""
    assert miss(design(beam), pair("AC", 0.08, 0.45, 0.8), design(beam).voltage) > 0.1 * LEVEL


def test_overdamped_fingers_leave_two_real_exponents(beam):
    """With 30 N s/m on A and C mode 1 is overdamped, and 8 modes oscillate."""
    exponent = DiagonalSystem.of(beam.touched(pair("AC", 0.15, 30.0, 0.0))).exponent
    assert (exponent.imag == 0).sum() == 2
    assert (exponent.imag > 0).sum() == 8


@pytest.mark.parametrize("amplifier", [PLAIN, SLOW], ids=["plain", "slow"])
def test_the_field_is_met_at_critical_damping(design, beam, critical, amplifier):
    """Two exponents coincide: the law for slightly different fingers is corrected with the coupled equations."""
    fingers = pair("AC", 0.15, critical, 0.0)
    stimulus = design(beam.touched(fingers), amplifier=amplifier)
    _, condition = CoupledModes.of(
        beam.angular_frequency, beam.damping_ratio, beam.modal_gain, stimulus.model.loads
    ).uncoupled()
    assert condition > 1e5
    assert stimulus.system.real is not None
    assert miss(stimulus, fingers, stimulus.voltage, amplifier) <= 1e-12 * LEVEL
    assert miss(stimulus, fingers, stimulus.voltage_played(LEVEL), amplifier) <= 1e-6 * LEVEL
    assert left_over(stimulus, fingers, amplifier) <= 1e-12 * LEVEL


@pytest.mark.parametrize("damping", [0.7, None], ids=["light", "critical"])
def test_an_uneven_clock_is_followed_under_fingers(design, beam, critical, damping):
    """12,345 samples begin at clock edges, later than their nominal times."""
    fingers = pair("AC", 0.15, critical if damping is None else damping, 0.0)
    timing = Timing(AFG3022B.converter, n_samples=12_345)
    assert timing.clock_error is not None
    stimulus = design(beam.touched(fingers), timing=timing)
    reference = Coupled(beam, fingers)
    for voltage, allowed in ((stimulus.voltage, 1e-11), (stimulus.voltage_played(LEVEL), 1e-6)):
        velocity, displacement = reference.on_clock(voltage, timing, timing.focusing_instant)
        assert np.abs(velocity - stimulus.target).max() <= allowed * LEVEL
        assert np.abs(displacement).max() <= allowed * LEVEL


@pytest.mark.parametrize("zones", ["AC", "BD"])
def test_fingers_that_relax_are_met(design, beam, zones):
    """Maxwell terms in addition to mass, damper and spring."""
    fingers = pair(zones, 0.1, 0.5, 0.3, maxwell=RELAXING)
    stimulus = design(beam.touched(fingers))
    assert miss(stimulus, fingers, stimulus.voltage) <= 1e-12 * LEVEL
    assert miss(stimulus, fingers, stimulus.voltage_played(LEVEL)) <= 1e-6 * LEVEL
    assert left_over(stimulus, fingers) <= 1e-12 * LEVEL


@pytest.mark.parametrize("values", FINGERS[:3], ids=str)
def test_every_mode_is_steered_on_a_beam_with_even_modes(design, uneven_beam, values):
    """Fingers at A and C couple even modes: all 19 meet their targets, unselected ones at rest."""
    fingers = pair("AC", *values)
    stimulus = design(uneven_beam.touched(fingers))
    assert (stimulus.target == 0).any()
    assert miss(stimulus, fingers, stimulus.voltage) <= 1e-12 * LEVEL
    assert miss(stimulus, fingers, stimulus.voltage_played(LEVEL)) <= 1e-6 * LEVEL
    assert left_over(stimulus, fingers) <= 1e-12 * LEVEL


def test_a_mode_that_only_fingers_move_is_steered(design, uneven_beam):
    """Even modes without gain are driven through fingers at A and C, but not through those at B and D."""
    gain = np.where(np.array(uneven_beam.label)[:, None] % 2, uneven_beam.modal_gain, 0.0)
    silent = replace(uneven_beam, modal_gain=gain)
    assert (gain == 0).all(axis=1).sum() == 9
    for zones in ("AC", "BD"):
        fingers = pair(zones, 0.15, 0.7, 0.5)
        stimulus = design(silent.touched(fingers))
        bound = max(1e-12, 10 * np.finfo(float).eps * stimulus.drive.condition_number)
        assert miss(stimulus, fingers, stimulus.voltage) <= bound * LEVEL
        assert left_over(stimulus, fingers) <= bound * LEVEL


@pytest.mark.parametrize("name", ["norm_4", "least_peak"])
def test_designs_of_less_peak_voltage_meet_the_field_too(design, beam, name):
    """Other designs meet the same states at the focus, with at least a tenth less peak voltage."""
    fingers = pair("AC", 0.15, 0.7, 0.5)
    stimulus = design(beam.touched(fingers), timing=COARSE, design=name)
    assert miss(stimulus, fingers, stimulus.voltage) <= 1e-11 * LEVEL
    assert stimulus.peak_voltage.max() < 0.9 * design(beam.touched(fingers), timing=COARSE).peak_voltage.max()


@settings(max_examples=40)
@given(
    mass_g=st.floats(0.01, 0.5),
    damping=st.floats(0.05, 3.0),
    stiffness=st.floats(0.0, 3.0),
    left=st.floats(-0.045, -0.01),
    right=st.floats(0.0, 0.045),
)
def test_light_fingers_anywhere_are_met(design, beam, mass_g, damping, stiffness, left, right):
    """Any two fingertips up to 3 N s/m, at any two places."""
    fingers = tuple(Finger(place, mass_g * 1e-3, damping, stiffness * 1e3) for place in (left, right))
    stimulus = design(beam.touched(fingers), timing=COARSE)
    bound = max(1e-12, 10 * np.finfo(float).eps * stimulus.drive.condition_number)
    assert miss(stimulus, fingers, stimulus.voltage) <= bound * LEVEL
    assert left_over(stimulus, fingers) <= bound * LEVEL


@pytest.mark.parametrize("amplifier", [PLAIN, SLOW], ids=["plain", "slow"])
@pytest.mark.parametrize("options", [{}, {"maxwell": RELAXING}], ids=["plain", "relaxing"])
@pytest.mark.parametrize("values", [FINGERS[0], FINGERS[4]], ids=str)
def test_what_fingers_make_of_another_design_is_predicted(design, beam, zones, values, options, amplifier):
    """Velocity at the focus, highest speed, over points of the beam, by stepping through the samples in eighths."""
    fingers = pair("AC", *values, **options)
    free = design(beam, timing=COARSE, amplifier=amplifier)
    touched, unit = free.touched(fingers), free.volts_per_code(LEVEL)
    reference = Coupled(beam, fingers, amplifier)
    shapes = np.array([shapes_at(label, np.array(zones, dtype=LONG) / LONG(0.1)) for label in beam.label]).astype(float)
    voltage = free.voltage_played(LEVEL)
    velocity, _ = reference.at(voltage, COARSE, COARSE.focusing_instant)
    np.testing.assert_allclose(touched.velocity_at_focus(zones, unit), velocity @ shapes, rtol=0, atol=1e-6 * LEVEL)
    fine = longer(replace(COARSE, n_samples=100_000), 120_000)
    history = reference.history(np.pad(np.repeat(voltage, 8, axis=1), ((0, 0), (0, 20_000))), fine)[9:18]
    speed = np.abs(shapes.T @ history).max(axis=1)
    np.testing.assert_allclose(touched.peak_velocity(zones, unit), speed, rtol=5e-3)


@pytest.mark.parametrize(
    ("values", "amplifier", "allowed"),
    [
        (None, SLOW, 5e-9),
        ((*FINGERS[0], RELAXING), SLOW, 1e-8),
        ((*FINGERS[4], ()), PLAIN, 5e-9),
        ((0.15, None, 0.0, ()), PLAIN, 1e-6),
    ],
    ids=["none", "light, relaxing", "overdamped", "critical"],
)
def test_derivatives_are_those_of_the_coupled_beam(design, beam, critical, values, amplifier, allowed):
    """Central differences in extended precision, relative step 1e-7, of the parameters of modes 1 and 17."""
    *given, maxwell = (critical if each is None else each for each in values or [()])
    fingers = pair("AC", *given, maxwell=maxwell) if given else ()
    stimulus = design(beam.touched(fingers), timing=COARSE, amplifier=amplifier)
    step = LONG(1e-7)

    def difference(parameter, mode):
        def moved(by):
            values = getattr(stimulus.model, parameter).astype(LONG)
            values[mode] *= 1 + by
            other = SimpleNamespace(**{**vars(stimulus.model), parameter: values})
            return np.stack(Coupled(other, fingers, amplifier).at(stimulus.voltage, COARSE, COARSE.focusing_instant))

        return (moved(step) - moved(-step)) / (2 * step)

    for mode in (0, 8):
        for parameter in ("natural_frequency", "damping_ratio", "modal_gain"):
            found = derivative(stimulus, parameter, mode)
            assert found == pytest.approx(difference(parameter, mode), abs=allowed)


@pytest.mark.parametrize("stays", [(), (0,)], ids=["none", "left"])
def test_fingers_taken_away_at_the_worst_instant(design, beam, stays):
    """200 bursts, each with fingers lifted at another instant near the focus, stepped sample by sample."""
    timing = Timing(AFG3022B.converter, n_samples=31_250)
    fingers = pair("AC", 0.25, 1.5, 1.5)
    left = tuple(fingers[which] for which in stays)
    stimulus = design(beam.touched(fingers), timing=timing)
    loaded, lighter, unit = stimulus.touched(fingers), stimulus.touched(left), stimulus.volts_per_code(LEVEL)
    voltage, (decay, push) = stimulus.voltage_played(LEVEL), Coupled(beam, left).held(LONG(timing.hold))
    decay, push = decay.astype(float), push.astype(float)
    zones = [0.0, 0.05, 0.02]
    taken, shapes = np.arange(14_100, 15_700, 8), beam.shapes(zones)
    states = Coupled(beam, fingers).history(voltage, timing)[:, taken]
    highest = np.zeros((len(zones), taken.size))
    for sample in range(taken[0], 15_800):
        gone = taken <= sample
        highest = np.where(gone, np.maximum(highest, np.abs(shapes.T @ states[9:18])), highest)
        states[:, gone] = decay @ states[:, gone] + push @ voltage[:, sample, None]
    peak = loaded.peak_when_lifted(lighter, zones, unit, 0.15)
    anyhow = np.maximum(loaded.peak_velocity(zones, unit), lighter.peak_velocity(zones, unit))
    expected = np.maximum(np.maximum(highest.max(axis=1), anyhow), 0.15)
    assert (peak >= expected * (1 - 1e-6)).all()
    np.testing.assert_allclose(peak, expected, rtol=5e-3)
    assert not stays or peak.max() > 1.02 * anyhow.max()
    assert loaded.peak_when_lifted(lighter, zones, unit, 2.5 * peak.max()) == pytest.approx(2.5 * peak.max(), abs=0)


@pytest.mark.parametrize("timing", [FINE, COARSE], ids=["fine", "coarse"])
def test_speeds_are_stationary_at_the_instants_of_their_peaks(design, beam, timing):
    """No later or earlier instant is faster, nor is any that is tried in the search for the peak."""
    fingers = pair("AC", 0.1, 0.5, 0.8)
    stimulus = design(beam.touched(fingers), timing=timing)
    played, unit, places = stimulus.touched(fingers), stimulus.volts_per_code(LEVEL), [ZONE["A"], ZONE["C"]]
    instants = played.peak_instants(places, unit)
    speed, sooner, later = (np.abs(played.velocity_at(places, instants + by, unit)) for by in (0.0, -5e-8, 5e-8))
    assert (speed >= played.peak_velocity(places, unit)).all()
    assert (speed >= np.maximum(sooner, later)).all()


def test_modal_peaks_are_upper_bounds_between_samples():
    """A step of voltage moves a mode at up to G V/w exp(-xi/sqrt(1 - xi^2) arccos xi), here in mid-sample."""
    ratio, timing = 0.1, Timing(AFG3022B.converter, n_samples=5000)
    turn = np.arccos(ratio) / np.sqrt(1 - ratio**2) / 5.5
    free = ModalModel((1,), [turn / timing.hold / (2 * np.pi)], [ratio], [[1.0]], 0.1)
    played = TouchedStimulus(free, PLAIN, timing, np.ones((1, 5000)))
    peak = np.exp(-ratio / np.sqrt(1 - ratio**2) * np.arccos(ratio)) / free.angular_frequency[0]
    assert played.peak_velocity([0.0], np.ones(1))[0] < 0.993 * peak
    assert peak <= played.modal_peaks(np.ones(1))[0] < 1.03 * peak


@pytest.mark.parametrize("amplifier", [PLAIN, SLOW], ids=["plain", "slow"])
@pytest.mark.parametrize("maxwell", [(), RELAXING], ids=["plain", "relaxing"])
def test_the_pull_is_the_force_on_each_finger(design, beam, maxwell, amplifier):
    """|m a + c v + k x| plus the Maxwell terms, for the mean velocity over the contact, by finite differences."""
    fingers = (Finger(-0.04, 0.1e-3, 0.5, 800.0, maxwell=maxwell), Finger(0.0, 0.3e-3, 2.0, 2000.0, maxwell=maxwell))
    stimulus = design(beam, timing=FINE, amplifier=amplifier)
    history = Coupled(beam, fingers, amplifier).history(stimulus.voltage_played(LEVEL), FINE)[9:18]
    pulls, hold = [], FINE.hold
    for finger in fingers:
        at, weights = contact_of(beam, finger)
        velocity = (at @ weights).astype(float) @ history
        force = finger.mass * np.diff(velocity) / hold
        middle = (velocity[1:] + velocity[:-1]) / 2
        place = np.cumsum(middle) * hold - middle * hold / 2
        force += finger.damping * middle + finger.stiffness * place
        for stiffness, time in finger.maxwell:
            fade, branch, row = np.exp(-hold / time), 0.0, np.empty_like(middle)
            for n, speed in enumerate(middle):
                row[n] = branch + speed * hold / 2
                branch = fade * branch + speed * time * (1 - fade)
            force += stiffness * row
        pulls.append(np.abs(force).max())
    found = stimulus.touched(fingers).pull(stimulus.volts_per_code(LEVEL))
    np.testing.assert_allclose(found, pulls, rtol=5e-3)


def test_the_pull_is_found_between_samples(beam, rng):
    """At the turn of mode 17 in 0.4 us, 0.23 rad; against samples of an eighth of it."""
    loaded, converter = beam.touched(pair("AC", 0.3, 0.1, 0.0)), replace(AFG3022B.converter, max_points=10**6)
    codes = rng.normal(size=(2, 125_000)) * np.hanning(125_000)
    finer = Timing(replace(converter, clock_rate=1e9), n_samples=1_000_000)
    pulls = [
        TouchedStimulus(loaded, PLAIN, *played).pull(np.ones(2))
        for played in ((FINE, codes), (finer, np.repeat(codes, 8, axis=1)))
    ]
    np.testing.assert_allclose(*pulls, rtol=3e-3)


def test_an_untouched_beam_has_no_contact_forces(shipped):
    """The array of forces is empty."""
    assert shipped.touched(()).pull(shipped.volts_per_code(LEVEL)).size == 0


@given(
    frequency=st.floats(50.0, 2e4),
    ratio=st.floats(1e-3, 0.2),
    mass=st.floats(0.0, 3e-3),
    damping=st.floats(0.0, 20.0),
    stiffness=st.floats(0.0, 1e4),
)
def test_one_rigid_mode_under_a_finger_is_an_oscillator(frequency, ratio, mass, damping, stiffness):
    """With phi = 1 the exponents have product (w^2 + k/m_b)/(1 + m/m_b), sum -(2 xi w + c/m_b)/(1 + m/m_b)."""
    w, load = 2 * np.pi * frequency, 1 + mass / MASS
    square, rate = (w**2 + stiffness / MASS) / load, (2 * ratio * w + damping / MASS) / load
    assume(abs(rate**2 / 4 - square) > 1e-3 * square)
    bare = ModalModel((1,), [frequency], [ratio], [[1.0]], 0.1, mass=MASS)
    exponent = DiagonalSystem.of(bare.touched((Finger(0.013, mass, damping, stiffness),))).exponent
    roots = np.array([exponent[0], exponent[0].conjugate()]) if exponent.size == 1 else exponent
    assert roots.prod().real == pytest.approx(square, rel=1e-9)
    assert -roots.sum().real == pytest.approx(rate, rel=1e-9)
    if rate**2 < 4 * square:
        closed = w * np.sqrt((1 + stiffness / (MASS * w**2)) / (1 + mass / MASS))
        assert abs(exponent[0]) == pytest.approx(closed, rel=1e-9)


def test_exponents_under_fingers_are_right_to_the_last_digits(beam):
    """Within 1e-15 of thirty-digit eigenvalues, including mode 1, which is 400 times slower than mode 17."""
    fingers = pair("BD", 0.15, 0.7, 0.5)
    matrix = Coupled(beam, fingers).matrix
    with mpmath.workdps(30):
        # Each entry as the sum of two doubles, which hold an extended one.
        high = matrix.astype(float)
        low = (matrix - high).astype(float)
        exact = mpmath.matrix(high.tolist()) + mpmath.matrix(low.tolist())
        values, _ = mpmath.eig(exact)
        expected = sorted((complex(each) for each in values if each.imag > 0), key=lambda each: each.imag)
    found = sorted(DiagonalSystem.of(beam.touched(fingers)).exponent, key=lambda each: each.imag)
    np.testing.assert_allclose(found, expected, rtol=1e-15)


@given(place=st.floats(-0.05, 0.05), mass=st.floats(1e-6, 1e-3), stiffness=st.floats(1.0, 5e3))
def test_a_mass_lowers_every_frequency_and_a_spring_raises_it(beam, place, mass, stiffness):
    """Rayleigh's theorem, on modes with negligible damping."""
    bare = replace(beam, damping_ratio=np.full(9, 1e-7))
    free = np.sort(bare.angular_frequency)
    for finger, sign in ((Finger(place, mass=mass), -1), (Finger(place, stiffness=stiffness), 1)):
        loaded = np.sort(DiagonalSystem.of(bare.touched((finger,))).exponent.imag)
        assert (sign * (loaded - free) >= -1e-9 * free).all()
        assert (sign * (loaded - free)).max() > 0


@settings(max_examples=40)
@given(
    values=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 60.0), st.floats(0.0, 5.0)),
    places=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
    maxwell=st.lists(st.tuples(st.floats(1.0, 1e4), st.floats(1e-6, 1.0)), max_size=2),
)
def test_fingers_are_passive(uneven_beam, values, places, maxwell):
    """For any mass, damping, stiffness and Maxwell terms every motion decays."""
    mass, damping, stiffness = values
    fingers = tuple(Finger(at, mass * 1e-3, damping, stiffness * 1e3, maxwell=tuple(maxwell)) for at in places)
    assert (DiagonalSystem.of(uneven_beam.touched(fingers)).exponent.real < 0).all()


def test_a_slow_maxwell_term_is_a_spring(design, beam, zones):
    """During a burst of 0.05 s a Maxwell term with a relaxation time of 1e6 s acts like its spring."""
    stimulus = design(beam, timing=COARSE)
    slow, spring = (Finger(0.0, 1e-4, 0.5, k, maxwell=terms) for k, terms in ((0.0, ((900.0, 1e6),)), (900.0, ())))
    at = [stimulus.touched((each,)).velocity_at_focus(zones, stimulus.volts_per_code(LEVEL)) for each in (slow, spring)]
    np.testing.assert_allclose(*at, rtol=0, atol=1e-7 * LEVEL)
    pulls = [stimulus.touched((each,)).pull(stimulus.volts_per_code(LEVEL)) for each in (slow, spring)]
    np.testing.assert_allclose(*pulls, rtol=1e-6)


@pytest.mark.parametrize("time", [1e-8, 1e-9])
def test_a_fast_maxwell_term_is_a_damper(design, beam, zones, time):
    """A fast Maxwell term is a damper of stiffness times relaxation time, within a fraction w tau."""
    stimulus = design(beam, timing=COARSE)
    quick = Finger(0.0, 1e-4, 0.5, 500.0, maxwell=((0.8 / time, time),))
    damper = Finger(0.0, 1e-4, 1.3, 500.0)
    unit = stimulus.volts_per_code(LEVEL)
    at = [stimulus.touched((each,)).velocity_at_focus(zones, unit) for each in (quick, damper)]
    w = beam.angular_frequency.max()
    np.testing.assert_allclose(*at, rtol=0, atol=w * time * LEVEL)
    assert np.abs(at[1] - stimulus.touched(()).velocity_at_focus(zones, unit)).max() > 0.05 * LEVEL


def test_a_second_mass_has_the_poles_of_two_coupled_masses(beam):
    """Mode 1 alone, whose shape is 1, against the roots of the characteristic polynomial of both masses."""
    names = ("natural_frequency", "damping_ratio", "modal_gain")
    first = replace(beam, label=(1,), **{name: getattr(beam, name)[:1] for name in names})
    mass, spring, damper, w, ratio = 1.2e-3, 1e5, 0.8, 2 * np.pi * 229, 0.0437
    finger = Finger(0.01, 0.2e-3, 0.6, 700.0, second_mass=(mass, spring, damper))
    alone = np.array([MASS, 2 * ratio * w * MASS, w**2 * MASS])
    own = alone + [0.2e-3, 0.6, 700.0]
    roots = np.roots(np.polyadd(np.polymul(own, [mass, damper, spring]), np.polymul([spring, 0], [mass, damper])))
    found = np.sort_complex(DiagonalSystem.of(first.touched((finger,))).exponent)
    assert found == pytest.approx(np.sort_complex(roots[roots.imag > 0]), rel=1e-9)
    assert finger.impedance(found) == pytest.approx(-np.polyval(alone, found) / found, rel=1e-9)


@pytest.mark.parametrize(
    ("second", "alike"),
    [((1e6, 900.0, 0.0), {"stiffness": 1400.0}), ((1e-4, 1e13, 0.4), {"mass": 2e-4, "damping": 0.9})],
    ids=["at rest", "moves along"],
)
def test_limits_of_a_second_mass(design, beam, zones, second, alike):
    """If too heavy to move, it acts as a spring; on a rigid spring, as a mass and a damper."""
    stimulus, values = design(beam, timing=COARSE), {"mass": 1e-4, "damping": 0.5, "stiffness": 500.0}
    unit = stimulus.volts_per_code(LEVEL)
    fingers = Finger(0.01, **values, second_mass=second), Finger(0.01, **{**values, **alike})
    at = [stimulus.touched((each,)).velocity_at_focus(zones, unit) for each in fingers]
    np.testing.assert_allclose(*at, rtol=0, atol=1e-6 * LEVEL)
    assert np.abs(at[1] - stimulus.touched((Finger(0.01, **values),)).velocity_at_focus(zones, unit)).max() > 1e-4


def same_loads(one, other):
    """Return whether the fingers on two beams are bit-identical, so that their designs are, too."""
    return all(
        finger == like and (contact == alike).all()
        for (contact, finger), (alike, like) in zip(one.loads, other.loads, strict=True)
    )


@pytest.mark.parametrize("maxwell", [(), RELAXING], ids=["plain", "relaxing"])
@pytest.mark.parametrize("places", [(-0.04, 0.0), (-0.0371, -0.0113), (-0.045, 0.02)], ids=str)
def test_mirrored_fingers_on_symmetric_modes_have_identical_codes(design, beam, places, maxwell):
    """(A, C) and (C, E), or any other mirrored pair, share one design."""
    left, right = (
        Finger(place, mass, 0.7, 500.0, maxwell=maxwell) for place, mass in zip(places, (1e-4, 2e-4), strict=True)
    )
    mirrored = tuple(replace(finger, position=-finger.position) for finger in (right, left))
    assert same_loads(beam.touched((left, right)), beam.touched(mirrored))
    one, other = (design(beam.touched(each), timing=COARSE).burst for each in ((left, right), mirrored))
    assert one.content_hash == other.content_hash
    assert (one.codes == other.codes).all()
    assert one.amplitude == other.amplitude


def test_mirrored_fingers_on_even_modes_have_different_codes(design, uneven_beam):
    """Even modes are antisymmetric, so left and right differ."""
    left, right = (
        design(uneven_beam.touched(pair(zones, 0.1, 0.7, 0.5)), timing=COARSE).burst.codes for zones in ("AC", "CE")
    )
    assert (left != right).any()


def test_the_order_of_the_fingers_does_not_matter(design, beam):
    """The codes do not depend on which finger is listed first."""
    two = Finger(-0.04, 1e-4, 0.5, 500.0, maxwell=RELAXING), Finger(0.0, 2e-4, 0.7, 900.0, maxwell=RELAXING[:1])
    assert same_loads(beam.touched(two), beam.touched(two[::-1]))
    first, second = (design(beam.touched(fingers), timing=COARSE).burst.codes for fingers in (two, two[::-1]))
    assert (first == second).all()


def test_without_a_finger_the_codes_are_those_of_the_untouched_beam(design, model, beam, shipped):
    """Bit-identical whether or not the beam's mass is known, and after fingers were lifted."""
    lifted = beam.touched(pair("AC", 0.1, 0.7, 0.5)).touched(())
    for each in (beam, beam.touched(()), lifted):
        assert design(each).burst.content_hash == shipped.burst.content_hash
    unit = shipped.volts_per_code(LEVEL)
    same = design(beam).touched(())
    places = list(ZONE.values())
    assert (same.velocity_at_focus(places, unit) == shipped.velocity_at_focus(places, LEVEL)).all()
    assert (same.peak_velocity(places, unit) == shipped.peak_velocity(places, LEVEL)).all()


@pytest.mark.parametrize("width", [0.002, 0.02, 0.04])
def test_a_contact_of_any_width_is_averaged(uneven_beam, width):
    """Against means over 64 Gauss points; a contact at the end of the beam is cut off there."""
    for place in (0.0, 0.018, 0.048):
        finger = Finger(place, width=width)
        at, weights = contact_of(uneven_beam, finger)
        expected = ((at * weights) @ at.T).astype(float)
        np.testing.assert_allclose(finger.contact(uneven_beam.shapes, 0.1), expected, atol=1e-10)
        np.testing.assert_allclose(finger.mean_shape(uneven_beam.shapes, 0.1), (at @ weights).astype(float), atol=1e-10)


def test_fingers_need_a_place_on_a_beam_of_known_mass(model, beam):
    """Refused: a place off the beam, and an unknown moving mass."""
    with pytest.raises(ValueError, match="a finger lies at 51 mm, off the beam, which spans -50 to 50 mm"):
        beam.touched((Finger(0.051),))
    with pytest.raises(ValueError, match="fingers lie on a beam of unknown mass; give its moving mass"):
        model.touched((Finger(0.0),))


@pytest.mark.parametrize("n", [12, 16, 24, 120])
def test_the_quadrature_of_a_contact_is_gauss_legendre(n):
    """Nodes and weights agree with NumPy's."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    np.testing.assert_allclose(gauss_legendre(n), (nodes, weights), rtol=0, atol=1e-14)
