"""Checks of a new protocol: whole bursts, gaps between bursts, and words that a participant can read.

They do not apply to records, so that a session begun under older rules can be resumed.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.conditions import check_way
from modaltouch.protocol.reading import Reading
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.source import EMPTY, Problem
from modaltouch.protocol.stimulus_sections import STANDARD_LEVEL, StimulusSection

WHOLE = 5e-3
"""Tolerance of a duration for rounding in the file [bursts]."""

MOST_OF_PERIOD = 0.95
"""Longest burst that leaves room for the jitter of the next trigger, as a fraction of the period [1]."""


def check_timing(protocol: Reading[Protocol], apparatus: Reading[Apparatus] | None) -> list[Problem]:
    """Return a problem for each duration not allowed in a new session."""
    found = [*_check_durations(protocol), *_check_written_once(protocol), *_check_shown(protocol)]
    if protocol.sound("answers", "ways", "two_hands") == "free_hand":
        found += check_way(protocol, "two_hands")
    if apparatus is not None:
        found += [*_check_period(protocol, apparatus), *_check_catch_trials(protocol, apparatus)]
    return found


def _check_shown(protocol: Reading[Protocol]) -> Iterator[Problem]:
    """Yield empty words that a participant should read; those of a record were replaced by those of the texts."""
    paths = [("answers", "question"), ("instructions",)]
    for section in (("answers", "then"), ("form",), ("people",)):
        paths += [(*section, name, "question") for name in protocol.keys(*section) or ()]
    choices = [("people", name, "choices") for name in protocol.keys("people") or ()]
    words = [(path, protocol.sound(*path)) for path in paths]
    words += [((*path, index), text) for path in choices for index, text in protocol.items(*path)]
    yield from (protocol.problem(path, *EMPTY) for path, text in words if text is not None and not text.strip())


def _check_durations(protocol: Reading[Protocol]) -> Iterator[Problem]:
    for key, name in product(("presentation_s", "longest_presentation_s"), protocol.sound("stimuli") or ("",)):
        seconds, own = protocol.sound("answers", key), ("stimuli", name)
        rate = protocol.sound(*own, "repetition_rate_Hz") or protocol.sound("stimulus", "repetition_rate_Hz")
        counted = key == "presentation_s" and protocol.sound(*own, "presentation_bursts") is not None
        n_bursts = 1.0 if None in (seconds, rate) or counted else seconds * rate
        if n_bursts > 1 - WHOLE and abs(n_bursts - round(n_bursts)) <= WHOLE:
            continue
        below, above = int(n_bursts), int(n_bursts) + 1
        nearest = " or ".join(f"{n / rate:.5g} s ({n} burst{'s' * (n > 1)})" for n in (below, above))
        if n_bursts < 1:
            nearest = f"{1 / rate:.5g} s (1 burst), or more"
        yield protocol.problem(
            ("answers", key),
            f"{seconds:g} s, which is {n_bursts:.4g} bursts at {rate:g} per second",
            f"whole bursts: {nearest}",
            "or give `presentation_bursts`" if key == "presentation_s" else "or leave it out",
        )


def _check_written_once(protocol: Reading[Protocol]) -> Iterator[Problem]:
    seconds, n_bursts = (protocol.sound("answers", f"presentation_{unit}") for unit in ("s", "bursts"))
    if seconds is not None and n_bursts is not None:
        yield protocol.problem(
            ("answers", "presentation_bursts"),
            f"{n_bursts} bursts beside presentation_s, {seconds:g} s",
            "one of the two",
            "remove one of them",
        )


def _check_period(protocol: Reading[Protocol], apparatus: Reading[Apparatus]) -> Iterator[Problem]:
    is_single = (apparatus.sound("generator", "repetition") or "single") == "single"
    most, why = (MOST_OF_PERIOD, ", so that a burst is over before the next is triggered") if is_single else (1.0, "")
    usual = {key: StimulusSection.model_fields[key].default for key in ("duration_ms", "repetition_rate_Hz")}
    shared = {key: protocol.sound("stimulus", key) for key in usual}
    for own in (None, *(protocol.sound("stimuli") or ())):
        section = ("stimulus",) if own is None else ("stimuli", own)
        duration, rate = (protocol.sound(*section, key) or shared[key] for key in shared)
        written = {key: node.line for key in shared if (node := protocol.find((*section, key)))}
        if duration is None or rate is None or not written or duration * rate <= most * 1e3:
            continue
        # The key that alone is too long or too fast for the usual value of the other; of two such, or none, the later
        # one, in which a group or a stimulus differs from what all share.
        alone = {
            "duration_ms": duration * usual["repetition_rate_Hz"],
            "repetition_rate_Hz": rate * usual["duration_ms"],
        }
        key = max(written, key=lambda each: (alone[each] > most * 1e3, written[each]))
        other, unit = (rate, "ms") if key == "duration_ms" else (duration, "bursts per second")
        yield protocol.problem(
            (*section, key),
            f"{duration:g} ms at {rate:g} bursts per second",
            f"at most {most * 1e3 / other:.6g} {unit}{why}",
            "shorten the burst or repeat it less often" + ", or set generator.repetition to continuous" * is_single,
        )


def _check_catch_trials(protocol: Reading[Protocol], apparatus: Reading[Apparatus]) -> Iterator[Problem]:
    repetition, silent = apparatus.sound("generator", "repetition"), dict[tuple[str, ...], str]()
    if n_catch := protocol.sound("schedule", "catch_trials"):
        silent["schedule", "catch_trials"] = f"{n_catch}"
    if protocol.sound(*STANDARD_LEVEL) == 0:
        silent[STANDARD_LEVEL] = "silence"
    for path, reason in silent.items() if repetition in ("continuous", "wired") else ():
        given = f"{reason}, but the generator's repetition is {repetition}"
        allowed = "none" if reason == "silence" else "0"
        allowed += ": only bursts triggered by command can be held back while the outputs are on"
        yield protocol.problem(path, given, allowed, "set generator.repetition to single")
