"""What a design may be asked for, and the refusal of all else."""

from __future__ import annotations

from typing import Literal, get_args

from modaltouch.stimulus.drive import Law, Release
from modaltouch.stimulus.quantities import require_positive

Rounding = Literal["settled", "plain"]
Design = Literal["least_energy", "norm_4", "norm_8", "least_peak"]

Priority = Literal["field", "level"]

MEANT = "the paper has 0.08 to 0.2 m/s"
"""Levels that a field has, said where one is refused."""


def check_options(law: str, release: str, rounding: str, design: str, priority: str) -> None:
    """Refuse words that mean nothing here."""
    for name, given, kind in (
        ("drive law", law, Law),
        ("release", release, Release),
        ("rounding", rounding, Rounding),
        ("design", design, Design),
        ("priority", priority, Priority),
    ):
        if given not in get_args(kind):
            raise ValueError(f"the {name} {given!r} is unknown; allowed: {', '.join(get_args(kind))}")
    if priority == "level" and (law, design) != ("exact", "least_energy"):
        raise ValueError(
            f"the level first is a design of the law exact of least energy, not of {law} with {design}; leave one out"
        )
    if law == "paper" and design != "least_energy":
        raise ValueError(f"the paper's law has no design of {design!r}; allowed: least_energy, or the law exact")


def check_levels(levels: tuple[float, ...], reference: float) -> None:
    """Refuse levels that cannot be played by codes that fill the generator's range at the reference [m/s]."""
    if not levels:
        raise ValueError("no velocity level is given; give at least one")
    for level in levels:
        require_positive("the velocity level", level, "m/s", MEANT)
        if level > reference * (1 + 1e-12):
            raise ValueError(
                f"the level of {level * 1e3:g} mm/s passes the reference of {reference * 1e3:g} mm/s, for "
                f"which the codes fill the generator's range: design for the highest level"
            )
