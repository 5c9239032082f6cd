"""Calibration file: corrections for a rig to produce a protocol's stimuli, and checks that the file applies to them."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import Field, RootModel

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.reading import Reading, read
from modaltouch.protocol.section import (
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
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.source import Problem, Source
from modaltouch.protocol.stimulus_sections import StimulusSection, presented_levels

Hash = Annotated[Text, Field(pattern=r"^[0-9a-f]{64}$", json_schema_extra={"x-allowed": "64 hexadecimal digits"})]


class CalibratedApparatus(Section):
    """The apparatus file used."""

    name: Text = described("Name of the apparatus.")
    sha256: Hash = described(
        "Hash of the apparatus values: beam, sets, modes, amplifier, generator, acquisition, twin."
    )


class Instruments(Section):
    """The instruments used."""

    generator: Text = described("Reply of the generator to *IDN?, with its serial number.")
    scope: Text = described("Model and serial number of the scope.")
    mode: Literal["simulated", "real"] = described("Whether any instrument was simulated.")


class CalibratedAmplifier(Section):
    """The path from the generator to the beam, identified from the measured drive."""

    gain_V_per_V: Positive = described("Voltage gain of the stronger channel [V/V].")  # noqa: N815
    bandwidth_kHz: Positive | None = described("Corner of its first-order pole [kHz]; null if too high to measure.")  # noqa: N815
    delay_us: NotNegative = described("Delay from generator to beam [us].")


class MeasuringChain(Section):
    """Effects of the measuring chain, removed from every result."""

    vibrometer_delay_us: NotNegative = described("Pure delay of the vibrometer [us].")
    vibrometer_lag_us: NotNegative = described("Time constant of its low-pass [us].")
    clock_offset_ppm: Number = described("How much faster the scope's clock runs than the generator's [ppm].")


class CalibratedMode(Section):
    """A modelled mode on this rig: refined values, corrected targets, and the result at the reference level."""

    label: Label = described("Number of the mode.")
    natural_frequency_Hz: Positive = described("Natural frequency [Hz].")  # noqa: N815
    damping_ratio: DampingRatio = described("Damping ratio [1].")
    gain_mm_s2_per_V: dict[Word, Number] = described("Modal acceleration per volt at the beam, by actuator set.")  # noqa: N815
    wished_mm_s: Number = described("Desired modal velocity at the focusing instant [mm/s].")
    target_mm_s: Number = described("Modal velocity aimed at [mm/s].")
    target_displacement_mm_s: Number = described("Modal displacement times angular frequency aimed at [mm/s].")
    error_before_mm_s: tuple[Number, Number] = described(
        "Errors of velocity and of displacement times angular frequency before the calibration [mm/s]."
    )
    error_after_mm_s: tuple[Number, Number] = described("The same errors after the calibration [mm/s].")
    uncertainty_mm_s: NotNegative = described(
        "Half width of the 95 % interval of each error: noise, disagreement of the points, vibrometer and its "
        "sensitivity, trigger [mm/s]."
    )


class CalibratedLevel(Section):
    """A velocity level as measured at the centre of the focus zone."""

    velocity_mm_s: Positive = described("The level [mm/s].")
    amplitude_factor: Annotated[float, Field(strict=True, gt=0.5, lt=2, allow_inf_nan=False)] = described(
        "Factor relative to the amplitude that is proportional to the level [1]."
    )
    amplitude_Vpp: tuple[NotNegative, ...] = described("Amplitude of each output [V peak to peak, open circuit].")  # noqa: N815
    at_focus_mm_s: Number = described("Velocity measured at the focusing instant [mm/s].")
    uncertainty_mm_s: NotNegative = described(
        "Half width of the 95 % interval of that velocity, from noise and the vibrometer's sensitivity [mm/s]."
    )
    highest_mm_s: NotNegative = described("Highest speed there over the whole burst [mm/s].")


class MissedLimit(Section):
    """A missed limit, set by the protocol or by the calibration itself."""

    limit: Word = described(
        "velocity_mm_s, displacement_mm_s, level_percent: as in the protocol's limits; frequencies_mm_s: effect of "
        "changed natural frequencies on the focus; focus_percent: excess of the speed measured there over that "
        "predicted from the points along the beam; drive_percent: shortfall of the amplifier's peaks; "
        "reading_percent: change of all speeds alike since the modes were identified."
    )
    level_mm_s: Positive = described("Level at which it was missed [mm/s].")
    reached: NotNegative = described("The value reached, with its uncertainty, in the unit of the limit.")
    allowed: NotNegative = described("The limit.")

    def __str__(self) -> str:
        """Describe the missed limit."""
        return f"{self.limit} {self.reached:.3g} at {self.level_mm_s:g} mm/s (allowed {self.allowed:g})"


class IterationFigures(Section):
    """Result of one iteration, at the reference level."""

    iteration: Annotated[int, Field(strict=True, ge=0)] = described(
        "Number of the iteration; 0 is before the calibration."
    )
    worst_velocity_error_mm_s: NotNegative = described("Largest error of a modal velocity [mm/s].")
    worst_displacement_error_mm_s: NotNegative = described(
        "Largest modal displacement times angular frequency; the target is 0 [mm/s]."
    )
    peak_voltage_V: NotNegative = described("Highest voltage at the beam [V].")  # noqa: N815


class Calibration(Section):
    """The part common to all calibration files: author, equipment, and results for the rig as a whole."""

    calibration: Literal[1] = described("Version of this format.")
    made: Text = described("Date and time, with the offset from UTC (ISO 8601).")
    made_by: Text = described("Version and commit of the program.")
    person: Text = described("Person who made the calibration.", default="")
    protocol: Text = described("Name of the protocol that the stimulus belongs to.")
    apparatus: CalibratedApparatus = described("The apparatus file that was used.")
    instruments: Instruments = described("The instruments that were used.")
    amplifier: CalibratedAmplifier = described("The path from the generator to the beam.")
    measuring_chain: MeasuringChain = described("Effects of the measurement itself.")
    unlisted_modes_Hz: tuple[Positive, ...] = described(  # noqa: N815
        "Modes seen that are not in the table [Hz].", default=()
    )
    positions_mm: tuple[Number, ...] = described("Positions at which the beam was measured [mm].")

    @property
    @abstractmethod
    def by_stimulus(self) -> dict[str, CalibratedStimulus]:
        """Results by name of the stimulus; the name is empty if the protocol has only one."""

    @property
    def mark(self) -> str:
        """The missed limits and the reasons; empty if there are none."""
        own = [
            (f"stimulus {name}: " if name else "") + f"{', '.join(map(str, each.missed))}: {'; '.join(each.causes)}"
            for name, each in self.by_stimulus.items()
            if each.missed
        ]
        return "; ".join(own)

    def alone(self, name: str) -> CalibrationFile | None:
        """Return the calibration of a single stimulus; None for an unknown name.

        Parameters
        ----------
        name : str
            The stimulus; empty if the protocol has only one.
        """
        own = self.by_stimulus.get(name)
        if own is None:
            return None
        return CalibrationFile.model_construct(
            **{key: getattr(self, key) for key in Calibration.model_fields},
            **{key: getattr(own, key) for key in OWN_KEYS},
        )

    @staticmethod
    def of(values: Mapping[str, Any]) -> Calibration:
        """Return the calibration with given keys and values, for several stimuli if these include ``stimuli``.

        Parameters
        ----------
        values : mapping
            The keys and values of a calibration file.
        """
        return (CalibrationOfSeveral if "stimuli" in values else CalibrationFile).model_validate(values)


class CalibratedStimulus(Section):
    """The calibration of one stimulus: its targets on this rig, and the residual errors."""

    stimulus: StimulusSection = described("The stimulus section of the protocol.")
    focus_centre_mm: Number = described("Centre of the focus zone [mm].")
    reference_mm_s: Positive = described("Level of the targets [mm/s].")
    iterations: tuple[IterationFigures, ...] = described("The iterations of the loop.", min_length=1)
    modes: tuple[CalibratedMode, ...] = described("The modelled modes.", min_length=1, max_length=200)
    levels: tuple[CalibratedLevel, ...] = described("The velocity levels.", min_length=1, max_length=100)
    missed: tuple[MissedLimit, ...] = described(
        "The limits that the calibration misses; empty if it keeps them all.", default=()
    )
    causes: tuple[Text, ...] = described("Why it misses them, and the remedy.", default=())

    @property
    def worst_error_mm_s(self) -> float:
        """Largest residual error of a modal velocity or of w eta at the reference level [mm/s]."""
        return max(abs(each) for mode in self.modes for each in mode.error_after_mm_s)


OWN_KEYS = tuple(CalibratedStimulus.model_fields)
"""Keys that each stimulus has separately."""


_REFINED = {"natural_frequency_Hz", "damping_ratio", "gain_mm_s2_per_V"}
"""Keys of a mode that a calibration refines."""


class CalibrationFile(CalibratedStimulus, Calibration):
    """A calibration of one stimulus on one rig."""

    @property
    def by_stimulus(self) -> dict[str, CalibratedStimulus]:
        """The file itself, with an empty name."""
        return {"": self}

    def applied(self, apparatus: Apparatus) -> Apparatus:
        """Return an apparatus with the calibrated modes and amplifier."""
        found = {mode.label: mode.model_dump(include=_REFINED) for mode in self.modes}
        modes = tuple(mode.model_copy(update={**found[mode.label], "assumed": ()}) for mode in apparatus.modes)
        amplifier = apparatus.amplifier.model_copy(update=self.amplifier.model_dump())
        return apparatus.model_copy(update={"modes": modes, "amplifier": amplifier})


class CalibrationOfSeveral(Calibration):
    """A calibration of every stimulus of a protocol with several, on one rig."""

    stimuli: dict[Word, CalibratedStimulus] = described(
        "Results for each stimulus, by its name in the protocol.", min_length=1, max_length=20
    )

    @property
    def by_stimulus(self) -> dict[str, CalibratedStimulus]:
        """Results by name of the stimulus."""
        return self.stimuli


class AnyCalibration(RootModel[CalibrationFile | CalibrationOfSeveral]):
    """A calibration of one stimulus, or of several."""


AGAIN = "calibrate again with `modaltouch calibrate`"


def examine_calibration(source: Source) -> Reading[Calibration]:
    """Read and check a calibration file of one or several stimuli."""
    of_several = re.search(r"""^["']?stimuli["']?\s*:""", source.text, re.MULTILINE) is not None
    model: type[Calibration] = CalibrationOfSeveral if of_several else CalibrationFile
    return read(source, model)


def check_calibration(
    calibration: Reading[Calibration], protocol: Reading[Protocol], apparatus: Reading[Apparatus] | None
) -> Iterator[Problem]:
    """Yield the problems of a calibration with the valid parts of a protocol and apparatus.

    For a protocol with several stimuli, only the names and the apparatus are checked here: the part for each stimulus
    is checked with the protocol of that stimulus alone.
    """
    if calibration.value is None:
        return
    others, only = [*_check_names(calibration, calibration.value, protocol)], calibration.value.alone("")
    yield from others
    if apparatus is not None and apparatus.value is not None:
        yield from _check_apparatus(calibration, calibration.value, apparatus.value)
    if only is not None and not others:
        yield from _check_stimulus(calibration, only, protocol, apparatus)
        yield from _check_levels(only, protocol)


def check_mark(calibration: Reading[Calibration]) -> list[Problem]:
    """Return a problem for each limit that a stimulus missed, for which the calibration is marked."""
    if calibration.value is None:
        return []
    remedy = "remove the cause and calibrate again, or accept it with --with-marked-calibration"
    return [
        calibration.problem(
            (("stimuli", name) if name else ()) + ("missed",),
            f"{', '.join(map(str, own.missed))}: {'; '.join(own.causes)}",
            "a calibration within its limits",
            remedy,
        )
        for name, own in calibration.value.by_stimulus.items()
        if own.missed
    ]


def calibration_alone(reading: Reading[Calibration], name: str) -> Reading[Calibration]:
    """Return the part of a calibration file for one stimulus, in the form of a file of that stimulus alone."""
    root, own = reading.root, reading.find(("stimuli", name))
    value = None if reading.value is None else reading.value.alone(name)
    if root is not None and own is not None and isinstance(root.content, dict) and isinstance(own.content, dict):
        root = replace(root, content=root.content | own.content, keys=root.keys | own.keys)
    return Reading(reading.source, CalibrationFile, root, value)


def _check_names(
    reading: Reading[Calibration], calibration: Calibration, protocol: Reading[Protocol]
) -> Iterator[Problem]:
    """Yield a problem if a calibration does not cover the protocol's stimuli."""
    wanted, made = tuple(protocol.sound("stimuli") or ("",)), tuple(calibration.by_stimulus)
    if set(wanted) <= set(made):
        return
    given = f"a calibration of the stimuli {', '.join(made)}" if made != ("",) else "a calibration of one stimulus"
    allowed = f"one of {', '.join(wanted)}" if wanted != ("",) else "one of a single stimulus"
    yield reading.problem(("stimuli",), given, f"{allowed}, as in {protocol.source.path}", AGAIN)


def _check_apparatus(
    reading: Reading[Calibration], calibration: Calibration, apparatus: Apparatus
) -> Iterator[Problem]:
    labels = [mode.label for mode in apparatus.modes]
    only = calibration.alone("")
    modes = () if only is None else only.modes
    if apparatus.measured_hash != calibration.apparatus.sha256:
        yield reading.problem(
            ("apparatus", "sha256"),
            f"a calibration of another apparatus ({calibration.apparatus.name}, or its values have changed)",
            f"one made with {apparatus.apparatus} in its present state",
            AGAIN,
        )
    elif modes and [mode.label for mode in modes] != labels:
        yield reading.problem(
            ("modes",), f"modes {', '.join(str(mode.label) for mode in modes)}", ", ".join(map(str, labels)), AGAIN
        )
    for index, mode in enumerate(modes):
        if set(mode.gain_mm_s2_per_V) != set(apparatus.actuator_sets):
            yield reading.problem(
                ("modes", index, "gain_mm_s2_per_V"),
                f"gains by {', '.join(mode.gain_mm_s2_per_V) or 'no set'}",
                f"one by each of {', '.join(apparatus.actuator_sets)}",
                AGAIN,
            )


def _check_stimulus(
    reading: Reading[Calibration],
    calibration: CalibrationFile,
    protocol: Reading[Protocol],
    apparatus: Reading[Apparatus] | None,
) -> Iterator[Problem]:
    section = protocol.sound("stimulus")
    if section is None:
        return
    made, now = calibration.stimulus.model_dump(), section.model_dump()
    # The release follows the focusing instant and cannot affect it.
    different = [key for key in now if key != "release" and made[key] != now[key]]
    for key in different:
        yield reading.problem(
            ("stimulus", key),
            f"{_words(made[key])}, from a calibration of another stimulus",
            f"{_words(now[key])}, as in {protocol.source.path}",
            AGAIN,
        )
    if "focus" in different or apparatus is None:
        return
    centre = apparatus.sound("zones", section.focus, "centre_mm")
    if centre is not None and centre != calibration.focus_centre_mm:
        yield reading.problem(
            ("focus_centre_mm",),
            f"{calibration.focus_centre_mm:g} mm, a calibration of another stimulus",
            f"{centre:g} mm, the centre of zone {section.focus}",
            AGAIN,
        )


def _check_levels(calibration: CalibrationFile, protocol: Reading[Protocol]) -> Iterator[Problem]:
    known = {level.velocity_mm_s for level in calibration.levels}
    for path, level in presented_levels(protocol).items():
        if level not in known:
            yield protocol.problem(
                path,
                f"{level:g} mm/s, a level that was not calibrated",
                ", ".join(f"{each:g}" for each in sorted(known)) + " mm/s",
                AGAIN,
            )


def check_age(
    calibration: Reading[Calibration], protocol: Reading[Protocol], now: datetime | None = None
) -> Iterator[Problem]:
    """Yield a problem if a calibration is too old for a protocol or dated in the future.

    Parameters
    ----------
    calibration : Reading
        The calibration file.
    protocol : Reading
        The protocol file, which may give ``calibration.max_age_days``.
    now : datetime, optional
        Current time with its UTC offset.
    """
    made, path = calibration.sound("made"), ("calibration", "max_age_days")
    if made is None:
        return
    try:
        days = ((now or datetime.now(UTC)) - datetime.fromisoformat(made)).total_seconds() / 86400
    except (ValueError, TypeError):
        allowed = "a date and time with its offset from UTC, as in 2026-05-04T10:30:00+00:00"
        yield calibration.problem(("made",), f"{made!r}, which is not a valid instant", allowed, AGAIN)
        return
    if days < -1 / 24:
        given, remedy = f"{made}, which lies in the future", "set this machine's clock right"
        yield calibration.problem(("made",), given, "a time before now", remedy)
    if (limit := protocol.sound(*path)) is not None and days > limit:
        given = f"{limit:g} days, but the calibration {calibration.source.path} is {days:.1f} days old ({made})"
        yield protocol.problem(path, given, "a more recent calibration", AGAIN)


def _words(value: object) -> str:
    if isinstance(value, dict):
        return " ".join(_words(each) for each in value.values() if each is not None)
    if isinstance(value, tuple | list):
        return ", ".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
