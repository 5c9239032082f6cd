"""Target fields of every shape, their projection, and the part that the modes cannot reach."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.shapes import mode_shapes
from modaltouch.stimulus.stimulus import design_stimulus
from modaltouch.stimulus.target_field import Projection, TargetField, quadrature

SHAPES = ("triangle", "box", "half_cosine", "raised_cosine", "gaussian")


@pytest.fixture(scope="module")
def full_model():
    """Return a beam with its first forty modes, even ones included."""
    n = 40
    return ModalModel(tuple(range(1, n + 1)), np.linspace(200.0, 90e3, n), np.full(n, 0.02), np.ones((n, 2)), 0.1)


@pytest.mark.parametrize("shape", SHAPES)
@settings(max_examples=6, deadline=None)
@given(base=st.floats(0.008, 0.09), centre=st.floats(-0.045, 0.045))
def test_coefficients_match_a_fine_sum(shape, base, centre, full_model):
    """The mean of field times mode shape, by the midpoint rule on 20,001 points, for any width and centre."""
    target_field = TargetField(shape=shape, base=base, centre=centre, selection=40)
    place = (np.arange(20_001) + 0.5) / 20_001 * 0.1 - 0.05
    labels = [1, 2, 3, 6, 17, 40]
    summed = mode_shapes(labels, place, 0.1) @ target_field.profile(place) / place.size
    found = Projection(full_model, target_field).coefficient[[k - 1 for k in labels]]
    assert found == pytest.approx(summed, abs=2e-4)


@pytest.mark.parametrize("shape", SHAPES)
def test_many_modes_recover_the_target_field(full_model, shape):
    """The modes are complete: forty of them follow the target, except at the edges of a box."""
    projection = Projection(full_model, TargetField(shape=shape, centre=0.01, selection=40))
    assert projection.reconstruction_error < (0.2 if shape == "box" else 0.03)
    assert projection.field([0.01])[0] == pytest.approx(0.2, rel=1e-12)


def test_widths_at_half_height_agree_among_the_shapes():
    """At half height a triangle and a raised cosine are half as wide as their base."""
    for shape in ("triangle", "raised_cosine"):
        assert TargetField(shape=shape, base=0.04).profile([0.01, -0.01]) == pytest.approx(0.5, abs=1e-12)


@pytest.mark.parametrize("level", [0.1, 0.2])
def test_the_reconstruction_error_is_that_of_a_fine_sum(model, level):
    """Root mean square of target minus field over that of the target, on 20,001 points; the level cancels."""
    projection = Projection(model, TargetField(velocity=level))
    place = (np.arange(20_001) + 0.5) / 20_001 * 0.1 - 0.05
    wished = level * projection.target_field.profile(place)
    missed = wished - projection.field(place)
    assert projection.reconstruction_error == pytest.approx(np.sqrt((missed**2).mean() / (wished**2).mean()), rel=1e-4)


def test_a_width_is_where_the_field_has_fallen_to_the_fraction(model):
    """The width lies between the crossings nearest the centre."""
    projection = Projection(model, TargetField())
    place = np.linspace(-0.05, 0.05, 100_001)
    for fraction in (0.3, 0.5, 0.9):
        above = projection.field(place) >= fraction * 0.2
        left = place[:50_001][~above[:50_001]].max()
        right = place[50_000:][~above[50_000:]].min()
        assert projection.width(fraction) == pytest.approx(right - left, abs=4e-6)


def test_the_default_target_field_is_that_of_the_paper():
    """Section III: a triangle of 56 mm at mid-beam, decomposed on fifty modes, of which the six strongest count."""
    target_field = TargetField()
    assert (
        target_field.shape,
        target_field.base,
        target_field.centre,
        target_field.n_decomposed,
        target_field.selection,
    ) == ("triangle", 0.056, 0.0, 50, 6)


def test_symmetric_wiring_mirrors_the_field(model):
    """With odd modes alone a focus at 20 mm also appears at -20 mm; the missing even modes are listed."""
    projection = Projection(model, TargetField(centre=0.02))
    left, right = projection.field([-0.02, 0.02])
    assert left == pytest.approx(right, rel=1e-12)
    assert right == pytest.approx(0.2)
    assert 2 in projection.missing
    assert 4 in projection.missing
    assert projection.residual([-0.02])[0] == pytest.approx(-0.2, rel=1e-6)
    assert "because of the missing modes" in projection.unreached()
    assert "at -20 mm" in projection.unreached()


def test_two_shapes_that_overlap_meet_midway(model):
    """The field has an edge where the two shapes cross, so each side is integrated separately."""
    field = TargetField(centre=-0.01, further_centres=(0.015,))

    def shapes(place: float) -> float:
        return float(model.shapes([place])[0, 0] * field.profile([place])[0])

    edges = [-0.05, -0.038, -0.01, 0.0025, 0.015, 0.043, 0.05]
    whole = sum(quad(shapes, a, b, epsabs=1e-14)[0] for a, b in itertools.pairwise(edges))
    assert Projection(model, field).coefficient[0] == pytest.approx(whole / 0.1, rel=1e-10)


def test_two_zones_at_once_are_reached_by_symmetric_wiring(model):
    """B and D together form a symmetric field: both reach the level, and every state is met."""
    target_field = TargetField(base=0.03, centre=-0.02, further_centres=(0.02,), selection=7)
    stimulus = design_stimulus(
        model, target_field, Timing(AFG3022B.converter, n_samples=25_000), Amplifier(gain=25.0, limit=1e3)
    )
    assert stimulus.velocity_at_focus([-0.02, 0.02], 0.2) == pytest.approx(0.2, rel=1e-4)
    assert stimulus.worst_modal_error(0.2) < 1e-6
    assert not [k for k in stimulus.projection.missing if k % 2 == 0]


def test_overlapping_shapes_do_not_add_up():
    """Where two shapes overlap, the higher one counts."""
    target_field = TargetField(base=0.06, centre=-0.01, further_centres=(0.01,))
    assert target_field.profile([-0.01, 0.0, 0.01]) == pytest.approx([1, 2 / 3, 1])


def test_a_sampled_field_of_three_points_is_the_triangle(model):
    """Three points, in any unit of velocity, give the same projection as the triangle."""
    sampled = TargetField("sampled", points=((-0.028, 0.0), (0.0, 350.0), (0.028, 0.0)))
    expected = Projection(model, TargetField())
    assert Projection(model, sampled).target == pytest.approx(expected.target, abs=1e-15)
    assert Projection(model, sampled).selected == (1, 3, 5, 7, 11, 13)


def test_a_sampled_field_moves_forwards_at_its_centre():
    """A centre that moves backwards has no level."""
    with pytest.raises(ValueError, match="relative velocity -1 at its centre of 0 mm"):
        TargetField("sampled", points=((0.0, -1.0), (0.005, -2.0)))


def test_field_wider_than_the_beam_is_as_wide_as_the_beam(model):
    """A rigid translation never falls to half, so the width is that of the beam."""
    assert Projection(model, TargetField(selection=(1,))).width(0.5) == pytest.approx(0.1)


@pytest.mark.parametrize("base", [0.02, 0.056])
def test_the_base_of_a_gaussian_is_its_full_width_at_half_maximum(base):
    """Closed form exp(-4 ln 2 (x / FWHM)^2), as the protocol's schema describes base_mm."""
    target_field = TargetField(shape="gaussian", base=base, centre=0.01)
    position = np.linspace(-0.05, 0.05, 101)
    expected = np.exp(-4 * np.log(2) * ((position - 0.01) / base) ** 2)
    np.testing.assert_allclose(target_field.profile(position), expected, rtol=1e-12)
    np.testing.assert_allclose(target_field.profile([0.01 - base / 2, 0.01 + base / 2]), 0.5, rtol=1e-12)


@given(degree=st.integers(0, 31))
def test_quadrature_is_exact_up_to_its_degree(degree):
    """Sixteen nodes integrate x^31 on each panel: closed form 1/(n + 1) from 0 to 1."""
    position, weight = quadrature([0.0, 0.3, 1.0], 1.0)
    assert weight @ position**degree == pytest.approx(1 / (degree + 1), rel=1e-14)
