"""Sections of an apparatus file: the beam, its modes and fingertips, as identified and in the simulated rig."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from modaltouch.protocol.reading import Reading
from modaltouch.protocol.section import (
    Count,
    DampingRatio,
    Interval,
    Label,
    NotNegative,
    Number,
    Positive,
    Section,
    Spread,
    Text,
    Word,
    described,
)
from modaltouch.protocol.source import Problem, fault

if TYPE_CHECKING:
    from modaltouch.stimulus import Finger, MeasuredShapes


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
        """Return the shapes in the order of given labels."""
        from modaltouch.stimulus import MeasuredShapes

        values = {mode.label: mode.values for mode in self.modes}
        shapes = np.array([values[label] for label in labels])
        return MeasuredShapes(labels, np.array(self.position_mm) * 1e-3, shapes, length)


def check_shapes(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield a problem for each inconsistency between shapes, theory and mode table, as far as they are valid."""
    theory, table = reading.sound("beam", "theory"), reading.sound("beam", "measured_shapes")
    here = ("beam", "measured_shapes")
    if theory == "measured" and reading.find(here) is None:
        yield reading.problem(
            ("beam", "theory"),
            "measured, but there are no shapes",
            "shapes of a scan",
            "add `measured_shapes`, or choose euler_bernoulli or timoshenko",
        )
    if theory in ("euler_bernoulli", "timoshenko") and reading.find(here) is not None:
        yield reading.problem(
            here,
            f"shapes of a scan, which {theory} does not use",
            "only with `theory: measured`",
            "write `theory: measured`",
            at_key=True,
        )
    if theory != "measured" or table is None:
        return
    for index, mode in enumerate(table.modes):
        if len(mode.values) != len(table.position_mm):
            yield reading.problem(
                (*here, "modes", index, "values"),
                f"{len(mode.values)} values for {len(table.position_mm)} positions",
                "one value for each position",
            )
    labels = [mode.label for _, mode in reading.items("modes")]
    shaped = [mode.label for mode in table.modes]
    for label in labels:
        if shaped.count(label) != 1:
            yield reading.problem(
                (*here, "modes"),
                f"{shaped.count(label)} shapes of mode {label}",
                "one shape for each mode of the table",
                at_key=True,
            )


class Beam(Section):
    """The bare beam."""

    length_mm: Positive = described("Length of the beam [mm].")
    width_mm: Positive = described("Width of the beam [mm].")
    thickness_mm: Positive = described("Thickness of the beam [mm].")
    mass_g: Positive | None = described(
        "Moving mass without fingers, including the patches [g]; null for a plain aluminium beam of this size.",
        default=None,
    )
    theory: Literal["euler_bernoulli", "timoshenko", "measured"] = described(
        "Source of the mode shapes: a slender uniform free-free beam, one with shear and rotary inertia, or a scan "
        "(`measured_shapes`).",
        default="euler_bernoulli",
    )
    poissons_ratio: Annotated[float, Field(strict=True, gt=-1, le=0.5)] = described(
        "Poisson's ratio, which sets the shear stiffness in the timoshenko theory [1].", default=0.33
    )
    measured_shapes: ShapeTable | None = described("Mode shapes from a scan, for `theory: measured`.", default=None)

    @property
    def mass(self) -> float:
        """Moving mass [kg]; by default that of plain aluminium, 2.7 mg/mm^3."""
        aluminium = 2.7e-6 * self.length_mm * self.width_mm * self.thickness_mm
        return aluminium if self.mass_g is None else self.mass_g * 1e-3


class Zone(Section):
    """A part of the beam that a finger may touch; origin at mid-beam, positive to the right."""

    centre_mm: Number = described("Centre of the zone [mm from mid-beam, positive to the participant's right].")
    width_mm: Positive = described("Width of the zone [mm].")

    @property
    def edges(self) -> tuple[float, float]:
        """Left and right edge [mm from mid-beam]."""
        return self.centre_mm - self.width_mm / 2, self.centre_mm + self.width_mm / 2


class ActuatorSet(Section):
    """Patches wired together and fed by one generator output."""

    channel: Annotated[int, Field(strict=True, ge=1, le=2)] = described("Generator output that feeds the set.")
    patches_mm: tuple[tuple[Number, Number], ...] = described(
        "Left and right end of each patch, for the record [mm from mid-beam].", default=()
    )


