"""The smallest number of samples for a tolerance."""

import numpy as np
import pytest
from forward import modal_history

from modaltouch.stimulus.tolerances import cheapest_samples

PLACES = np.linspace(-0.05, 0.05, 21)


@pytest.mark.parametrize("tolerance", [1e-1, 3e-3, 1e-3])
def test_cheapest_count_keeps_the_tolerance_and_the_next_cheaper_does_not(shipped, tolerance):
    """The cheapest count that keeps the tolerance is chosen and reported."""
    economy = cheapest_samples(shipped, tolerance, PLACES)
    assert economy.error <= tolerance
    cheaper = [error for count, error in economy.tried if count < economy.n_samples]
    assert all(error > tolerance for error in cheaper)
    assert f"{economy.n_samples} samples give the field" in str(economy)


def test_error_is_the_change_of_the_field_around_the_focus(shipped):
    """Recomputed at the instants that both clocks share, within 1 ms of the focus."""
    economy = cheapest_samples(shipped, 1e-9, PLACES)
    assert economy.n_samples == 125_000
    errors = dict(economy.tried)
    coarse = cheapest_samples(shipped, errors[25_000], PLACES)
    assert coarse.n_samples == 25_000
    ours = modal_history(shipped.model, shipped.voltage, shipped.timing)[:, 60_000:65_001:5]
    theirs = modal_history(shipped.model, coarse.stimulus.voltage, coarse.stimulus.timing)[:, 12_000:13_001]
    change = np.abs(shipped.model.shapes(PLACES).T @ (theirs - ours)).max() / 0.2
    assert errors[25_000] == pytest.approx(change, rel=1e-9)


def test_refinement_converges_at_the_order_of_the_hold(shipped):
    """The order of convergence lies between 0.8 and 2.5, as for held samples of a smooth optimum."""
    errors = dict(cheapest_samples(shipped, 1e-9, PLACES).tried)
    order = np.log(errors[12_500] / errors[62_500]) / np.log(5)
    assert 0.8 < order < 2.5


@pytest.mark.parametrize("tolerance", [1e-1, 5e-3, 1e-9])
def test_every_count_tried_is_allowed_in_a_protocol(shipped, tolerance):
    """`stimulus.n_samples` must be even, which excludes 15,625 although it divides 125,000."""
    assert all(count % 2 == 0 for count, _ in cheapest_samples(shipped, tolerance, PLACES).tried)


def test_the_count_resolves_the_highest_mode(shipped):
    """At least 2.5 samples per cycle of the highest mode: 87,855 Hz over 50 ms need 10,982."""
    economy = cheapest_samples(shipped, 10.0, PLACES)
    assert economy.n_samples == 12_500
