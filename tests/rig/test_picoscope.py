"""The PicoScope adapter against a transcript of Pico's library.

The transcript follows the maker's header ps3000aApi.h and its block example; it was not recorded from an instrument.
"""

from __future__ import annotations

import ctypes
import sys
import time
from typing import Any

import numpy as np
import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.interface import RigError
from modaltouch.rig.scope import Acquisition, PicoScope
from modaltouch.system import SYSTEM_CLOCK

FULL_SCALE = 32512
HANDLE = 16384


class Library:
    """A stand-in for Pico's library at the process boundary: logs every call, and answers like a 3404D."""

    def __init__(self, **statuses: int) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.statuses = statuses
        self.buffers: dict[int, Any] = {}
        self.overflow = 0
        self.polls = 1
        self.counts = {0: 8128, 1: -16256, 2: 32512}

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("ps3000a"):
            raise AttributeError(name)

        def call(*arguments: Any) -> int:
            plain = tuple(each for each in arguments if isinstance(each, int | float | None))
            self.calls.append((name.removeprefix("ps3000a"), *plain))
            getattr(self, f"on_{name.removeprefix('ps3000a')}", lambda *_: None)(*arguments)
            return self.statuses.get(name.removeprefix("ps3000a"), 0)

        return call

    def on_OpenUnit(self, handle: Any, serial: None) -> None:  # noqa: N802
        handle._obj.value = HANDLE

    def on_GetUnitInfo(self, handle: Any, text: Any, size: int, needed: Any, what: int) -> None:  # noqa: N802
        text.value = {3: b"3404D", 4: b"GQ123/0042"}[what]

    def on_MaximumValue(self, handle: Any, value: Any) -> None:  # noqa: N802
        value._obj.value = FULL_SCALE

    def on_GetTimebase2(self, handle: Any, base: int, n: int, interval: Any, *_: Any) -> None:  # noqa: N802
        interval._obj.value = (base - 2) * 8.0

    def on_IsReady(self, handle: Any, ready: Any) -> None:  # noqa: N802
        self.polls -= 1
        ready._obj.value = self.polls <= 0

    def on_SetDataBuffer(self, handle: Any, channel: int, buffer: Any, n: int, *_: Any) -> None:  # noqa: N802
        self.buffers[channel] = (buffer, n)

    def on_GetValues(self, handle: Any, start: int, n: Any, ratio: int, mode: int, segment: int, over: Any) -> None:  # noqa: N802
        over._obj.value = self.overflow
        for channel, (buffer, size) in self.buffers.items():
            for index in range(size):
                buffer[index] = self.counts[channel]


TRANSCRIPT: list[tuple[Any, ...]] = [
    ("SetChannel", 0, 1, 1, 8, 0.0),  # A: on, DC, 5 V, for 200 mm/s at 50 mm/s per V
    ("SetChannel", 1, 1, 1, 7, 0.0),  # B: 2 V, for 180 V through a probe of 100 : 1
    ("SetChannel", 2, 0, 1, 10, 0.0),  # C and D: off
    ("SetChannel", 3, 0, 1, 10, 0.0),
    ("GetTimebase2", 252, 100, 1, 0),  # 125 MHz / (252 - 2) = 500 kHz
    ("SetSimpleTrigger", 1, 4, 6553, 2, 0, 0),  # EXT, 1 V, rising, no delay, waits for ever
    ("RunBlock", 20, 80, 252, 1, None, 0, None, None),  # 40 us before the trigger
    ("IsReady",),
    ("IsReady",),
    ("SetDataBuffer", 0, 100, 0, 0),
    ("SetDataBuffer", 1, 100, 0, 0),
    ("GetValues", 0, 1, 0, 0),
]


