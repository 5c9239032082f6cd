"""A protocol with the files that it names, their sources for the record, and all problems."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modaltouch.protocol.apparatus import Apparatus, examine_apparatus
from modaltouch.protocol.checks import check_fit, check_protocol
from modaltouch.protocol.reading import Reading, read, read_tree
from modaltouch.protocol.schedule_section import LIMITS, Occasion, at_occasion, check_alike, check_groups, occasions_of
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.source import InputError, Problem, Source, Sources
from modaltouch.protocol.stimulus_sections import MEASURED, NO_FINGERS, presented_levels
from modaltouch.protocol.texts import Texts, check_labels, check_words
from modaltouch.protocol.tree import parse_tree
from modaltouch.protocol.trial import Condition

if TYPE_CHECKING:
    import numpy as np

    from modaltouch.protocol.calibration import Calibration
    from modaltouch.protocol.placements import FingersFile, Placements


@dataclass(frozen=True)
class Experiment:
    """The valid content of all files of a protocol.

    Attributes
    ----------
    protocol : Protocol
        The design: stimuli, questions and repetitions.
    apparatus : Apparatus
        The equipment.
    texts : Texts
        All text shown to the participant.
    sources : Sources
        The files, for the record.
    """

    protocol: Protocol
    apparatus: Apparatus
    texts: Texts
    sources: Sources


@dataclass(frozen=True)
class Findings:
    """The valid parts of a protocol's files, and all their problems.

    Attributes
    ----------
    protocol, apparatus, texts : Reading or None
        Each file; None if it cannot be opened.
    problems : tuple of Problem
        Problems of all files.
    calibration : Reading or None
        The calibration file, if any.
    field : Source or None
        The file of the target field's points, if any.
    fingers : Reading or None
        The fingers for which the stimulus is designed, if any.
    table : Source or None
        The table of cells, if any.
    occasion : Occasion
        The group of participants and the kind of session to which these findings apply.
    others : tuple of Findings
        Findings for the other occasions; `problems` includes theirs.
    at_samples : bool
        As in `Sources`.
    """

    protocol: Reading[Protocol] | None
    apparatus: Reading[Apparatus] | None
    texts: Reading[Texts] | None
    problems: tuple[Problem, ...]
    calibration: Reading[Calibration] | None = None
    field: Source | None = None
    fingers: Reading[FingersFile] | None = None
    table: Source | None = None
    occasion: Occasion = Occasion()
    others: tuple[Findings, ...] = ()
    at_samples: bool = False

    def experiment(self) -> Experiment:
        """Return the experiment.

        Raises
        ------
        InputError
            Lists every problem of all its files.
        """
        if self.problems or not (self.protocol and self.apparatus and self.texts):
            raise InputError(self.problems)
        protocol, apparatus, texts = self.protocol.require(), self.apparatus.require(), self.texts.require()
        files = getattr(self.calibration, "source", None), self.field, getattr(self.fingers, "source", None), self.table
        sources = Sources(self.protocol.source, self.apparatus.source, self.texts.source, *files, self.at_samples)
        return Experiment(protocol, apparatus, texts.fitted(protocol), sources)

    def problem(self, path: Iterable[str | int], given: str, allowed: str, remedy: str = "") -> Problem:
        """Return a problem at a path of an opened protocol, as `Reading.problem`.

        Raises
        ------
        ValueError
            If the protocol was not opened.
        """
        if self.protocol is None:
            raise ValueError("there is no file to search for the fault: open the protocol first")
        return self.protocol.problem(path, given, allowed, remedy)

    @property
    def levels(self) -> dict[tuple[str | int, ...], float]:
        """Valid levels in the protocol, by path [mm/s]."""
        return {} if self.protocol is None else presented_levels(self.protocol)

    def points(self) -> tuple[tuple[float, float], ...] | None:
        """Return the points of the target field, positions [mm] and relative velocities; None if invalid."""
        if self.field is None:
            return ()
        from modaltouch.protocol.cell_table import read_points

        points, faults = read_points(self.field)
        return None if faults else points

    def under(self, name: str) -> Findings:
        """Return findings with the fingers of a file, or shipped ones, in place of those that the protocol names.

        Raises
        ------
        InputError
            Lists every problem of the file.
        """
        from modaltouch.protocol.placements import read_fingers

        reading, problems = read_fingers(Source.find("fingers", name), self.protocol)
        if problems:
            raise InputError(problems)
        return replace(self, fingers=reading)

    @property
    def measured(self) -> bool:
        """Whether the fingers are measured in the session."""
        return self.protocol is not None and self.protocol.sound("stimulus", "fingers") == MEASURED

    @cached_property
    def placements(self) -> Placements | None:
        """Fingers on the beam in each condition; None for the untouched beam or if a file is invalid."""
        fingers = None if self.fingers is None else self.fingers.value
        protocol = None if self.protocol is None else self.protocol.value
        apparatus = None if self.apparatus is None else self.apparatus.value
        if fingers is None or protocol is None or apparatus is None:
            return None
        from modaltouch.protocol.placements import Placements

        return Placements(fingers, protocol, apparatus)

    def with_true_fingers(self, rng: np.random.Generator) -> Apparatus:
        """Return the apparatus with a random person's fingers, if the stimulus is for fingers and the twin has none.

        They are drawn with the spread of the file; ``twin`` may give other spreads between placements and trials.
        """
        apparatus = self.experiment().apparatus
        fingers = None if self.placements is None else self.placements.drawn(rng)
        if self.placements is None or fingers is None or apparatus.twin.fingers is not None:
            return apparatus
        file = self.placements.file
        own = {"finger_spread": file.placement_spread, "finger_trial_spread": file.trial_spread}
        own |= {name: getattr(apparatus.twin, name) for name in own.keys() & apparatus.twin.model_fields_set}
        return apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update={"fingers": fingers, **own})})

    def placement_of(self, finger_condition: str, left: str, right: str) -> str:
        """Return the placement name of a finger condition on two zones of the unturned beam; empty for none."""
        return self.placement(Condition(finger_condition, left, right, velocity_mm_s=0.0))

    def placement(self, condition: Condition) -> str:
        """Return the placement name of a condition; empty if the stimulus is for the untouched beam."""
        return "" if self.placements is None else self.placements.name(condition)

    def generator_problem(self, identity: str) -> Problem | None:
        """Return a problem if the calibration was made with a generator other than the open one, else None.

        Manufacturer, model and serial number must agree; the firmware may differ.

        Parameters
        ----------
        identity : str
            Reply of the open generator to ``*IDN?``.
        """
        made_with = None if self.calibration is None else self.calibration.sound("instruments", "generator")
        if self.calibration is None or made_with is None or _serial(made_with) == _serial(identity):
            return None
        return self.calibration.problem(
            ("instruments", "generator"),
            f"{made_with}, the generator it was made with",
            f"{identity}, the generator that is open",
            "open the one it was made with, or calibrate again with `modaltouch calibrate`",
        )

    def each_stimulus(self) -> Iterator[tuple[str, Findings]]:
        """Yield the name of each of several stimuli and the findings as if it were the only one."""
        if self.protocol is None or self.protocol.value is None or self.apparatus is None:
            return
        from modaltouch.protocol.cell_table import at_own_levels

        for name, variant in self.protocol.value.stimuli.items():
            value = self.protocol.value.with_stimulus(name)
            # Their order is drawn and checked for all stimuli together.
            eased = value.schedule.model_copy(update={"catch_trials": 0, **dict.fromkeys(LIMITS)})
            alone = at_own_levels(replace(self.protocol, value=value.model_copy(update={"schedule": eased})))
            problems = [*check_protocol(alone), *check_fit(alone, self.apparatus)]
            if variant.field is not None and variant.field.file is not None:
                path, remedy = ("stimuli", name, "field", "file"), "write the points into the protocol"
                problems.append(self.problem(path, "a file for one of several stimuli", "points", remedy))
            calibration = self.calibration
            if calibration is not None:
                from modaltouch.protocol.calibration import calibration_alone, check_calibration

                calibration = calibration_alone(calibration, name)
                problems += check_calibration(calibration, alone, self.apparatus)
            yield name, replace(self, protocol=alone, problems=tuple(problems), calibration=calibration)

    def at_stimulus(self, name: str, problems: Iterable[Problem]) -> Iterator[Problem]:
        """Yield problems found as if a stimulus were the only one, with its name, at its own key if there is one."""
        calibration = self.calibration
        in_calibration = calibration is not None and calibration.find(("stimuli", name)) is not None
        for problem in problems:
            section, _, key = problem.path.partition(".")
            path = ("stimuli", name, key.split(".")[0].split("[")[0])
            given = f"{problem.given} (stimulus {name})"
            own = calibration is not None and in_calibration and problem.file == str(calibration.source.path)
            if section == "stimulus" and not own and self.protocol is not None and self.protocol.find(path) is not None:
                yield self.problem(path, given, problem.allowed, problem.remedy)
            else:
                at = f"stimuli.{name}.{problem.path}" if own else problem.path
                yield replace(problem, given=given, path=at, written="" if own else problem.written)

    @classmethod
    def restored(cls, sources: Sources, occasion: tuple[str, str] = ("", "")) -> Findings:
        """Return the findings for the copies in a record, independent of the original files.

        Parameters
        ----------
        sources : Sources
            The copies, read by `Sources.from_dict`.
        occasion : (str, str)
            The group and the kind of session.
        """
        own, problems = Occasion(*occasion), list[Problem]()
        protocol = _read_protocol(sources.protocol, own, sources.table)
        calibration, fingers = None, None
        if sources.calibration is not None:
            from modaltouch.protocol.calibration import examine_calibration

            # Its age is not checked, since a record keeps the calibration with which it was begun.
            calibration = examine_calibration(sources.calibration)
        if sources.fingers is not None:
            from modaltouch.protocol.placements import read_fingers

            fingers, problems = read_fingers(sources.fingers, protocol)
        found = cls._checked(protocol, vars(sources), calibration, fingers, own, problems)
        return replace(found, at_samples=sources.at_samples)

    @classmethod
    def _checked(
        cls,
        protocol: Reading[Protocol],
        files: Mapping[str, Source | None],
        calibration: Reading[Calibration] | None,
        fingers: Reading[FingersFile] | None,
        occasion: Occasion,
        problems: Iterable[Problem],
    ) -> Findings:
        """Return the findings for a protocol and its files, with `problems` and those within and between the files."""
        apparatus, texts, found = None, None, {*problems, *protocol.problems, *check_protocol(protocol)}
        if (source := files["apparatus"]) is not None:
            apparatus, faults = examine_apparatus(source)
            found.update(faults)
        found.update(check_fit(protocol, apparatus))
        if (source := files["texts"]) is not None:
            texts = read(source, Texts)
            found.update(texts.problems, check_words(protocol, texts))
        if calibration is not None:
            from modaltouch.protocol.calibration import check_calibration

            found.update(calibration.problems, check_calibration(calibration, protocol, apparatus))
        if (field := files["field"]) is not None:
            from modaltouch.protocol.cell_table import read_points

            found.update(read_points(field)[1])
        return cls(
            protocol, apparatus, texts, tuple(sorted(found)), calibration, field, fingers, files["table"], occasion
        )

    @classmethod
    def recorded(cls, start: dict[str, Any]) -> Findings:
        """Return the findings for the copies in a session's start record, on its occasion."""
        own = start.get("schedule", {})
        return cls.restored(Sources.recorded(start), (own.get("group", ""), own.get("session_kind", "")))

    @classmethod
    def read(
        cls, path: Path | str, calibration: Path | None = None, *, uncalibrated: bool = False, marked: bool = False
    ) -> Findings:
        """Read and check a protocol file and the files that it names.

        Parameters
        ----------
        path : path
            The protocol file, or the name of a shipped protocol.
        calibration : Path, optional
            Calibration file to use instead of the one that the protocol names.
        uncalibrated : bool
            Whether to ignore a calibration that the protocol names or requires, for calibrating or planning.
        marked : bool
            Whether to accept a calibration that is marked for missing its limits.
        """
        try:
            source = Source.find("protocol", path)
        except InputError as error:
            return cls(None, None, None, error.problems)
        about: dict[str, Any] = {"calibration": calibration, "uncalibrated": uncalibrated, "marked": marked}
        first, *others = (cls._read(source, occasion, **about) for occasion in occasions_of(parse_tree(source)[0]))
        unlike = check_alike([(each.occasion, each.protocol) for each in (first, *others)])
        problems = sorted(set(first.problems).union(unlike, *(each.problems for each in others)))
        return replace(first, problems=tuple(problems), others=tuple(others))

    @classmethod
    def _read(
        cls, source: Source, occasion: Occasion, calibration: Path | None, *, uncalibrated: bool, marked: bool
    ) -> Findings:
        """Return the findings of one occasion."""
        # Only here, since durations are not checked in records.
        from modaltouch.protocol.durations import check_timing

        problems: list[Problem] = []
        protocol = _read_protocol(source, occasion)
        table = protocol.load_named(("conditions", "table"), problems)
        protocol = protocol if table is None else _read_protocol(source, occasion, table)
        keys = {"apparatus": ("apparatus",), "texts": ("texts",), "field": ("stimulus", "field", "file")}
        files = {name: protocol.load_named(key, problems) for name, key in keys.items()} | {"table": table}
        calibrated = None if uncalibrated else _examine_calibration(protocol, calibration, problems, marked=marked)
        fingers = None
        if protocol.sound("stimulus", "fingers") not in (None, NO_FINGERS):
            from modaltouch.protocol.placements import load_fingers

            fingers = load_fingers(protocol, problems)
        found = cls._checked(protocol, files, calibrated, fingers, occasion, problems)
        problems += check_timing(protocol, found.apparatus)
        problems += [] if found.texts is None else check_labels(protocol, found.texts)
        if found.measured:
            from modaltouch.protocol.placements import check_measured

            problems += check_measured(protocol, found.apparatus)
        # A name misspelt elsewhere would appear to be missing from the cells as well.
        others = any(
            each.path.startswith(("conditions", "adaptive", "stimuli")) for each in (*found.problems, *problems)
        )
        listed = protocol.value and (protocol.value.conditions.cells or protocol.value.conditions.exclude)
        if listed and not others:
            from modaltouch.protocol.cell_table import check_excluded

            problems += check_excluded(protocol)
        return replace(found, problems=tuple(sorted({*found.problems, *problems})))


