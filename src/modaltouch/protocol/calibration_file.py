"""A calibration and the files it is used with: whether it fits them, and what it makes of the apparatus."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.document import Problem, Reading, Source, read
from modaltouch.protocol.sections import Protocol

if TYPE_CHECKING:
    from modaltouch.protocol.calibration_sections import Calibration, CalibrationFile

AGAIN = "calibrate again with `modaltouch calibrate`"

MEASURED = ("beam", "actuator_sets", "modes", "amplifier", "generator", "acquisition", "twin")
"""Parts of an apparatus that a calibration holds for; names, zones and limits may change."""


def examine_calibration(source: Source) -> Reading[Calibration]:
    """Return what the text of a calibration file, of one stimulus or of several, holds, and its faults."""
    # Most protocols name none: its forty keys are not built for them.
    from modaltouch.protocol.calibration_sections import CalibrationFile, CalibrationOfSeveral

    of_several = re.search(r"""^["']?stimuli["']?\s*:""", source.text, re.MULTILINE) is not None
    model: type[Calibration] = CalibrationOfSeveral if of_several else CalibrationFile
    return read(source, model)


def check_calibration(
    calibration: Reading[Calibration], protocol: Reading[Protocol], apparatus: Reading[Apparatus] | None
) -> list[Problem]:
    """Return why a calibration is not one of this stimulus on this apparatus, as far as its sound parts show it.

    Where the protocol has several stimuli, whether it is of all of them and of this apparatus: what it holds of each
    is checked with the protocol of that one alone.
    """
    if calibration.value is None:
        return []
    others = [*_check_names(calibration, calibration.value, protocol)]
    problems = [*others]
    if apparatus is not None and apparatus.value is not None:
        problems += _check_apparatus(calibration, calibration.value, apparatus.value)
    only = calibration.value.alone("")
    if only is None or others:
        return problems
    return [*problems, *_check_stimulus(calibration, only, protocol, apparatus), *_check_levels(only, protocol)]


def calibration_alone(reading: Reading[Calibration], name: str) -> Reading[Calibration]:
    """Return the part of a calibration file that is of one stimulus, as if it were a file of that one alone.

    Parameters
    ----------
    reading : Reading
        A sound file of several stimuli, that one among them.
    name : str
        The stimulus.
    """
    from modaltouch.protocol.calibration_sections import CalibrationFile

    root, own = reading.root, reading.find(("stimuli", name))
    value = None if reading.value is None else reading.value.alone(name)
    if root is not None and own is not None and isinstance(root.content, dict) and isinstance(own.content, dict):
        root = replace(root, content=root.content | own.content, keys=root.keys | own.keys)
    return Reading(reading.source, CalibrationFile, root, value)


def in_calibration(reading: Reading[Calibration], name: str, problems: Iterable[Problem]) -> Iterator[Problem]:
    """Yield the problems of a calibration of one stimulus alone, at their keys in the file of several.

    Parameters
    ----------
    reading : Reading
        The file of several.
    name : str
        The stimulus.
    problems : iterable of Problem
        What is wrong with `calibration_alone` of it.
    """
    for problem in problems:
        at_own = problem.file == str(reading.source.path) and reading.find(("stimuli", name)) is not None
        yield replace(problem, path=f"stimuli.{name}.{problem.path}") if at_own else problem


def _check_names(
    reading: Reading[Calibration], calibration: Calibration, protocol: Reading[Protocol]
) -> Iterator[Problem]:
    """Yield a calibration of other stimuli than the protocol's."""
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
    if apparatus_hash(apparatus) != calibration.apparatus.sha256:
        given = f"a calibration of another apparatus ({calibration.apparatus.name}, values changed since or others)"
        allowed = f"one made with {apparatus.apparatus} as its file is now"
        yield reading.problem(("apparatus", "sha256"), given, allowed, AGAIN)
    elif modes and [mode.label for mode in modes] != labels:
        given = f"modes {', '.join(str(mode.label) for mode in modes)}"
        yield reading.problem(("modes",), given, ", ".join(map(str, labels)), AGAIN)
    for index, mode in enumerate(modes):
        if set(mode.gain_mm_s2_per_V) != set(apparatus.actuator_sets):
            given = f"gains by {', '.join(mode.gain_mm_s2_per_V) or 'no set'}"
            allowed = f"one by each of {', '.join(apparatus.actuator_sets)}"
            yield reading.problem(("modes", index, "gain_mm_s2_per_V"), given, allowed, AGAIN)


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
    # What follows the focusing instant does not act on it.
    different = [key for key in now if key != "release" and made[key] != now[key]]
    for key in different:
        given = f"{_words(made[key])}, a calibration of another stimulus"
        yield reading.problem(("stimulus", key), given, f"{_words(now[key])}, as in {protocol.source.path}", AGAIN)
    if "focus" in different or apparatus is None:
        return
    centre = apparatus.sound("zones", section.focus, "centre_mm")
    if centre is not None and centre != calibration.focus_centre_mm:
        given = f"{calibration.focus_centre_mm:g} mm, a calibration of another stimulus"
        allowed = f"{centre:g} mm, the centre of zone {section.focus}"
        yield reading.problem(("focus_centre_mm",), given, allowed, AGAIN)


def _check_levels(calibration: CalibrationFile, protocol: Reading[Protocol]) -> Iterator[Problem]:
    known = {level.velocity_mm_s for level in calibration.levels}
    for index, level in protocol.items("conditions", "peak_velocities_mm_s"):
        if level not in known:
            given = f"{level:g} mm/s, a level that the calibration did not measure"
            allowed = ", ".join(f"{each:g}" for each in sorted(known)) + " mm/s"
            yield protocol.problem(("conditions", "peak_velocities_mm_s", index), given, allowed, AGAIN)


def check_age(
    calibration: Reading[Calibration], protocol: Reading[Protocol], now: datetime | None = None
) -> list[Problem]:
    """Return why a calibration is too old for a protocol, or lies in the future.

    Parameters
    ----------
    calibration : Reading
        The calibration file.
    protocol : Reading
        The protocol file, which may say ``calibration.max_age_days``.
    now : datetime, optional
        The present, with its offset from UTC.
    """
    made_text = calibration.sound("made")
    if made_text is None:
        return []
    try:
        made = datetime.fromisoformat(made_text)
        days = ((now or datetime.now(UTC)) - made).total_seconds() / 86400
    except (ValueError, TypeError):
        allowed = "a date and time with its offset from UTC, as in 2026-05-04T10:30:00+00:00"
        return [calibration.problem(("made",), f"{made_text!r}, which is no such instant", allowed, AGAIN)]
    if days < -1 / 24:
        given = f"{made_text}, which lies in the future"
        return [calibration.problem(("made",), given, "a time before now", "set this machine's clock right")]
    limit = protocol.sound("calibration", "max_age_days")
    if limit is not None and days > limit:
        given = f"{limit:g} days, and the calibration {calibration.source.path} is {days:.1f} days old ({made_text})"
        return [protocol.problem(("calibration", "max_age_days"), given, "a younger calibration", AGAIN)]
    return []


def generator_problem(calibration: Reading[Calibration], identity: str) -> Problem | None:
    """Return why a calibration was made with another generator than the one that is open; None if it was not.

    Maker, model and serial number must agree; the firmware may be another.

    Parameters
    ----------
    calibration : Reading
        The calibration file.
    identity : str
        Reply of the open generator to ``*IDN?``.
    """
    made_with = calibration.sound("instruments", "generator")
    if made_with is None or _serial(made_with) == _serial(identity):
        return None
    given = f"{made_with}, the generator it was made with"
    allowed = f"{identity}, the generator that is open"
    return calibration.problem(("instruments", "generator"), given, allowed, f"open that one, or {AGAIN}")


def _serial(identity: str) -> tuple[str, ...]:
    return tuple(word.strip().upper() for word in identity.split(",")[:3])


def _words(value: object) -> str:
    if isinstance(value, dict):
        return " ".join(_words(each) for each in value.values() if each is not None)
    if isinstance(value, tuple | list):
        return ", ".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def apparatus_hash(apparatus: Apparatus) -> str:
    """Return the SHA-256 of the values of an apparatus that a calibration depends on.

    Comments, order and keys left at their default do not count.

    Parameters
    ----------
    apparatus : Apparatus
        The apparatus, as its file gives it.
    """
    values = apparatus.model_dump(mode="json", include=set(MEASURED), exclude_defaults=True)
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def calibrated_apparatus(apparatus: Apparatus, calibration: CalibrationFile) -> Apparatus:
    """Return an apparatus with modes and amplifier as a calibration found them.

    Parameters
    ----------
    apparatus : Apparatus
        As its file gives it.
    calibration : CalibrationFile
        Made with this apparatus.
    """
    found = {mode.label: mode for mode in calibration.modes}
    modes = tuple(
        mode.model_copy(
            update={
                "natural_frequency_Hz": found[mode.label].natural_frequency_Hz,
                "damping_ratio": found[mode.label].damping_ratio,
                "gain_mm_s2_per_V": found[mode.label].gain_mm_s2_per_V,
                "assumed": (),
            }
        )
        for mode in apparatus.modes
    )
    measured = calibration.amplifier
    amplifier = apparatus.amplifier.model_copy(
        update={
            "gain_V_per_V": measured.gain_V_per_V,
            "bandwidth_kHz": measured.bandwidth_kHz,
            "delay_us": measured.delay_us,
        }
    )
    return apparatus.model_copy(update={"modes": modes, "amplifier": amplifier})