class Mode(Section):
    """A modelled vibration mode: one row of the paper's Table I."""

    label: Label = described("Number of the mode: 1 rigid translation, 2 rigid rotation, k from 3 on bending k - 2.")
    natural_frequency_Hz: Positive = described("Natural frequency [Hz].")  # noqa: N815
    damping_ratio: DampingRatio = described("Damping ratio [1].")
    gain_mm_s2_per_V: dict[Word, Number] = described(  # noqa: N815
        "Modal acceleration per volt at the beam [mm/s^2 per V], by actuator set; the gain of a set that is left out "
        "is unknown and taken as zero."
    )
    assumed: tuple[Word, ...] = described("Actuator sets whose gain is assumed, not measured.", default=())
    intervals_95: Intervals | None = described("95 % intervals, as identified.", default=None)
    provenance: Provenance | None = described("Where each number comes from.", default=None)


class AmplifierSection(Section):
    """The amplifier between generator and beam."""

    gain_V_per_V: Positive = described("Voltage gain [V at the beam per V of the generator].")  # noqa: N815
    limit_V: Positive = described("Highest voltage at the beam [V, peak]; no protocol can raise it.")  # noqa: N815
    bandwidth_kHz: Positive | None = described(  # noqa: N815
        "Corner of its first-order pole [kHz]; null where it has not been identified.", default=None
    )
    delay_us: NotNegative = described("Delay from generator to beam [us].", default=0.0)


class Safety(Section):
    """Limits that no protocol can raise."""

    velocity_limit_mm_s: Positive = described("Highest velocity anywhere in a zone [mm/s, peak].")


class UnlistedMode(Section):
    """A mode of the beam that is not in the mode table."""

    family: Literal["bending", "torsion"] = described(
        "Family of the mode: bending (including rigid motions), or torsion, which does not show on the mid-line.",
        default="bending",
    )
    label: Label = described(
        "Number of the mode: for bending, as in the table of modes; for torsion, 1 is the first with a node at "
        "mid-beam."
    )
    natural_frequency_Hz: Positive = described("Natural frequency [Hz].")  # noqa: N815
    damping_ratio: DampingRatio = described("Damping ratio [1].")
    gain_mm_s2_per_V: dict[Word, Number] = described(  # noqa: N815
        "Modal acceleration per volt at the beam [mm/s^2 per V], by actuator set; 0 for a set that is left out."
    )


class TrueAmplifier(Section):
    """The true amplifier; null for identified values."""

    gain_V_per_V: Positive | None = described("True voltage gain [V/V].", default=None)  # noqa: N815
    limit_V: Positive | None = described("Voltage at which it saturates [V, peak].", default=None)  # noqa: N815
    bandwidth_kHz: Positive | None = described("True corner of its first-order pole [kHz].", default=None)  # noqa: N815
    delay_us: NotNegative | None = described("True delay from generator to beam [us].", default=None)


class Vibrometer(Section):
    """The true vibrometer."""

    bandwidth_kHz: Positive | None = described(  # noqa: N815
        "Corner of its first-order low-pass [kHz]; null for none.", default=250.0
    )
    delay_us: NotNegative = described("Delay from the motion to the vibrometer's output [us].", default=4.0)
    noise_um_s_per_sqrt_Hz: NotNegative = described(  # noqa: N815
        "Density of its white noise before the low-pass [um/s per root Hz].", default=0.5
    )
    offset_mm: Number = described(
        "Distance of the laser spot from the mid-line [mm across the beam], where torsion shows.", default=0.2
    )
    dropouts_Hz: NotNegative = described(  # noqa: N815
        "How often the light is lost for 0.2 ms, as from a loose sensor or dark speckles [Hz].", default=0.0
    )


class ScopeSection(Section):
    """The true oscilloscope."""

    bits: Annotated[int, Field(strict=True, ge=4, le=24)] = described("Resolution of its converters [bits].", default=8)
    noise_steps: NotNegative = described("Noise of its inputs [steps of the converter, rms].", default=0.3)
    clock_MHz: Positive = described(  # noqa: N815
        "Highest sampling rate; the others are this rate divided by whole numbers [MHz].", default=125.0
    )
    clock_offset_ppm: Number = described(
        "How much faster its clock runs than the generator's [parts per million].", default=5.0
    )
    memory_samples: Annotated[int, Field(strict=True, ge=2)] = described(
        "Number of samples in its memory, shared by its channels.", default=4_000_000
    )
    trigger_latency_us: NotNegative = described(
        "Time from the generator's first sample to the scope's first [us].", default=0.05
    )
    trigger_jitter_ns: NotNegative = described(
        "Standard deviation of that time from one record to the next [ns].", default=2.0
    )


