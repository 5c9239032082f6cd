"""Protocol x apparatus: zones, modes and levels that the protocol asks for and the apparatus must have."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.document import Problem, Reading, suggest
from modaltouch.protocol.masking import check_masking
from modaltouch.protocol.sections import Protocol

LEAST_SAMPLES_PER_CYCLE = 2.5
"""Fewest samples to a cycle of the highest modelled mode: the 2 of the sampling theorem and a quarter to spare [1]."""


def check_fit(protocol: Reading[Protocol], apparatus: Reading[Apparatus]) -> list[Problem]:
    """Return what a protocol asks for that its apparatus has not, as far as the sound parts of both show it."""
    return [
        *_check_zones(protocol, apparatus),
        *_check_modes(protocol, apparatus),
        *_check_delay(protocol, apparatus),
        *_check_levels(protocol, apparatus),
        *check_masking(protocol, apparatus),
    ]


def _names(apparatus: Reading[Apparatus], key: str) -> list[str] | None:
    node = apparatus.find((key,))
    return list(node.content) if node is not None and isinstance(node.content, dict) else None


def _check_zones(protocol: Reading[Protocol], apparatus: Reading[Apparatus]) -> Iterator[Problem]:
    zones = _names(apparatus, "zones")
    if zones is None:
        return
    focus = protocol.sound("stimulus", "focus")
    if focus is not None and focus not in zones:
        yield _unknown_zone(protocol, ("stimulus", "focus"), focus, zones)
    for index, further in protocol.items("stimulus", "further_foci"):
        if further not in zones:
            yield _unknown_zone(protocol, ("stimulus", "further_foci", index), further, zones)
    pairs = protocol.find(("conditions", "zone_pairs"))
    n_pairs = len(pairs.content) if pairs is not None and isinstance(pairs.content, list) else 0
    for index in range(n_pairs):
        path = ("conditions", "zone_pairs", index)
        unknown = [(position, name) for position, name in protocol.items(*path) if name not in zones]
        for position, name in unknown:
            yield _unknown_zone(protocol, (*path, position), name, zones)
        pair = protocol.sound(*path)
        if pair is None or unknown or pair[0] == pair[1]:
            continue
        left, right = (apparatus.sound("zones", name, "centre_mm") for name in pair)
        if left is not None and right is not None and left >= right:
            given = f"[{pair[0]}, {pair[1]}], whose left zone {pair[0]} lies right of {pair[1]}"
            yield protocol.problem(path, given, "the left zone first", f"write [{pair[1]}, {pair[0]}]")


def _unknown_zone(protocol: Reading[Protocol], path: tuple[str | int, ...], name: str, zones: list[str]) -> Problem:
    meant = suggest(name, zones)
    remedy = f"did you mean '{meant}'?" if meant else ""
    return protocol.problem(path, f"'{name}', which is not a zone of this beam", ", ".join(zones), remedy)


def _check_modes(protocol: Reading[Protocol], apparatus: Reading[Apparatus]) -> Iterator[Problem]:
    modes = apparatus.find(("modes",))
    if modes is None or not isinstance(modes.content, list):
        return
    n_modes = len(modes.content)
    labels = [apparatus.sound("modes", index, "label") for index in range(n_modes)]
    selection = protocol.sound("stimulus", "selected_modes")
    if isinstance(selection, int) and selection > n_modes:
        given = f"{selection}, more than the {n_modes} modelled modes"
        path = ("stimulus", "selected_modes")
        yield protocol.problem(path, given, f"1 to {n_modes}", "select fewer or add modes to the apparatus")
    if None not in labels:
        for index, label in protocol.items("stimulus", "selected_modes"):
            if label not in labels:
                given = f"{label}, which is not a modelled mode"
                allowed = ", ".join(str(known) for known in labels)
                yield protocol.problem(("stimulus", "selected_modes", index), given, allowed)
    yield from _check_sampling(protocol, apparatus, n_modes)


def _check_sampling(protocol: Reading[Protocol], apparatus: Reading[Apparatus], n_modes: int) -> Iterator[Problem]:
    n_samples, duration = (protocol.sound("stimulus", key) for key in ("n_samples", "duration_ms"))
    known = [apparatus.sound("modes", index, "natural_frequency_Hz") for index in range(n_modes)]
    highest: Any = max((value for value in known if value is not None), default=None)
    if n_samples is None or duration is None or highest is None:
        return
    # Records are even; what rounding adds to an even bound shall not ask for two samples more.
    least = 2 * math.ceil(LEAST_SAMPLES_PER_CYCLE * highest * duration * 1e-3 / 2 * (1 - 1e-12))
    if n_samples < least:
        given = f"{n_samples} samples in {duration:g} ms, too few for the mode of {highest:g} Hz"
        remedy = "take more samples, shorten the burst or leave the mode out of the apparatus"
        yield protocol.problem(("stimulus", "n_samples"), given, f"at least {least}", remedy)


def _check_delay(protocol: Reading[Protocol], apparatus: Reading[Apparatus]) -> Iterator[Problem]:
    delay = apparatus.sound("amplifier", "delay_us")
    instant = protocol.sound("stimulus", "focusing_instant_ms")
    if delay is not None and instant is not None and delay >= instant * 1e3:
        given = f"{delay:g} us, past the focusing instant of {instant:g} ms"
        allowed = f"below {instant * 1e3:g} us, so that the drive reaches the beam by then"
        yield apparatus.problem(("amplifier", "delay_us"), given, allowed, "write the delay in microseconds")


def _check_levels(protocol: Reading[Protocol], apparatus: Reading[Apparatus]) -> Iterator[Problem]:
    limit = apparatus.sound("safety", "velocity_limit_mm_s")
    for index, velocity in protocol.items("conditions", "peak_velocities_mm_s"):
        if limit is not None and velocity > limit:
            given = f"{velocity:g} mm/s, beyond the safety limit of the apparatus"
            path = ("conditions", "peak_velocities_mm_s", index)
            yield protocol.problem(path, given, f"at most {limit:g} mm/s", "lower the level")
