"""Probes of a beam under known fingers: fits and refusals."""

from dataclasses import replace

import numpy as np
import pytest

from modaltouch.stimulus.fingers import Finger
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.probe import Probe, ProbedBeam

FREQUENCY = np.repeat(np.geomspace(60.0, 15e3, 60), 2) * np.tile([1.0, 1.01], 60)
CHANNEL = np.tile([0, 1], 60)
LASER = 0.049
EXPECTED = (Finger(-0.04, 8e-5, 0.5, 500.0), Finger(0.0, 8e-5, 0.5, 500.0))
TRUE = (Finger(-0.0415, 1.5e-4, 0.9, 900.0), Finger(0.001, 1.1e-4, 0.7, 700.0))


@pytest.fixture(scope="module")
def table():
    """Six modes, even ones included, each driven by both outputs."""
    gain = np.array([[0.11, 0.01], [0.02, -0.05], [0.65, 0.06], [0.2, 0.5], [0.6, 6.5], [0.4, -1.2]])
    frequency, ratio = np.array([229.0, 310, 2553, 4550, 7137, 9800]), np.array([0.044, 0.04, 0.017, 0.02, 0.026, 0.02])
    return ModalModel((1, 2, 3, 4, 5, 6), frequency, ratio, gain, 0.1, mass=3.3e-3)


@pytest.fixture(scope="module")
def beam(table):
    """The same modes, with random errors of 0.1 % in frequency and 2 % in damping and gain."""
    off = np.exp(np.random.default_rng(3).standard_normal((4, 6)) * np.array([[1e-3], [0.02], [0.02], [0.02]]))
    return replace(
        table,
        natural_frequency=table.natural_frequency * off[0],
        damping_ratio=table.damping_ratio * off[1],
        modal_gain=table.modal_gain * off[2:].T,
    )


def responses(model, delay=0.0, channels=None):
    """Velocity per volt, each line by the solution of the coupled modes' equations."""
    s, omega = 2j * np.pi * FREQUENCY, model.angular_frequency
    rows = []
    for each, channel in zip(s, np.broadcast_to(CHANNEL if channels is None else channels, s.shape), strict=True):
        stiff = np.diag(each + 2 * model.damping_ratio * omega + omega**2 / each)
        for finger in model.fingers:
            contact = finger.contact(model.shapes, model.length) / model.mass
            stiff = stiff + complex(finger.impedance(np.array(each))) * contact
        motion = np.linalg.solve(stiff, model.modal_gain[:, channel])
        rows.append(model.shapes([LASER])[:, 0] @ motion * np.exp(-each * delay))
    return np.array(rows)


def measured(model, seed=0, noise=0.003):
    """A noisy probe of a beam, by a vibrometer with a delay of 4 us."""
    exact = responses(model, 4e-6)
    deviation = noise * np.sqrt(np.abs(exact) * np.abs(exact).mean())
    rng = np.random.default_rng(seed)
    drawn = rng.standard_normal(exact.size) + 1j * rng.standard_normal(exact.size)
    return Probe(LASER, FREQUENCY, np.eye(2)[CHANNEL], exact + deviation * drawn, deviation)


@pytest.fixture(scope="module")
def free(table, beam):
    """The untouched beam, by a probe."""
    return measured(beam).untouched(table)


@pytest.fixture(scope="module")
def found(beam, free):
    """The beam under fingers, by a probe."""
    return measured(beam.touched(TRUE), seed=1).touched(free, EXPECTED)


def test_the_untouched_beam_is_found(beam, free):
    """Natural frequencies, damping ratios, gains and delay are within four standard deviations."""
    steps = np.concatenate(
        [
            np.log(beam.natural_frequency / free.model.natural_frequency),
            np.log(beam.damping_ratio / free.model.damping_ratio),
            ((beam.modal_gain - free.model.modal_gain) / np.abs(beam.modal_gain).max(axis=1, keepdims=True)).ravel(),
            [(4e-6 - free.delay) * 1e6],
        ]
    )
    assert np.all(np.abs(steps) < 4 * np.sqrt(np.diag(free.covariance)))
    assert free.trusted.all()
    assert 0.5 < free.misfit < 1.5


def test_a_vibrometer_delay_of_over_half_a_cycle_is_found(table, beam):
    """45 us are two thirds of a cycle at the highest frequency; a fit started at zero would not converge."""
    late = measured(beam)
    turned = late.response * np.exp(-2j * np.pi * FREQUENCY * 41e-6)
    assert replace(late, response=turned).untouched(table).delay == pytest.approx(45e-6, abs=0.1e-6)