def test_calls_match_the_transcript(apparatus: Apparatus) -> None:
    """Settings, trigger and one record, in the order and with the numbers of the maker's header and example."""
    library = Library()
    with PicoScope(apparatus, driver=library) as scope:
        library.calls.clear()
        library.polls = 2
        scope.configure(
            Acquisition(sampling_rate=500e3, n_samples=100, start=-40e-6, velocity_range=0.2, drive_range=180.0)
        )
        seen = scope.measure(0.015)
        assert library.calls == TRANSCRIPT
    assert library.calls[-2:] == [("Stop",), ("CloseUnit",)]
    assert scope.identity == "PicoScope 3404D, serial GQ123/0042"
    assert seen.time[[0, 20]] == pytest.approx([-40e-6, 0.0], abs=1e-12)
    # A quarter of 5 V at 50 mm/s per V; minus half of 2 V through 100 : 1.
    np.testing.assert_allclose(seen.velocity, np.full((1, 100), 0.0625))
    np.testing.assert_allclose(seen.drive, np.full((1, 1, 100), -100.0))


def test_a_burst_is_recorded_without_waiting_for_it(apparatus: Apparatus) -> None:
    """Armed immediately and fetched later, at the vibrometer's present position; armed again if no burst came."""
    library = Library()
    with PicoScope(apparatus, driver=library) as scope:
        scope.configure(Acquisition(n_samples=100, drives=()))
        library.calls.clear()
        scope.arm()
        assert [call[0] for call in library.calls] == ["RunBlock"]
        scope.arm()
        assert [call[0] for call in library.calls] == ["RunBlock", "Stop", "RunBlock"]
        seen = scope.fetch(0.049)
        assert [call[0] for call in library.calls[3:]] == ["IsReady", "SetDataBuffer", "GetValues"]
    assert (seen.velocity.shape, seen.position) == ((1, 100), 0.049)


@pytest.mark.parametrize("probe", ["configure", "time_trigger"])
def test_a_pending_trigger_is_cancelled_before_new_settings(apparatus: Apparatus, probe: str) -> None:
    """A unit that still waits for its trigger is stopped first: an aborted trial does not affect the next one."""
    library = Library()
    with PicoScope(apparatus, driver=library) as scope:
        scope.arm()
        library.calls.clear()
        if probe == "configure":
            scope.configure(Acquisition(n_samples=100))
        else:
            scope.time_trigger(lambda: None)
        assert [call[0] for call in library.calls[:2]] == ["Stop", "SetChannel"]
        assert library.calls.count(("Stop",)) == 1


def test_every_call_passes_the_handle(apparatus: Apparatus) -> None:
    """The handle from OpenUnit is the first argument of every other call."""
    handles = []

    class Watching(Library):
        def __getattr__(self, name: str) -> Any:
            call = super().__getattr__(name)
            return lambda *arguments: handles.append(arguments[0]) or call(*arguments)

    with PicoScope(apparatus, driver=Watching()):
        pass
    assert all(isinstance(handle, ctypes.c_int16) and handle.value == HANDLE for handle in handles[1:])


def test_drives_and_records_are_kept_separate(apparatus: Apparatus) -> None:
    """Input B is drive 1 and C is drive 2; an overload bit of any record identifies its input."""
    library = Library()
    library.overflow = 0b100
    with PicoScope(apparatus, driver=library) as scope:
        scope.configure(Acquisition(n_samples=10, n_records=3, drives=(1, 2)))
        seen = scope.measure(0.0)
    assert seen.velocity.shape == (3, 10)
    assert seen.drive.shape == (3, 2, 10)
    np.testing.assert_allclose(seen.drive[2, :, 0], [-1000.0, 2000.0])
    assert seen.overloaded == ("drive 2",)


