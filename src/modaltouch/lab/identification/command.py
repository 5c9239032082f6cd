"""The command ``modaltouch identify``: a table of modes from a bare beam or from files of measured responses."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.lab.identification.excitation import (
    CLOCK_TOLERANCE,
    LOWEST,
    Excitation,
    IdentificationPlan,
    evenly,
    excite,
    highest_needed,
)
from modaltouch.lab.identification.files import read_responses
from modaltouch.lab.identification.joint_fit import axis_error, identify_each, over_repeats
from modaltouch.lab.identification.joint_fit import identify as fit_jointly
from modaltouch.lab.identification.modal_parameters import Identification, IdentifiedMode
from modaltouch.lab.identification.report import (
    COMMAND,
    check_export,
    identified_apparatus,
    write_identification,
)
from modaltouch.lab.identification.responses import (
    FrequencyResponses,
    ResponseFormat,
    along,
    responses_of,
)
from modaltouch.lab.identification.shapes import check_points
from modaltouch.lab.identification.verdict import check_all, check_modes, mirrored_scan
from modaltouch.lab.laboratory import SILENT_PROGRESS, SIMULATED, MeasurementProgress, open_laboratory
from modaltouch.lab.scan import Scan, kept_rows, read_scan, rows_over
from modaltouch.protocol import Apparatus, Source
from modaltouch.report import refuse_other

FEWEST_SHAPE_POINTS = 6
"""Minimum number of points in a file for identifying its modes by their shapes."""

BY_FORCE = (
    "the excitation is a force, so there are no gains per volt, and no apparatus file: measure the responses to the "
    "voltage of each actuator set"
)
"""Mark of responses to a hammer or shaker."""


@dataclass(frozen=True)
class IdentifyOptions:
    """Options of an identification, and of its measurement or files.

    Attributes
    ----------
    apparatus : Path
        The apparatus file whose table is replaced, or the name of a shipped one.
    files : tuple of Path
        Files of measured responses, or folders of earlier scans; empty to measure on a rig.
    rig : str
        ``simulated``, or the generator's VISA address.
    out : Path
        Folder for scans, apparatus file, table and figures.
    points, averages : int
        Evenly spaced points of the scan, and records at each.
    voltage : float
        Peak of the excitation at the beam [V].
    excitation : str
        ``multisine`` or ``chirp``.
    highest : float or None
        Upper end of the band of a measurement [Hz]; it follows from the highest mode of the table if not given.
    margin : float
        Distance from the ends of the beam to the outermost points [m].
    sets : tuple of str
        Actuator sets; all those of the apparatus if empty.
    modes : str
        Modes of the new table: ``listed`` in the apparatus file, ``all``, or labels such as ``1,3,5``.
    form : ResponseFormat
        How to read the files, and what they do not state.
    seed : int or None
        Seed of the simulated rig, in place of the one in the apparatus file.
    export : Path or None
        File to which the responses and shapes are written for other programs.
    leave_out : tuple of float
        Positions of responses to be left out [m].
    rows : int
        Number of rows of points to measure across the width, odd; torsion requires three or more. Earlier scans are
        read with all their rows.
    """

    apparatus: Path
    files: tuple[Path, ...] = ()
    rig: str = SIMULATED
    out: Path = Path("identification")
    points: int = 41
    averages: int = 4
    voltage: float = 50.0
    excitation: Excitation = "multisine"
    highest: float | None = None
    margin: float = 0.5e-3
    sets: tuple[str, ...] = ()
    modes: str = "listed"
    form: ResponseFormat = ResponseFormat()
    seed: int | None = None
    export: Path | None = None
    leave_out: tuple[float, ...] = ()
    rows: int = 1


def identify(options: IdentifyOptions, progress: MeasurementProgress = SILENT_PROGRESS) -> dict[str, Any]:
    """Identify the modes of a beam from a new or earlier scan, or from files of measured responses.

    Parameters
    ----------
    options : IdentifyOptions
        Options of the identification, and of its measurement or files.
    progress : MeasurementProgress, optional
        Reports progress and lets the user interrupt.

    Returns
    -------
    dict
        The result as plain values, with the path of each file written.

    Raises
    ------
    ValueError
        If an option, a file or the apparatus is faulty, or a requested mode was not found.
    RecordError
        If a folder holds something else or cannot be written.
    RigError
        If the rig fails.
    """
    if options.export is not None:
        check_export(options.export)
    refuse_other(options.out, COMMAND)
    folders = options.files if all(path.is_dir() for path in options.files) else ()
    if options.files and not folders:
        responses = read_responses(options.files, options.form).between(*options.form.band)
        if responses.positions is None or responses.n_points < FEWEST_SHAPE_POINTS:
            progress.show("fitting", 0, 1)
            found = over_repeats(identify_each(responses))
            progress.show("fitting", 1, 1)
            check_all(found)
            sources = [path.name for path in options.files]
            return write_identification(found, options.out, "file", sources, export_to=options.export)
        beam = _Beam(options)
        facts = {
            "date": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "mode": "file",
            "source": ", ".join(path.name for path in options.files),
            "method": "responses of a file, joint fit of all of them",
        }
        return beam.fit(beam.chosen(responses), facts, progress)
    beam = _Beam(options)
    measured = [beam.read(folder) for folder in folders] or [beam.measure(progress)]
    first = next(iter(measured[0][0].values())).facts
    facts = {
        "date": first["begun"],
        "mode": first["mode"],
        "source": ", ".join(folder.as_posix() for folder in folders or (options.out,)),
        "generator": first["settings"]["generator"],
        "scope": first["settings"]["scope"],
        "method": f"{first['settings']['about']['stimulus']}, H1 by the measured drive, joint fit of all responses",
    }
    responses = FrequencyResponses.of_repeats(
        [FrequencyResponses.of_rows([responses_of(scans, beam.bandwidth) for scans in rows]) for rows in measured]
    )
    return beam.fit(responses.between(1.5 * LOWEST, float(responses.frequency[-1])), facts, progress)


class _Beam:
    """The beam of an apparatus file and the modes to identify, checked before any instrument is opened."""

    def __init__(self, options: IdentifyOptions) -> None:
        self.options = options
        self.source = Source.find("apparatus", options.apparatus)
        self.apparatus = Apparatus.read(self.source.path)
        known = tuple(self.apparatus.actuator_sets)
        self.sets = options.sets or known
        strange = next((name for name in self.sets if name not in known), None)
        if strange is not None:
            raise ValueError(
                f"'{strange}' is not an actuator set of {options.apparatus}: give one of {', '.join(known)}"
            )
        self.labels = self._labels()
        self.length = self.apparatus.beam.length_mm * 1e-3
        corner = self.apparatus.acquisition.vibrometer_bandwidth_kHz
        self.bandwidth = None if corner is None else corner * 1e3

    def _labels(self) -> tuple[int, ...]:
        """Return the labels of the required modes; for ``all``, those of the table."""
        modes = self.options.modes
        if modes in ("listed", "all"):
            return tuple(mode.label for mode in self.apparatus.modes)
        try:
            labels = tuple(sorted({int(word) for word in modes.split(",")}))
        except ValueError:
            labels = ()
        if not labels or labels[0] < 1:
            raise ValueError(f"--modes is '{modes}': give `listed`, `all`, or labels from 1 on, such as 1,3,5")
        return labels

    def measure(self, progress: MeasurementProgress) -> list[dict[str, Scan]]:
        """Take or resume the scans of each row."""
        options, out = self.options, self.options.out
        positions = evenly(self.length, options.points, options.margin)
        check_points(np.array(positions), self.labels, self.length)
        highest = highest_needed(self.apparatus) if options.highest is None else options.highest
        campaign = IdentificationPlan(
            positions, options.averages, options.voltage, highest, self.sets, options.excitation
        )
        rows = rows_over(self.apparatus, options.rows)
        for name in self.sets:
            excite(self.apparatus, name, options.voltage, highest, "chirp")
        with (
            progress.interruptible() as heard,
            open_laboratory(
                self.apparatus, options.rig, heard, seed=options.seed, repetition="continuous"
            ) as laboratory,
        ):
            return [replace(campaign, across=across).scan(laboratory, self.source, out) for across in rows]

    def read(self, folder: Path) -> list[dict[str, Scan]]:
        """Read the scans of each row from a folder."""
        for name in self.sets:
            if not (folder / f"scan_{name}").is_dir():
                raise ValueError(
                    f"{folder}: there is no scan of the actuator set {name} (scan_{name} is missing); measure it, or "
                    "name the sets that were measured with --set"
                )
        rows = kept_rows(folder, f"scan_{self.sets[0]}")
        return [{name: read_scan(folder / f"scan_{name}{row}") for name in self.sets} for row in rows]

    def chosen(self, responses: FrequencyResponses) -> FrequencyResponses:
        """Select a file's responses to the requested actuator sets; those to a force have none."""
        sets = responses.sets if responses.per == "N" else self.sets
        missing = [name for name in sets if name not in responses.sets]
        if missing:
            raise ValueError(
                f"the files contain responses to {', '.join(responses.sets)}, but none to the actuator set "
                f"{missing[0]}: give the sets in the files the names of the apparatus file, or name the sets that "
                "were measured with --set"
            )
        rows = [responses.sets.index(name) for name in sets]
        return replace(
            responses,
            response=responses.response[rows],
            coherence=None if responses.coherence is None else responses.coherence[rows],
            sets=sets,
            bandwidth=self.bandwidth,
            per=responses.per or "V",
            repeats=tuple(self.chosen(replace(each, per=responses.per)) for each in responses.repeats),
        )

    def fit(
        self, responses: FrequencyResponses, facts: dict[str, Any], progress: MeasurementProgress
    ) -> dict[str, Any]:
        """Identify the modes, and write the results with the apparatus file with the new table."""
        if self.options.leave_out:
            responses = responses.without(self.options.leave_out)
        if responses.places:
            across, width = float(np.abs(responses.across).max()) * 1e3, self.apparatus.beam.width_mm
            if across > width:
                raise ValueError(
                    f"a point lies {across:.4g} mm from the mid-line, but the beam is {width:g} mm wide: check the "
                    "unit and the order of the coordinates along and across it"
                )
            check_points(along(responses.places)[0], self.labels, self.length)
        progress.show("fitting", 0, 1)
        found = over_repeats(fit_jointly(responses, self.length, clock_tolerance=CLOCK_TOLERANCE))
        progress.show("fitting", 1, 1)
        axis, by_force = axis_error(found), responses.per == "N"
        marks = (*responses.marks, *([axis] if axis else []))
        found = replace(found, responses=replace(found.responses, marks=marks))
        check_modes(found, self.labels)
        if by_force:
            modes = tuple(replace(mode, gain=(), half_power_gain=math.nan) for mode in found.modes)
            found = replace(found, modes=modes)
        off_listed = check_gains(found, self.apparatus, self.labels)
        marks = (*marks, *off_listed, *([BY_FORCE] if by_force else []))
        found = replace(found, responses=replace(found.responses, marks=marks))
        uncertainty = self.apparatus.acquisition.sensitivity_uncertainty_percent * 1e-2
        found = found.with_sensitivity_uncertainty(uncertainty)
        labels = tuple(found.by_label) if self.options.modes == "all" else self.labels
        apparatus = None if by_force else identified_apparatus(self.source, found, labels, facts)
        return write_identification(
            found,
            self.options.out,
            facts["mode"],
            facts["source"],
            labels=labels,
            apparatus=apparatus,
            export_to=self.options.export,
        )


