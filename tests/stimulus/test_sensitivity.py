"""Sensitivities and scatter; `test_fingers` checks the derivatives themselves."""

import numpy as np
import pytest

from modaltouch.stimulus.tolerances import derivative, focus_sensitivity, scatter

PARAMETERS = ("natural_frequency", "damping_ratio", "modal_gain")


def test_gain_moves_its_mode_in_proportion(shipped):
    """Velocities are linear in the gain, so the relative derivative of a mode's velocity is its target."""
    found = np.array([derivative(shipped, "modal_gain", mode) for mode in range(9)])
    assert found[:, 0] == pytest.approx(np.diag(shipped.target), abs=1e-10)
    assert found[:, 1] == pytest.approx(0, abs=1e-10)


def test_errors_of_five_per_cent_move_the_field_by_millimetres_per_second(shipped):
    """+5 % in gain moves the field by about 3 mm/s, +5 % in damping by 1.4 mm/s, +0.1 % in frequency by 0.5 mm/s."""
    rows = focus_sensitivity(shipped, np.linspace(-0.05, 0.05, 101))
    worst = {name: max(r["field"] for r in rows if r["parameter"] == name) for name in PARAMETERS}
    assert 2e-3 < worst["modal_gain"] < 7e-3
    assert 0.5e-3 < worst["damping_ratio"] < 4e-3
    assert 0.05e-3 < worst["natural_frequency"] < 1.5e-3
    assert rows[0]["field"] == max(r["field"] for r in rows)


def test_scatter_agrees_with_the_derivatives(shipped):
    """First-order propagation of independent deviations agrees with 400 drawn beams within 12 %."""
    spread = {"natural_frequency": 1e-4, "damping_ratio": 5e-3, "modal_gain": 5e-3}
    field, modal_error = scatter(shipped, [0.0, 0.02], n_draws=400, **spread)
    shapes = shipped.model.shapes([0.0, 0.02])
    variance = sum(
        (derivative(shipped, name, mode)[0] @ shapes * spread[name]) ** 2 for name in PARAMETERS for mode in range(9)
    )
    assert field.std(axis=0, ddof=1) == pytest.approx(np.sqrt(variance), rel=0.12)
    assert (modal_error > 0).all()
