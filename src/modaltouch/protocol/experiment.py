"""Experiment: a protocol with the apparatus and the texts that it names, and their sources for the record."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modaltouch.protocol.apparatus import Apparatus, examine_apparatus
from modaltouch.protocol.calibration_file import check_age, check_calibration, examine_calibration
from modaltouch.protocol.checks import check_protocol, check_settling
from modaltouch.protocol.document import InputError, Problem, Reading, Source, find, load_source, read
from modaltouch.protocol.document.source import YAML_FILE
from modaltouch.protocol.field_points import read_points
from modaltouch.protocol.fit import check_fit
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.texts import Texts, check_words

if TYPE_CHECKING:
    from modaltouch.protocol.calibration_sections import Calibration
from collections.abc import Iterator

from modaltouch.protocol.sections import whole_bursts

WHOLE = 5e-3
"""How far from a whole number of bursts a duration may be, for its rounding [1]."""

MOST_OF_PERIOD = 0.95
"""Longest burst that leaves room for the next one's jitter, as a part of the period [1]."""


def check_timing(protocol: Reading[Protocol], apparatus: Reading[Apparatus] | None) -> list[Problem]:
    """Return the durations that are no whole bursts, and the bursts that cannot be played one by one."""
    found = [*_check_durations(protocol), *_check_written_once(protocol)]
    if apparatus is not None:
        found += [*_check_period(protocol, apparatus), *_check_catch_trials(protocol, apparatus)]
    return found


def _stimuli(protocol: Reading[Protocol], key: str) -> Iterator[tuple[tuple[str, ...], float]]:
    """Yield the values of a key of the stimulus, and of those of the several stimuli that have their own."""
    value = protocol.sound("stimulus", key)
    if value is not None:
        yield ("stimulus", key), value
    for name in protocol.sound("stimuli") or ():
        own = protocol.sound("stimuli", name, key)
        if own is not None:
            yield ("stimuli", name, key), own


def _check_durations(protocol: Reading[Protocol]) -> Iterator[Problem]:
    for key in ("presentation_s", "longest_presentation_s"):
        seconds = protocol.sound("answers", key)
        if seconds is None:
            continue
        for _, rate in _stimuli(protocol, "repetition_rate_Hz"):
            n_bursts = seconds * rate
            if n_bursts > 1 - WHOLE and abs(n_bursts - round(n_bursts)) <= WHOLE:
                continue
            below, above = int(n_bursts), int(n_bursts) + 1
            nearest = " or ".join(f"{n / rate:.5g} s ({n} burst{'s' * (n > 1)})" for n in (below, above))
            if n_bursts < 1:
                nearest = f"{1 / rate:.5g} s (1 burst), or more"
            given = f"{seconds:g} s, which is {n_bursts:.4g} bursts at {rate:g} per second"
            remedy = "or give `presentation_bursts`" if key == "presentation_s" else "or leave it out"
            yield protocol.problem(("answers", key), given, f"whole bursts: {nearest}", remedy)
            break


def _check_written_once(protocol: Reading[Protocol]) -> Iterator[Problem]:
    seconds, n_bursts = (protocol.sound("answers", f"presentation_{unit}") for unit in ("s", "bursts"))
    rates = [rate for _, rate in _stimuli(protocol, "repetition_rate_Hz")]
    if seconds is None or n_bursts is None:
        return
    if any(whole_bursts(seconds, rate) != n_bursts for rate in rates):
        given = f"{n_bursts}, where presentation_s says {seconds:g} s"
        yield protocol.problem(("answers", "presentation_bursts"), given, "one of the two", "remove one of them")


def _check_period(protocol: Reading[Protocol], apparatus: Reading[Apparatus]) -> Iterator[Problem]:
    if (apparatus.sound("generator", "repetition") or "single") != "single":
        return
    shared = {key: protocol.sound("stimulus", key) for key in ("duration_ms", "repetition_rate_Hz")}
    for own in (None, *(protocol.sound("stimuli") or ())):
        section = ("stimulus",) if own is None else ("stimuli", own)
        duration, rate = (protocol.sound(*section, key) or shared[key] for key in shared)
        is_written = own is None or any(protocol.sound(*section, key) for key in shared)
        if duration is None or rate is None or not is_written or duration * rate <= MOST_OF_PERIOD * 1e3:
            continue
        if duration * rate > 1e3:
            continue  # longer than the period, which is told anyway
        given = f"{duration:g} ms at {rate:g} bursts per second"
        allowed = f"at most {MOST_OF_PERIOD * 1e3 / rate:.6g} ms, so that a burst is over before the next is triggered"
        remedy = "shorten the burst, repeat it less often, or set generator.repetition to continuous"
        key = "duration_ms" if protocol.sound(*section, "duration_ms") is not None else "repetition_rate_Hz"
        yield protocol.problem((*section, key), given, allowed, remedy)