FEWEST_GAINS = 3
"""Minimum number of listed gains, or natural frequencies, to recognise a common factor."""

SPREAD = 0.1
"""Relative tolerance of a factor between units that are often confused [1]."""

FACTORS = {
    9.80665: "an acceleration in g was taken for m/s^2, or the other way round, or a 10 : 1 probe for 1 : 1",
    1e3: "a prefix, milli or kilo, was missed",
}
"""Factors between units that are often confused, and their meaning."""

POWERS = {0: "", 1: " times 2 pi f", -1: " over 2 pi f"}
"""Powers of 2 pi f by which the gains of another quantity differ, in words."""

ROUGHLY = 1.0
"""Relative tolerance of gains for a factor of a thousand [1]."""

MOST_GAINS = 0.75
"""Minimum fraction of the gains within the tolerance; labels at the end of the band may belong to other modes [1]."""

AXES = {
    2 * np.pi: "angular frequencies [rad/s] taken for frequencies [Hz]",
    1e3: "a prefix, milli or kilo, was missed",
}
"""Factors between frequency units that are often confused, and their meaning."""

MOVED, FASTER = 0.05, 2.5
"""Relative change of a natural frequency, and factor of a gain, above which a warning is given [1]."""

SCALE, EQUALLY = 1.25, 0.2
"""Factor of all gains of a set above which a warning is given, and their median relative deviation from it below which
the factor is that of a drive or a sensor, not of the beam [1]."""


