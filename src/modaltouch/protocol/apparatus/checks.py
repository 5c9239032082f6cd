"""What an apparatus file can say that no single key can: overlaps, doubles, names that lead nowhere."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from modaltouch.protocol.apparatus.measured_shapes import check_shapes
from modaltouch.protocol.apparatus.offered import check_patches
from modaltouch.protocol.apparatus.sections import Apparatus, Zone
from modaltouch.protocol.document import Problem, Reading, suggest


def check_apparatus(reading: Reading[Apparatus]) -> list[Problem]:
    """Return the faults between the keys of an apparatus, as far as its sound parts show them."""
    return [
        *_check_zones(reading),
        *_check_actuator_sets(reading),
        *_check_modes(reading),
        *_check_unlisted(reading),
        *check_shapes(reading),
        *check_patches(reading),
        *_check_latency(reading),
    ]


def zone_edges(zone: Zone) -> tuple[float, float]:
    """Return the left and the right edge of a zone [mm from mid-beam]."""
    return zone.centre_mm - zone.width_mm / 2, zone.centre_mm + zone.width_mm / 2


def _check_zones(reading: Reading[Apparatus]) -> Iterator[Problem]:
    length = reading.sound("beam", "length_mm")
    zones: list[tuple[str, Zone]] = reading.items("zones")
    tolerance = 1e-9 * (length or 1.0)
    for name, zone in zones:
        left, right = zone_edges(zone)
        if length is not None and max(-left, right) > length / 2 + tolerance:
            given = f"a zone from {left:g} to {right:g} mm"
            allowed = f"from {-length / 2:g} to {length / 2:g} mm, where the beam of {length:g} mm ends"
            yield reading.problem(("zones", name), given, allowed, "move it or make it narrower")
    ordered = sorted(zones, key=lambda item: item[1].centre_mm)
    for (first, one), (second, other) in itertools.pairwise(ordered):
        if zone_edges(other)[0] < zone_edges(one)[1] - tolerance:
            given = f"a zone that begins at {zone_edges(other)[0]:g} mm, within zone {first}"
            allowed = f"from {zone_edges(one)[1]:g} mm on, where zone {first} ends"
            yield reading.problem(("zones", second), given, allowed, "move one of them or make it narrower")


def _check_actuator_sets(reading: Reading[Apparatus]) -> Iterator[Problem]:
    taken: dict[int, str] = {}
    for name, actuators in reading.items("actuator_sets"):
        if actuators.channel in taken:
            given = f"{actuators.channel}, which feeds the set {taken[actuators.channel]} already"
            remedy = "give each set an output of its own"
            yield reading.problem(("actuator_sets", name, "channel"), given, "a free output of 1, 2", remedy)
        taken.setdefault(actuators.channel, name)


def _check_modes(reading: Reading[Apparatus]) -> Iterator[Problem]:
    node = reading.find(("actuator_sets",))
    sets = list(node.content) if node is not None and isinstance(node.content, dict) else None
    lines: dict[int, int] = {}
    for index in range(_count(reading, "modes")):
        label = reading.sound("modes", index, "label")
        if label in lines:
            given = f"{label}, the label of modes[{lines[label]}] too"
            yield reading.problem(("modes", index, "label"), given, "each label once", "remove one of them")
        elif label is not None:
            lines[label] = index
        gains = reading.find(("modes", index, "gain_mm_s2_per_V"))
        named = list(gains.content) if gains is not None and isinstance(gains.content, dict) else []
        for name in named if sets is not None else ():
            if name not in (sets or ()):
                path = ("modes", index, "gain_mm_s2_per_V", name)
                yield _unknown_set(reading, path, name, sets or [], at_key=True)
        known = reading.find(("modes", index, "intervals_95", "gain_mm_s2_per_V"))
        for name in list(known.content) if known is not None and isinstance(known.content, dict) else ():
            if name not in named:
                within = ("modes", index, "intervals_95", "gain_mm_s2_per_V", name)
                yield _unknown_set(reading, within, name, named, at_key=True)
        for position, name in reading.items("modes", index, "assumed"):
            if name not in named:
                path = ("modes", index, "assumed", position)
                yield _unknown_set(reading, path, name, named, at_key=False)


def _check_unlisted(reading: Reading[Apparatus]) -> Iterator[Problem]:
    node = reading.find(("actuator_sets",))
    sets = list(node.content) if node is not None and isinstance(node.content, dict) else []
    taken = {("bending", reading.sound("modes", i, "label")): f"modes[{i}]" for i in range(_count(reading, "modes"))}
    where: tuple[str | int, ...] = ("twin", "unlisted_modes")
    for index in range(_count(reading, *where)):
        label = reading.sound(*where, index, "label")
        family = reading.sound(*where, index, "family")
        if label is not None and (family, label) in taken:
            given = f"{label}, the label of {taken[(family, label)]} too"
            yield reading.problem((*where, index, "label"), given, "each mode once", "remove one of them")
        taken.setdefault((family, label), f"twin.unlisted_modes[{index}]")
        gains = reading.find((*where, index, "gain_mm_s2_per_V"))
        for name in list(gains.content) if gains is not None and isinstance(gains.content, dict) else ():
            if name not in sets:
                yield _unknown_set(reading, (*where, index, "gain_mm_s2_per_V", name), name, sets, at_key=True)


def _count(reading: Reading[Apparatus], *path: str | int) -> int:
    node = reading.find(path)
    return len(node.content) if node is not None and isinstance(node.content, list) else 0


def _unknown_set(
    reading: Reading[Apparatus], path: tuple[str | int, ...], name: str, allowed: list[str], *, at_key: bool
) -> Problem:
    meant = suggest(name, allowed)
    kind = "a set of actuator_sets" if at_key else "a set with a gain in this mode"
    remedy = f"did you mean '{meant}'?" if meant else ""
    return reading.problem(path, f"'{name}', which is not {kind}", ", ".join(allowed), remedy, at_key=at_key)


def _check_latency(reading: Reading[Apparatus]) -> Iterator[Problem]:
    low, high = (reading.sound("generator", "trigger_latency_ms", bound) for bound in ("low", "high"))
    if low is not None and high is not None and low > high:
        path = ("generator", "trigger_latency_ms", "low")
        yield reading.problem(path, f"{low:g} ms, above the longest of {high:g} ms", f"at most {high:g}", "swap them")
