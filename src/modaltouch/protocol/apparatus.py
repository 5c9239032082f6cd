"""Apparatus file: beam, zones, modes, actuator sets, amplifier and generator.

Numbers keep the units of their keys (mm, Hz, mm/s, V); only `modal_model` and `amplifier_values` convert them to SI.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from modaltouch.protocol.apparatus_sections import (
    ActuatorSet,
    AmplifierSection,
    Beam,
    Identified,
    Latency,
    Mode,
    Safety,
    TwinSection,
    Zone,
    check_shapes,
)
from modaltouch.protocol.reading import Reading, read, repeats
from modaltouch.protocol.section import (
    Count,
    FileName,
    NotNegative,
    Positive,
    Section,
    Text,
    Word,
    described,
)
from modaltouch.protocol.source import InputError, Problem, Source, format_path

if TYPE_CHECKING:
    from modaltouch.stimulus import Amplifier as AmplifierValues
    from modaltouch.stimulus import ModalModel


_MEASURED = ("beam", "actuator_sets", "modes", "amplifier", "generator", "acquisition", "twin")
"""Sections whose change invalidates a calibration; names, zones and limits do not."""


class GeneratorSection(Section):
    """The arbitrary function generator."""

    model: Text = described("Model, as given in the instrument's identity.", default="AFG3022B")
    load: Literal["high_impedance", "50_ohm"] = described(
        "Load on the outputs: high_impedance or 50_ohm.", default="high_impedance"
    )
    repetition: Literal["single", "timer", "continuous", "wired", "burst"] = described(
        "single: each burst is triggered by its own command, counted and timed; timer: the generator's free timer, "
        "whose bursts are neither counted nor timed; wired: a pulse source at the trigger input, which counts them; "
        "continuous: one record of burst and silence, for a generator whose burst mode cannot be used (its steps "
        "come up to half a sample early or late: 0.014 mm/s of 200 in the paper's stimulus). `burst` is the "
        "former name of timer.",
        default="single",
    )
    trigger_latency_ms: Latency | None = described(
        "Time from the command that triggers a burst to its first sample, as measured by `rig check --scope` [ms]; "
        "null if unknown, in which case no instant is claimed to better than a millisecond.",
        default=None,
    )

    @property
    def trigger_latency(self) -> tuple[float, float] | None:
        """Shortest and longest latency from a trigger to the first sample [s]; None if unknown."""
        latency = self.trigger_latency_ms
        return None if latency is None else (latency.low * 1e-3, latency.high * 1e-3)

    @property
    def repeats(self) -> Literal["single", "timer", "continuous", "wired"]:
        """Repetition mode of bursts, by its current name."""
        return "timer" if self.repetition == "burst" else self.repetition

    @property
    def load_factor(self) -> float:
        """Ratio of load voltage to open-circuit voltage, for an output of 50 ohm [1]."""
        return 1.0 if self.load == "high_impedance" else 0.5


class AcquisitionSection(Section):
    """The instruments that measure velocity and drive, with their settings."""

    sensitivity_mm_s_per_V: Positive = described(  # noqa: N815
        "Velocity per volt of the vibrometer's output [mm/s per V].", default=50.0
    )
    sensitivity_uncertainty_percent: NotNegative = described(
        "Half width of the 95 % interval of the sensitivity, from the data sheet or certificate [%]. It is part of the "
        "intervals of identified gains and of a calibration. It scales all speeds alike, so the limits of calibrations "
        "and the intervals of speeds under fingers do not include it; `fingers probe` states it beside them.",
        default=1.0,
    )
    range_mm_s: Positive = described("Highest velocity in the vibrometer's range [mm/s, peak].", default=500.0)
    vibrometer_bandwidth_kHz: Positive | None = described(  # noqa: N815
        "Corner frequency of the vibrometer's first-order low-pass, from its data sheet [kHz]; null to assume none.",
        default=None,
    )
    probe_attenuation: Positive = described("Volts at the beam per volt at the scope's inputs [V/V].", default=100.0)
    trigger_latency_us: NotNegative = described(
        "Time from the generator's first sample to the scope's, measured with the two wired directly together [us].",
        default=0.0,
    )
    trigger_latency_uncertainty_us: NotNegative = described(
        "Half width of the 95 % interval of that time, part of a calibration's uncertainty [us].", default=0.05
    )


class ScreenSection(Section):
    """The participant's screen and its distance."""

    width_mm: Positive = described("Width of the picture [mm], such as 531 for 24 inches of 16:9.")
    width_px: Count = described("Width of the picture [pixels], such as 1920.")
    height_px: Count = described("Height of the picture [pixels], such as 1080.")
    distance_mm: Positive = described("Distance from the participant's eyes to the screen [mm], such as 700.")