def check_gains(identification: Identification, apparatus: Apparatus, labels: Sequence[int] | None = None) -> list[str]:
    """Refuse natural frequencies, or gains of one set or all, that differ from the listed ones by a factor of units.

    Other large differences from the listed values may be real and are returned as warnings, a sentence each.

    Parameters
    ----------
    identification, apparatus
        The modes found, and the table of the same beam; fewer than three values in common are not checked.
    labels : sequence of int, optional
        Modes to warn about; all if not given.

    Raises
    ------
    ValueError
        If such a factor is found; the message states it and the units that were probably confused.
    """
    found, sets = identification.by_label, identification.responses.sets
    listed = {
        (name, mode.label): (own.gain[sets.index(name)].value * 1e3 / value, own.natural_frequency.value)
        for mode in apparatus.modes
        for own in [found.get(mode.label)]
        for name, value in mode.gain_mm_s2_per_V.items()
        if own is not None and own.gain and name in sets and value
    }
    ratios = {
        mode.label: found[mode.label].natural_frequency.value / mode.natural_frequency_Hz
        for mode in apparatus.modes
        if mode.label in found
    }
    _refuse_factor("the natural frequencies", [(each, 1.0) for each in ratios.values()], AXES, {0: ""}, apparatus)
    _refuse_exchanged(found, sets, apparatus)
    for chosen in dict.fromkeys((sets, *((name,) for name in sets))):
        of_chosen = [each for (name, _), each in listed.items() if name in chosen]
        _refuse_factor(f"the gains of {' and '.join(chosen)}", of_chosen, FACTORS, POWERS, apparatus)
    if len(ratios) < FEWEST_GAINS:
        return []
    if mirrored := mirrored_scan({key: each for key, (each, _) in listed.items()}, str(apparatus.apparatus)):
        return [mirrored]
    shown = ratios if labels is None else labels
    moved = {f"mode {label}": each for label, each in ratios.items() if label in shown and abs(each - 1) > MOVED}
    other: dict[str, float] = {}
    for name in sets:
        own = {label: each for (by, label), (each, _) in listed.items() if by == name}
        common = float(np.median([*own.values()])) if len(own) >= FEWEST_GAINS else 1.0
        if not 1 / SCALE < common < SCALE and np.median(np.abs(np.array([*own.values()]) / common - 1)) < EQUALLY:
            other[f"every mode by {name}"] = common
            continue
        far = {label: each for label, each in own.items() if label in shown and not 1 / FASTER < each < FASTER}
        other |= {f"mode {label} by {name}": each for label, each in far.items()}
    return [
        f"{what}, times those listed: {', '.join(f'{each:.3g} for {name}' for name, each in far.items())}; check "
        f"{remedy}, or give the file of this beam with --apparatus"
        for what, far, remedy in (
            ("natural frequencies", moved, "the sampling rate and the frequency axis"),
            ("gains", other, "units, settings, signs and wiring of drive and sensor, and which set is which"),
        )
        if far
    ]


