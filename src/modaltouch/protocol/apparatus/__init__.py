"""YAML -> Apparatus: the beam, its zones and modes, the actuator sets, amplifier and generator."""

from __future__ import annotations

from pathlib import Path

from modaltouch.protocol.apparatus.checks import check_apparatus, zone_edges
from modaltouch.protocol.apparatus.intervals import Identified, Intervals, Provenance
from modaltouch.protocol.apparatus.offered import offered_gains
from modaltouch.protocol.apparatus.sections import (
    AcquisitionSection,
    ActuatorSet,
    AmplifierSection,
    Apparatus,
    Beam,
    GeneratorSection,
    Mode,
    Safety,
    Sound,
    Zone,
)
from modaltouch.protocol.apparatus.twin import (
    Fingers,
    ScopeSection,
    TrueAmplifier,
    TwinSection,
    UnlistedMode,
    Vibrometer,
)
from modaltouch.protocol.document import InputError, Problem, Reading, Source, find, load_source, read
from modaltouch.protocol.document.section import Number, Positive, Section

__all__ = [
    "AcquisitionSection",
    "ActuatorSet",
    "AmplifierSection",
    "Apparatus",
    "Beam",
    "Fingers",
    "GeneratorSection",
    "Identified",
    "Intervals",
    "Mode",
    "Number",
    "Positive",
    "Provenance",
    "Safety",
    "ScopeSection",
    "Section",
    "Sound",
    "TrueAmplifier",
    "TwinSection",
    "UnlistedMode",
    "Vibrometer",
    "Zone",
    "check_apparatus",
    "examine_apparatus",
    "read_apparatus",
    "zone_edges",
    "offered_gains",
]


def read_apparatus(path: Path | str) -> Apparatus:
    """Return the apparatus that a YAML file describes.

    Parameters
    ----------
    path : path
        The file, or the name of a shipped apparatus.

    Raises
    ------
    InputError
        With every fault of the file.
    """
    reading, problems = examine_apparatus(load_source(find("apparatus", path)))
    if problems or reading.value is None:
        raise InputError(problems)
    return reading.value


def examine_apparatus(source: Source) -> tuple[Reading[Apparatus], list[Problem]]:
    """Return what the text of an apparatus file holds, as far as it is sound, and its faults."""
    reading = read(source, Apparatus)
    return reading, [*reading.problems, *check_apparatus(reading)]
