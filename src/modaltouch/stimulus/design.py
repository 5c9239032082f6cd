"""The engine's front: a wished field in, a Stimulus out."""

from __future__ import annotations

from typing import get_args

from modaltouch.stimulus.bounds import require_positive
from modaltouch.stimulus.burst import Burst
from modaltouch.stimulus.correction import Correction
from modaltouch.stimulus.designed import Design, Rounding, Stimulus
from modaltouch.stimulus.drive import Law, Release, check_drivable
from modaltouch.stimulus.dynamics import Amplifier
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.target_field import TargetField
from modaltouch.stimulus.timing import Timing

__all__ = ["Amplifier", "Burst", "Correction", "ModalModel", "Stimulus", "Timing", "TargetField", "design_stimulus"]


def design_stimulus(
    model: ModalModel,
    wish: TargetField,
    timing: Timing,
    amplifier: Amplifier,
    *,
    law: Law = "exact",
    release: Release = "braked",
    levels: tuple[float, ...] | None = None,
    load_factor: float = 1.0,
    rounding: Rounding = "settled",
    design: Design = "least_energy",
    correction: Correction | None = None,
) -> Stimulus:
    """Return the stimulus that makes a wished field at the focusing instant.

    Parameters
    ----------
    model : ModalModel
        The identified beam.
    wish : TargetField
        The wished field; its velocity is the reference level, the highest.
    timing : Timing
        Samples, clock and focusing instant.
    amplifier : Amplifier
        Between generator and beam.
    law : str
        ``exact`` (every modelled mode meets its target) or ``paper`` (equations 6 and 7).
    release : str
        ``braked`` (at rest when the burst ends) or ``free`` (zero volts after the focus).
    levels : tuple of float, optional
        Every level that will be played [m/s]; the wish's own if not given.
    load_factor : float
        Share of the generator's open-circuit voltage that reaches the amplifier's input [1].
    rounding : str
        ``settled`` (single codes changed so that rounding costs the exact law next to nothing at the focus) or
        ``plain``.
    design : str
        Of the exact law: ``least_energy``, or ``norm_4``, ``norm_8`` or ``least_peak`` for less peak voltage.
    correction : Correction, optional
        What a calibration makes of the targets of the exact law and of the amplitudes.

    Raises
    ------
    ValueError
        If a mode, the field, the timing or a level is out of bounds; the message names it, its bound and the
        remedy.
    """
    played = (wish.velocity,) if levels is None else tuple(levels)
    _check_options(law, release, rounding, design)
    _check_levels(played, wish.velocity)
    require_positive("the load factor", load_factor, "", "1 into high impedance, 0.5 into 50 ohm")
    _check_arrival(amplifier, timing)
    stimulus = Stimulus(
        model, wish, timing, amplifier, law, release, played, load_factor, rounding, correction, design=design
    )
    check_drivable(model, stimulus.target, timing)
    return stimulus


def _check_options(law: str, release: str, rounding: str, design: str) -> None:
    """Refuse words that mean nothing here."""
    if law not in ("exact", "paper"):
        raise ValueError(f"the drive law {law!r} is unknown; allowed: exact, paper")
    if release not in ("braked", "free"):
        raise ValueError(f"the release {release!r} is unknown; allowed: braked, free")
    if rounding not in ("settled", "plain"):
        raise ValueError(f"the rounding {rounding!r} is unknown; allowed: settled, plain")
    if design not in get_args(Design):
        raise ValueError(f"the design {design!r} is unknown; allowed: {', '.join(get_args(Design))}")
    if law == "paper" and design != "least_energy":
        raise ValueError(f"the paper's law has no design of {design!r}; allowed: least_energy, or the law exact")


def _check_arrival(amplifier: Amplifier, timing: Timing) -> None:
    """Refuse a delay after which nothing would arrive by the focusing instant."""
    if amplifier.delay >= timing.focusing_instant:
        raise ValueError(
            f"the delay of the amplifier is {amplifier.delay:g} s, past the focusing instant of "
            f"{timing.focusing_instant:g} s; it must be shorter: focus later, or check the delay"
        )


def _check_levels(levels: tuple[float, ...], reference: float) -> None:
    """Refuse levels that cannot be played by codes that fill the generator's range at the reference [m/s]."""
    if not levels:
        raise ValueError("no velocity level is given; give at least one")
    for level in levels:
        require_positive("the velocity level", level, "m/s", "the paper has 0.08 to 0.2 m/s")
        if level > reference * (1 + 1e-12):
            raise ValueError(
                f"the level of {level * 1e3:g} mm/s passes the reference of {reference * 1e3:g} mm/s, for "
                f"which the codes fill the generator's range: design for the highest level"
            )
