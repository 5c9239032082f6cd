"""An instrument that fails at any instant of a stimulus: nothing of it is ever confirmed.

``MODALTOUCH_DEATHS=1000`` tries 1000 failures instead of 60.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.connection import Patience
from modaltouch.rig.generator import Generator
from modaltouch.rig.interface import Firing, RigError, StimulusLost
from modaltouch.rig.player import RELAYS_SETTLE, Repetition
from modaltouch.rig.simulator import LocalClient, Simulator
from modaltouch.rig.visa import VisaSession
from modaltouch.stimulus.burst import Burst
from modaltouch.system.clock import VirtualClock

N_DEATHS = int(os.environ.get("MODALTOUCH_DEATHS", "60"))
N_TOGETHER = 20

REPETITIONS: tuple[Repetition, ...] = ("single", "single", "single", "single", "timer", "continuous")

N_MESSAGES = 12
"""Approximate number of exchanges of a stimulus, without its triggers."""


class Ward(VisaSession):
    """A link to an instrument that may fail at an instant or just before a message.

    Parameters
    ----------
    simulator : Simulator
        The instrument.
    clock : VirtualClock
        The clock of both.
    """

    def __init__(self, simulator: Simulator, clock: VirtualClock) -> None:
        super().__init__(simulator.address)
        self._simulator = simulator
        self._clock = clock
        self._frozen = False
        self._left = -1
        self.kind = ""
        self.died = False

    def condemn(self, kind: str, *, after: float | None = None, messages: int = -1) -> None:
        """Let the instrument fail in a given way, after a time [s] or a number of messages."""
        self.kind, self._left = kind, messages
        if after is not None:
            self._clock.call_at(self._clock.now() + after, self._die)

    def discharge(self) -> None:
        """Cancel the failure."""
        if self.died and self.kind in ("power cut", "cable out"):
            self._simulator.server.listen()
        self.kind, self._left, self._frozen = "", -1, False

    def _die(self) -> None:
        if not self.kind:
            return
        self.died = True
        if self.kind == "freeze":
            self._frozen = True
            return
        if self.kind in ("power cut", "cable out"):
            self._simulator.server.refuse()
        if self.kind == "cable out":
            self._simulator.server.drop_connections()
        else:
            self._simulator.power_cycle()

    def open(self) -> str:
        if self._frozen:
            raise TimeoutError("no answer")
        return super().open()

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> bytes:
        # The timer is stopped after the end was confirmed with the outputs off: a failure then has no effect.
        if self._left == 0 and not message.startswith(b":TRIG:SOUR EXT"):
            self._die()
        self._left -= 1
        if self._frozen:
            self._clock.sleep(timeout)
            raise TimeoutError("no answer")
        return super().exchange(message, timeout=timeout, reply=reply)


KINDS = ("power cut", "power cycle", "cable out", "freeze")


@dataclass(frozen=True)
class End:
    """The outcome of a stimulus: whether the instrument failed before its end was confirmed, and the firing."""

    seed: int
    kind: str
    died: bool
    firing: Firing | None


def client_of(ward: Ward, simulator: Simulator, clock: VirtualClock) -> LocalClient:
    """Return a client in this process whose messages take the link."""
    client = LocalClient(simulator.afg, clock)
    client.open, client.exchange, client.close = ward.open, ward.exchange, ward.close
    client.release = lambda clean: ward.release()
    return client


def play(seed: int, simulator: Simulator, apparatus: Apparatus, clock: VirtualClock, burst: Burst) -> End:
    """Play bursts; the instrument fails at a random instant (half of the seeds) or before a random message."""
    rng = random.Random(seed)
    ward, n_bursts = Ward(simulator, clock), rng.randint(1, 14)
    length = RELAYS_SETTLE + n_bursts / burst.repetition_rate
    rig = Generator(
        simulator.address,
        apparatus,
        patience=Patience(reply=0.2, copy=0.4, tries=2, pause=0.02),
        repetition=rng.choice(REPETITIONS),
        start_guard=lambda address, off: client_of(ward, simulator, clock),
        clock=clock,
    )
    with rig:
        rig.load(burst)
        kind = rng.choice(KINDS)
        if seed % 2:
            ward.condemn(kind, after=rng.uniform(0.0, length + 0.02))
        else:
            ward.condemn(kind, messages=rng.randrange(N_MESSAGES + n_bursts))
        end = clock.now() + length + 0.01
        try:
            started = rig.fire(0.1, n_bursts=n_bursts, exactly=rng.random() < 0.5).started
            while started and clock.now() < end:
                clock.sleep(0.02)
                rig.heartbeat()
            rig.stop()
        except StimulusLost:
            stop_lost(rig)
        except RigError:
            pass
        told = End(seed, kind, ward.died, rig.firing)
        ward.discharge()
    return told


def stop_lost(rig: Generator) -> None:
    """Stop a stimulus that is known to be lost."""
    try:
        rig.stop()
    except RigError:
        return


@pytest.mark.parametrize("first", range(0, N_DEATHS, N_TOGETHER))
def test_a_failing_instrument_confirms_nothing(
    first: int, simulator: Simulator, apparatus: Apparatus, clock: VirtualClock, make: Callable[..., Burst]
) -> None:
    """Power cut, power cycle, cable out, freeze: unconfirmed with a reason; after the end they do not matter."""
    burst = make(n_samples=200)
    ends = [play(seed, simulator, apparatus, clock, burst) for seed in range(first, first + N_TOGETHER)]
    for end in ends:
        assert end.firing is not None
        assert end.firing.confirmed is not end.died, end
        assert bool(end.firing.reason) is end.died, end
    assert sum(end.died for end in ends) > N_TOGETHER / 2