def test_fingers_and_their_places_are_found(found):
    """Mass, damping, stiffness and place of each finger are within four stated standard deviations."""
    deviation = np.sqrt(np.diag(found.covariance))[found.n_beam :].reshape(2, 4)
    for finger, true, spread in zip(found.model.fingers, TRUE, deviation, strict=True):
        off = [np.log(getattr(finger, name) / getattr(true, name)) for name in ("mass", "damping", "stiffness")]
        assert np.all(np.abs([*off, (finger.position - true.position) * 1e3]) < 4 * spread)
    assert deviation[:, 0].max() < 0.05
    assert 0.5 < found.misfit < 1.5


def test_the_spread_of_a_figure_equals_that_of_its_parameter(found):
    """For figures that are single parameters, the spread is the standard deviation in the covariance."""
    spread = found.spread(found.slopes(lambda model: np.log([finger.mass for finger in model.fingers])))
    known = np.sqrt(np.diag(found.covariance))[[found.n_beam, found.n_beam + 4]]
    assert spread == pytest.approx(known, rel=1e-3)


def test_drift_of_fingers_and_gains_is_found_from_a_burst(beam, found):
    """Changes since the probe are found within four standard deviations while both outputs play together."""
    later = tuple(replace(finger, mass=1.2 * finger.mass, damping=0.8 * finger.damping) for finger in TRUE)
    gains = np.array([1.02, 0.97])
    drifted = replace(beam, modal_gain=beam.modal_gain * gains).touched(later)
    each = [replace(beam, modal_gain=beam.modal_gain * gains * own).touched(later) for own in np.eye(2)]
    rng = np.random.default_rng(5)
    drive = rng.standard_normal((FREQUENCY.size, 2)) + 1j * rng.standard_normal((FREQUENCY.size, 2))
    per_volt = np.stack([responses(one, 4e-6, channel) for channel, one in enumerate(each)], axis=1)
    exact = (per_volt * drive).sum(axis=1)
    deviation = 0.003 * np.sqrt(np.abs(exact) * np.abs(exact).mean())
    noise = deviation * (rng.standard_normal(exact.size) + 1j * rng.standard_normal(exact.size))
    seen = Probe(LASER, FREQUENCY, drive, exact + noise, deviation).later(found)
    slopes = seen.slopes(lambda model: np.log([finger.mass for finger in model.fingers]))
    off = np.log([finger.mass / true.mass for finger, true in zip(seen.model.fingers, drifted.fingers, strict=True)])
    assert np.all(np.abs(off) < 4 * seen.spread(slopes))
    assert seen.spread(slopes).max() < 0.05
    assert (seen.model.modal_gain / found.model.modal_gain).mean(axis=0) == pytest.approx(gains, abs=0.02)
    assert 0.5 < seen.misfit < 1.5
    with pytest.raises(ValueError, match="no drift of the fingers explains the record: misfit [0-9.]+, at most 10 is"):
        Probe(LASER, FREQUENCY, drive[::-1], exact, deviation).later(found)


def test_slopes_are_differences_of_responses(beam):
    """Every derivative, including that of a Maxwell term, agrees with central differences of responses."""
    relaxing = replace(TRUE[0], maxwell=((2000.0, 1e-4),))
    n = 6 * 4 + 1 + 5 + 4
    known = ProbedBeam(beam.touched((relaxing, TRUE[1])), 4e-6, np.eye(n), 1.0, np.ones(120, dtype=bool))
    probe = measured(beam)
    _, slopes = probe._responses(known)
    for number in range(n):
        low, high = (probe._responses(known.moved(side * 1e-5 * np.eye(n)[number]))[0] for side in (-1, 1))
        size = np.abs(slopes[:, number]).max()
        assert slopes[:, number] == pytest.approx((high - low) / 2e-5, abs=2e-4 * size), number


def test_viscoelastic_fingers_are_fitted_with_maxwell_terms(beam, free):
    """No mass, damper and spring describes two Maxwell terms; the fit adds terms and meets the responses to 1 %."""
    relaxing = tuple(replace(each, damping=0.05, maxwell=((3000.0, 2e-4), (20e3, 2e-5))) for each in TRUE)
    under = measured(beam.touched(relaxing), seed=2).touched(free, EXPECTED)
    assert all(len(finger.maxwell) == 3 for finger in under.model.fingers)
    assert under.misfit < 3
    exact = responses(beam.touched(relaxing))
    assert np.median(np.abs(responses(under.model) / exact - 1)) < 1e-2


def test_viscoelastic_fingers_behind_a_slow_amplifier_are_where_they_are(table, beam):
    """A corner of 35 kHz that is not in the table hides most of a Maxwell term's misfit, but not of its place."""
    corner = 1 / (1 + 1j * FREQUENCY / 35e3)
    relaxing = tuple(replace(each, maxwell=((1000.0, 1e-4),)) for each in TRUE)
    off, on = measured(beam), measured(beam.touched(relaxing), seed=2)
    free = replace(off, response=off.response * corner).untouched(table)
    under = replace(on, response=on.response * corner).touched(free, EXPECTED)
    spread = np.sqrt(np.diag(under.covariance))[under.n_beam :].reshape(2, -1)[:, 3]
    places = [(finger.position - true.position) * 1e3 for finger, true in zip(under.model.fingers, TRUE, strict=True)]
    assert np.all(np.abs(places) < 1.96 * spread)


