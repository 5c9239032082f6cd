"""Figure 2: nine coefficients of the target field, six of them selected."""

import numpy as np
import pytest

from modaltouch.stimulus.target_field import Projection, TargetField


def test_triangle_projects_as_its_closed_form(model):
    """The mean of the triangle is checked in closed form, the rest with a 120-point Gauss rule on its half."""
    projection = Projection(model, TargetField())
    assert projection.coefficient[0] == pytest.approx(0.28, rel=1e-13)
    node, weight = np.polynomial.legendre.leggauss(120)
    half = 0.014
    for k, label in enumerate(model.label):
        place = half + half * node
        integral = 2 * (weight * half * (1 - place / 0.028)) @ model.shapes(place)[k] / 0.1
        assert projection.coefficient[k] == pytest.approx(integral, abs=1e-13), label


def test_six_strongest_modes_are_those_of_the_paper(model):
    """Section II-B: 1, 3, 5, 7, 11, 13; the sixth coefficient is six times the seventh."""
    projection = Projection(model, TargetField())
    strength = np.sort(np.abs(projection.coefficient))[::-1]
    assert projection.selected == (1, 3, 5, 7, 11, 13)
    assert strength[5] / strength[6] == pytest.approx(6, abs=0.7)


@pytest.mark.parametrize("base", [0.0505, 0.053, 0.056, 0.061])
def test_selection_does_not_depend_on_the_base(model, base):
    """The same six modes are selected for bases of 50.5 to 61 mm."""
    assert Projection(model, TargetField(base=base)).selected == (1, 3, 5, 7, 11, 13)


@pytest.mark.parametrize("base", [0.049, 0.063])
def test_selection_changes_for_smaller_or_larger_bases(model, base):
    """Outside 50.5 to 61 mm another six modes are strongest."""
    assert Projection(model, TargetField(base=base)).selected != (1, 3, 5, 7, 11, 13)


@pytest.mark.parametrize(("shape", "base"), [("half_cosine", 0.04), ("box", 0.027)])
def test_other_fields_select_the_same_modes(model, shape, base):
    """A half-cosine of 40 mm and a box of 27 mm select the same six."""
    assert Projection(model, TargetField(shape=shape, base=base)).selected == (1, 3, 5, 7, 11, 13)


def test_antisymmetric_modes_do_not_contribute_to_a_centred_field(model):
    """The field is decomposed on the first fifty modes; antisymmetric coefficients vanish."""
    decomposition = Projection(model, TargetField()).decomposition
    assert decomposition.shape == (50,)
    assert np.abs(decomposition[1::2]).max() < 1e-15
    kept = decomposition[[k - 1 for k in model.label]]
    assert kept == pytest.approx(Projection(model, TargetField()).coefficient, abs=1e-15)


def test_all_selected_modes_add_up_at_the_focus(shipped):
    """Every selected mode moves the focus in the same direction."""
    share = shipped.target * shipped.model.shapes([0.0])[:, 0]
    assert (share[shipped.target != 0] > 0).all()
