"""Mode shapes as a scan found them, in the place of those of a theory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from modaltouch.protocol.document import Problem, Reading
from modaltouch.protocol.document.section import Label, Number, Section, described

if TYPE_CHECKING:
    from modaltouch.stimulus import MeasuredShapes

Numbers = Annotated[tuple[Number, ...], Field(min_length=2, max_length=10_000)]


class MeasuredShape(Section):
    """The shape of one mode."""

    label: Label = described("Label of the mode, as in the table of modes.")
    values: Numbers = described("Value at each position, in any unit; scale and sign are taken out.")


class ShapeTable(Section):
    """Shapes of the modelled modes on the points of a scan."""

    position_mm: Numbers = described("Points of the scan, from left to right [mm from mid-beam].")
    modes: Annotated[tuple[MeasuredShape, ...], Field(min_length=1, max_length=200)] = described(
        "The shape of each modelled mode."
    )

    def basis(self, labels: tuple[int, ...], length: float) -> MeasuredShapes:
        """Return the shapes in the order of the labels.

        Parameters
        ----------
        labels : tuple of int
            Labels of the modelled modes.
        length : float
            Length of the beam [m].

        Raises
        ------
        ValueError
            If they span no basis.
        """
        from modaltouch.stimulus import MeasuredShapes

        values = {mode.label: mode.values for mode in self.modes}
        shapes = np.array([values[label] for label in labels])
        return MeasuredShapes(labels, np.array(self.position_mm) * 1e-3, shapes, length)


def check_shapes(reading: Reading[Any]) -> Iterator[Problem]:
    """Return the faults between shapes, theory and table of modes, as far as their sound parts show them."""
    theory, table = reading.sound("beam", "theory"), reading.sound("beam", "measured_shapes")
    here = ("beam", "measured_shapes")
    if theory == "measured" and reading.find(here) is None:
        remedy = "add `measured_shapes`, or take euler_bernoulli or timoshenko"
        yield reading.problem(("beam", "theory"), "measured, without any shapes", "shapes of a scan", remedy)
    if theory in ("euler_bernoulli", "timoshenko") and reading.find(here) is not None:
        given = f"shapes of a scan, which {theory} does not use"
        yield reading.problem(here, given, "only with `theory: measured`", "write `theory: measured`", at_key=True)
    if theory != "measured" or table is None:
        return
    for index, mode in enumerate(table.modes):
        if len(mode.values) != len(table.position_mm):
            given = f"{len(mode.values)} values at {len(table.position_mm)} positions"
            yield reading.problem((*here, "modes", index, "values"), given, "one value to each position")
    labels = [mode.label for _, mode in reading.items("modes")]
    shaped = [mode.label for mode in table.modes]
    for label in labels:
        if shaped.count(label) != 1:
            given = f"{shaped.count(label)} shapes of mode {label}"
            yield reading.problem((*here, "modes"), given, "one shape to each mode of the table", at_key=True)
