"""The section ``twin``: what the simulated rig has and the identified tables have not."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from modaltouch.protocol.fingers import FingerSection, FingerSpread
from modaltouch.protocol.problems import fault
from modaltouch.protocol.section import DampingRatio, Label, NotNegative, Number, Positive, Section, Word, described


class UnlistedMode(Section):
    """A mode that the beam has and the table of modes has not."""

    family: Literal["bending", "torsion"] = described(
        "Of which family: bending (rigid motions included), or torsion, which the mid-line does not show.",
        default="bending",
    )
    label: Label = described(
        "Number of the mode: for bending as in the table of modes; for torsion 1 is the first with a node at mid-beam."
    )
    natural_frequency_Hz: Positive = described("Natural frequency [Hz].")  # noqa: N815
    damping_ratio: DampingRatio = described("Damping ratio [1].")
    gain_mm_s2_per_V: dict[Word, Number] = described(  # noqa: N815
        "Modal acceleration per volt at the beam [mm/s^2 per V], by actuator set; 0 for a set that is left out."
    )


class TrueAmplifier(Section):
    """The amplifier as it is; what is null is as identified."""

    gain_V_per_V: Positive | None = described("True voltage gain [V/V].", default=None)  # noqa: N815
    limit_V: Positive | None = described("Voltage at which it saturates [V, peak].", default=None)  # noqa: N815
    bandwidth_kHz: Positive | None = described("True corner of its first-order pole [kHz].", default=None)  # noqa: N815
    delay_us: NotNegative | None = described("True delay from generator to beam [us].", default=None)


class Vibrometer(Section):
    """The vibrometer as it is."""

    bandwidth_kHz: Positive | None = described(  # noqa: N815
        "Corner of its first-order low-pass [kHz]; null for none.", default=250.0
    )
    delay_us: NotNegative = described("From the motion to its output [us].", default=4.0)
    noise_um_s_per_sqrt_Hz: NotNegative = described(  # noqa: N815
        "Density of its white noise before the low-pass [um/s per root Hz].", default=0.5
    )
    offset_mm: Number = described(
        "How far off the mid-line its spot lies [mm across the beam], where torsion shows.", default=0.2
    )
    dropouts_Hz: NotNegative = described(  # noqa: N815
        "How often its light is lost for 0.2 ms, as by a loose sensor or dark speckles [Hz].", default=0.0
    )


class ScopeSection(Section):
    """The oscilloscope as it is."""

    bits: Annotated[int, Field(strict=True, ge=4, le=24)] = described("Resolution of its converters [bits].", default=8)
    noise_steps: NotNegative = described("Noise of its inputs [steps of the converter, rms].", default=0.3)
    clock_MHz: Positive = described(  # noqa: N815
        "Highest sampling rate; every other is a whole fraction of it [MHz].", default=125.0
    )
    clock_offset_ppm: Number = described(
        "How much its clock runs fast against the generator's [parts per million].", default=5.0
    )
    memory_samples: Annotated[int, Field(strict=True, ge=2)] = described(
        "Samples of its memory, shared by its channels.", default=4_000_000
    )
    trigger_latency_us: NotNegative = described(
        "From the generator's first sample to the scope's first [us].", default=0.05
    )
    trigger_jitter_ns: NotNegative = described(
        "Standard deviation of that time from one record to the next [ns].", default=2.0
    )


class Latency(Section):
    """Bounds of the time from a trigger's command to its burst."""

    low: NotNegative = described("At least [ms].")
    high: NotNegative = described("At most [ms].")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low > self.high:
            raise fault(f"low: {self.low:g} above high: {self.high:g}", "the lower bound as low", "exchange them")
        return self


class TrueGenerator(Section):
    """The generator as it is: how long its hardware takes."""

    trigger_latency_ms: Latency = described(
        "From the command of a trigger to the first sample of its burst, anywhere between two bounds.",
        default=Latency(low=0.1, high=0.3),
    )
    relay_ms: NotNegative = described("From the command to the relay of an output, on or off [ms].", default=4.0)
    external_pulses_Hz: Positive | None = described(  # noqa: N815
        "Rate of the pulse source at the trigger input [Hz]; null with nothing wired to it.", default=None
    )


class TwinSection(Section):
    """What the simulated rig has and the identified tables have not."""

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
        "Gain of a set that does not drive a mode, relative to the one that does [1].", default=0.0
    )
    generator_gain_mismatch: Annotated[float, Field(strict=True, ge=0, lt=0.5)] = described(
        "Relative standard deviation of the generator's output voltages, one error to each output [1].", default=0.0
    )
    frequency_drift: Annotated[float, Field(strict=True, ge=-0.01, le=0.01)] = described(
        "Relative change of every natural frequency from one measurement to the next, as of a beam that warms [1].",
        default=0.0,
    )
    softening: Annotated[float, Field(strict=True, ge=-0.2, le=0.2)] = described(
        "Relative fall of every natural frequency at the amplifier's limit; with the square of a burst's peak [1].",
        default=0.0,
    )
    hysteresis: Annotated[float, Field(strict=True, ge=0, lt=1)] = described(
        "Share of the actuators' force at the amplifier's limit that lags behind the voltage [1].", default=0.0
    )
    unlisted_modes: tuple[UnlistedMode, ...] = described(
        "Modes of the beam that the table lacks.", default=(), max_length=200
    )
    beam_mass_g: Positive | None = described(
        "True moving mass of the beam, that fingers add to [g]; null for that of the section beam.", default=None
    )
    fingers: FingerSection | None = described(
        "What a finger adds to the beam where it touches; null for fingers that only feel.", default=None
    )
    finger_spread: FingerSpread = described(
        "How much fingers differ from one placement to the next, in a session that is followed.",
        default=FingerSpread(),
    )
    finger_trial_spread: FingerSpread = described(
        "How much the fingers of a placement differ from one trial to the next, in a session that is followed.",
        default=FingerSpread(),
    )
    finger_press_N: Positive | None = described(  # noqa: N815
        "Force with which each finger presses [N]; where the beam pulls harder, skin and beam part; null for fingers "
        "that never let go.",
        default=None,
    )
    amplifier: TrueAmplifier = described("The amplifier as it is.", default=TrueAmplifier())
    generator: TrueGenerator = described("The generator as it is.", default=TrueGenerator())
    vibrometer: Vibrometer = described("The vibrometer as it is.", default=Vibrometer())
    scope: ScopeSection = described("The oscilloscope as it is.", default=ScopeSection())