class Sound(Section):
    """The device that plays sound to the participant."""

    device: Text = described("Part of the sound device's name; empty for the system's own choice.", default="")
    sampling_rate_Hz: Annotated[float, Field(strict=True, ge=8000, le=192_000)] = described(  # noqa: N815
        "Samples per second [Hz].", default=48_000.0
    )
    full_scale_dB_SPL: Annotated[float, Field(strict=True, ge=0, le=200)] | None = described(  # noqa: N815
        "Sound pressure level at the ear for a sine of full scale [dB SPL]; null if not measured.", default=None
    )


class Apparatus(Section):
    """The equipment of a lab."""

    apparatus: FileName = described("Name of the apparatus.")
    description: Text = described("Description of the apparatus, in one sentence.", default="")
    beam: Beam = described("The bare beam.")
    zones: dict[Word, Zone] = described("Parts of the beam that fingers touch, by name.", min_length=1, max_length=100)
    actuator_sets: dict[Word, ActuatorSet] = described("Actuator sets, by name, each on its own output.", min_length=1)
    modes: tuple[Mode, ...] = described("Identified modes that the model contains.", min_length=1, max_length=200)
    amplifier: AmplifierSection = described("The amplifier between generator and beam.")
    safety: Safety = described("Limits that no protocol can raise.")
    generator: GeneratorSection = described("The arbitrary function generator.", default=GeneratorSection())
    acquisition: AcquisitionSection = described(
        "The instruments that measure velocity and drive.", default=AcquisitionSection()
    )
    identified: Identified | None = described("The identification that the table of modes comes from.", default=None)
    sound: Sound = described("The device that plays sound to the participant.", default=Sound())
    screen: ScreenSection | None = described("The participant's screen, used to check the size of text.", default=None)
    twin: TwinSection = described("Properties of the simulated rig that are not in the tables.", default=TwinSection())

    def modal_model(self) -> ModalModel:
        """Return the identified modal model in SI units.

        Returns
        -------
        ModalModel
            Modal gains, (n_modes, n_channels) array [m/s^2 per V at the beam], 0 where unknown; natural frequencies
            [Hz], damping ratios [1], length [m].
        """
        from modaltouch.stimulus import ModalModel

        beam, length = self.beam, self.beam.length_mm * 1e-3
        label = tuple(mode.label for mode in self.modes)
        bending, basis = None, None
        if beam.theory == "timoshenko":
            from modaltouch.stimulus import TimoshenkoBeam

            bending = TimoshenkoBeam(length, beam.thickness_mm * 1e-3, poissons_ratio=beam.poissons_ratio)
        if beam.theory == "measured" and beam.measured_shapes is not None:
            basis = beam.measured_shapes.basis(label, length)
        channel = {name: actuators.channel for name, actuators in self.actuator_sets.items()}
        gain = np.zeros((len(self.modes), max(channel.values())))
        for row, mode in enumerate(self.modes):
            for name, value in mode.gain_mm_s2_per_V.items():
                gain[row, channel[name] - 1] = value * 1e-3
        return ModalModel(
            label=label,
            natural_frequency=np.array([mode.natural_frequency_Hz for mode in self.modes]),
            damping_ratio=np.array([mode.damping_ratio for mode in self.modes]),
            modal_gain=gain,
            length=length,
            basis=basis,
            beam=bending,
            mass=beam.mass,
        )

    @property
    def to_beam(self) -> float:
        """Voltage at the beam per open-circuit voltage of the generator [V/V]."""
        return self.amplifier.gain_V_per_V * self.generator.load_factor

    def amplifier_values(self) -> AmplifierValues:
        """Return the amplifier: gain [V/V], limit [V at the beam], bandwidth [Hz] or None, delay [s]."""
        from modaltouch.stimulus import Amplifier as AmplifierValues

        amplifier = self.amplifier
        return AmplifierValues(
            gain=amplifier.gain_V_per_V,
            limit=amplifier.limit_V,
            bandwidth=None if amplifier.bandwidth_kHz is None else amplifier.bandwidth_kHz * 1e3,
            delay=amplifier.delay_us * 1e-6,
        )

    def unknown_gains(self) -> tuple[tuple[int, str], ...]:
        """Return mode label and actuator set of each unknown gain, which is taken as zero."""
        return tuple(
            (mode.label, name)
            for mode in self.modes
            for name in self.actuator_sets
            if name not in mode.gain_mm_s2_per_V
        )

    def assumed_gains(self) -> tuple[tuple[int, str], ...]:
        """Return mode label and actuator set of each assumed gain."""
        return tuple((mode.label, name) for mode in self.modes for name in mode.assumed)

    @property
    def ordered_zones(self) -> dict[str, Zone]:
        """Zones by name, from left to right."""
        return dict(sorted(self.zones.items(), key=lambda item: item[1].centre_mm))

    @property
    def zone_spans(self) -> dict[str, tuple[float, float]]:
        """Ends of each zone, from left to right, relative to mid-beam, as fractions of the beam length [1]."""
        length = self.beam.length_mm
        return {name: (zone.edges[0] / length, zone.edges[1] / length) for name, zone in self.ordered_zones.items()}

    @property
    def measured_hash(self) -> str:
        """SHA-256 of the values on which a calibration depends, without keys at their default."""
        free = {"beam": {"mass_g"}}  # does not affect any measurement on the untouched beam
        values = self.model_dump(mode="json", include=set(_MEASURED), exclude=free, exclude_defaults=True)
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()

    @classmethod
    def read(cls, given: Path | str | Source) -> Apparatus:
        """Read an apparatus from a YAML file.

        Parameters
        ----------
        given : path or Source
            The file, the name of a shipped apparatus, or a source already loaded.

        Raises
        ------
        InputError
            Lists every problem of the file.
        """
        reading, problems = examine_apparatus(given if isinstance(given, Source) else Source.find("apparatus", given))
        if problems or reading.value is None:
            raise InputError(problems)
        return reading.value


