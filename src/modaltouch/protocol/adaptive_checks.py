"""What an adaptive protocol can say that no single key can: levels, orders and pairs that make no run."""

from __future__ import annotations

import math
from collections.abc import Iterator

from modaltouch.protocol.document import Problem, Reading
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


def check_adaptive(reading: Reading[Protocol]) -> Iterator[Problem]:
    """Yield the faults between the section ``adaptive`` and the others, as far as its sound parts show them."""
    if not is_adaptive(reading):
        return
    yield from _check_levels(reading)
    yield from _check_order(reading)
    yield from _check_success(reading)


def is_adaptive(reading: Reading[Protocol]) -> bool:
    """Return whether a protocol has a section ``adaptive``, sound or not."""
    node = reading.find(("adaptive",))
    return node is not None and isinstance(node.content, dict)


def check_bounds(reading: Reading[Protocol], when: str, reached: str) -> Iterator[Problem]:
    """Yield why the peak velocities are no bounds, a lowest level and then a higher one.

    Parameters
    ----------
    reading : Reading
        The protocol file.
    when, reached : str
        Where they have to be, as in ``runs are adaptive``, and who stays between them, as in ``a run may reach``.
    """
    path = ("conditions", "peak_velocities_mm_s")
    levels = [level for _, level in reading.items(*path)]
    node = reading.find(path)
    given = len(node.content) if node is not None and isinstance(node.content, list) else None
    if given is not None and given != 2:
        words = f"{given} levels where {when}"
        yield reading.problem(path, words, f"two: the lowest and the highest that {reached}", "give both")
    elif len(levels) == 2 and not levels[0] < levels[1]:
        words = f"[{levels[0]:g}, {levels[1]:g}] where {when}"
        yield reading.problem(path, words, "the lowest level first, then a higher one", "write the lowest first")


def _check_levels(reading: Reading[Protocol]) -> Iterator[Problem]:
    yield from check_bounds(reading, "runs are adaptive", "a run may reach")
    levels = [level for _, level in reading.items("conditions", "peak_velocities_mm_s")]
    start = reading.sound("adaptive", "start_mm_s")
    if start is not None and len(levels) == 2 and levels[0] < levels[1] and not levels[0] <= start <= levels[1]:
        allowed = f"{levels[0]:g} to {levels[1]:g} mm/s, the levels of conditions.peak_velocities_mm_s"
        yield reading.problem(("adaptive", "start_mm_s"), f"{start:g} mm/s", allowed, "start within them")


def _check_order(reading: Reading[Protocol]) -> Iterator[Problem]:
    repetitions, order = reading.sound("schedule", "repetitions"), reading.sound("schedule", "order")
    if repetitions is not None and repetitions != 1:
        given = f"{repetitions} where runs are adaptive"
        remedy = "remove it; adaptive.trials says how long a run is"
        yield reading.problem(("schedule", "repetitions"), given, "1", remedy)
    if order in ("by_velocity", "latin_square"):
        remedy = "shuffle the runs into each other, or take one after the other"
        given = f"{order}, where the levels are not known beforehand"
        yield reading.problem(("schedule", "order"), given, "shuffled or by_pair", remedy)


def _check_success(reading: Reading[Protocol]) -> Iterator[Problem]:
    success = reading.sound("adaptive", "success") or "focus_named"
    focus = reading.sound("stimulus", "focus")
    # Of several stimuli each is looked at by itself; what they share need not be one of them.
    if success == "focus_named" and focus is not None and not reading.sound("stimuli"):
        for index, pair in reading.items("conditions", "zone_pairs"):
            if focus not in pair:
                given = f"[{pair[0]}, {pair[1]}], neither of which is in focus, where success is naming the focus"
                path = ("conditions", "zone_pairs", index)
                yield reading.problem(path, given, f"a pair with {focus}", "remove it, or count `felt` as success")
    keys = reading.find(("answers", "keys"))
    offers_none = keys is not None and isinstance(keys.content, dict) and "none" in keys.content
    if success == "felt" and not offers_none:
        given = "felt, where no answer says that nothing was felt"
        yield reading.problem(("adaptive", "success"), given, "focus_named, or keys for `none`", "give the keys")
