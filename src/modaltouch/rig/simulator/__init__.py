"""The twin, a simulated rig on the loopback interface: generator behind a VXI-11 server, amplifier, beam, fingers.

``modaltouch rig simulate`` runs one in a separate process.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol import Apparatus
from modaltouch.rig.pacing import Order, Pacer, Report
from modaltouch.rig.simulator.afg import afg_twin
from modaltouch.rig.simulator.common import Behaviour, Reply, State
from modaltouch.rig.simulator.timeline import Delays, Playback
from modaltouch.rig.simulator.twin import Twin
from modaltouch.system import SYSTEM_CLOCK, Clock, VirtualClock

if TYPE_CHECKING:
    from modaltouch.rig.simulator.faults import Faults
    from modaltouch.rig.simulator.motion import TrueState
    from modaltouch.rig.simulator.scope import SimulatedScope
    from modaltouch.rig.simulator.scpi import CommandTable
    from modaltouch.rig.simulator.session_files import FollowedSession, PlayedLog
    from modaltouch.rig.simulator.vxi11 import Vxi11Server
    from modaltouch.stimulus import Finger


def twin_of(model: str) -> Callable[..., tuple[Any, CommandTable]]:
    """Return the factory of state and command table for a generator model; that of an AFG3022B for unknown models."""
    if model.startswith("AFG"):
        return afg_twin
    from modaltouch.rig.simulator.keysight33500b import keysight_twin

    twins = {
        "33522B": keysight_twin,
        "33512B": keysight_twin,
    }
    return twins.get(model, afg_twin)


class Simulator(AbstractContextManager["Simulator"]):
    """The twin of a rig, accessed like a real one via its VISA address.

    Parameters
    ----------
    apparatus : Apparatus
        The simulated apparatus; its section ``twin`` specifies how the true beam differs from the identified one.
    seed : int, optional
        Seed; by default that in ``twin``.
    port : int
        TCP port on 127.0.0.1; 0 for any free port.
    behaviour : Behaviour, optional
        Behaviour of the real generator that is not publicly known.
    clock : Clock
        Clock of playback; the transport waits in real time.
    played : Path, optional
        File to which a line is appended when a burst ends; times are those of `clock`.
    follow : Path, optional
        Log of the session that uses the twin, in any process; its placements give the positions of the fingers.
    sends : tuple of Playback or None, optional
        Output of the channels, overriding the generator's settings.

    Raises
    ------
    InputError
        If the file `played` cannot be written, or `follow` is a folder.

    Attributes
    ----------
    afg : Afg or Trueform
        State of the generator, of the model named in the apparatus; an AFG3022B for unknown models.
    twin : Twin
        True beam and amplifier, whose protection disables its output while ``tripped``.
    """

    def __init__(
        self,
        apparatus: Apparatus,
        seed: int | None = None,
        *,
        port: int = 0,
        behaviour: Behaviour | None = None,
        clock: Clock = SYSTEM_CLOCK,
        played: Path | None = None,
        follow: Path | None = None,
        sends: tuple[Playback | None, ...] | None = None,
    ) -> None:
        self.apparatus = apparatus
        true, seed = apparatus.twin.generator, apparatus.twin.seed if seed is None else seed
        latency = true.trigger_latency_ms.low * 1e-3, true.trigger_latency_ms.high * 1e-3
        delays = Delays(latency, true.relay_ms * 1e-3, true.external_pulses_Hz)
        model, hardware = apparatus.generator.model, {"delays": delays, "seed": seed, "clock": clock}
        self.afg: Any
        self.afg, self.afg.table = twin_of(model)(model, behaviour, **hardware)
        self.twin = Twin(apparatus, seed)
        self._touched: dict[str, Finger] = {}
        self._played: PlayedLog | None = None
        self._followed: FollowedSession | None = None
        if follow is not None or played is not None:
            from modaltouch.rig.simulator.session_files import FollowedSession, PlayedLog

            self._followed = None if follow is None else FollowedSession(follow, apparatus)
            if played is not None:
                self._played = PlayedLog(played, self.twin, self.afg.settle, lambda: self.touched)
                self.afg.timeline.on_burst = self._played.take
        self._port = port
        self._sends = sends

    @cached_property
    def server(self) -> Vxi11Server:
        """VXI-11 server, started on first use; it can drop connections, reject new ones and listen again."""
        from modaltouch.rig.simulator.vxi11 import Vxi11Server

        return Vxi11Server(self.afg, self._port)

    @cached_property
    def faults(self) -> Faults:
        """Faults, which can be injected at any time."""
        from modaltouch.rig.simulator.faults import Faults

        return Faults(self.afg)

    @property
    def address(self) -> str:
        """VISA address."""
        return self.server.address

    @property
    def socket_address(self) -> str:
        """VISA address of the raw socket."""
        return f"TCPIP::127.0.0.1::{self.server.port}::SOCKET"

    @property
    def driver_options(self) -> dict[str, Any]:
        """Arguments of `Generator` for this twin: in virtual time neither a server nor a watchdog process."""
        clock = self.afg.clock
        if not isinstance(clock, VirtualClock):
            return {"address": self.address, "clock": clock}
        client = LocalClient(self.afg, clock)
        return {"address": "simulated", "clock": clock, "start_guard": lambda address, off: client}

    @property
    def outputs(self) -> tuple[bool, ...]:
        """Whether each output is on."""
        return tuple(channel.output for channel in self.afg.channels.values())

    def felt_velocity(self, places: Sequence[str | float]) -> NDArray[np.float64]:
        """Return the peak speed under the fingers for the current output.

        Parameters
        ----------
        places : sequence of str or float
            Names of zones, or positions, origin at mid-beam [m]. For a zone, the position of its finger in the followed
            session is used, or otherwise its centre.

        Returns
        -------
        (n_places,) array
            Highest speed over one burst [m/s]; 0 while no output is on or no bursts are played.

        Raises
        ------
        ValueError
            If there is no such zone.
        """
        if self.twin.tripped:
            return np.zeros(len(places))
        if self._followed is None:
            return self.twin.felt(self.playbacks, [self.position(place) for place in places])
        fingers = self.touched
        positions = [fingers[str(each)].position if str(each) in fingers else self.position(each) for each in places]
        return self.twin.felt(self.playbacks, positions, touched=tuple(fingers.values()))

    def true_state(self, instant: float, *, first: bool = False) -> TrueState:
        """Return the true state of the beam at an instant of the current burst, as a reference for measurements.

        Parameters
        ----------
        instant : float
            Time since a trigger [s]; the first sample leaves the generator at 0.
        first : bool
            Whether the burst starts from rest rather than after many bursts.
        """
        return self.twin.true_state(self.playbacks, instant, first=first, touched=tuple(self.touched.values()))

    def scope(self) -> SimulatedScope:
        """Return the vibrometer and scope at this beam; equal seeds give equal noise."""
        from modaltouch.rig.simulator.scope import SimulatedScope

        playing, touched = (lambda: self.playbacks), (lambda: tuple(self.touched.values()))
        return SimulatedScope(self.twin, playing, touched, self.afg.timeline)

    @property
    def playbacks(self) -> tuple[Playback | None, ...]:
        """Current output of each channel."""
        if self._sends is not None:
            return self._sends
        return tuple(self.afg.playback(number) for number in self.afg.channels)

    def on_beam(self, apparatus: Apparatus, seed: int | None = None) -> Simulator:
        """Return a twin with another beam, driven by the current output; equal seeds give equal beams."""
        return Simulator(apparatus, seed, sends=self.playbacks)

    def touch(self, places: Sequence[str | float]) -> None:
        """Replace the fingers on the beam for all further measurements; none if `places` is empty."""
        from modaltouch.stimulus import Finger

        at = {str(place): self.position(place) for place in places}
        fingers = self.twin.fingers(*at.values()) or [Finger(position) for position in at.values()]
        self._touched = dict(zip(at, fingers, strict=True))

    @property
    def touched(self) -> dict[str, Finger]:
        """Fingers on the beam, by zone or position: those of the followed session, or otherwise those of `touch`."""
        return self._touched if self._followed is None else self._followed.fingers()

    def position(self, place: str | float) -> float:
        """Return the centre of a zone, or the given position [m]."""
        if not isinstance(place, str):
            return float(place)
        zone = self.apparatus.zones.get(place)
        if zone is None:
            known = ", ".join(self.apparatus.zones)
            raise ValueError(f"'{place}' is not a zone of this beam: name one of {known}, or a position in metres")
        return zone.centre_mm * 1e-3

    def front_panel(self, command: str) -> str:
        """Execute a command as if entered at the front panel, and return the reply to a query."""
        return str(self.afg.run(command.encode(), 0).data.decode("latin1").removesuffix("\n"))

    def power_cycle(self) -> None:
        """Power-cycle the generator: connections and settings are lost, outputs off, USER memories kept."""
        self.afg.power_on()
        if "server" in vars(self):
            self.server.drop_connections()

    def close(self) -> None:
        """Stop serving and switch the generator off."""
        if "server" in vars(self):
            self.server.close()
        self.afg.power_off()
        if self._played is not None:
            self._played.close()
            self._played = None

    def serve(self) -> None:
        """Serve until SIGINT or SIGTERM, then close; the first lines on standard output are the addresses."""
        ended = threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: ended.set())
        with self:
            sys.stdout.write(f"{self.address}\n{self.socket_address}\n")
            sys.stdout.flush()
            while not ended.wait(0.5):  # Windows notices Ctrl-C only between two waits
                pass

    def __exit__(self, *exc: object) -> None:
        self.close()


ROUNDING = 1e-9
"""Tolerance for rounding in sums of virtual times [s]."""


class LocalClient:
    """Watchdog client of a driver in the same process, in virtual time: no network, and no process to watch.

    It cannot outlive its process and is therefore only for a twin in the same process.
    """

    def __init__(self, instrument: State, clock: VirtualClock) -> None:
        self._instrument = instrument
        self._clock = clock
        self._pacer: Pacer | None = None
        self._start = instrument.n_starts

    def open(self) -> str:
        """Begin a connection, and return how other programs are locked out."""
        self._start = self._instrument.n_starts
        return "no other program can reach it"

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> bytes:
        """Have a message executed and return the reply, if one is expected, without waiting for one that is late."""
        is_open = self._start == self._instrument.n_starts
        received = self._instrument.execute(message) if is_open else Reply(hang_up=True)
        if received.hang_up:
            raise ConnectionResetError("the instrument closed the connection")
        if reply and (not received.data or received.delay > timeout):
            raise TimeoutError(f"no reply within {timeout:g} s")
        return received.data if reply else b""

    def do_nothing(self, **_: bool) -> None:
        """Do nothing, since nothing is held and no other process watches this one."""

    arm = disarm = close = release = do_nothing

    def held_up(self) -> float:
        """Return 0, since nothing stalls in virtual time."""
        return 0.0

    def beat(self) -> str:
        """Return the reason if the bursts ended without a request, else an empty string."""
        return self.look().lost

    def play(self, order: Order) -> Report:
        """Schedule bursts, advance the time until the first is played, and return the report."""
        message = order.command.encode() + b"\n"

        def trigger() -> None:
            self.exchange(message, timeout=order.timeout, reply=False)

        def step() -> None:
            pacer.step()
            if pacer.due is not None:
                self._clock.call_at(pacer.due, step)

        pacer = self._pacer = Pacer(order, trigger, self.held_up, self._clock)
        self._clock.call_at(order.first, step)
        self._clock.sleep(order.first - self._clock.now() + ROUNDING)
        return pacer.report

    def look(self) -> Report:
        """Return the report so far."""
        return Report() if self._pacer is None else self._pacer.report

    def end(self) -> None:
        """Trigger no further burst."""
        if self._pacer is not None:
            self._pacer.end()

    def report(self, *, wait: bool) -> Report:
        """Trigger no further burst and return the report; with `wait`, after the end of the last burst."""
        if self._pacer is not None:
            self._pacer.end()
            self._pacer.step()
            if wait:
                self._clock.sleep(self._pacer.silent_from - self._clock.now())
        return self.look()
