"""The session's end of the console in the terminal: starts its process, feeds it, hears what is asked."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence

from modaltouch.session.console.interface import COMMANDS, Console, Facts, NoConsole, Request
from modaltouch.session.console.keyboard import restore_terminal, save_terminal

_KEPT = 64
"""Facts kept for a terminal that takes none: each says everything, so old ones are dropped."""
_PATIENCE = 2.0
"""Longest time the process may take to give the terminal back [s]."""
_LEAVE_SCREEN = b"\x1b[?1049l\x1b[?25h"
"""Back to the terminal's own page, with its cursor."""


class TerminalConsole(NoConsole):
    """A live picture in the terminal, and its keys.

    Parameters
    ----------
    keys, screen : int
        Descriptors of the terminal: keys come from the first, the picture goes to the second.
    emergency : sequence of str
        Names of the keys that stop everything at once.
    instead : Console, optional
        Shows how the session stands once the process is gone.

    Raises
    ------
    OSError
        If the process cannot be started; the terminal is as it was.
    """

    def __init__(
        self,
        keys: int = 0,
        screen: int = 2,
        emergency: Sequence[str] = ("f12",),
        instead: Console | None = None,
    ) -> None:
        self._instead = instead or NoConsole()
        self._is_given_back = False
        self._terminal = keys
        self._screen = screen
        self._before = save_terminal(keys)
        # Numbers of their own: the process's standard input and output are the pipes.
        passed = () if sys.platform == "win32" else (os.dup(keys), os.dup(screen))
        words = [str(number) for number in passed or (keys, screen)]
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "modaltouch.session.console", *words, ",".join(emergency) or "x"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            pass_fds=passed,
        )
        for number in passed:
            os.close(number)
        self._asked: deque[Request] = deque()
        self._facts: deque[Facts] = deque(maxlen=_KEPT)
        self._wake: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._send, self._hear)]
        for thread in self._threads:
            thread.start()

    def show(self, facts: Facts) -> None:
        """Show how the session stands; a terminal that stands still is not waited for."""
        if self._process.poll() is not None:
            self._give_back()
            self._instead.show(facts)
            return
        self._facts.append(facts)
        self._wake.put(True)

    def requests(self) -> list[Request]:
        """Return what was typed since the last call."""
        requests = []
        while self._asked:
            requests.append(self._asked.popleft())
        return requests

    def close(self) -> None:
        """Have the terminal given back; do it here if the process cannot any more."""
        self._wake.put(False)
        try:
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._give_back()
        for thread in self._threads:
            thread.join(_PATIENCE)
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _give_back(self) -> None:
        """Leave the terminal as it was, whether or not the process could."""
        if self._is_given_back:
            return
        self._is_given_back = True
        if self._process.returncode != 0:
            with contextlib.suppress(OSError):
                os.write(self._screen, _LEAVE_SCREEN)
        restore_terminal(self._terminal, self._before)

    def _send(self) -> None:
        """Write facts to the process until told to end."""
        pipe = self._process.stdin
        if pipe is None:
            return
        with contextlib.suppress(OSError, ValueError):
            while self._wake.get():
                if self._facts:
                    pipe.write(json.dumps(self._facts.popleft()).encode() + b"\n")
                    pipe.flush()
        with contextlib.suppress(OSError):
            pipe.close()

    def _hear(self) -> None:
        """Keep what the process says was typed."""
        pipe = self._process.stdout
        if pipe is None:
            return
        with contextlib.suppress(OSError, ValueError):
            for line in pipe:
                asked = json.loads(line)
                if asked.get("command") in COMMANDS:
                    self._asked.append(Request(asked["command"], str(asked.get("text", "")), float(asked.get("at", 0))))
