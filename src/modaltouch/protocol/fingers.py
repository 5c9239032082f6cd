"""The keys of a fingers file: the mechanical load of each fingertip on the beam."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Discriminator, Field, Tag

from modaltouch.protocol.reading import read
from modaltouch.protocol.section import Interval, NotNegative, Number, Positive, Section, Spread, Text, described
from modaltouch.protocol.source import Source

if TYPE_CHECKING:
    from modaltouch.stimulus import Finger


class MaxwellSection(Section):
    """A Maxwell element: a spring in series with a damper."""

    stiffness_N_per_mm: Positive = described("Stiffness before it relaxes [N/mm].")  # noqa: N815
    relaxation_ms: Positive = described("Relaxation time [ms].")


class SecondMassSection(Section):
    """A mass behind a spring, such as the finger behind its pulp."""

    mass_g: Positive = described("The mass [g].")
    stiffness_N_per_mm: Positive = described("Stiffness of the spring [N/mm].")  # noqa: N815
    damping_N_s_per_m: NotNegative = described("Damping between the mass and a point at rest [N s/m].", default=0.0)  # noqa: N815

    @property
    def values(self) -> tuple[float, float, float]:
        """Mass [kg], stiffness [N/m] and damping [N s/m]."""
        return self.mass_g * 1e-3, self.stiffness_N_per_mm * 1e3, self.damping_N_s_per_m


class FingerSection(Section):
    """Mechanical load of a fingertip on the beam."""

    mass_g: NotNegative = described("Mass that moves with the beam [g].")
    damping_N_s_per_m: NotNegative = described("Viscous damping [N s/m].")  # noqa: N815
    stiffness_N_per_mm: NotNegative = described("Stiffness [N/mm].", default=0.0)  # noqa: N815
    contact_width_mm: Positive = described("Width of the contact along the beam [mm].", default=10.0)
    maxwell: Annotated[tuple[MaxwellSection, ...], Field(max_length=8)] = described(
        "Springs in series with dampers, in addition to the rest.", default=()
    )
    second_mass: SecondMassSection | None = described("A second mass behind a spring; null for none.", default=None)
    offset_mm: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-10, le=10)] = described(
        "Distance from the centre of the zone that it rests on, positive as the zones' positions are [mm].", default=0.0
    )

    def at(self, centre: float) -> Finger:
        """Return the finger in SI units on a zone centred at `centre` [m]."""
        from modaltouch.stimulus import Finger

        return Finger(
            centre + self.offset_mm * 1e-3,
            mass=self.mass_g * 1e-3,
            damping=self.damping_N_s_per_m,
            stiffness=self.stiffness_N_per_mm * 1e3,
            width=self.contact_width_mm * 1e-3,
            maxwell=tuple((each.stiffness_N_per_mm * 1e3, each.relaxation_ms * 1e-3) for each in self.maxwell),
            second_mass=None if self.second_mass is None else self.second_mass.values,
        )


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


class FingerSpread(Section):
    """Variability of fingertips: standard deviations of logarithms, and of the position."""

    mass: Spread = described("Spread of the mass.", default=0.0)
    damping: Spread = described("Spread of the damping.", default=0.0)
    stiffness: Spread = described("Spread of the stiffness.", default=0.0)
    offset_mm: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=5)] = described(
        "Spread of the position along the beam [mm].", default=0.0
    )

    def drawn(self, typical: FingerSection, rng: np.random.Generator) -> FingerSection:
        """Draw the fingertip of a person, a placement or a trial around a typical one."""
        mass, damping, stiffness = np.exp(rng.standard_normal(3) * (self.mass, self.damping, self.stiffness)).tolist()
        values = {
            "mass_g": typical.mass_g * mass,
            "damping_N_s_per_m": typical.damping_N_s_per_m * damping,
            "stiffness_N_per_mm": typical.stiffness_N_per_mm * stiffness,
        }
        if self.offset_mm:
            values["offset_mm"] = typical.offset_mm + self.offset_mm * float(rng.standard_normal())
        return typical.model_copy(update=values)


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