def _check_catch_trials(protocol: Reading[Protocol], apparatus: Reading[Apparatus]) -> Iterator[Problem]:
    n_catch, repetition = protocol.sound("schedule", "catch_trials"), apparatus.sound("generator", "repetition")
    if n_catch and repetition in ("continuous", "wired"):
        given = f"{n_catch}, where the generator's repetition is {repetition}"
        allowed = "0: only bursts that are triggered by command can be kept back while the outputs are on"
        yield protocol.problem(("schedule", "catch_trials"), given, allowed, "set generator.repetition to single")


@dataclass(frozen=True)
class Sources:
    """The files of an experiment as they were read.

    Attributes
    ----------
    protocol, apparatus, texts : Source
        Path, text and hash of each.
    calibration : Source or None
        Path, text and hash of the calibration, where there is one.
    field : Source or None
        The same of the points of the wished field, where they stand in a file.
    """

    protocol: Source
    apparatus: Source
    texts: Source
    calibration: Source | None = None
    field: Source | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return path, hash and text of each file for the record."""
        named = {name: getattr(self, name) for name in ("protocol", "apparatus", "texts", "calibration", "field")}
        return {name: source.as_dict() for name, source in named.items() if source is not None}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Sources:
        """Return the sources that `as_dict` described."""
        return cls(**{name: Source(Path(each["path"]), each["text"]) for name, each in values.items()})


@dataclass(frozen=True)
class Experiment:
    """Everything that the files of a protocol say.

    Attributes
    ----------
    protocol : Protocol
        What is presented, asked and repeated.
    apparatus : Apparatus
        What it is presented with.
    texts : Texts
        What the participant reads.
    sources : Sources
        The files, for the record.
    """

    protocol: Protocol
    apparatus: Apparatus
    texts: Texts
    sources: Sources


@dataclass(frozen=True)
class Findings:
    """What the files of a protocol hold, as far as they are sound, and everything that is wrong with them.

    Attributes
    ----------
    protocol, apparatus, texts : Reading or None
        Each file; None where it cannot be opened.
    problems : tuple of Problem
        Every fault of all of them.
    calibration : Reading or None
        The calibration file, where there is one.
    field : Source or None
        The file of the wished field's points, where there is one.
    """

    protocol: Reading[Protocol] | None
    apparatus: Reading[Apparatus] | None
    texts: Reading[Texts] | None
    problems: tuple[Problem, ...]
    calibration: Reading[Calibration] | None = None
    field: Source | None = None

    def experiment(self) -> Experiment:
        """Return the experiment.

        Raises
        ------
        InputError
            With every fault of all its files.
        """
        if self.problems or not (self.protocol and self.apparatus and self.texts):
            raise InputError(self.problems)
        protocol, apparatus, texts = self.protocol.value, self.apparatus.value, self.texts.value
        if protocol is None or apparatus is None or texts is None:
            raise InputError(self.problems)
        calibration = None if self.calibration is None else self.calibration.source
        sources = Sources(self.protocol.source, self.apparatus.source, self.texts.source, calibration, self.field)
        return Experiment(protocol, apparatus, texts, sources)


def read_protocol(path: Path | str) -> Experiment:
    """Return the experiment that a protocol file describes, with the apparatus and texts that it names.

    Parameters
    ----------
    path : path
        The protocol file, or the name of a shipped protocol.

    Raises
    ------
    InputError
        With every fault of the protocol, its apparatus and its texts.
    """
    return examine_files(path).experiment()


def restore_experiment(sources: Sources) -> Experiment:
    """Return the experiment of a record from the texts kept there, whatever became of its files.

    Parameters
    ----------
    sources : Sources
        As `Sources.from_dict` reads them from the record.

    Raises
    ------
    InputError
        With every fault of the texts.
    """
    return examine_sources(sources).experiment()


def examine_sources(sources: Sources) -> Findings:
    """Return what the texts of a record hold, with every fault of them.

    Parameters
    ----------
    sources : Sources
        As `Sources.from_dict` reads them from the record.
    """
    protocol, texts = read(sources.protocol, Protocol), read(sources.texts, Texts)
    apparatus, problems = examine_apparatus(sources.apparatus)
    problems += [*protocol.problems, *check_protocol(protocol), *check_fit(protocol, apparatus)]
    problems += [*texts.problems, *check_words(protocol, texts)]
    calibration = None
    if sources.calibration is not None:
        # However old it has become since: a record keeps what it was begun with.
        calibration = examine_calibration(sources.calibration)
        problems += [*calibration.problems, *check_calibration(calibration, protocol, apparatus)]
    if sources.field is not None:
        problems += read_points(sources.field)[1]
    return Findings(protocol, apparatus, texts, tuple(problems), calibration, sources.field)


def examine_files(path: Path | str, calibration: Path | None = None, *, uncalibrated: bool = False) -> Findings:
    """Return what a protocol file and the files that it names hold, with every fault of them.

    Parameters
    ----------
    path : path
        The protocol file, or the name of a shipped protocol.
    calibration : Path, optional
        Calibration file to use instead of the one that the protocol names.
    uncalibrated : bool
        Whether no calibration is read, although the protocol names or requires one: to make one, or to plan.
    """
    try:
        source = load_source(find("protocol", path))
    except InputError as error:
        return Findings(None, None, None, error.problems)
    protocol = read(source, Protocol)
    problems = [*protocol.problems, *check_protocol(protocol), *check_settling(protocol)]
    apparatus, texts = None, None
    named = _load_named(protocol, ("apparatus",), problems)
    if named is not None:
        apparatus, found = examine_apparatus(named)
        problems += [*found, *check_fit(protocol, apparatus)]
    named = _load_named(protocol, ("texts",), problems)
    if named is not None:
        texts = read(named, Texts)
        problems += [*texts.problems, *check_words(protocol, texts)]
    problems += check_timing(protocol, apparatus)
    calibrated = None if uncalibrated else _examine_calibration(protocol, apparatus, calibration, problems)
    field = _load_named(protocol, ("stimulus", "field", "file"), problems)
    if field is not None:
        problems += read_points(field)[1]
    return Findings(protocol, apparatus, texts, tuple(sorted(set(problems))), calibrated, field)


def _examine_calibration(
    protocol: Reading[Protocol], apparatus: Reading[Apparatus] | None, path: Path | None, problems: list[Problem]
) -> Reading[Calibration] | None:
    """Return the calibration that is given, or that the protocol names; what is wrong goes to `problems`."""
    source = None
    if path is not None:
        try:
            source = load_source(path)
        except InputError as error:
            problems += error.problems
    else:
        source = _load_named(protocol, ("calibration", "file"), problems)
        if protocol.sound("calibration", "file") is None and protocol.sound("calibration", "required"):
            given = "true, and no calibration is given"
            remedy = "make one with `modaltouch calibrate` and name it under `file`, or give it with --calibration"
            problems.append(protocol.problem(("calibration", "required"), given, "a calibration", remedy))
    if source is None:
        return None
    if protocol.sound("stimulus", "field", "file") is not None:
        given = "a file, which a calibration does not hold"
        remedy = "write the points into the protocol, under `points`"
        problems.append(protocol.problem(("stimulus", "field", "file"), given, "points, with a calibration", remedy))
    reading = examine_calibration(source)
    problems += [*reading.problems, *check_calibration(reading, protocol, apparatus), *check_age(reading, protocol)]
    return reading


def _load_named(protocol: Reading[Protocol], key: tuple[str, ...], problems: list[Problem]) -> Source | None:
    """Return the text of the file that a key names; what is wrong with the name goes to `problems`."""
    name = protocol.sound(*key)
    if name is None:
        return None
    path = protocol.source.path.parent / name
    try:
        return load_source(path)
    except InputError as error:
        found = error.problems[0]
        if found.line > 1 or found.column > 1 or "UTF-8" in found.allowed:
            problems.append(found)
        else:
            wanted = YAML_FILE.replace("YAML", "CSV") if key[0] == "stimulus" else YAML_FILE
            allowed = f"{wanted}, named as seen from this file" if found.allowed == YAML_FILE else found.allowed
            given = f"{name!r}, {found.given} ({path})"
            problems.append(protocol.problem(key, given, allowed, found.remedy))
        return None
