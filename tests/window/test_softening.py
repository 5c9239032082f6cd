"""Coverage of pixels by polygons, against closed forms of the area."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modaltouch.window.layout import Box, capsule, cover, rectangle, rounded, triangle


@given(st.floats(3, 60), st.floats(3, 60), st.floats(-20, 20), st.floats(-20, 20))
def test_a_rectangle_covers_its_area(width: float, height: float, x: float, y: float) -> None:
    """Width times height, within one pixel for the corners."""
    corners = np.array(rectangle(Box(x, y, width, height), "#000000").corners)
    assert cover(corners).alpha.sum() == pytest.approx(width * height, abs=1.0)


def test_a_capsule_covers_its_area() -> None:
    """A bar of length 40 and width 20 plus two half discs of radius 10."""
    corners = np.array(capsule((3.3, 7.1), (43.3, 7.1), 10, "#000000", n_steps=60).corners)
    assert cover(corners).alpha.sum() == pytest.approx(40 * 20 + math.pi * 100, rel=2e-3)


def test_the_orientation_of_a_polygon_does_not_matter() -> None:
    """Reversed corners cover the same area."""
    corners = np.array(triangle("up", 10, 10, 8, "#000000").corners)
    np.testing.assert_allclose(cover(corners).alpha, cover(corners[::-1]).alpha, atol=1e-6)


def test_coverage_inside_outside_and_at_an_edge() -> None:
    """With an edge at 10.25, the pixel it crosses is covered by a quarter."""
    covered = cover(np.array([(2.0, 2.0), (10.25, 2.0), (10.25, 12.0), (2.0, 12.0)]))
    row = covered.alpha[6 - covered.bottom]
    assert row[5 - covered.left] == 1
    assert row[10 - covered.left] == pytest.approx(0.25)
    assert row[0] == row[-1] == 0


def test_round_corners_stay_inside_the_box() -> None:
    """A radius larger than the box is reduced to half its shorter side."""
    shape = rounded(Box(0, 0, 2, 1), 5, "#000000")
    xs, ys = zip(*shape.corners, strict=True)
    assert (min(xs), max(xs), min(ys), max(ys)) == pytest.approx((-1, 1, -0.5, 0.5))
