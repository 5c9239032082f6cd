"""A fingers file, and the placements of its fingers on the beam, by whose names designs are stored."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Discriminator, Field, Tag

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.apparatus_sections import FingerSection, FingerSpread
from modaltouch.protocol.reading import Reading, read
from modaltouch.protocol.section import Interval, NotNegative, Number, Section, Text, described
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.source import InputError, Problem, Source
from modaltouch.protocol.stimulus_sections import MEASURED, NO_FINGERS
from modaltouch.protocol.trial import Condition

if TYPE_CHECKING:
    import numpy as np

    from modaltouch.stimulus import Finger


class HandSection(Section):
    """The fingers of a hand."""

    index: FingerSection | None = described("The index finger.", default=None)
    middle: FingerSection | None = described("The middle finger.", default=None)
    ring: FingerSection | None = described("The ring finger.", default=None)
    little: FingerSection | None = described("The little finger.", default=None)
    thumb: FingerSection | None = described("The thumb.", default=None)


class HandsSection(Section):
    """Fingers by hand."""

    left: HandSection = described("The left hand.", default=HandSection())
    right: HandSection = described("The right hand.", default=HandSection())


def _kind_of_fingers(value: object) -> str:
    keys = set(value) if isinstance(value, dict) else set()
    return "hands" if isinstance(value, HandsSection) or keys & {"left", "right"} else "all"


class FingerProbe(Section):
    """The probe by which fingers were measured."""

    placement: Text = described("Zones from left to right, and the fingers on them.")
    date: Text = described("When the probe was made.")
    mode: Text = described("simulated or real.")
    misfit: NotNegative = described("Mean square of the residuals of the fit, relative to that of the noise [1].")
    level_percent: Interval = described(
        "95 % interval of the level at the focus, as a share of the level asked for, without the uncertainty of the "
        "vibrometer's sensitivity, which all levels share [%]."
    )
    covariance: Annotated[tuple[tuple[Number, ...], ...], Field(max_length=100)] = described(
        "Covariance of the logarithms of mass, damping and stiffness, the offset [mm] and the logarithms of the "
        "stiffnesses in `maxwell`, finger after finger."
    )


class FingersFile(Section):
    """Fingertips on the beam."""

    description: Text = described("What these fingers represent.", default="")
    sources: tuple[Text, ...] = described("Where the numbers come from.", default=())
    fingers: Annotated[
        Annotated[FingerSection, Tag("all")] | Annotated[HandsSection, Tag("hands")], Discriminator(_kind_of_fingers)
    ] = described("One entry for all fingers, or one for each hand and finger.")
    spread: FingerSpread = described("How much fingers differ between people.", default=FingerSpread())
    placement_spread: FingerSpread = described(
        "How much one person's fingers differ from one placement to the next, on the simulated beam.",
        default=FingerSpread(),
    )
    trial_spread: FingerSpread = described(
        "How much the fingers of one placement differ from one trial to the next, on the simulated beam.",
        default=FingerSpread(),
    )
    probes: Annotated[tuple[FingerProbe, ...], Field(max_length=100)] = described(
        "The probes with which the fingers were measured, written by `modaltouch fingers probe`.", default=()
    )

    def of(self, name: str) -> FingerSection | None:
        """Return the fingertip with a name such as ``left index``; None if the file has none."""
        if isinstance(self.fingers, FingerSection):
            return self.fingers
        hand, finger = name.split()
        found: FingerSection | None = getattr(getattr(self.fingers, hand), finger)
        return found

    @classmethod
    def read(cls, name: Path | str) -> FingersFile:
        """Read fingers from a file."""
        return read(Source.find("fingers", name), cls).require()


@dataclass(frozen=True)
class Placements:
    """The fingers of a design on its beam.

    Attributes
    ----------
    file : FingersFile
        The fingers.
    protocol : Protocol
        The design.
    apparatus : Apparatus
        The beam.
    """

    file: FingersFile
    protocol: Protocol
    apparatus: Apparatus

    def all(self) -> dict[str, tuple[Finger, ...]]:
        """Return the fingers on the beam, from left to right, by placement name."""
        design, placed = self.protocol.conditions, {}
        for condition, place, zones in product(design.finger_conditions, design.placements, design.contacts):
            each = Condition.on(zones[::-1] if place.startswith("mirrored") else zones, condition, 0.0, place)
            if len(zones) != len(design.fingers_of(each)):
                continue  # listed cells of another finger condition
            placed[self.name(each)] = tuple(
                section.at(self._centre(zone))
                for zone, finger in self._laid(each)
                if (section := self.file.of(finger)) is not None
            )
        return placed

    def name(self, condition: Condition) -> str:
        """Return the placement name of a condition: its zones from left to right, such as ``A-C``.

        The fingers are appended if each has separate values and they are not those of the first finger condition.
        """
        laid = self._laid(condition)
        zones = "-".join(zone for zone, _ in laid)
        first = self.protocol.conditions.finger_conditions[0]
        usual = self._laid(Condition.on(condition.zones[:: -1 if condition.is_mirrored else 1], first, 0.0))
        if isinstance(self.file.fingers, FingerSection) or laid == usual:
            return zones
        return f"{zones} {', '.join(name for _, name in laid)}"

    def drawn(self, rng: np.random.Generator) -> FingerSection | None:
        """Draw the fingertip of a person around the file's index finger; None if the file has none."""
        usual = self.file.of(f"{self.protocol.conditions.hand} index")
        return None if usual is None else self.file.spread.drawn(usual, rng)

    def expected(
        self, finger_condition: str, zones: tuple[str, ...], placement: str = "normal"
    ) -> dict[str, tuple[str, Finger]]:
        """Return zone and values of each finger of a finger condition, by name, from the left end of the beam."""
        return {
            name: (zone, section.at(self._centre(zone)))
            for zone, name in self._laid(Condition.on(zones, finger_condition, 0.0, placement))
            if (section := self.file.of(name)) is not None
        }

    def measured(self, fingers: Mapping[str, Mapping[str, Any]]) -> dict[str, Finger]:
        """Return fingers by zone, from the keys of each in a file, including ``zone``."""
        found = {}
        for values in fingers.values():
            own = FingerSection.model_validate({key: value for key, value in values.items() if key != "zone"})
            found[values["zone"]] = own.at(self._centre(values["zone"]))
        return found

    def _centre(self, zone: str) -> float:
        return self.apparatus.zones[zone].centre_mm * 1e-3

    def _laid(self, condition: Condition) -> list[tuple[str, str]]:
        """Return zones and fingers on them, from the left end of the beam."""
        # Not strict, because `name` compares with the first finger condition, which may have fewer or more fingers.
        laid = zip(condition.zones, self.protocol.conditions.fingers_of(condition), strict=False)
        return sorted(laid, key=lambda each: self.apparatus.zones[each[0]].centre_mm)


