"""All that the golden tests take from inside the package; a module that is moved or renamed is followed here alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import modaltouch
from modaltouch.protocol import Schedule


def orders_of(protocol: Path, who: Sequence[tuple[str, int, int]]) -> list[dict[str, Any]]:
    """Return orders as start records keep them, one to each (participant, seed, session)."""
    design = modaltouch.examine(protocol).experiment.protocol
    return [Schedule.draw(design, *each).as_dict() for each in who]


def drive_of(protocol: Path) -> tuple[dict[str, NDArray[np.uint16]], list[dict[str, Any]]]:
    """Return codes and figures of the stimuli.

    Returns
    -------
    codes : dict
        What the generator is given, a row to each channel, by the name of the design.
    figures : list of dict
        As a record keeps them, one to each design and level.
    """
    preflight = modaltouch.examine(protocol).require()
    codes = {name: part.stimulus.burst.codes for name, part in preflight.designs.items()}
    return codes, preflight.stimuli
