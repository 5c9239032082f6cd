"""Consistency checks between the keys of a protocol, and between a protocol and its apparatus."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.conditions import check_contacts, contacts, is_adaptive, offered_answers
from modaltouch.protocol.people import check_people
from modaltouch.protocol.questions import IN_EMERGENCY, MOST_ANSWERS, check_key, check_keys, check_questions
from modaltouch.protocol.reading import Reading, repeats
from modaltouch.protocol.schedule_section import LIMITS
from modaltouch.protocol.sections import AnswersSection, Protocol
from modaltouch.protocol.source import Problem, suggest
from modaltouch.protocol.stimulus_sections import check_masking, check_target_field, presented_levels
from modaltouch.protocol.trial import SHIPPED, TIME_OUT

TRIAL_LIMIT = 10_000
"""Largest number of trials of a session, about a day's worth."""


def _check_schedule(reading: Reading[Protocol]) -> Iterator[Problem]:
    """Yield the problems of a valid design with its numbers of trials, and limits that have no effect."""
    if (protocol := reading.value) is None:
        return
    schedule, names = protocol.schedule, protocol.conditions.finger_conditions
    n_driven = [len(protocol.cells(name)) * protocol.scheduled_repetitions for name in names]
    n_trials = sum(n_driven) + schedule.catch_trials * len(names)
    limits = {key: limit for key in LIMITS if (limit := getattr(schedule, key)) is not None}
    idle = "" if schedule.order == "shuffled" else next(iter(limits), "")
    yield from reading.faults(
        (
            schedule.catch_trials > min(n_driven),
            ("schedule", "catch_trials"),
            f"{schedule.catch_trials}, but only {min(n_driven)} trials of a finger condition have a stimulus",
            f"at most {min(n_driven)}",
            "use fewer: each follows a trial with a stimulus",
        ),
        (
            n_trials > TRIAL_LIMIT,
            ("schedule", "repetitions"),
            f"{schedule.repetitions}, which gives {n_trials} trials",
            f"at most {TRIAL_LIMIT} trials",
            "repeat less often",
        ),
        (
            idle,
            ("schedule", idle),
            f"{limits.get(idle)} with the order {schedule.order}",
            "null, or order: shuffled",
            "remove the limit or shuffle the trials",
        ),
    )


def _check_stimuli(reading: Reading[Protocol]) -> Iterator[Problem]:
    """Yield the keys of individual stimuli that have no effect in this protocol."""
    until, noise = reading.sound("answers", "stimulus_until"), reading.sound("masking")
    for name in reading.sound("stimuli") or ():
        bursts, masked = ("stimuli", name, "presentation_bursts"), ("stimuli", name, "masked")
        n_bursts = reading.sound(*bursts)
        yield from reading.faults(
            (
                until == "answer" and n_bursts is not None,
                bursts,
                f"{n_bursts}, but the stimulus plays until the answer",
                "only for a stimulus that stops before the question (answers)",
                "write stimulus_until: question",
            ),
            (
                noise is None and reading.sound(*masked) is not None,
                masked,
                "a choice of masking, but there is no noise",
                "only with a section masking",
                "add that section, or leave this out",
            ),
        )


TAKEN_NAMES = frozenset(
    {"finger_condition", "pair", "zone_left", "zone_right", "velocity_mm_s", "multiple_of_threshold", "n"}
)
"""Fixed columns of the table of counts, reserved because each answer has a column of its name there."""


def check_protocol(reading: Reading[Protocol]) -> list[Problem]:
    """Return a problem for each inconsistency between the valid keys of a protocol."""
    return [
        *_check_stimulus(reading),
        *check_target_field(reading),
        *check_contacts(reading),
        *_check_doubles(reading),
        *_check_stimuli(reading),
        *_check_schedule(reading),
        *_check_if_given(reading),
        *_check_keys(reading),
        *check_questions(reading),
        *check_people(reading),
    ]


def _check_if_given(reading: Reading[Protocol]) -> Iterator[Problem]:
    # Most designs are crossed, with fixed levels and one stimulus per trial: other code is imported only if needed.
    if any(reading.find(("conditions", key)) for key in ("table", "cells", "exclude")):
        from modaltouch.protocol.cell_table import check_cells

        yield from check_cells(reading)
    if is_adaptive(reading) or reading.find(("conditions", "sensation_levels")) is not None:
        from modaltouch.protocol.levels import check_own_levels

        yield from check_own_levels(reading)
    if any(reading.find((*section, "intervals")) for section in ((), ("answers",))):
        from modaltouch.protocol.intervals import check_intervals

        yield from check_intervals(reading)


