"""What levels calibrated by participant can say that no single key can: bounds that no participant fits."""

from __future__ import annotations

import math
from collections.abc import Iterator

from modaltouch.document import Problem, Reading
from modaltouch.protocol.adaptive_checks import check_bounds, is_adaptive
from modaltouch.protocol.sections import Protocol

_SECTION = ("conditions", "sensation_levels")


def check_sensation_levels(reading: Reading[Protocol]) -> Iterator[Problem]:
    """Yield the faults between the section ``sensation_levels`` and the others."""
    node = reading.find(_SECTION)
    if node is None or not isinstance(node.content, dict):
        return
    if is_adaptive(reading):
        given = "levels calibrated by participant where runs are adaptive and find their own"
        yield reading.problem(_SECTION, given, "one of the two", "remove this section, or the section adaptive")
        return
    if reading.sound(*_SECTION, "thresholds_from") == (name := reading.sound("protocol")) and name is not None:
        path, given = (*_SECTION, "thresholds_from"), f"'{name}', which is this protocol itself"
        yield reading.problem(path, given, "the name of an adaptive protocol", "name the one that finds thresholds")
    multiples = dict(reading.items(*_SECTION, "multiples"))
    yield from _check_doubles(reading, multiples)
    faults = list(check_bounds(reading, "they are calibrated by participant", "anyone may get"))
    yield from faults
    levels = [level for _, level in reading.items("conditions", "peak_velocities_mm_s")]
    if faults or len(levels) != 2 or not multiples:
        return
    if max(multiples.values()) / min(multiples.values()) > levels[1] / levels[0]:
        given = f"{min(multiples.values()):g} to {max(multiples.values()):g}, further apart than the levels allowed"
        allowed = f"a ratio of at most {levels[1] / levels[0]:.4g}, that of conditions.peak_velocities_mm_s"
        remedy = "bring them closer together, or allow lower or higher levels"
        yield reading.problem((*_SECTION, "multiples"), given, allowed, remedy)


def _check_doubles(reading: Reading[Protocol], multiples: dict[int, float]) -> Iterator[Problem]:
    """Yield multiples that no generator can tell apart: it has four digits."""
    seen: dict[int, float] = {}
    for index, value in multiples.items():
        like = next((at for at, other in seen.items() if math.isclose(value, other, rel_tol=2e-3)), None)
        if like is not None:
            given = f"{value:g}, as good as the multiple of multiples[{like}]"
            allowed = "multiples that are 0.2 % apart or more"
            yield reading.problem((*_SECTION, "multiples", index), given, allowed, "remove one of them")
        seen[index] = value