def load_fingers(protocol: Reading[Protocol], problems: list[Problem]) -> Reading[FingersFile] | None:
    """Return the fingers that the protocol names; add their problems to `problems`."""
    name = protocol.sound("stimulus", "fingers")
    # Typical fingers are assumed until they are measured.
    name = "typical" if name == MEASURED else name
    beside = protocol.source.path.parent / name
    own = beside.is_file()
    try:
        source = Source.load(beside) if own else Source.shipped_text("fingers", name)
    except InputError as error:
        found = error.problems[0]
        problems.append(
            found
            if own
            else protocol.problem(
                ("stimulus", "fingers"),
                f"{name!r}, {found.given} ({beside})",
                f"{NO_FINGERS}, {MEASURED}, {found.allowed}",
                found.remedy,
            )
        )
        return None
    reading, faults = read_fingers(source, protocol)
    problems += faults
    return reading


def check_measured(protocol: Reading[Protocol], apparatus: Reading[Apparatus] | None) -> Iterator[Problem]:
    """Yield the reasons why fingers cannot be measured, if the protocol requires measured fingers."""
    path = "stimulus", "fingers"
    if protocol.sound(*path) != MEASURED or apparatus is None or apparatus.value is None:
        return
    typical = "write `fingers: typical`, with which a level is right on average and wrong by a fifth for one person"
    if apparatus.find(("acquisition",)) is None:
        yield protocol.problem(
            path,
            "measured, but the apparatus has no section acquisition",
            "none, typical, a file, or an apparatus with that section",
            typical,
        )
    try:
        apparatus.value.modal_model().require_all_modes()
    except ValueError as error:
        given, _, needed = str(error).partition("; allowed: ")
        allowed, _, remedy = needed.partition("; ")
        yield protocol.problem(path, f"measured, but {given}", allowed, f"{remedy}; or {typical}")


def read_fingers(source: Source, protocol: Reading[Protocol] | None) -> tuple[Reading[FingersFile], list[Problem]]:
    """Return fingers and their problems, including missing fingers of the design."""
    reading = read(source, FingersFile)
    file, design = reading.value, None if protocol is None else protocol.value
    lacking = [] if file is None or design is None else [n for n in design.conditions.fingers_used if not file.of(n)]
    return reading, [
        *reading.problems,
        *(
            reading.problem(("fingers",), f"no {name} finger", "every finger that touches the beam", f"add the {name}")
            for name in lacking
        ),
    ]
