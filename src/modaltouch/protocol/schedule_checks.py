"""Faults of a design: too many trials, limits that no order keeps, cells that are not there."""

from __future__ import annotations

from collections.abc import Iterator

from modaltouch.protocol.adaptive import contacts, is_adaptive
from modaltouch.protocol.order_limits import LIMITS
from modaltouch.protocol.problems import Problem
from modaltouch.protocol.reading import Reading
from modaltouch.protocol.sections import Protocol

TRIAL_LIMIT = 10_000
"""Most trials of a session: a day of them."""


def check_schedule(reading: Reading[Protocol]) -> Iterator[Problem]:
    """Yield the faults between the keys of the sections conditions and schedule, as far as sound parts show them."""
    if any(reading.find(("conditions", key)) for key in ("table", "cells", "exclude")):
        # Most designs are crossed.
        from modaltouch.protocol.cell_table import check_cells

        yield from check_cells(reading)
    yield from _check_stimuli(reading)
    own = ("sensation_levels", "multiples") if reading.sound("conditions", "sensation_levels") else None
    n_pairs, n_levels = len(contacts(reading)), len(reading.items("conditions", *(own or ("peak_velocities_mm_s",))))
    n_blocks = len(reading.items("conditions", "finger_conditions"))
    repetitions = reading.sound("schedule", "repetitions")
    path = ("schedule", "max_same_pair_running")
    running = reading.sound(*path)
    if repetitions is None or not n_pairs or not n_levels:
        return
    n_in_run = reading.sound("adaptive", "trials") if is_adaptive(reading) else None
    n_stimuli = len(reading.sound("stimuli") or ()) or 1
    n_each = n_in_run if is_adaptive(reading) else n_levels * repetitions
    if n_each is None:
        return
    n_driven, n_all = n_pairs * n_each * n_stimuli, n_pairs * n_each * n_stimuli * max(n_blocks, 1)
    if reading.value is not None and not reading.value.is_crossed:
        conditions = reading.value.conditions.finger_conditions
        each = [len(reading.value.cells(name)) * repetitions for name in conditions]
        n_driven, n_all = min(each), sum(each)
    n_catch = reading.sound("schedule", "catch_trials") or 0
    if n_catch > n_driven:
        given = f"{n_catch} where {n_driven} trials of a finger condition have a stimulus"
        remedy = "take fewer: each follows a trial with a stimulus"
        yield reading.problem(("schedule", "catch_trials"), given, f"at most {n_driven}", remedy)
    n_trials = n_all + n_catch * max(n_blocks, 1)
    if n_trials > TRIAL_LIMIT:
        given = f"{repetitions}, which makes {n_trials} trials"
        yield reading.problem(("schedule", "repetitions"), given, f"at most {TRIAL_LIMIT} trials", "repeat less often")
    order = reading.sound("schedule", "order")
    limits = {key: reading.sound("schedule", key) for key in LIMITS}
    for key, limit in limits.items() if order not in ("shuffled", None) else ():
        if limit is not None:
            given = f"{limit} with the order {order}"
            yield reading.problem(
                ("schedule", key), given, "null, or the order shuffled", "remove the limit or shuffle"
            )
            return
    faulty = any(problem.path.startswith("conditions.zone") for problem in reading.problems)
    if running is not None and n_pairs == 1 and not faulty and n_driven > running:
        given = f"{running} where every trial has the same pair"
        allowed = f"at least {n_driven}, or null for no limit"
        yield reading.problem(path, given, allowed, "add a pair of zones or lift the limit")


def _check_stimuli(reading: Reading[Protocol]) -> Iterator[Problem]:
    """Yield what one of several stimuli has of its own and the protocol has no use for."""
    until = reading.sound("answers", "stimulus_until")
    for name in reading.sound("stimuli") or ():
        path = ("stimuli", name, "presentation_bursts")
        if until == "answer" and (n_bursts := reading.sound(*path)) is not None:
            given, remedy = f"{n_bursts}, where the stimulus plays until the answer", "write stimulus_until: question"
            yield reading.problem(path, given, "only where it stops before the question (answers)", remedy)
        path = ("stimuli", name, "masked")
        if reading.sound(*path) is not None and reading.sound("masking") is None:
            given = "a stimulus with or without masking, where there is no noise"
            yield reading.problem(path, given, "only with a section masking", "write one, or leave it out")