def _check_stimulus(reading: Reading[Protocol]) -> Iterator[Problem]:
    section = ("stimulus",)
    keys = ("duration_ms", "focusing_instant_ms", "repetition_rate_Hz", "n_samples")
    duration, instant, rate, n_samples = (reading.sound(*section, key) for key in keys)
    if duration is not None and instant is not None and instant >= duration:
        yield reading.problem(
            (*section, "focusing_instant_ms"),
            f"{instant:g} ms, outside the burst of {duration:g} ms",
            f"below {duration:g} ms",
            "move one of them",
        )
    if None not in (duration, instant, n_samples) and instant < duration / n_samples:
        yield reading.problem(
            (*section, "focusing_instant_ms"),
            f"{instant:g} ms, before the second sample",
            f"at least {duration / n_samples:g} ms",
            "move it later",
        )
    yield from _check_laws(reading)
    band = reading.sound(*section, "equalise_band_Hz")
    # The spectrum of a repeated burst consists of multiples of the repetition rate, up to half the sampling rate.
    if None not in (band, duration, rate, n_samples) and (
        band[0] < band[1] and math.floor(min(band[1], n_samples / duration * 500) / rate) < math.ceil(band[0] / rate)
    ):
        yield reading.problem(
            (*section, "equalise_band_Hz"),
            f"{band[0]:g} to {band[1]:g} Hz, which contains no multiple of the repetition rate of {rate:g} Hz",
            f"a band that contains a multiple of {rate:g} Hz below {n_samples / duration / 2:g} kHz",
            "widen it",
        )


def _check_laws(reading: Reading[Protocol]) -> Iterator[Problem]:
    """Yield choices of law, design, priority, fingers and band that exclude each other."""
    section = ("stimulus",)
    law, priority, fingers = (reading.sound(*section, key) for key in ("law", "priority", "fingers"))
    for key, value in (("design", "least_energy"), ("fingers", "none")) if law == "paper" else ():
        if (other := reading.sound(*section, key)) not in (None, value):
            yield reading.problem(
                (*section, key),
                f"{other}, which the paper's law does not support",
                f"{value}, or the law exact",
                "leave it out",
            )
    usual = {"law": "exact", "design": "least_energy", "equalise_band_Hz": None}
    for key, known in usual.items() if priority == "level" else ():
        if (other := reading.sound(*section, key)) not in (None, known):
            yield reading.problem(
                (*section, "priority"),
                f"level, with the {key} {other}",
                "field, or the law exact of least energy without a band",
                "leave one of them out",
            )
    low, high = reading.sound(*section, "equalise_band_Hz") or (None, None)
    yield from reading.faults(
        (
            low and fingers == "none",
            (*section, "equalise_band_Hz"),
            "a band, with fingers none",
            "none",
            "leave it out, or name the fingers in stimulus.fingers",
        ),
        (
            low and low >= high,
            (*section, "equalise_band_Hz"),
            f"{low or 0:g} to {high or 0:g} Hz",
            "the lower end first",
            "swap its ends",
        ),
    )


def _check_doubles(reading: Reading[Protocol]) -> Iterator[Problem]:
    nouns = {
        ("conditions", "finger_conditions"): "finger condition",
        ("conditions", "peak_velocities_mm_s"): "peak velocity",
        ("conditions", "placements"): "placement",
        ("conditions", "sensation_levels", "multiples"): "multiple",
        ("stimulus", "selected_modes"): "mode",
        ("answers", "below"): "answer",
    }
    for path, noun in nouns.items():
        for index, value, first in repeats(reading.items(*path)):
            word = f"{value:g}" if isinstance(value, float) else value
            yield reading.problem(
                (*path, index), f"{word}, the same {noun} as {path[-1]}[{first}]", f"each {noun} once", "remove it"
            )


def _check_keys(reading: Reading[Protocol]) -> Iterator[Problem]:
    yield from _check_answers(reading, reading.keys("answers", "keys"))
    yield from check_keys(reading, ("answers", "keys"))
    others = {
        "continue_keys": dict.fromkeys((name for _, name in reading.items("answers", "emergency_keys")), IN_EMERGENCY),
        "emergency_keys": {AnswersSection.END_KEY: "ends a session that is paused"},
    }
    for section, taken in others.items():
        for index, name in reading.items("answers", section):
            path = ("answers", section, index)
            yield from check_key(reading, path, name)
            if name in taken:
                yield reading.problem(
                    path, f"'{name}', which {taken[name]}", "a key with no other meaning", "choose another"
                )