class Latency(Section):
    """Bounds of the latency from a trigger command to its burst."""

    low: NotNegative = described("Shortest [ms].")
    high: NotNegative = described("Longest [ms].")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low > self.high:
            raise fault(f"low: {self.low:g}, which is above high: {self.high:g}", "low below high", "exchange them")
        return self


class TrueGenerator(Section):
    """The true generator: latencies of its hardware, and its trigger input."""

    trigger_latency_ms: Latency = described(
        "Time from the trigger command to the first sample of its burst, anywhere between two bounds.",
        default=Latency(low=0.1, high=0.3),
    )
    relay_ms: NotNegative = described(
        "Time from the command to the switching of an output relay, on or off [ms].", default=4.0
    )
    external_pulses_Hz: Positive | None = described(  # noqa: N815
        "Rate of the pulse source at the trigger input [Hz]; null if nothing is wired to it.", default=None
    )


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
    contact_width_mm: Annotated[Positive, Field(le=40)] = described(
        "Width of the contact along the beam [mm]; that of a fingertip is about 10.", default=10.0
    )
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


class TwinSection(Section):
    """Properties of the simulated rig that are not in the identified tables."""

    seed: Annotated[int, Field(strict=True, ge=0)] = described("Seed of the differences and of all noise.", default=1)
    natural_frequency_mismatch: Annotated[float, Field(strict=True, ge=0, lt=0.1)] = described(
        "Relative standard deviation of the natural frequencies [1].", default=0.0
    )
    damping_ratio_mismatch: Annotated[float, Field(strict=True, ge=0, lt=0.5)] = described(
        "Relative standard deviation of the damping ratios [1].", default=0.0
    )
    gain_mismatch: Annotated[float, Field(strict=True, ge=0, lt=0.5)] = described(
        "Relative standard deviation of the gains [1].", default=0.0
    )
    cross_gain: Annotated[float, Field(strict=True, ge=-1, le=1)] = described(
        "Gain of a set for a mode that only the other set should drive, relative to that other set [1].", default=0.0
    )
    generator_gain_mismatch: Annotated[float, Field(strict=True, ge=0, lt=0.5)] = described(
        "Relative standard deviation of the generator's output voltages, one error per output [1].", default=0.0
    )
    frequency_drift: Annotated[float, Field(strict=True, ge=-0.01, le=0.01)] = described(
        "Relative change of every natural frequency from one measurement to the next, as in a beam that warms up [1].",
        default=0.0,
    )
    softening: Annotated[float, Field(strict=True, ge=-0.2, le=0.2)] = described(
        "Relative fall of every natural frequency at the amplifier's limit; proportional to the square of a burst's "
        "peak [1].",
        default=0.0,
    )
    hysteresis: Annotated[float, Field(strict=True, ge=0, lt=1)] = described(
        "Share of the actuators' force at the amplifier's limit that lags behind the voltage [1].", default=0.0
    )
    unlisted_modes: tuple[UnlistedMode, ...] = described(
        "Modes of the beam that are not in the table.", default=(), max_length=200
    )
    beam_mass_g: Positive | None = described(
        "True moving mass of the beam without fingers [g]; null for the value in the section beam.", default=None
    )
    fingers: FingerSection | None = described(
        "What a finger adds to the beam where it touches; null for fingers that do not load the beam.", default=None
    )
    finger_spread: FingerSpread = described(
        "How much fingers differ from one placement to the next, in a session that the simulated rig follows.",
        default=FingerSpread(),
    )
    finger_trial_spread: FingerSpread = described(
        "How much the fingers of a placement differ from one trial to the next, in a session that the simulated rig "
        "follows.",
        default=FingerSpread(),
    )
    finger_press_N: Positive | None = described(  # noqa: N815
        "Force with which each finger presses [N]; where the beam pulls harder, the skin loses contact; null for "
        "fingers that never lose contact.",
        default=None,
    )
    amplifier: TrueAmplifier = described("The true amplifier.", default=TrueAmplifier())
    generator: TrueGenerator = described("The true generator.", default=TrueGenerator())
    vibrometer: Vibrometer = described("The true vibrometer.", default=Vibrometer())
    scope: ScopeSection = described("The true oscilloscope.", default=ScopeSection())
