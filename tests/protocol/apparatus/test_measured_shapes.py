"""Mode shapes by theory or from a scan."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modaltouch.preflight import examine
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.stimulus.other_shapes import TimoshenkoBeam
from modaltouch.stimulus.shapes import mode_shapes

Edit = Callable[..., Path]
BEAM = "apparatus/beam_100x6x2.yaml"
THEORY = "theory: euler_bernoulli"
LABELS = tuple(range(1, 18, 2))


def scanned(n_points: int, labels: tuple[int, ...] = LABELS, theory: str = "measured") -> str:
    """Return the section of a scan of the theoretical shapes, three times as large and inverted."""
    x = np.linspace(-50, 50, n_points)
    rows = -3 * mode_shapes(labels, x * 1e-3, 0.1)
    lines = [f"theory: {theory}", "  measured_shapes:", f"    position_mm: [{', '.join(f'{v:g}' for v in x)}]"]
    lines += ["    modes:"]
    for label, row in zip(labels, rows, strict=True):
        lines.append(f"      - {{label: {label}, values: [{', '.join(f'{v:.9f}' for v in row)}]}}")
    return "\n".join(lines)


def faults(edit: Edit, text: str) -> list[str]:
    """Return the problems of a protocol with such a beam."""
    edit(BEAM, (f"{THEORY}   # mode shapes of a uniform free-free beam", text))
    protocol = edit("differentiated_stimulation.yaml")
    return [str(problem).replace(f"{protocol.parent}/", "") for problem in examine(protocol).problems]


def test_scanned_shapes_replace_theory(edit: Edit) -> None:
    """A scan of theoretical shapes at 41 points, with any scale and sign, gives the theoretical shapes."""
    model = Apparatus.read(edit(BEAM, (THEORY, scanned(41)))).modal_model()
    x = np.linspace(-0.05, 0.05, 101)
    assert model.shapes(x) == pytest.approx(mode_shapes(LABELS, x, 0.1), abs=1e-6)


def test_timoshenko_shapes_follow_from_the_beam(edit: Edit) -> None:
    """Bending modes have the shapes for this length, thickness and Poisson's ratio."""
    apparatus = Apparatus.read(edit(BEAM, (THEORY, "theory: timoshenko\n  poissons_ratio: 0.3")))
    x = np.linspace(-0.05, 0.05, 11)
    expected = TimoshenkoBeam(0.1, 0.002, poissons_ratio=0.3).shapes([15], x)
    assert apparatus.modal_model().shapes(x)[-1] == pytest.approx(expected[0])
    assert not np.allclose(apparatus.modal_model().shapes(x), mode_shapes(LABELS, x, 0.1), atol=1e-3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("theory: measured", "beam.theory: given measured, but there are no shapes"),
        (scanned(41, theory="timoshenko"), "beam.measured_shapes: given shapes of a scan, which timoshenko"),
        (scanned(41, LABELS[:-1]), "beam.measured_shapes.modes: given 0 shapes of mode 17"),
        (scanned(11), "given a stimulus that cannot be made, 9 shapes on 11 points are linearly dependent"),
    ],
)
def test_unusable_shapes_are_refused(edit: Edit, text: str, said: str) -> None:
    """Missing, unused, incomplete or dependent shapes: file, line, column, value and remedy."""
    (problem,) = faults(edit, text)
    assert problem.startswith(BEAM)
    assert said in problem


def test_each_shape_needs_one_value_per_position(edit: Edit) -> None:
    """A wrong number of values is reported at its mode."""
    (problem,) = faults(edit, scanned(41).replace("values: [", "values: [1.0, ", 1))
    assert "beam.measured_shapes.modes[0].values: given 42 values for 41 positions" in problem
