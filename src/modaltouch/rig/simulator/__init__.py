"""A whole rig on the loopback interface: generator behind a VXI-11 server, amplifier, beam, fingers.

``modaltouch rig simulate`` runs one in a process of its own. Beside the
instrument, ``inst0`` of its address, others reach its front panel, ``panel0``: past the lock of whoever uses the
instrument, as a person who stands before it.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol import Apparatus
from modaltouch.rig.simulator.commands import afg_twin
from modaltouch.rig.simulator.instrument import Faults, SimulatedInstrument
from modaltouch.rig.simulator.state import Behaviour
from modaltouch.rig.simulator.timeline import Delays, Playback
from modaltouch.rig.simulator.twin import TrueState, Twin
from modaltouch.rig.simulator.vxi11 import Vxi11Server
from modaltouch.system import SYSTEM_CLOCK, Clock, VirtualClock

if TYPE_CHECKING:
    from modaltouch.rig.simulator.followed import FollowedSession
    from modaltouch.rig.simulator.played import PlayedLog
    from modaltouch.rig.simulator.scope import SimulatedScope
    from modaltouch.rig.simulator.scpi import CommandTable
    from modaltouch.stimulus import Finger


def twin_of(model: str) -> Callable[..., tuple[Any, CommandTable]]:
    """Return what makes the state of a model of generator and its table; the AFG3022B stands for those not known."""
    if model.startswith("AFG"):
        return afg_twin
    from modaltouch.rig.simulator.keysight33500b import keysight_twin

    return {"33522B": keysight_twin, "33512B": keysight_twin}.get(model, afg_twin)


class Simulator:
    """The digital twin of a rig, reached like a real one through its VISA address.

    Parameters
    ----------
    apparatus : Apparatus
        What is on the table; its section ``twin`` says how the true beam differs from the identified one.
    seed : int, optional
        Instead of the seed in ``twin``.
    port : int
        TCP port on 127.0.0.1; 0 takes a free one.
    behaviour : Behaviour, optional
        What is not publicly known of the real generator.
    clock : Clock
        By which it plays; its transport waits in real time.
    played : Path, optional
        File that gets a line for each burst when it ends; times are those of `clock`.
    follow : Path, optional
        Log of the session that plays, in whatever process: its placements say there where fingers lie.
    sends : tuple of Playback or None, optional
        What the outputs send, instead of what the generator is told.

    Raises
    ------
    InputError
        If the file cannot be written.

    Attributes
    ----------
    afg : Afg or Trueform
        State of the generator: that of the model which the apparatus names, an AFG3022B for one that is not known.
    twin : Twin
        Amplifier, whose protection cuts its output while it is ``tripped``, and true beam.
    faults : Faults
        What goes wrong, switchable at any time.
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
        self.afg, table = twin_of(model)(model, behaviour, **hardware)
        self.faults = Faults()
        self.twin = Twin(apparatus, seed)
        self._touched: dict[str, Finger] = {}
        self._played: PlayedLog | None = None
        self._followed: FollowedSession | None = None
        if follow is not None:
            from modaltouch.rig.simulator.followed import FollowedSession

            self._followed = FollowedSession(follow, apparatus)
        if played is not None:
            from modaltouch.rig.simulator.played import PlayedLog

            self._played = PlayedLog(played, self.twin, self.afg.settle, lambda: self.touched)
            self.afg.timeline.told = self._played.take
        self._instrument = SimulatedInstrument(self.afg, table, self.faults)
        self._port = port
        self._sends = sends

    @cached_property
    def server(self) -> Vxi11Server:
        """What serves it from when it is first asked for: drops connections, refuses new ones, listens again."""
        return Vxi11Server(self._instrument, self._port)

    @property
    def address(self) -> str:
        """VISA address."""
        return self.server.address

    @property
    def socket_address(self) -> str:
        """VISA address of its raw socket."""
        return f"TCPIP::127.0.0.1::{self.server.port}::SOCKET"

    @property
    def driver_options(self) -> dict[str, Any]:
        """What `Generator` is to be given for this twin: its clock, and in virtual time no watchdog process."""
        clock = self.afg.clock
        if not isinstance(clock, VirtualClock):
            return {"clock": clock}
        from modaltouch.rig.pacing import LocalClient
        from modaltouch.rig.visa import VisaSession

        # No other program knows of this twin; one that had the same port before may still hold the address's lock.
        return {
            "clock": clock,
            "start_guard": lambda address, off: LocalClient(VisaSession(address, shares=True), clock),
        }

    @property
    def outputs(self) -> tuple[bool, ...]:
        """Whether each output is on."""
        return tuple(channel.output for channel in self.afg.channels.values())

    def felt_velocity(self, places: Sequence[str | float]) -> NDArray[np.float64]:
        """Return the peak speed that fingers feel now.

        Parameters
        ----------
        places : sequence of str or float
            Names of zones (their centres are taken, unless a finger lies elsewhere in them in the session that is
            followed) or positions, origin at mid-beam [m].

        Returns
        -------
        (n_places,) array
            Highest speed over one burst [m/s]; 0 while no output is on or no burst comes.

        Raises
        ------
        ValueError
            If there is no such zone.
        """
        if self._followed is None:
            return self.twin.felt(self.playbacks, [self.position(place) for place in places])
        laid = self.touched
        positions = [laid[str(each)].position if str(each) in laid else self.position(each) for each in places]
        return self.twin.felt(self.playbacks, positions, touched=tuple(laid.values()))

    def true_state(self, instant: float, *, first: bool = False) -> TrueState:
        """Return what the beam really does at an instant of the burst that plays now, to judge measurements by.

        Parameters
        ----------
        instant : float
            From a trigger, when the first sample leaves the generator unless it is set to wait [s].
        first : bool
            Whether the burst starts from rest; else it is one after many.
        """
        return self.twin.true_state(self.playbacks, instant, first=first, touched=tuple(self.touched.values()))

    def scope(self) -> SimulatedScope:
        """Return the vibrometer and the scope that stand at this beam; equal seeds give equal noise."""
        from modaltouch.rig.simulator.scope import SimulatedScope

        playing, touched = (lambda: self.playbacks), (lambda: tuple(self.touched.values()))
        return SimulatedScope(self.twin, playing, touched, self.afg.timeline)

    @property
    def playbacks(self) -> tuple[Playback | None, ...]:
        """What each output sends now."""
        if self._sends is not None:
            return self._sends
        return tuple(self.afg.playback(number) for number in self.afg.channels)

    def on_beam(self, apparatus: Apparatus, seed: int | None = None) -> Simulator:
        """Return another beam under what this generator sends now; equal seeds give equal beams."""
        return Simulator(apparatus, seed, sends=self.playbacks)

    def touch(self, places: Sequence[str | float]) -> None:
        """Lay fingers on the beam for whatever is measured from now on; nowhere for an empty sequence."""
        from modaltouch.stimulus import Finger

        at = {str(place): self.position(place) for place in places}
        laid = self.twin.fingers(*at.values()) or [Finger(position) for position in at.values()]
        self._touched = dict(zip(at, laid, strict=True))

    @property
    def touched(self) -> dict[str, Finger]:
        """Fingers on the beam, by zone or position: those of the session that is followed, else as they were laid."""
        return self._touched if self._followed is None else self._followed.fingers()

    def position(self, place: str | float) -> float:
        """Return the centre of a zone, or the position that is given [m]."""
        if not isinstance(place, str):
            return float(place)
        zone = self.apparatus.zones.get(place)
        if zone is None:
            known = ", ".join(self.apparatus.zones)
            raise ValueError(f"'{place}' is not a zone of this beam: name one of {known}, or a position in metres")
        return zone.centre_mm * 1e-3

    def front_panel(self, command: str) -> str:
        """Do at the instrument what a command says, and return the reply of a query."""
        return self._instrument.perform(command.encode()).data.decode("latin1").removesuffix("\n")

    def power_cycle(self) -> None:
        """Cut the generator's power: connections gone, settings lost, outputs off, USER memories kept."""
        self.afg.power_on()
        self.server.drop_connections()

    def close(self) -> None:
        """Stop serving, and switch the generator off."""
        if "server" in vars(self):
            self.server.close()
        self.afg.power_off()
        if self._played is not None:
            self._played.close()
            self._played = None

    def serve(self) -> None:
        """Serve until SIGINT or SIGTERM, and close; its addresses are the first lines on standard output."""
        ended = threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: ended.set())
        with self:
            sys.stdout.write(f"{self.address}\n{self.socket_address}\n")
            sys.stdout.flush()
            while not ended.wait(0.5):  # Windows hears of Ctrl-C between two waits alone
                pass

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