def examine_apparatus(source: Source) -> tuple[Reading[Apparatus], list[Problem]]:
    """Read and check an apparatus file; return its valid parts and its problems."""
    reading = read(source, Apparatus)
    checks = _check_zones, _check_actuator_sets, _check_modes, check_shapes
    return reading, [*reading.problems, *(problem for check in checks for problem in check(reading))]


def _check_zones(reading: Reading[Apparatus]) -> Iterator[Problem]:
    length = reading.sound("beam", "length_mm")
    zones: list[tuple[str, Zone]] = reading.items("zones")
    tolerance = 1e-9 * (length or 1.0)
    for name, zone in zones:
        left, right = zone.edges
        if length is not None and max(-left, right) > length / 2 + tolerance:
            yield reading.problem(
                ("zones", name),
                f"a zone from {left:g} to {right:g} mm",
                f"from {-length / 2:g} to {length / 2:g} mm, the ends of the {length:g} mm beam",
                "move it or make it narrower",
            )
    for (first, one), (second, other) in itertools.pairwise(sorted(zones, key=lambda item: item[1].centre_mm)):
        if other.edges[0] < one.edges[1] - tolerance:
            yield reading.problem(
                ("zones", second),
                f"a zone that begins at {other.edges[0]:g} mm, inside zone {first}",
                f"from {one.edges[1]:g} mm on, where zone {first} ends",
                "move one of them or make it narrower",
            )


def _check_actuator_sets(reading: Reading[Apparatus]) -> Iterator[Problem]:
    for name, channel, first in repeats([(name, each.channel) for name, each in reading.items("actuator_sets")]):
        yield reading.problem(
            ("actuator_sets", name, "channel"),
            f"{channel}, which already feeds the set {first}",
            "a free output of 1, 2",
            "give each set its own output",
        )


def _check_modes(reading: Reading[Apparatus]) -> Iterator[Problem]:
    """Yield repeated labels and unknown actuator sets of the modelled modes and of the twin's unlisted ones."""
    sets = reading.keys("actuator_sets")
    labels: list[tuple[tuple[str | int, ...], tuple[str, int]]] = []
    for table in (("modes",), ("twin", "unlisted_modes")):
        for mode in [(*table, index) for index in range(reading.length(*table) or 0)]:
            label, family = reading.sound(*mode, "label"), reading.sound(*mode, "family")
            labels += [] if label is None else [(mode, ("bending" if table == ("modes",) else family, label))]
            gains, named = (*mode, "gain_mm_s2_per_V"), reading.keys(*mode, "gain_mm_s2_per_V") or []
            known, intervals = named if sets is None else sets, (*mode, "intervals_95", "gain_mm_s2_per_V")
            yield from reading.unlisted(gains, "a set of actuator_sets", known, at_key=True)
            yield from reading.unlisted(intervals, "a set of actuator_sets", named, at_key=True)
            yield from reading.unlisted((*mode, "assumed"), "a set with a gain in this mode", named)
    for mode, (_, label), first in repeats(labels):
        yield reading.problem(
            (*mode, "label"),
            f"{label}, which is also the label of {format_path(first)}",
            "each label once" if mode[0] == "modes" else "each mode once",
            "remove one of them",
        )
