"""Calibration file: what makes the stimuli of a protocol true on one rig, as `modaltouch calibrate` measured them."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Literal

from pydantic import Field, RootModel

from modaltouch.protocol.document.section import (
    DampingRatio,
    Label,
    NotNegative,
    Number,
    Positive,
    Section,
    Text,
    Word,
    described,
)
from modaltouch.protocol.stimulus_sections import StimulusSection

Hash = Annotated[Text, Field(pattern=r"^[0-9a-f]{64}$", json_schema_extra={"x-allowed": "64 hexadecimal digits"})]


class CalibratedApparatus(Section):
    """Which apparatus file it was made with."""

    name: Text = described("Name of the apparatus.")
    sha256: Hash = described("Hash of its values: beam, sets, modes, amplifier, generator, acquisition, twin.")


class Instruments(Section):
    """Which instruments it was made with."""

    generator: Text = described("Reply of the generator to *IDN?, with its serial number.")
    scope: Text = described("Model and serial number of the scope.")
    mode: Literal["simulated", "real"] = described("Whether any of them was simulated.")


class CalibratedAmplifier(Section):
    """The way from the generator to the beam, as the measured drive tells."""

    gain_V_per_V: Positive = described("Voltage gain of the stronger channel [V/V].")  # noqa: N815
    bandwidth_kHz: Positive | None = described("Corner of its first-order pole [kHz]; null if too high to tell.")  # noqa: N815
    delay_us: NotNegative = described("Delay from generator to beam [us].")


class MeasuringChain(Section):
    """What the measurement itself adds, taken out of every figure."""

    vibrometer_delay_us: NotNegative = described("Pure delay of the vibrometer [us].")
    vibrometer_lag_us: NotNegative = described("Time constant of its low-pass [us].")
    clock_offset_ppm: Number = described("How much the scope's clock runs fast against the generator's [ppm].")


class CalibratedMode(Section):
    """A modelled mode on this rig: refined values, corrected targets, and what was reached at the reference level."""

    label: Label = described("Number of the mode.")
    natural_frequency_Hz: Positive = described("Natural frequency [Hz].")  # noqa: N815
    damping_ratio: DampingRatio = described("Damping ratio [1].")
    gain_mm_s2_per_V: dict[Word, Number] = described("Modal acceleration per volt at the beam, by actuator set.")  # noqa: N815
    wished_mm_s: Number = described("Modal velocity wished at the focusing instant [mm/s].")
    target_mm_s: Number = described("Modal velocity aimed at [mm/s].")
    target_displacement_mm_s: Number = described("Modal displacement times angular frequency aimed at [mm/s].")
    error_before_mm_s: tuple[Number, Number] = described(
        "Errors of velocity and of displacement times angular frequency before [mm/s]."
    )
    error_after_mm_s: tuple[Number, Number] = described("The same after [mm/s].")
    uncertainty_mm_s: NotNegative = described("Half width of the 95 % interval of each error, from noise [mm/s].")


class CalibratedLevel(Section):
    """A velocity level as measured at the centre of the focus zone."""

    velocity_mm_s: Positive = described("The level [mm/s].")
    amplitude_factor: Annotated[float, Field(strict=True, gt=0.5, lt=2, allow_inf_nan=False)] = described(
        "Factor of the amplitude that proportion would give [1]."
    )
    amplitude_Vpp: tuple[NotNegative, ...] = described("Amplitude of each output [V peak to peak, open circuit].")  # noqa: N815
    at_focus_mm_s: Number = described("Velocity measured at the focusing instant [mm/s].")
    uncertainty_mm_s: NotNegative = described("Half width of its 95 % interval, from noise [mm/s].")
    highest_mm_s: NotNegative = described("Highest speed over the whole burst there [mm/s].")


class IterationFigures(Section):
    """What one turn of the loop measured, at the reference level."""

    iteration: Annotated[int, Field(strict=True, ge=0)] = described("0 before the calibration.")
    worst_velocity_error_mm_s: NotNegative = described("Largest error of a modal velocity [mm/s].")
    worst_displacement_error_mm_s: NotNegative = described(
        "Largest modal displacement times angular frequency, which is wished to be 0 [mm/s]."
    )
    peak_voltage_V: NotNegative = described("Highest voltage at the beam [V].")  # noqa: N815


class Calibration(Section):
    """What every calibration file holds: who made it, with what, and what holds for the rig."""

    calibration: Literal[1] = described("Version of this form.")
    made: Text = described("When, with the offset from UTC (ISO 8601).")
    made_by: Text = described("Program, version and commit.")
    person: Text = described("Who made it.", default="")
    protocol: Text = described("Name of the protocol whose stimulus it is.")
    apparatus: CalibratedApparatus = described("Which apparatus file it was made with.")
    instruments: Instruments = described("Which instruments it was made with.")
    amplifier: CalibratedAmplifier = described("The way from the generator to the beam.")
    measuring_chain: MeasuringChain = described("What the measurement itself adds.")
    unlisted_modes_Hz: tuple[Positive, ...] = described("Modes seen that the table lacks [Hz].", default=())  # noqa: N815
    positions_mm: tuple[Number, ...] = described("Where the beam was measured [mm].")

    @property
    @abstractmethod
    def by_stimulus(self) -> dict[str, CalibratedStimulus]:
        """What holds for each stimulus, by its name; without a name where the protocol has one alone."""

    def alone(self, name: str) -> CalibrationFile | None:
        """Return the calibration of one stimulus alone; None where there is none of that name.

        Parameters
        ----------
        name : str
            The stimulus; empty for that of a protocol with a single one.
        """
        own = self.by_stimulus.get(name)
        if own is None:
            return None
        shared = {key: getattr(self, key) for key in Calibration.model_fields}
        return CalibrationFile.model_construct(**shared, **{key: getattr(own, key) for key in OWN_KEYS})


class CalibratedStimulus(Section):
    """What a calibration holds of one stimulus: its targets on this rig, and what they reached."""

    stimulus: StimulusSection = described("The stimulus section of the protocol.")
    focus_centre_mm: Number = described("Centre of the focus zone [mm].")
    reference_mm_s: Positive = described("Level of the targets [mm/s].")
    iterations: tuple[IterationFigures, ...] = described("The turns of the loop.", min_length=1)
    modes: tuple[CalibratedMode, ...] = described("The modelled modes.", min_length=1, max_length=200)
    levels: tuple[CalibratedLevel, ...] = described("The velocity levels.", min_length=1, max_length=100)

    @property
    def worst_error_mm_s(self) -> float:
        """Largest error, of a modal velocity or w eta, that was left at the reference level [mm/s]."""
        return max(abs(each) for mode in self.modes for each in mode.error_after_mm_s)


OWN_KEYS = tuple(CalibratedStimulus.model_fields)
"""Keys that each stimulus has for itself."""


class CalibrationFile(CalibratedStimulus, Calibration):
    """A calibration of one stimulus on one rig."""

    @property
    def by_stimulus(self) -> dict[str, CalibratedStimulus]:
        """The file itself, without a name."""
        return {"": self}


class CalibrationOfSeveral(Calibration):
    """A calibration of every stimulus of a protocol with several, on one rig."""

    stimuli: dict[Word, CalibratedStimulus] = described(
        "What holds for each stimulus, by the name that it has in the protocol.", min_length=1, max_length=20
    )

    @property
    def by_stimulus(self) -> dict[str, CalibratedStimulus]:
        """What holds for each stimulus, by its name."""
        return self.stimuli


class AnyCalibration(RootModel[CalibrationFile | CalibrationOfSeveral]):
    """A calibration of one stimulus, or of several."""
