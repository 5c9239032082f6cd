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
    n_in_run = reading.sound("adaptive", "trials") if is_adaptive(reading) else n_levels * (repetitions or 0)
    if repetitions is None or n_in_run is None or not n_pairs or not n_levels:
        return
    n_driven = n_pairs * n_in_run * (len(reading.sound("stimuli") or ()) or 1)
    n_all = n_driven * max(n_blocks, 1)
    if reading.value is not None and not reading.value.is_crossed:
        conditions = reading.value.conditions.finger_conditions
        each = [len(reading.value.cells(name)) * repetitions for name in conditions]
        n_driven, n_all = min(each), sum(each)
    n_catch = reading.sound("schedule", "catch_trials") or 0
    n_trials = n_all + n_catch * max(n_blocks, 1)
    order = reading.sound("schedule", "order")
    limits = {key: limit for key in LIMITS if (limit := reading.sound("schedule", key)) is not None}
    idle = "" if order in ("shuffled", None) else next(iter(limits), "")
    faulty = any(problem.path.startswith("conditions.zone") for problem in reading.problems)
    yield from reading.faults(
        (
            n_catch > n_driven,
            ("schedule", "catch_trials"),
            f"{n_catch} where {n_driven} trials of a finger condition have a stimulus",
            f"at most {n_driven}",
            "take fewer: each follows a trial with a stimulus",
        ),
        (
            n_trials > TRIAL_LIMIT,
            ("schedule", "repetitions"),
            f"{repetitions}, which makes {n_trials} trials",
            f"at most {TRIAL_LIMIT} trials",
            "repeat less often",
        ),
        (
            idle,
            ("schedule", idle),
            f"{limits.get(idle)} with the order {order}",
            "null, or the order shuffled",
            "remove the limit or shuffle",
        ),
        (
            not idle and not faulty and n_pairs == 1 and n_driven > limits.get(LIMITS[0], n_driven),
            ("schedule", LIMITS[0]),
            f"{limits.get(LIMITS[0])} where every trial has the same pair",
            f"at least {n_driven}, or null for no limit",
            "add a pair of zones or lift the limit",
        ),
    )


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
