"""Figures of an identification: fitted responses, poles by model order, and phases of the shapes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from modaltouch.lab.identification import figures
from modaltouch.lab.identification.figures import HIGHEST_ORDER, poles_by_order
from modaltouch.lab.identification.joint_fit import identify_each
from modaltouch.lab.identification.modal_parameters import Identification
from modaltouch.lab.identification.responses import FrequencyResponses
from modaltouch.lab.identification.shapes import phase_collinearity
from modaltouch.rig.simulator.true_beam import TrueBeam


def test_the_residual_is_the_noise(found: Identification) -> None:
    """Its power is that given by the coherence, within 3 %, half in each part."""
    responses = found.responses
    left = (responses.response - found.fitted) / np.sqrt(responses.noise)[:, None]
    assert np.mean(left.real**2) == pytest.approx(0.5, rel=0.03)
    assert np.mean(left.imag**2) == pytest.approx(0.5, rel=0.03)


def test_every_listed_mode_is_stable_over_the_model_orders(found: Identification, beam: TrueBeam) -> None:
    """In all orders above 35: frequencies within 0.1 %, damping ratios, which noise lowers, within 12 %."""
    order, frequency, damping, stability = poles_by_order(found.responses)
    for own, ratio in zip(beam.table.natural_frequency, beam.table.damping_ratio, strict=True):
        near = (order > 35) & (np.abs(frequency / own - 1) < 0.02)
        assert set(order[near & (stability == 2)]) == set(range(36, HIGHEST_ORDER + 1))
        assert np.median(frequency[near]) == pytest.approx(own, rel=1e-3)
        assert np.median(damping[near]) == pytest.approx(ratio, rel=0.12)


def test_collinearity_of_phases() -> None:
    """For any common phase; two points in quadrature have none."""
    shape = np.array([1.0, -0.4, 0.2, -1.3]) * np.exp(0.7j)
    assert phase_collinearity(shape) == pytest.approx(1.0, abs=1e-12)
    assert phase_collinearity(np.array([1.0, 1j])) == pytest.approx(0.0, abs=1e-12)
    assert math.isnan(phase_collinearity(np.array([1j])))


def test_the_complexity_of_a_mode_is_found(found: Identification) -> None:
    """The beam's modes are real; a damper that turns one end by 20 degrees is visible."""
    assert phase_collinearity(found.by_label[5].residue) > 0.9999
    frequency = np.arange(100.0, 400.0, 0.25)
    shape = np.array([1.0, -0.5, 0.8]) * np.exp(1j * np.radians([0.0, 0.0, 20.0]))
    pole = 2 * np.pi * 230 * (-0.01 + 1j * math.sqrt(1 - 0.01**2))
    omega = 2 * np.pi * frequency
    motion = omega * (shape[:, None] / (1j * omega - pole) - shape.conj()[:, None] / (1j * omega - np.conj(pole)))
    one = identify_each(FrequencyResponses(frequency, motion[:, None], None, ("a", "b", "c")))
    turned = one.modes[0].residue / one.modes[0].residue[0]
    assert turned == pytest.approx(shape, abs=0.01)
    assert phase_collinearity(one.modes[0].residue) == pytest.approx(phase_collinearity(shape), abs=1e-3)


def test_axes_end_with_the_beam_and_the_band(found: Identification) -> None:
    """Shapes from end to end of the beam, responses from a fifth of the lowest mode or the first bin to the last."""
    few = replace(found, modes=tuple(mode for mode in found.modes if mode.label in (1, 3, 5)))
    shapes = figures.draw_shapes(few)
    assert [axes.get_xlim() for axes in shapes.axes] == [pytest.approx((-50, 50))] * 3
    low, high = few.responses.frequency[[0, -1]] / 1e3
    assert all(axes.get_xlim() == pytest.approx((low, high)) for axes in figures.draw_fits(few).axes)
    higher = replace(few, modes=few.modes[1:])
    assert figures.draw_fits(higher).axes[0].get_xlim() == pytest.approx((0.51, high), rel=0.01)
    assert [each.get_text() for each in figures.draw_stability(few).axes[0].texts] == ["1", "3", "5"]


def test_the_worst_fit_is_shown_with_its_residual(found: Identification) -> None:
    """One point with half of its motion added in quadrature: 0.5 / 1.118 of it remains."""
    response = found.responses.response.copy()
    response[1, 7] *= 1 + 0.5j
    worst = figures.draw_fits(replace(found, responses=replace(found.responses, response=response))).axes[0]
    assert worst.get_title().startswith(f"worst: side at {found.responses.positions[7] * 1e3:.4g} mm,\n44.")
