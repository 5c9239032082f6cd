"""The session's end of the watchdog: starts its process and keeps it informed."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
import typing

from modaltouch.rig.interface import RigError
from modaltouch.rig.watchdog import ARM, BEAT, CLEAN, DISARM, LIMIT, OPEN

BEAT_PERIOD = LIMIT / 10
"""Time between two signs of life [s]."""


class Guard(typing.Protocol):
    """What the driver asks of a watchdog."""

    def attach(self) -> None:
        """The instrument is reached, and may be opened a second time."""

    def arm(self) -> None:
        """Outputs may go on from now."""

    def beat(self) -> None:
        """The session is alive."""

    def disarm(self) -> None:
        """Outputs are off."""

    def release(self, *, clean: bool) -> None:
        """End it; unless clean, it switches the outputs off first."""


class Watchdog:
    """A process that switches the outputs off when this one dies or stalls.

    Parameters
    ----------
    address : str
        VISA address.
    visa_library : str
        Backend, as PyVISA names it.
    """

    def __init__(self, address: str, visa_library: str) -> None:
        # A session of its own keeps it out of reach of a closed terminal and of Ctrl-C.
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "modaltouch.rig.watchdog", address, visa_library],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                bufsize=0,
                start_new_session=True,
                env=_environment(),
            )
        except OSError as error:
            raise RigError(
                f"the watchdog process cannot be started ({error}), so the generator at {address} was not "
                f"touched; see whether this machine can start {sys.executable}"
            ) from error
        self._said: list[str] = []
        self._heard = threading.Event()
        self._reader = threading.Thread(target=self._listen, daemon=True, name="watchdog")
        self._reader.start()
        self._next_beat = 0.0
        self._armed = False

    @property
    def said(self) -> tuple[str, ...]:
        """What the watchdog has reported."""
        return tuple(self._said)

    def attach(self) -> None:
        """Let it open the instrument: were it first, an instrument that admits one session would be taken.

        Raises
        ------
        RigError
            If it is gone.
        """
        self._send(OPEN)

    def arm(self, patience: float = 20.0) -> None:
        """Make sure that it watches, then tell it that outputs may go on.

        Raises
        ------
        RigError
            If it does not start, or is gone.
        """
        if not self._heard.wait(patience) or self._process.poll() is not None:
            raise RigError(
                f"the watchdog process {self._process.pid} does not run (exit status {self._process.poll()}), "
                "so no output is switched on; the outputs are off; see whether this machine can start processes"
            )
        self._armed = True
        self._next_beat = time.perf_counter() + BEAT_PERIOD
        self._send(ARM)

    def beat(self) -> None:
        """Tell it that this process is alive, at most ten times a second.

        Raises
        ------
        RigError
            If it is gone while outputs may be on.
        """
        now = time.perf_counter()
        if self._armed and now >= self._next_beat:
            self._next_beat = now + BEAT_PERIOD
            self._send(BEAT)

    def disarm(self) -> None:
        """Tell it that the outputs are off."""
        if self._armed:
            self._armed = False
            with contextlib.suppress(RigError):
                self._send(DISARM)

    def release(self, *, clean: bool) -> None:
        """Let it go, without waiting for what it still has to do."""
        with contextlib.suppress(RigError):
            if clean:
                self._send(CLEAN)
        pipe = self._process.stdin
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()
        reaper = threading.Thread(target=self._reap, daemon=True, name="watchdog-reaper")
        reaper.start()
        if clean:
            reaper.join(2.0)

    def _reap(self) -> None:
        """Wait for its end, so that no zombie and no open pipe is left."""
        self._process.wait()
        self._reader.join()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _send(self, letter: bytes) -> None:
        pipe = self._process.stdin
        try:
            if pipe is None or pipe.closed:
                raise BrokenPipeError("closed")
            pipe.write(letter)
        except OSError as error:
            raise RigError(
                f"the watchdog process {self._process.pid} is gone (exit status {self._process.poll()}); the "
                "outputs are being switched off; start the session again with `modaltouch resume`"
            ) from error

    def _listen(self) -> None:
        stream = self._process.stdout
        if stream is None:
            return
        with contextlib.suppress(ValueError, OSError):
            for line in iter(stream.readline, b""):
                self._said.append(line.decode("ascii", "replace").strip())
                self._heard.set()
        self._heard.set()


def _environment() -> dict[str, str]:
    """Return the environment with this process's module path, in case the package is not installed."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
