"""Results of an identification in an apparatus file: measured mode shapes, confidence intervals, sources of numbers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field

from modaltouch.protocol.problems import Problem, fault
from modaltouch.protocol.reading import Reading
from modaltouch.protocol.section import Count, Label, NotNegative, Number, Section, Text, Word, described

if TYPE_CHECKING:
    from modaltouch.stimulus import MeasuredShapes


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise fault(f"an interval from {pair[0]:g} to {pair[1]:g}", "the lower end first", "exchange them")
    return pair


Interval = Annotated[tuple[Number, Number], AfterValidator(_ordered)]
"""Lower and upper bounds."""


class Intervals(Section):
    """95 % confidence intervals of the identified parameters of a mode."""

    natural_frequency_Hz: Interval | None = described("Interval of the natural frequency [Hz].", default=None)  # noqa: N815
    damping_ratio: Interval | None = described("Interval of the damping ratio [1].", default=None)
    gain_mm_s2_per_V: dict[Word, Interval] = described(  # noqa: N815
        "Interval of the modal acceleration per volt at the beam, by actuator set [mm/s^2 per V].", default={}
    )


class Provenance(Section):
    """Source of each parameter of a mode."""

    natural_frequency_Hz: Text = described("Source of the natural frequency.", default="")  # noqa: N815
    damping_ratio: Text = described("Source of the damping ratio.", default="")
    gain_mm_s2_per_V: Text = described("Source of the gains.", default="")  # noqa: N815


class Identified(Section):
    """The identification from which the mode table was obtained."""

    date: Text = described("When it was measured.")
    mode: Text = described("simulated; real; or file, for responses measured elsewhere.")
    source: Text = described("Folder or files of the measurement.")
    generator: Text = described("Generator, as given in its identity.", default="")
    scope: Text = described("Vibrometer and scope.", default="")
    method: Text = described("How the numbers were found.", default="")
    n_points: Count | None = described("Number of positions measured.", default=None)
    n_averages: Count | None = described("Number of records averaged at each position.", default=None)
    velocity_delay_us: Number | None = described(
        "Delay of the measured velocity relative to the measured drive, in addition to the vibrometer's low-pass [us].",
        default=None,
    )
    velocity_delay_interval_us: Interval | None = described("95 % interval of that delay [us].", default=None)
    misfit: NotNegative | None = described(
        "Mean square of the residuals of the fit, relative to that of the noise [1].", default=None
    )
    warnings: tuple[Text, ...] = described("Reservations about these numbers, one sentence each.", default=())
    replaced_sha256: Text = described("Hash of the apparatus file that this one was made from.", default="")


Numbers = Annotated[tuple[Number, ...], Field(min_length=2, max_length=10_000)]


class MeasuredShape(Section):
    """The shape of one mode."""

    label: Label = described("Label of the mode, as in the table of modes.")
    values: Numbers = described("Value at each position, in any unit; scale and sign do not matter.")


class ShapeTable(Section):
    """Shapes of the modelled modes on the points of a scan."""

    position_mm: Numbers = described("Points of the scan, from left to right [mm from mid-beam].")
    modes: Annotated[tuple[MeasuredShape, ...], Field(min_length=1, max_length=200)] = described(
        "The shape of each modelled mode."
    )

    def basis(self, labels: tuple[int, ...], length: float) -> MeasuredShapes:
        """Return the shapes in the order of given labels.

        Parameters
        ----------
        labels : tuple of int
            Labels of the modelled modes.
        length : float
            Length of the beam [m].

        Raises
        ------
        ValueError
            If the shapes are linearly dependent.
        """
        from modaltouch.stimulus import MeasuredShapes

        values = {mode.label: mode.values for mode in self.modes}
        shapes = np.array([values[label] for label in labels])
        return MeasuredShapes(labels, np.array(self.position_mm) * 1e-3, shapes, length)


def check_shapes(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield a problem for each inconsistency between shapes, theory and mode table, as far as they are valid."""
    theory, table = reading.sound("beam", "theory"), reading.sound("beam", "measured_shapes")
    here = ("beam", "measured_shapes")
    if theory == "measured" and reading.find(here) is None:
        remedy = "add `measured_shapes`, or choose euler_bernoulli or timoshenko"
        yield reading.problem(("beam", "theory"), "measured, but there are no shapes", "shapes of a scan", remedy)
    if theory in ("euler_bernoulli", "timoshenko") and reading.find(here) is not None:
        given = f"shapes of a scan, which {theory} does not use"
        yield reading.problem(here, given, "only with `theory: measured`", "write `theory: measured`", at_key=True)
    if theory != "measured" or table is None:
        return
    for index, mode in enumerate(table.modes):
        if len(mode.values) != len(table.position_mm):
            given = f"{len(mode.values)} values for {len(table.position_mm)} positions"
            yield reading.problem((*here, "modes", index, "values"), given, "one value for each position")
    labels = [mode.label for _, mode in reading.items("modes")]
    shaped = [mode.label for mode in table.modes]
    for label in labels:
        if shaped.count(label) != 1:
            given = f"{shaped.count(label)} shapes of mode {label}"
            yield reading.problem((*here, "modes"), given, "one shape for each mode of the table", at_key=True)
