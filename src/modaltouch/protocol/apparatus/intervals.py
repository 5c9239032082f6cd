"""Where the numbers of a table of modes come from, and how far they may be wrong."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator

from modaltouch.protocol.document import fault
from modaltouch.protocol.document.section import Count, NotNegative, Number, Section, Text, Word, described


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise fault(f"an interval from {pair[0]:g} to {pair[1]:g}", "the lower end first", "exchange them")
    return pair


Interval = Annotated[tuple[Number, Number], AfterValidator(_ordered)]
"""Lower and upper end."""


class Intervals(Section):
    """95 % intervals of a mode's numbers, as identified."""

    natural_frequency_Hz: Interval | None = described("Of the natural frequency [Hz].", default=None)  # noqa: N815
    damping_ratio: Interval | None = described("Of the damping ratio [1].", default=None)
    gain_mm_s2_per_V: dict[Word, Interval] = described(  # noqa: N815
        "Of the modal acceleration per volt at the beam, by actuator set [mm/s^2 per V].", default={}
    )


class Provenance(Section):
    """Where each number of a mode comes from, in words."""

    natural_frequency_Hz: Text = described("Of the natural frequency.", default="")  # noqa: N815
    damping_ratio: Text = described("Of the damping ratio.", default="")
    gain_mm_s2_per_V: Text = described("Of the gains.", default="")  # noqa: N815


class Identified(Section):
    """The identification that the table of modes comes from."""

    date: Text = described("When it was measured.")
    mode: Text = described("simulated, real, or file for responses measured elsewhere.")
    source: Text = described("Folder or files of the measurement.")
    generator: Text = described("Generator, as its identity names it.", default="")
    scope: Text = described("Vibrometer and scope.", default="")
    method: Text = described("How the numbers were found.", default="")
    n_points: Count | None = described("Positions that were measured.", default=None)
    n_averages: Count | None = described("Records averaged at each of them.", default=None)
    velocity_delay_us: Number | None = described(
        "Delay of the measured velocity against the measured drive, beyond the vibrometer's low-pass [us].",
        default=None,
    )
    velocity_delay_interval_us: Interval | None = described("Its 95 % interval [us].", default=None)
    misfit: NotNegative | None = described(
        "Mean square of what the fit leaves over that of the noise [1].", default=None
    )
    replaced_sha256: Text = described("Hash of the apparatus file that this one was made from.", default="")
