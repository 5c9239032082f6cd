"""Screens and timing while the fingers are measured: independent of the result."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from modaltouch.session import probing
from modaltouch.session.probing import Probing


class Room:
    """A window that notes its screens, a log that notes its lines, and a clock set by hand."""

    def __init__(self) -> None:
        self.shown: list[Any] = []
        self.lines: list[str] = []
        self.time = 0.0

    def now(self) -> float:
        return self.time

    def append(self, event: str, **facts: Any) -> None:
        self.lines.append(event)

    def announce(self, message: str) -> None:
        self.shown.append(message)

    def settle(self, *where: Any) -> None:
        self.shown.append("settle")

    def show_measuring(self, duration: float) -> None:
        self.shown.append(duration)


def test_hands_off_once_per_block_and_again_after_a_refusal() -> None:
    """A pause comes before each measurement."""
    room, refusals = Room(), ["something moved"]

    def hands_off() -> dict[str, Any]:
        if refusals:
            raise ValueError(refusals.pop())
        return {}

    prober: Any = SimpleNamespace(hands_off=hands_off, speed=0.015, laser=0.049)
    anything: Any = SimpleNamespace()
    parts: Any = room
    measuring = Probing(anything, prober, anything, parts, parts, parts)
    for index in (1, 2):
        trial: Any = SimpleNamespace(block=1, index=index)
        measuring.lift_hands(trial)
    assert room.shown == ["hands_off", 1.0, "hands_off", 1.0]
    assert room.lines == ["hands_off", "probe_refused", "probe"]


@pytest.mark.parametrize(("taken", "left"), [(0.0, 2.0), (0.75, 1.25), (3.0, 0.0)])
def test_the_wait_after_a_measurement_hides_the_design_time(
    monkeypatch: pytest.MonkeyPatch, taken: float, left: float
) -> None:
    """At least two seconds from the measurement, so that slower designs are not recognisable."""
    room, loaded = Room(), []
    design = SimpleNamespace(stimulus=SimpleNamespace(burst=SimpleNamespace(content_hash="")), sound=(), attainable=60)

    def designed(*given: Any) -> Any:
        room.time += taken
        place = SimpleNamespace(placement=lambda condition: "A-C")
        return SimpleNamespace(findings=place, parts={"": SimpleNamespace(placed={"A-C": design})})

    monkeypatch.setattr(probing, "with_measured", designed)
    expected: Any = SimpleNamespace(
        findings=SimpleNamespace(placements=SimpleNamespace(expected=lambda *condition: None))
    )
    prober: Any = SimpleNamespace(hands_on=lambda expected: {}, predict=dict, speed=0.015, laser=0.049)
    rig: Any = SimpleNamespace(load=lambda *bursts: loaded.extend(bursts))
    condition = SimpleNamespace(finger_condition="one_hand", zones=("A", "C"), placement="normal")
    trial: Any = SimpleNamespace(condition=condition, as_dict=dict)
    parts: Any = room
    Probing(expected, prober, rig, parts, parts, parts).measure(trial, (1, 1))
    assert room.shown == [1.0, "settle", left]
    assert loaded == [design.stimulus.burst]