def _check_fingers(reading: Reading[Protocol], name: str) -> Iterator[Problem]:
    """Yield fingers that an answer names twice, and fingers that contradict the name of a shipped answer."""
    path = ("answers", "fingers", name)
    fingers = [value for _, value in reading.items(*path)]
    if len(set(fingers)) < len(fingers):
        yield reading.problem(path, f"[{', '.join(fingers)}]", "each finger once", "remove the second")
    elif name in SHIPPED and set(fingers) != set(SHIPPED[name]):
        yield reading.problem(
            path,
            f"[{', '.join(fingers)}] for '{name}'",
            f"[{', '.join(SHIPPED[name])}], which that name stands for",
            "remove it, or give the answer another name",
        )


def _check_answers(reading: Reading[Protocol], names: list[str] | None) -> Iterator[Problem]:
    """Yield a problem for too few or too many answers, answers without keys, and answers that name the same fingers."""
    path = ("answers", "keys")
    if names is not None and not 2 <= len(names) <= MOST_ANSWERS:
        yield reading.problem(
            path,
            f"{len(names)} answer{'s' * (len(names) != 1)}",
            f"2 to {MOST_ANSWERS} answers",
            "add a key, such as `left`, `both` or `right`" if len(names) < 2 else "offer fewer",
        )
    zones = {zone for _, listed in contacts(reading) for zone in listed}
    why = {
        **dict.fromkeys(zones, "which is a zone, and tables label answers by zone"),
        **dict.fromkeys(TAKEN_NAMES, "which is also a column of the table of counts"),
        TIME_OUT: "which is recorded when no answer comes in time",
    }
    for name in [name for name in names or () if name in why]:
        yield reading.problem((*path, name), f"{name}, {why[name]}", "any other name", "choose another")
    for step, _ in reading.items("answers", "fingers"):
        yield from _check_fingers(reading, str(step))
    for section in ("fingers", "below", "intervals"):
        for step, value in reading.items("answers", section):
            name = value if section == "below" else step
            if names is not None and name not in names:
                meant = suggest(name, names)
                yield reading.problem(
                    ("answers", section, step),
                    f"'{name}', which has no keys",
                    ", ".join(names),
                    f"did you mean '{meant}'?" if meant else "give it keys, or remove it",
                )
    offered = offered_answers(reading)
    for name, _, first in repeats((each.name, each.fingers) for each in offered if each.fingers is not None):
        given, place = f"'{name}', which names the same fingers as '{first}'", ("answers", "fingers", name)
        at = place if reading.find(place) is not None else (*path, name)
        yield reading.problem(at, given, "one answer for each finger, for both and for neither", "remove one of them")
    turned = any("mirrored" in str(name) for _, name in reading.items("conditions", "placements"))
    sides = {answer.fingers for answer in offered}
    one_sided = next((answer.name for answer in offered if answer.mirrored not in sides), None)
    if turned and one_sided is not None:
        yield reading.problem(
            ("conditions", "placements"),
            f"a turned beam, but '{one_sided}' has no counterpart on the other side",
            "answers for both sides",
            "add an answer for the other finger, or do not turn the beam",
        )
    if any(answer.fingers or answer.interval for answer in offered):
        return
    for key in ("practice_feedback", "practice_criterion"):
        if value := reading.sound("schedule", key):
            yield reading.problem(
                ("schedule", key),
                f"{str(value).lower()}, but no answer names a finger or an interval",
                "answers that name fingers or intervals",
                "remove it: practice is judged by the speeds under the fingers or by the intervals",
            )


LEAST_SAMPLES_PER_CYCLE = 2.5
"""Fewest samples per cycle of the highest modelled mode: the 2 of the sampling theorem plus 25 % [1]."""


def check_fit(protocol: Reading[Protocol], apparatus: Reading[Apparatus] | None) -> list[Problem]:
    """Return a problem for each requirement of a protocol that its apparatus, if any, fails to meet, if valid."""
    n_modes = 0 if apparatus is None else apparatus.length("modes") or 0
    labels = [] if apparatus is None else [apparatus.sound("modes", index, "label") for index in range(n_modes)]
    modes = _check_modes(protocol, labels)
    if apparatus is None:
        return [*modes]
    return [
        *modes,
        *_check_zones(protocol, apparatus),
        *_check_sampling(protocol, apparatus, n_modes),
        *_check_delay(protocol, apparatus),
        *_check_levels(protocol, apparatus),
        *check_masking(protocol, apparatus),
    ]


