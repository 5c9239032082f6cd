"""The connection to one generator: identity check, switching the outputs off, and reconnection."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from modaltouch.protocol import Apparatus
from modaltouch.rig import instrument_of, instruments
from modaltouch.rig.controls import Controls, Log
from modaltouch.rig.instrument import Setting
from modaltouch.rig.interface import InUse, LinkError, RigError, Unconfirmed
from modaltouch.system import SYSTEM_CLOCK, Clock

if TYPE_CHECKING:
    from modaltouch.rig.simulator import LocalClient
    from modaltouch.rig.watchdog_client import WatchdogClient

BurstPlayer: TypeAlias = "WatchdogClient | LocalClient"
"""The watchdog: holds the transport, plays bursts, and switches the outputs off if the driver cannot."""


def start_watchdog(address: str, off: str) -> BurstPlayer:
    """Start the watchdog process of an instrument; its module is imported lazily, since a twin may not need it."""
    from modaltouch.rig.watchdog_client import WatchdogClient

    return WatchdogClient(address, off)


@dataclass(frozen=True)
class Patience:
    """Timeouts and retries of the driver."""

    reply: float = 1.0  # longest wait for a reply [s]
    trigger: float = 0.1  # longest wait for the instrument to accept a trigger [s]; pyvisa-py waits one second longer
    copy: float = 15.0  # longest wait for an upload or a copy into a memory [s]
    tries: int = 4  # number of attempts to reopen a lost connection
    pause: float = 0.25  # pause before the second attempt, doubled for each further attempt [s]
    # time from reopening a connection to the next stimulus [s]: longer than any burst, relay switching or pending
    # trigger
    quarantine: float = 0.25


@dataclass(frozen=True)
class OutputState:
    """State of outputs and settings immediately before the outputs were switched off."""

    outputs: tuple[bool, ...]  # whether each output was on
    differences: tuple[str, ...] = ()  # settings that had changed
    errors: tuple[str, ...] = ()
    renewed: bool = False  # whether the connection had to be reopened and every setting applied again

    @property
    def faults(self) -> tuple[str, ...]:
        """Reasons why the stimulus played up to then is not confirmed; empty if there are none."""
        silent = [f"output {n} was off" for n, on in enumerate(self.outputs, start=1) if not on]
        return (*silent, *self.differences, *(f"the generator reports {error}" for error in self.errors))


class Connection:
    """The connection to one generator.

    `guard`, the watchdog, holds the VISA session; `log` receives every exchange and event.
    """

    def __init__(
        self,
        address: str,
        apparatus: Apparatus,
        *,
        guard: BurstPlayer,
        log: Log,
        patience: Patience,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.address = address
        self.identity = ""
        self.instrument = instrument_of(apparatus)
        self.limits = self.instrument.limits(apparatus)
        self.guard = guard
        self._expected_model = apparatus.generator.model
        self._log = log
        self.patience = patience
        self._clock = clock
        self.controls = Controls(
            guard, self.instrument, revive=self._revive, log=log, timeout=patience.reply, copy_timeout=patience.copy
        )

    def open(self) -> None:
        """Open the connection, check the instrument's model, and set it to a known state, outputs off.

        On any failure the watchdog is released: nothing was switched on, and another instrument is left as it is.
        Raises RigError if no such instrument responds, or it does not accept its settings.
        """
        try:
            self._take_over()
        except BaseException:
            self.guard.release(clean=True)
            raise

    def _take_over(self) -> None:
        """Open the connection, identify the instrument, and set it to a known state."""
        try:
            self.controls.open()
            self.identity = self.controls.ask("*IDN?")
            fields = self.identity.split(",")
            model = fields[1].strip() if len(fields) > 2 else ""
            if model != self._expected_model:
                known = ", ".join(name for each in instruments() for name in each.models)
                raise RigError(
                    f"the instrument at {self.address} says it is '{self.identity[:100]}', but the apparatus file "
                    f"names {self._expected_model}; no output was switched on; correct the address, name another "
                    "apparatus file (with `--apparatus`, or `apparatus` in the protocol), or correct generator.model "
                    f"in it (known models: {known})"
                )
            if model not in self.instrument.models:
                self._log("unknown_model", model=model, taken_for=self.instrument.models[0])
            self.controls.outputs_off()
            self.controls.clear_errors()
            self._prepare()
        except InUse as error:
            raise RigError(
                f"the generator at {self.address} is in use: {error}; it was left as it is; close the other program, "
                "or, if there is none (a lost connection may still be open), switch the generator off and on"
            ) from error
        except LinkError as error:
            way = "check that it is on and connected, and find its address"
            if "::" not in self.address:
                way = "give a VISA address such as TCPIP::192.168.1.20::INSTR, or find it"
            raise RigError(
                f"no generator answers at {self.address}: {error}; no output was switched on; {way} "
                "with `modaltouch rig list`"
            ) from error
        except Unconfirmed as error:
            raise RigError(
                f"{self.identity} at {self.address} does not accept its settings: {error}; no output was switched on; "
                "run `modaltouch rig check`"
            ) from error

    def switch_off(self, doing: str, expected: Sequence[Setting], replay: Callable[[], None]) -> OutputState:
        """Switch the outputs off, over a new connection if necessary, and return their state before.

        `doing` names the current operation in messages, `expected` are the settings compared with those read back, and
        `replay` applies all settings again, over a new connection. Raises RigError if the instrument does not confirm
        that the outputs are off.
        """
        try:
            outputs, errors = self.controls.outputs_off()
            self.guard.disarm()
            return OutputState(outputs, tuple(self.controls.differences(expected)), errors)
        except (LinkError, Unconfirmed) as error:
            self._log("connection_lost", doing=doing, reason=str(error))
        return self.restore(doing, expected, replay)

    def restore(self, doing: str, expected: Sequence[Setting], replay: Callable[[], None]) -> OutputState:
        """Reopen the connection, switch the outputs off, and apply every setting again; as `switch_off`."""
        last: Exception = LinkError("it was not tried")
        for attempt in range(self.patience.tries):
            if attempt:
                self._clock.sleep(self.patience.pause * 2 ** (attempt - 1))
            try:
                outputs, errors = self._revive()
                found = OutputState(outputs, tuple(self.controls.differences(expected)), errors, renewed=True)
                reported = self.controls.pending_errors()
                self.controls.clear_errors()
                self._prepare()
                replay()
                # A trigger in flight on the old connection would be played during this wait, with the outputs off.
                self._clock.sleep(self.patience.quarantine)
            except (LinkError, Unconfirmed) as error:
                last = error
                self._log("reconnect_failed", attempt=attempt + 1, reason=str(error))
            else:
                self._log(
                    "reconnected",
                    attempt=attempt + 1,
                    found_on=list(found.outputs),
                    found_changed=list(found.differences),
                    reported=reported,
                )
                return found
        raise RigError(
            f"{doing} failed, and so did {self.patience.tries} new connections to {self.address}: {last}; "
            f"{self._last_resort()}; check that the generator is on and connected"
        ) from last

    def _last_resort(self) -> str:
        """Try once more to switch the outputs off, and return a phrase with their known state."""
        with contextlib.suppress(LinkError, Unconfirmed):
            self._revive()
            return "the outputs are off"
        return "the outputs could not be confirmed off: SWITCH THE AMPLIFIER OFF (a watchdog process keeps trying)"

    def _revive(self) -> tuple[tuple[bool, ...], tuple[str, ...]]:
        """Reopen the connection to the same instrument and switch its outputs off; same return as `outputs_off`."""
        self.controls.open()
        identity = self.controls.ask("*IDN?")
        if identity != self.identity:
            # A single garbled reply does not make another instrument.
            identity = self.controls.ask("*IDN?")
        if identity != self.identity:
            raise RigError(
                f"{self.address} now answers as '{identity[:100]}' instead of '{self.identity}'; the outputs of the "
                "latter may be on: SWITCH THE AMPLIFIER OFF; connect one generator and start again"
            )
        found = self.controls.outputs_off()
        self.guard.disarm()
        return found

    def _prepare(self) -> None:
        """Apply the settings common to all bursts, from any previous state, outputs off."""
        self.controls.reset()
        for channel in self.instrument.channels:
            self.controls.apply_each(self.limits.quiet_settings(channel))
        self.controls.apply(self.instrument.on_all(self.instrument.commands.stopped))
