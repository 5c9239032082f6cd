"""Fixtures: a simulator on the loopback interface for each test, and a burst that is short enough to be sent often."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.connection import Patience
from modaltouch.rig.generator import Generator
from modaltouch.rig.simulator import LocalClient, Simulator
from modaltouch.rig.simulator.common import Behaviour
from modaltouch.rig.visa import VisaSession
from modaltouch.stimulus.burst import Burst
from modaltouch.system.clock import VirtualClock

APPARATUS = Path(__file__).parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"


class Heard:
    """Keep the events that a driver logs, in order, and refuse those that a session log could not store."""

    def __init__(self) -> None:
        self.events: list[tuple[str, dict[str, Any]]] = []

    def __call__(self, event: str, **facts: Any) -> None:
        json.dumps(facts, allow_nan=False)
        self.events.append((event, facts))

    def of(self, event: str) -> list[dict[str, Any]]:
        """Return the facts of one kind of event."""
        return [facts for kind, facts in self.events if kind == event]

    @property
    def sent(self) -> list[str]:
        """Every message that was sent."""
        return [facts["sent"] for facts in self.of("scpi")]

    def clear(self) -> None:
        """Discard all events."""
        self.events.clear()


class QuietGuard(LocalClient):
    """A stand-in for the watchdog process in tests of other things: VISA session and pacer in this process.

    It replaces the function that starts a watchdog as well: called with an address, it is the watchdog for it.
    """

    def __init__(self, clock: VirtualClock) -> None:
        super().__init__(SimpleNamespace(n_starts=0), clock)
        self.told: list[str] = []

    def __call__(self, address: str, off: str) -> QuietGuard:
        self._session = session = VisaSession(address)
        self.open, self.exchange, self.close = session.open, session.exchange, session.close
        return self

    def arm(self, *, free_running: bool) -> None:
        self.told.append("arm")

    def disarm(self) -> None:
        self.told.append("disarm")

    def release(self, *, clean: bool) -> None:
        self._session.release()
        self.told.append("clean" if clean else "left watching")


@pytest.fixture
def rng() -> np.random.Generator:
    """Return random numbers that are the same in every run."""
    return np.random.default_rng(20240607)


@pytest.fixture(scope="session")
def apparatus() -> Apparatus:
    """Return the shipped apparatus."""
    return Apparatus.read(APPARATUS)


@pytest.fixture
def clock() -> VirtualClock:
    """Return the virtual clock of driver and twin."""
    return VirtualClock(100.0)


@pytest.fixture
def simulator(apparatus: Apparatus, clock: VirtualClock) -> Iterator[Simulator]:
    """Return a running simulator in virtual time."""
    with Simulator(apparatus, clock=clock) as running:
        yield running


@pytest.fixture
def single_link(apparatus: Apparatus) -> Iterator[Simulator]:
    """Return a simulator that admits one session."""
    with Simulator(apparatus, behaviour=Behaviour(max_sessions=1)) as simulator:
        yield simulator


@pytest.fixture
def heard() -> Heard:
    """Return a log that keeps its events."""
    return Heard()


@pytest.fixture
def guard(clock: VirtualClock) -> QuietGuard:
    """Return the stand-in for the watchdog that `open_generator` uses."""
    return QuietGuard(clock)


@pytest.fixture
def patience() -> Patience:
    """Return timeouts short enough for many faults in a test."""
    return Patience(reply=0.2, trigger=1.0, copy=0.4, tries=2, pause=0.02)


@pytest.fixture
def open_generator(
    apparatus: Apparatus, simulator: Simulator, heard: Heard, guard: QuietGuard, patience: Patience, clock: VirtualClock
) -> Iterator[Callable[..., Generator]]:
    """Return a function that opens the driver on the simulator; every driver is closed afterwards."""
    opened: list[Generator] = []

    def open_one(**options: Any) -> Generator:
        defaults = {
            "log": heard,
            "patience": patience,
            "start_guard": guard,
            "clock": clock,
        }
        opened.append(Generator(simulator.address, apparatus, **(defaults | options)))
        return opened[-1]

    yield open_one
    for generator in opened:
        generator.close()


@pytest.fixture
def generator(open_generator: Callable[..., Generator]) -> Generator:
    """Return the driver, open on the simulator."""
    return open_generator()


@pytest.fixture
def loaded(generator: Generator, burst: Burst, heard: Heard) -> Generator:
    """Return the driver with the burst loaded and the log empty."""
    generator.load(burst)
    heard.clear()
    return generator


def make_burst(n_samples: int = 2500, seed: int = 0, amplitude: tuple[float, ...] = (12.0, 8.0)) -> Burst:
    """Return a smooth random burst of 50 ms, at rest at both ends, for 200 mm/s."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 1, n_samples)
    waves = rng.uniform(-1, 1, (len(amplitude), 8)) @ np.sin(np.pi * np.arange(1, 9)[:, None] * time)
    waves = waves * np.sin(np.pi * time) ** 2
    waves = waves / np.abs(waves).max(axis=1, keepdims=True)
    codes = np.round(8191 + 8191 * waves).astype(np.uint16)
    codes[:, [0, -1]] = 8191
    return Burst(codes, 0.05, 7.0, 0.2, amplitude, AFG3022B.converter)


@pytest.fixture
def burst() -> Burst:
    """Return a short burst."""
    return make_burst()


@pytest.fixture
def make() -> Callable[..., Burst]:
    """Return a function that makes bursts of other lengths, contents and amplitudes."""
    return make_burst