def _read_protocol(source: Source, occasion: Occasion, table: Source | None = None) -> Reading[Protocol]:
    """Read a protocol for an occasion, with the cells of its table, if any."""
    root, problems = parse_tree(source)
    if root is not None and any(occasion):
        problems += check_groups(source, root)
        root = at_occasion(root, occasion)
    conditions = None if root is None else root.child("conditions")
    if root is None or conditions is None or not (conditions.child("table") or conditions.child("cells")):
        return read_tree(source, Protocol, root, problems)
    from modaltouch.protocol.cell_table import with_cells, without_derived

    root, faults = with_cells(source, root, table)
    reading = read_tree(source, Protocol, root, problems)
    found = (*without_derived(reading), *faults)
    return replace(reading, value=None if found else reading.value, problems=found)


def _serial(identity: str) -> tuple[str, ...]:
    return tuple(word.strip().upper() for word in identity.split(",")[:3])


def _examine_calibration(
    protocol: Reading[Protocol], path: Path | None, problems: list[Problem], *, marked: bool
) -> Reading[Calibration] | None:
    """Return the calibration given, or the one that the protocol names; add problems of its use to `problems`."""
    source = None
    if path is not None:
        try:
            source = Source.load(path)
        except InputError as error:
            problems += error.problems
    else:
        source = protocol.load_named(("calibration", "file"), problems)
        problems += protocol.faults(
            (
                protocol.sound("calibration", "file") is None and protocol.sound("calibration", "required"),
                ("calibration", "required"),
                "true, but no calibration is given",
                "a calibration",
                "make one with `modaltouch calibrate`, and name it under `file` or give it with --calibration",
            )
        )
    if source is None:
        return None
    # Imported only here, since most protocols name no calibration and its models take time to build.
    from modaltouch.protocol.calibration import check_age, check_mark, examine_calibration

    fingers, reading = protocol.sound("stimulus", "fingers"), examine_calibration(source)
    problems += protocol.faults(
        (
            protocol.sound("stimulus", "field", "file") is not None,
            ("stimulus", "field", "file"),
            "a file, which a calibration cannot contain",
            "points, with a calibration",
            "write the points into the protocol, under `points`",
        ),
        (
            fingers not in (None, NO_FINGERS),
            ("stimulus", "fingers"),
            f"{fingers}, with a calibration, which is for the untouched beam",
            NO_FINGERS,
            "leave one of them out",
        ),
    )
    problems += [*check_age(reading, protocol), *([] if marked else check_mark(reading))]
    return reading
