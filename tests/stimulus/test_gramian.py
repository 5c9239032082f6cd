"""The weighted sums behind the Gramian, against explicit sums; the solver and its refusals."""

import numpy as np
import pytest

from modaltouch.stimulus.reachability import GramianSolver, Taper, raised_cosine


def weights(taper):
    """Return the weight of every sample."""
    ones = np.ones((1, taper.n_samples))
    taper.apply(ones)
    return ones[0]


TAPERS = [Taper(40, 7, 5), Taper(12, 6, 6), Taper(9, 1, 1), Taper(3, 1, 1)]


@pytest.mark.parametrize("taper", TAPERS, ids=str)
def test_all_samples_but_the_ends_are_free(taper):
    """The weight begins and ends at 0 and nowhere else."""
    weight = weights(taper)
    assert weight[0] == weight[-1] == 0
    assert (weight[1:-1] > 0).all()


@pytest.mark.parametrize("taper", TAPERS, ids=str)
def test_transforms_agree_with_explicit_sums(taper):
    """Also at rate 0, and at rates that resonate with the cosine of a taper."""
    rates = [0.0, -0.02 + 0.4j, -3.0, -1e-9 + 1e-7j]
    rates += [sign * 1j * np.pi / n for n in (taper.rise, taper.fall) if n > 1 for sign in (1, -1)]
    before_last = np.arange(taper.n_samples)[::-1]
    expected = [(weights(taper) * np.exp(rate * before_last)).sum() for rate in rates]
    assert taper.transform(np.array(rates, dtype=complex)) == pytest.approx(np.array(expected), abs=1e-12)


def test_tapers_are_shortened_together_if_they_fill_over_half():
    """Tapers keep their length if there is room; otherwise both shrink by one factor, to at least one sample."""
    assert Taper.fitting(100, 30.0, 20.0) == Taper(100, 30, 20)
    assert Taper.fitting(100, 60.0, 40.0) == Taper(100, 30, 20)
    assert Taper.fitting(100, 0.2, 0.0) == Taper(100, 1, 1)
    assert raised_cosine(4) == pytest.approx([0, 0.5 - 0.5**1.5, 0.5, 0.5 + 0.5**1.5])


def test_the_solver_ignores_directions_lost_in_rounding():
    """A well-scaled system is solved to rounding; a singular one gets the solution of least norm."""
    gramian = np.array([[4.0, 1.0], [1.0, 9.0]]) * [[1.0, 1e6], [1e6, 1e12]]
    solver = GramianSolver.of(gramian, [1])
    assert gramian @ solver.solve(np.array([2.0, 3e6])) == pytest.approx([2.0, 3e6])
    assert solver.condition_number == pytest.approx((1 + 1 / 6) / (1 - 1 / 6))
    twice = GramianSolver.of(np.array([[4.0, 4.0], [4.0, 4.0]]), [1])
    assert twice.solve(np.array([8.0, 8.0])) == pytest.approx([1.0, 1.0])
    assert twice.condition_number > 1e15


@pytest.mark.parametrize(("label", "named"), [((3, 7), "mode 7"), ((5,), "mode 5")])
def test_an_uncontrollable_condition_is_reported_with_its_mode(label, named):
    """Conditions are the velocities of all modes, then their displacements."""
    with pytest.raises(ValueError, match=f"{named} has 0 on the diagonal of the Gramian, which must be above 0"):
        GramianSolver.of(np.diag([1.0, 0.0]), label)
