"""The arbitrary function generator over PyVISA: AFG3022B and its relatives.

The outputs are off whenever no stimulus is wanted, whatever happens: after every failure they are switched off
and asked whether they are, and the watchdog process, which holds the VISA session, does it where this one cannot.
After a failed exchange an answer may belong to an earlier question, so the session is opened anew, the instrument
identified, its outputs switched off and every setting made again.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Self

from modaltouch.apparatus import Apparatus
from modaltouch.rig.connection import Connection, Found, Patience
from modaltouch.rig.controls import CHANNELS, Unconfirmed
from modaltouch.rig.guard import Guard, Watchdog
from modaltouch.rig.interface import Firing, RigError
from modaltouch.rig.link import Log
from modaltouch.rig.player import Player, Repetition, numbers
from modaltouch.rig.transport import LinkError
from modaltouch.stimulus.burst import Burst


def _ignore(event: str, **facts: Any) -> None:
    """Take an event and forget it."""


class Generator:
    """A generator with its two outputs, as a `modaltouch.rig.interface.Rig`.

    Parameters
    ----------
    address : str
        VISA address; ``@ivi`` after it takes the vendor's VISA library.
    apparatus : Apparatus
        Model, load, amplifier and limits.
    log : callable
        ``log(event, **facts)`` takes every exchange and event.
    patience : Patience
        How long to wait.
    repetition : str, optional
        ``burst`` or ``continuous``, instead of what the apparatus says.
    start_guard : callable
        Starts the watchdog for an address.

    Raises
    ------
    RigError
        If there is no such instrument at the address.
    """

    def __init__(
        self,
        address: str,
        apparatus: Apparatus,
        *,
        log: Log = _ignore,
        patience: Patience | None = None,
        repetition: Repetition | None = None,
        start_guard: Callable[[str], Guard] = Watchdog,
    ) -> None:
        self._log = log
        self._firing: Firing | None = None
        self._on = False
        self._closed = False
        self._connection = Connection(
            address,
            apparatus,
            guard=start_guard(address),
            log=log,
            patience=patience or Patience(),
        )
        repetition = repetition or apparatus.generator.repetition
        self._player = Player(self._connection.controls, self._connection.limits, repetition)
        try:
            self._connection.open()
        except BaseException:
            # No output was ever on, so the watchdog has nothing to do.
            self._connection.close(clean=True)
            raise

    @property
    def identity(self) -> str:
        """Reply to ``*IDN?``."""
        return self._connection.identity

    @property
    def address(self) -> str:
        """VISA address."""
        return self._connection.address

    @property
    def firing(self) -> Firing | None:
        """The latest firing; unconfirmed if `stop` found settings or outputs no longer as set."""
        return self._firing

    def set_levels(self, amplitudes: tuple[float, ...]) -> tuple[str, ...]:
        """Set both amplitudes, read them and the error queue back: all that a change of level is.

        Parameters
        ----------
        amplitudes : tuple of float
            Of each channel, open circuit [V peak to peak].

        Returns
        -------
        tuple of str
            What was read back.
        """
        return self._player.set_levels(amplitudes)

    def load(self, burst: Burst, *further: Burst) -> None:
        """Have both channels' records in the instrument, verified, and set everything but the level.

        Parameters
        ----------
        burst : Burst
            One record for each of the two outputs.
        *further : Burst
            More bursts to choose from when firing, as many as the memories hold: two where all records differ.

        Raises
        ------
        RigError
            If the instrument does not confirm it; the outputs are off.
        """
        bursts = (burst, *further)
        odd = next((each for each in bursts if each.codes.shape[0] != len(CHANNELS)), None)
        if odd is not None:
            raise RigError(
                f"the burst has {odd.codes.shape[0]} channels: the generator has {len(CHANNELS)}; the "
                "outputs are off; give each output an actuator set in the apparatus file"
            )
        self.stop()
        with self._off_after_a_failure("loading the stimulus"):
            self._player.take(bursts)
            try:
                self._player.replay()
            except LinkError:
                self._connection.restore("loading the stimulus", (), self._player.replay)

    def fire(self, velocity: float, *, silent: bool = False, which: int = 0) -> Firing:
        """Set the level, switch the outputs on and repeat the burst until `stop`.

        Parameters
        ----------
        velocity : float
            Peak velocity at the focus [m/s].
        silent : bool
            Whether no burst is let go, in a catch trial: the outputs are on, at the level's amplitude, and rest.
        which : int
            Which of the bursts that were loaded, from 0.

        Returns
        -------
        Firing
            Not confirmed, and the outputs off, if the instrument did not confirm a setting, or the connection
            was lost and found again: the trial is to be offered again.

        Raises
        ------
        RigError
            If nothing is loaded, the level is beyond a limit, or the instrument is lost; the outputs are off.
        """
        commanded = self._player.amplitudes(velocity, which)
        if self._on:
            self.stop()
        with self._off_after_a_failure("starting the stimulus"):
            self._on = True
            try:
                self._connection.guard.arm()
                self._player.choose(which)
                firing = self._player.start(commanded, silent=silent)
            except (Unconfirmed, LinkError) as error:
                firing = _unconfirmed(commanded, error)
                self._log("unconfirmed", reason=firing.reason)
                self._switch_off("starting the stimulus")
                if isinstance(error, Unconfirmed):
                    # Whoever changed a setting is to find it as it was for the next try.
                    self._connection.restore("starting the stimulus", (), self._player.replay)
        self._firing = firing
        return firing

    def stop(self) -> None:
        """Switch both outputs off, confirm it, and see whether everything still was as set.

        Raises
        ------
        RigError
            If the instrument cannot be brought to confirm it.
        """
        was_on = self._on
        found = self._switch_off("switching the outputs off")
        if was_on and found.faults and self._firing is not None:
            reason = "; ".join(found.faults) + " when the stimulus ended"
            self._firing = replace(self._firing, confirmed=False, reason=reason)
            self._log("unconfirmed", reason=reason)
        if was_on and found.differences:
            self._connection.restore("making the settings again", (), self._player.replay)

    def heartbeat(self) -> None:
        """Tell the watchdog that the session is alive; costs well under a microsecond between two beats.

        Raises
        ------
        RigError
            If the watchdog is gone while outputs may be on; they have been switched off.
        """
        try:
            self._connection.guard.beat()
        except LinkError as error:
            self._switch_off("going on without a watchdog")
            raise RigError(
                f"{error}; the outputs are off, switched off over a new one; go on with `modaltouch resume`"
            ) from error

    def close(self) -> None:
        """Switch the outputs off and release the instrument; never raises.

        If the outputs cannot be confirmed off, the watchdog stays and keeps trying.
        """
        if self._closed:
            return
        self._closed = True
        off = False
        try:
            self.stop()
            off = True
            with contextlib.suppress(LinkError, Unconfirmed):
                self._player.unlock()
        # Whatever fails, a full disk under the log included: the watchdog is left to do it.
        except Exception as error:
            with contextlib.suppress(Exception):
                self._log("close_failed", reason=str(error))
        finally:
            self._connection.close(clean=off)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _switch_off(self, doing: str) -> Found:
        """Switch the outputs off and stop the trigger; return how they were found."""
        was_on, self._on = self._on, False
        expected = self._player.expected if was_on else ()
        found = self._connection.switch_off(doing, expected, self._player.replay)
        if was_on:
            # With the outputs off a trigger moves nothing, and the next start sees whether it is stopped.
            with contextlib.suppress(LinkError, Unconfirmed):
                self._player.stop_trigger()
        return found

    @contextlib.contextmanager
    def _off_after_a_failure(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (LinkError, Unconfirmed) as error:
            self._switch_off(doing)
            raise RigError(
                f"{doing} failed: {error}; the outputs are off; see `modaltouch rig check`, then go on with "
                "`modaltouch resume`"
            ) from error
        except BaseException:
            if self._on:
                self._switch_off(doing)
            raise


def _unconfirmed(commanded: tuple[float, ...], error: Exception) -> Firing:
    read_back = numbers(error.read_back) if isinstance(error, Unconfirmed) else ()
    return Firing(commanded, read_back, False, time.perf_counter(), 0.0, str(error))
