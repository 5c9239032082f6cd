"""YAML -> Apparatus: the beam, its zones and modes, the actuator sets, amplifier and generator."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]


class Section(BaseModel):
    """A frozen part of a YAML file; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Beam(Section):
    """The bare beam."""

    length_mm: Positive
    width_mm: Positive
    thickness_mm: Positive
    theory: Literal["euler_bernoulli"] = "euler_bernoulli"


class Zone(Section):
    """A stretch of the beam that a finger may touch; origin at mid-beam, positive to the right."""

    centre_mm: Number
    width_mm: Positive


class ActuatorSet(Section):
    """Patches wired together and fed by one generator output."""

    channel: Annotated[int, Field(strict=True, ge=1, le=2)]


class Mode(Section):
    """A modelled vibration mode: one line of Table I."""

    label: Annotated[int, Field(strict=True, ge=1)]
    natural_frequency_Hz: Positive  # noqa: N815
    damping_ratio: Annotated[float, Field(strict=True, gt=0, lt=1)]
    gain_mm_s2_per_V: dict[str, Number]  # noqa: N815
    assumed: tuple[str, ...] = ()


class Amplifier(Section):
    """What stands between generator and beam."""

    gain_V_per_V: Positive  # noqa: N815
    limit_V: Positive  # noqa: N815
    bandwidth_kHz: Positive | None = None  # noqa: N815
    delay_us: Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)] = 0.0


class Safety(Section):
    """Limits that no protocol can raise."""

    velocity_limit_mm_s: Positive


class Generator(Section):
    """The arbitrary function generator."""

    model: str = "AFG3022B"
    load: Literal["high_impedance", "50_ohm"] = "high_impedance"


class Twin(Section):
    """How the simulated beam differs from the identified one."""

    seed: Annotated[int, Field(strict=True, ge=0)] = 1
    natural_frequency_mismatch: Annotated[float, Field(strict=True, ge=0, lt=0.1)] = 0.0
    damping_ratio_mismatch: Annotated[float, Field(strict=True, ge=0, lt=0.5)] = 0.0
    gain_mismatch: Annotated[float, Field(strict=True, ge=0, lt=0.5)] = 0.0
    cross_gain: Annotated[float, Field(strict=True, ge=-1, le=1)] = 0.0


class Apparatus(Section):
    """Everything a lab has on its table."""

    apparatus: str
    description: str = ""
    beam: Beam
    zones: dict[str, Zone]
    actuator_sets: dict[str, ActuatorSet]
    modes: tuple[Mode, ...]
    amplifier: Amplifier
    safety: Safety
    generator: Generator = Generator()
    twin: Twin = Twin()