def test_a_later_start_is_a_delay_after_the_trigger(apparatus: Apparatus) -> None:
    """24 ms at 1.25 MS/s are 30,000 samples of delay, and the time axis starts at 24 ms."""
    library = Library()
    with PicoScope(apparatus, driver=library) as scope:
        library.calls.clear()
        scope.configure(Acquisition(sampling_rate=1.25e6, n_samples=50, start=0.024, drives=()))
        seen = scope.measure(0.0)
    assert ("SetSimpleTrigger", 1, 4, 6553, 2, 30_000, 0) in library.calls
    assert ("RunBlock", 0, 50, 102, 1, None, 0, None, None) in library.calls
    assert seen.time[0] == pytest.approx(0.024, rel=1e-6)
    assert seen.drive.shape == (1, 0, 50)


def test_a_scope_on_usb_power_can_be_used(apparatus: Apparatus) -> None:
    """Status 282 at opening is answered by ChangePowerSource with the same number, as in the maker's example."""
    library = Library(OpenUnit=282)
    with PicoScope(apparatus, driver=library):
        assert ("ChangePowerSource", 282) in library.calls


@pytest.mark.parametrize(
    ("statuses", "words"),
    [
        ({"OpenUnit": 3}, "no PicoScope 3000 is found: connect it by USB"),
        ({"OpenUnit": 5}, r"does not open \(status 5"),
        ({"MaximumValue": 12}, r"refuses MaximumValue \(status 12"),
        ({"GetTimebase2": 21}, r"refuses GetTimebase2 \(status 21.*131072 samples of 2 channels do not fit its memory"),
    ],
)
def test_failures_at_opening_give_a_remedy(apparatus: Apparatus, statuses: dict[str, int], words: str) -> None:
    """Every status but success is a `RigError`, and a unit that was opened is closed."""
    library = Library(**statuses)
    with pytest.raises(RigError, match=words):
        PicoScope(apparatus, driver=library)
    assert ("OpenUnit" in statuses) != (("CloseUnit",) in library.calls)


def test_a_missing_trigger_is_an_error(apparatus: Apparatus) -> None:
    """The scope is stopped, and the message mentions the wiring."""
    library = Library()
    with PicoScope(apparatus, driver=library, trigger_wait=0.01) as scope:
        scope.configure(Acquisition(n_samples=10))
        library.polls = 10**9
        with pytest.raises(RigError, match="no trigger came within 0.01.* wire the generator's trigger output"):
            scope.measure(0.0)
        assert ("Stop",) in library.calls


def test_a_missing_library_is_an_error_only_when_a_scope_is_opened(
    apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Importing the adapter does not load Pico's library; the error gives the package to install."""
    assert "picosdk" not in sys.modules
    monkeypatch.setitem(sys.modules, "picosdk.ps3000a", None)
    with pytest.raises(RigError, match="cannot be used here .* install the package picosdk"):
        PicoScope(apparatus)


def test_a_trigger_is_timed_between_two_queries(apparatus: Apparatus) -> None:
    """A trigger 30 ms after the command is within the interval, whose width is the duration of one query."""
    library = Library()
    began: list[float] = []

    def send() -> None:
        time.sleep(0.03)
        began.append(SYSTEM_CLOCK.now())

    def is_ready(handle: Any, ready: Any) -> None:
        ready._obj.value = bool(began) and SYSTEM_CLOCK.now() >= began[0] + 100e-6

    with PicoScope(apparatus, driver=library) as scope:
        library.on_IsReady = is_ready  # type: ignore[method-assign]
        early, late = scope.time_trigger(send)
    assert early <= began[0] <= late
    assert ("RunBlock", 0, 100, 127, 1, None, 0, None, None) in library.calls  # 1 MHz: 125 MHz / (127 - 2)


def test_a_trigger_that_cannot_be_sent_is_an_error(apparatus: Apparatus) -> None:
    """The generator's error reaches the caller instead of an endless wait."""

    def send() -> None:
        raise RigError("the link is gone")

    library = Library()
    with PicoScope(apparatus, driver=library, trigger_wait=0.01) as scope:
        library.polls = 10**9
        with pytest.raises(RigError, match="the link is gone"):
            scope.time_trigger(send)