def _refuse_exchanged(found: Mapping[int, IdentifiedMode], sets: Sequence[str], apparatus: Apparatus) -> None:
    """Refuse gains of the sets that are the listed ones of other sets."""
    factor, off = np.full((2, len(sets), len(sets)), np.nan)
    for (row, _), (column, other) in itertools.product(enumerate(sets), enumerate(sets)):
        known = [
            (found[mode.label], mode.gain_mm_s2_per_V.get(other)) for mode in apparatus.modes if mode.label in found
        ]
        ratio = [own.gain[row].value * 1e3 / value for own, value in known if own.gain and value]
        if len(ratio) >= FEWEST_GAINS:
            size = np.log(np.abs(ratio))
            factor[row, column], off[row, column] = np.median(size), np.median(np.abs(size))
    # Sets that move each other's modes by a tenth seem exchanged if all gains are tenfold, as by a wrong unit.
    if len(sets) < 2 or np.isnan(off).any() or (np.diag(factor) > np.log(SCALE)).all():
        return
    nearest, correct = off.argmin(axis=1), np.arange(len(sets))
    if (nearest != correct).all() and (off[correct, nearest] < np.log(SCALE)).all():
        pairs = " and ".join(f"{sets[other]} under the name {name}" for name, other in zip(sets, nearest, strict=True))
        raise ValueError(f"the sets are exchanged: the files hold the gains of {pairs}; name each set after its wiring")


def _refuse_factor(
    what: str,
    listed: Sequence[tuple[float, float]],
    factors: Mapping[float, str],
    powers: Mapping[int, str],
    apparatus: Apparatus,
) -> None:
    """Refuse ratios to listed values that equal a factor between units, times a power of 2 pi f.

    Each ratio has its natural frequency.
    """
    if len(listed) < FEWEST_GAINS:
        return
    ratio, frequency = np.abs(np.array(listed)).T
    for power, quantity in powers.items():
        each = ratio / (2 * np.pi * frequency) ** power
        factor = float(np.median(each))
        meaning, spread = "", SPREAD
        if power and abs(factor - 1) < SPREAD:
            meaning = "the motion is not the quantity given with --quantity"
        for size, units in factors.items():
            # An approximately correct table suffices for a factor of a thousand.
            wide = ROUGHLY if size > 1 / SPREAD**2 and not power else SPREAD
            if abs(abs(np.log(factor)) - np.log(size)) < np.log1p(wide):
                meaning, spread = units, wide
        if meaning and (np.abs(np.log(each / factor)) < np.log1p(spread)).mean() >= MOST_GAINS:
            raise ValueError(
                f"{what} are {factor:.3g}{quantity} times those of {apparatus.apparatus}: {meaning}; check the units "
                "of the measurement, or give the file of this beam with --apparatus"
            )