def _check_zones(protocol: Reading[Protocol], apparatus: Reading[Apparatus]) -> Iterator[Problem]:
    zones, kind = apparatus.keys("zones"), "a zone of this beam"
    if zones is None:
        return
    if (focus := protocol.sound("stimulus", "focus")) is not None and focus not in zones:
        yield protocol.unknown(("stimulus", "focus"), kind, zones)
    yield from protocol.unlisted(("stimulus", "further_foci"), kind, zones)
    keys: tuple[tuple[str, ...], ...] = ("zones",), ("zone_pairs",), ("exclude", "pair")
    for key, index in ((each, index) for each in keys for index in range(protocol.length("conditions", each[0]) or 0)):
        path: tuple[str | int, ...] = "conditions", key[0], index, *key[1:]
        unknown = [position for position, name in protocol.items(*path) if name not in zones]
        yield from (protocol.unknown((*path, position), kind, zones) for position in unknown)
        listed = protocol.sound(*path)
        if listed is None or unknown or len(set(listed)) < len(listed):
            continue
        centres = {name: apparatus.sound("zones", name, "centre_mm") for name in listed}
        for left, right in pairwise(() if None in centres.values() else listed):
            if centres[left] >= centres[right]:
                yield protocol.problem(
                    path,
                    f"[{', '.join(listed)}], whose left zone {left} lies right of {right}",
                    "the left zone first",
                    f"write [{', '.join(sorted(listed, key=lambda name: centres[name]))}]",
                )
                break


def _check_modes(protocol: Reading[Protocol], labels: Sequence[int | None]) -> Iterator[Problem]:
    """Yield selected modes that are not decomposed or, as far as the labels of the modes are known, not modelled."""
    n_modes = len(labels) or math.inf
    path, n_decomposed = ("stimulus", "selected_modes"), protocol.sound("stimulus", "decomposed_modes") or math.inf
    selection = protocol.sound(*path)
    if isinstance(selection, int) and selection > min(n_modes, n_decomposed):
        most, kind, raised = min(
            (n_modes, "modelled", "add modes to the apparatus"), (n_decomposed, "decomposed", "raise decomposed_modes")
        )
        given = f"{selection}, more than the {most} {kind} modes"
        yield protocol.problem(path, given, f"1 to {most}", f"select fewer or {raised}")
    allowed = ", ".join(map(str, labels))
    for index, label in protocol.items(*path):
        if labels and None not in labels and label not in labels:
            yield protocol.problem((*path, index), f"{label}, which is not a modelled mode", allowed)
        elif label > n_decomposed:
            given = f"{label}, which is beyond the {n_decomposed} decomposed modes"
            yield protocol.problem(
                (*path, index), given, f"1 to {n_decomposed}", "raise decomposed_modes or leave it out"
            )


def _check_sampling(protocol: Reading[Protocol], apparatus: Reading[Apparatus], n_modes: int) -> Iterator[Problem]:
    n_samples, duration = (protocol.sound("stimulus", key) for key in ("n_samples", "duration_ms"))
    known = [apparatus.sound("modes", index, "natural_frequency_Hz") for index in range(n_modes)]
    highest: Any = max((value for value in known if value is not None), default=None)
    if n_samples is None or duration is None or highest is None:
        return
    # n_samples is even; rounding error at an even bound must not require two more samples.
    least = 2 * math.ceil(LEAST_SAMPLES_PER_CYCLE * highest * duration * 1e-3 / 2 * (1 - 1e-12))
    if n_samples < least:
        yield protocol.problem(
            ("stimulus", "n_samples"),
            f"{n_samples} samples in {duration:g} ms, too few for the mode of {highest:g} Hz",
            f"at least {least}",
            "use more samples, shorten the burst or leave the mode out of the apparatus",
        )


def _check_delay(protocol: Reading[Protocol], apparatus: Reading[Apparatus]) -> Iterator[Problem]:
    delay = apparatus.sound("amplifier", "delay_us")
    instant = protocol.sound("stimulus", "focusing_instant_ms")
    if delay is not None and instant is not None and delay >= instant * 500:
        yield apparatus.problem(
            ("amplifier", "delay_us"),
            f"{delay:g} us, more than half the time to the focusing instant of {instant:g} ms",
            f"below {instant * 500:g} us, so that the drive reaches the beam in time",
            "write the delay in microseconds",
        )


def _check_levels(protocol: Reading[Protocol], apparatus: Reading[Apparatus]) -> Iterator[Problem]:
    limit = apparatus.sound("safety", "velocity_limit_mm_s")
    for path, velocity in presented_levels(protocol).items():
        if limit is not None and velocity > limit:
            yield protocol.problem(
                path,
                f"{velocity:g} mm/s, above the safety limit of the apparatus",
                f"at most {limit:g} mm/s",
                "lower the level",
            )
