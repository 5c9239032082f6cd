"""The beam behind the simulated generator: how it differs from the identified one, and with fingers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.apparatus_sections import FingerSection, TrueAmplifier, UnlistedMode
from modaltouch.rig.simulator.timeline import Playback
from modaltouch.rig.simulator.true_beam import generator_gains, true_beam
from modaltouch.rig.simulator.twin import Twin

EVEN = UnlistedMode(label=4, natural_frequency_Hz=4550.0, damping_ratio=0.02, gain_mm_s2_per_V={"side": 80.0})
TWIST = UnlistedMode(
    family="torsion", label=1, natural_frequency_Hz=8700.0, damping_ratio=0.01, gain_mm_s2_per_V={"centre": 150.0}
)


def test_a_beam_without_mismatch_is_the_identified_one(
    with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """With zero mismatch every parameter of the table is exact."""
    beam, table = true_beam(with_twin(apparatus), seed=5), apparatus.modal_model()
    assert (beam.natural_frequency == table.natural_frequency).all()
    assert (beam.damping_ratio == table.damping_ratio).all()
    assert (beam.modal_gain == table.modal_gain).all()


def test_the_mismatch_has_the_stated_spread(with_twin: Callable[..., Apparatus], apparatus: Apparatus) -> None:
    """Over 400 seeds and nine modes the logarithms have the stated standard deviation, within 5 %."""
    known = with_twin(apparatus, natural_frequency_mismatch=0.02, damping_ratio_mismatch=0.1, gain_mismatch=0.05)
    beams = [true_beam(known, seed) for seed in range(400)]
    table = apparatus.modal_model()
    for name, spread in (("natural_frequency", 0.02), ("damping_ratio", 0.1), ("modal_gain", 0.05)):
        reference = getattr(table, name)
        logs = [np.log(getattr(beam.table, name)[reference != 0] / reference[reference != 0]) for beam in beams]
        assert np.std(logs) == pytest.approx(spread, rel=0.05)


def test_equal_seeds_give_equal_beams_and_mismatches_are_independent(
    with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """Random streams are separate: another damping mismatch changes neither frequencies nor gains."""
    first = true_beam(with_twin(apparatus, natural_frequency_mismatch=0.01, gain_mismatch=0.02), 3)
    again = true_beam(with_twin(apparatus, natural_frequency_mismatch=0.01, gain_mismatch=0.02), 3)
    other = true_beam(
        with_twin(apparatus, natural_frequency_mismatch=0.01, gain_mismatch=0.02, damping_ratio_mismatch=0.3), 3
    )
    for beam in (again, other):
        assert (beam.natural_frequency == first.natural_frequency).all()
        assert (beam.modal_gain == first.modal_gain).all()
    assert not np.allclose(other.damping_ratio, first.damping_ratio)


def test_cross_gain_replaces_zero_gains_of_the_table(with_twin: Callable[..., Apparatus], apparatus: Apparatus) -> None:
    """A set that does not drive a mode drives it by the stated fraction of the gain of the other set."""
    beam, table = true_beam(with_twin(apparatus, cross_gain=0.1), 1), apparatus.modal_model()
    for row, known in zip(beam.modal_gain, table.modal_gain, strict=True):
        driven = known[known != 0][0]
        assert row[known == 0] == pytest.approx(0.1 * driven)


def test_true_shapes_have_unit_mean_square_and_are_orthogonal(
    with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """Gram matrix over the area by Gauss-Legendre quadrature: the identity, for bending and torsion."""
    beam = true_beam(with_twin(apparatus, unlisted_modes=(EVEN, TWIST)), 1)
    along, weight = np.polynomial.legendre.leggauss(120)
    x, z = np.meshgrid(0.05 * along, 0.003 / np.sqrt(3) * np.array([-1.0, 1.0]))
    shapes = beam.shapes(x.ravel(), z.ravel())
    gram = (shapes * np.tile(weight, 2) / 4) @ shapes.T
    np.testing.assert_allclose(gram, np.eye(beam.natural_frequency.size), atol=1e-12)


def test_torsion_vanishes_on_the_mid_line(with_twin: Callable[..., Apparatus], apparatus: Apparatus) -> None:
    """Its shape is zero there and has opposite signs on either side."""
    beam = true_beam(with_twin(apparatus, unlisted_modes=(TWIST,)), 1)
    assert beam.shapes([0.03])[-1] == 0
    assert beam.shapes([0.05], 0.003)[-1] == pytest.approx(np.sqrt(24) / 2)
    assert beam.shapes([0.05], -0.003)[-1] == pytest.approx(-np.sqrt(24) / 2)


def test_unlisted_modes_are_in_the_twin_and_not_in_the_table(apparatus: Apparatus) -> None:
    """The shipped twin has even, torsional and higher modes; the design table has the nine of Table I."""
    beam = true_beam(apparatus, 1)
    families = {(mode.family, mode.label % 2 == 0, mode.label > 17) for mode in beam.apparatus.twin.unlisted_modes}
    assert {("bending", True, False), ("torsion", False, False), ("bending", False, True)} <= families
    assert apparatus.modal_model().label == (1, 3, 5, 7, 9, 11, 13, 15, 17)
    assert beam.natural_frequency.size == 9 + len(beam.apparatus.twin.unlisted_modes)


def test_an_even_mode_makes_left_and_right_differ(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """At its resonance A and E differ, since it is antisymmetric; with the modes of the table they are equal."""
    drive = playback(hertz=4550.0)
    odd = Twin(with_twin(apparatus), 1).felt([None, drive], [-0.04, 0.04])
    both = Twin(with_twin(apparatus, unlisted_modes=(EVEN,)), 1).felt([None, drive], [-0.04, 0.04])
    assert odd[0] == pytest.approx(odd[1], rel=1e-9)
    assert abs(both[0] - both[1]) > 0.02 * both.max()


def test_a_finger_lowers_the_first_frequency_as_a_mass_does(
    with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """Closed form for one mode: f0 / sqrt(1 + m_f/m) and a = (2 xi w m + c) / (2 (m + m_f)), phi = 1."""
    mode = next(mode for mode in apparatus.modes if mode.label == 1)
    fingers = FingerSection(mass_g=0.33, damping_N_s_per_m=0.4)
    known = with_twin(apparatus, fingers=fingers, beam_mass_g=3.3).model_copy(update={"modes": (mode,)})
    twin = Twin(known, 1)
    exponent = twin.system(twin.fingers(0.02)).exponent[0]
    frequency, mass = 229 / np.sqrt(1.1), 1.1 * 3.3e-3
    assert abs(exponent) / (2 * np.pi) == pytest.approx(frequency, rel=1e-9)
    damping = 2 * 0.0437 * 2 * np.pi * 229 * 3.3e-3 + 0.4
    assert -exponent.real == pytest.approx(damping / (2 * mass), rel=1e-9)
    assert twin.system().exponent[0] == pytest.approx(apparatus.modal_model().exponent[0], rel=1e-12)


def test_each_finger_changes_the_velocity_under_the_other(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """The velocity under a finger at C depends on another at A; without a load it does not."""
    drive = [playback(), playback(hertz=7137.0)]
    loaded = Twin(with_twin(apparatus, fingers=FingerSection(mass_g=0.1, damping_N_s_per_m=0.5)), 1)
    free = Twin(with_twin(apparatus), 1)
    assert free.felt(drive, [0.0])[0] == free.felt(drive, [0.0, -0.04])[0]
    assert loaded.felt(drive, [0.0])[0] > 1.01 * loaded.felt(drive, [0.0, -0.04])[0]
    assert loaded.felt(drive, [0.0])[0] < free.felt(drive, [0.0])[0]


def test_fingers_may_overdamp_a_mode(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """50 N s/m make mode 1 overdamped: two real exponents, and a velocity that is finite and lower."""
    heavy = Twin(with_twin(apparatus, fingers=FingerSection(mass_g=0.1, damping_N_s_per_m=50.0)), 1)
    assert np.sum(heavy.system(heavy.fingers(0.0)).exponent.imag == 0) >= 2
    assert (
        0 < heavy.felt([playback(), None], [0.0])[0] < Twin(with_twin(apparatus), 1).felt([playback(), None], [0.0])[0]
    )


def test_a_gain_error_of_the_generator_only_scales_the_drive(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """Each output has its own seeded factor with the stated spread; the beam does not change."""
    known = with_twin(apparatus, generator_gain_mismatch=0.02)
    logs = np.log([generator_gains(known, seed) for seed in range(400)])
    assert np.std(logs) == pytest.approx(0.02, rel=0.1)
    twin, plain = Twin(known, 3), Twin(with_twin(apparatus), 3)
    factor = generator_gains(known, 3)[0]
    assert factor != 1
    assert twin.felt([playback(), None], [0.0]) == pytest.approx(factor * plain.felt([playback(), None], [0.0]))


def test_the_twin_may_have_its_own_amplifier_values(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """Gain and limit in the twin's section apply to the twin; omitted values are as identified."""
    other = Twin(with_twin(apparatus, amplifier=TrueAmplifier(gain_V_per_V=30.0, limit_V=100.0)), 1)
    (held,) = other.held_of([playback(4.0), None])
    assert np.abs(held.voltage[0]).max() == pytest.approx(60, rel=1e-3)
    (held,) = other.held_of([playback(20.0), None])
    assert np.abs(held.voltage[0]).max() == pytest.approx(100)
    assert (other.amplifier.bandwidth, other.amplifier.delay) == (None, 0)