@pytest.mark.parametrize(("scale", "said"), [(1.03, "1.03"), (0.98, "0.98")])
def test_a_sensitivity_that_changed_is_refused(beam, free, scale, said):
    """A change between the probes with hands off and on; fingers fitted to it would put the level off by as much."""
    on = measured(beam.touched(TRUE), seed=1)
    with pytest.raises(
        ValueError,
        match=rf"modes move {said}\d times as fast .* allowed 0.990 to 1.010; the vibrometer's sensitivity or",
    ):
        replace(on, response=on.response * scale).touched(free, EXPECTED)


def test_table_without_even_modes_is_refused(table):
    """Fingers couple even modes to the others, so a mode missing in the table would be ascribed to the fingers."""
    odd = replace(
        table,
        label=table.label[::2],
        natural_frequency=table.natural_frequency[::2],
        damping_ratio=table.damping_ratio[::2],
        modal_gain=table.modal_gain[::2],
    )
    with pytest.raises(ValueError, match=r"the table lacks modes 2, 4, which .* run `modaltouch identify --modes all`"):
        odd.require_all_modes()


def test_a_beam_that_differs_from_the_table_is_refused(table, beam):
    """Fingers left on the beam are reported as a misfit of the untouched beam."""
    with pytest.raises(ValueError, match=r"do not describe the untouched beam: misfit [\d.]+, .*; take all hands off"):
        measured(beam.touched(TRUE)).untouched(table)


def test_weak_probe_is_refused(table, beam):
    """A probe with half of its responses below their noise."""
    with pytest.raises(
        ValueError,
        match=r"too weak: half of its responses contain more than \d+% of noise.*or give `fingers probe` a higher",
    ):
        measured(beam, noise=1.0).untouched(table)


@pytest.mark.parametrize(("there", "absent"), [((), -40), (TRUE[:1], 0), (TRUE[1:], -40)])
def test_a_missing_finger_is_reported_with_its_place(beam, free, there, absent):
    """One or both fingers are absent: the fit without them leaves only noise, whose mean square is 1."""
    said = rf"no finger is detected at \{absent:+d} mm .*\(misfit (0\.[89]|1\.[01])\); place the finger there"
    with pytest.raises(ValueError, match=said):
        measured(beam.touched(there), seed=4).touched(free, EXPECTED)


def test_lightest_fingers_are_detected(beam, free):
    """The lower end of the literature's range: 0.02 g and 0.1 N s/m without stiffness."""
    light = tuple(replace(finger, mass=2e-5, damping=0.1, stiffness=0.0) for finger in TRUE)
    found = measured(beam.touched(light), seed=4).touched(free, EXPECTED)
    assert [finger.mass for finger in found.model.fingers] == pytest.approx([2e-5, 2e-5], rel=0.05)


def test_a_finger_that_moves_between_records_is_reported(beam):
    """A shift of 1 mm between two records is refused; records of a still finger are averaged."""
    still = [measured(beam.touched(TRUE), seed) for seed in (5, 6)]
    assert Probe.averaged(still).deviation == pytest.approx(still[0].deviation / np.sqrt(2))
    moved = replace(TRUE[0], position=TRUE[0].position + 1e-3)
    with pytest.raises(
        ValueError, match=r"differ by \d+ times the variance of their noise, .*: something moved, or there is mains hum"
    ):
        Probe.averaged([still[0], measured(beam.touched((moved, TRUE[1])), 7)])


def test_a_vibrometer_that_is_off_is_reported(beam):
    """A signal of zeros has no noise to weight the lines by."""
    still = measured(beam, 5)
    silent = replace(still, response=0 * still.response, deviation=0 * still.deviation)
    with pytest.raises(ValueError, match="the velocity is zero throughout: check that the vibrometer is on"):
        Probe.averaged([silent, silent])


def test_an_unexpected_third_contact_is_refused(beam, free, monkeypatch):
    """The misfit shows a contact that is not in the model; a few steps of each fit suffice."""
    monkeypatch.setattr("modaltouch.stimulus.probe._MOST_EVALUATIONS", 8)
    third = Finger(0.03, 2e-3, 9.0, 9000.0)
    with pytest.raises(
        ValueError, match=r"no combination of mass, damper and springs describes the fingers: misfit [\d.]+"
    ):
        measured(beam.touched((*TRUE, third)), seed=8).touched(free, EXPECTED)
