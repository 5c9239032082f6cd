"""``modaltouch`` on a pseudo-terminal whose screen is read and whose keys are typed."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[3]
ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b[()][A-Z0-9]|\x1b[=>]")


def _begin_as_at_a_terminal(slave: int) -> None:
    """Become the terminal's session leader, and restore Ctrl-C, which background jobs ignore."""
    fcntl.ioctl(slave, termios.TIOCSCTTY, 0)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Terminal:
    """A process on its own pseudo-terminal."""

    def __init__(self, words: list[str], *, size: tuple[int, int] = (80, 24), **environment: str) -> None:
        self.master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
        self.height = size[1]
        self.settings = termios.tcgetattr(slave)
        self.slave = slave
        self.process = subprocess.Popen(
            [sys.executable, "-m", "modaltouch", *words],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            cwd=ROOT,
            env={**os.environ, "TERM": "xterm-256color", **environment},
            start_new_session=True,
            preexec_fn=lambda: _begin_as_at_a_terminal(slave),
        )
        self._output = b""
        threading.Thread(target=self._drain, daemon=True).start()

    def _drain(self) -> None:
        while True:
            try:
                data = os.read(self.master, 65536)
            except OSError:
                return
            if not data:
                return
            self._output += data

    @property
    def raw(self) -> str:
        """All output to the terminal."""
        return self._output.decode("utf-8", "replace")

    @property
    def text(self) -> str:
        """The output without control sequences."""
        return ESCAPES.sub("", self.raw)

    @property
    def picture(self) -> list[str]:
        """The lines of the console's last complete picture."""
        for frame in reversed(self.raw.split("\x1b[H")):
            lines = [line.rstrip() for line in ESCAPES.sub("", frame).replace("\r", "").split("\n")]
            if len(lines) >= self.height:
                return lines
        return self.text.replace("\r", "").split("\n")

    def type(self, keys: str) -> None:
        """Type on the terminal's keyboard."""
        os.write(self.master, keys.encode())

    def wait_for(self, words: str, seconds: float = 150.0) -> None:
        """Wait until some words are in the picture."""
        self.wait_until(lambda: any(words in line for line in self.picture), f"{words!r} in the picture", seconds)

    def wait_until(self, holds: Callable[[], bool], what: str, seconds: float = 150.0) -> None:
        """Wait until a condition holds."""
        end = time.monotonic() + seconds
        while not holds():
            assert time.monotonic() < end, f"{what} did not come; the terminal shows:\n" + "\n".join(self.picture)
            time.sleep(0.02)

    def finish(self, seconds: float = 150.0) -> int:
        """Wait for the end and return the exit status."""
        return self.process.wait(seconds)

    @property
    def is_restored(self) -> bool:
        """Whether the terminal has its former settings, screen and cursor."""
        left = self.raw.rfind("\x1b[?1049l") >= self.raw.rfind("\x1b[?1049h")
        shown = self.raw.rfind("\x1b[?25h") >= self.raw.rfind("\x1b[?25l")
        return termios.tcgetattr(self.slave) == self.settings and left and shown

    def close(self) -> None:
        """End the process and close the terminal."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        os.close(self.slave)
        os.close(self.master)


@pytest.fixture
def terminal() -> Iterator[Callable[..., Terminal]]:
    """Start ``modaltouch`` with some arguments on a terminal."""
    opened: list[Terminal] = []

    def start(*words: Any, **options: Any) -> Terminal:
        opened.append(Terminal([str(word) for word in words], **options))
        return opened[-1]

    yield start
    for each in opened:
        each.close()


@pytest.fixture
def long_protocol(edit: Callable[..., Path]) -> Path:
    """Provide the demonstration with 180 trials, which a model answers in some seconds."""
    return edit("demo.yaml", ("  repetitions: 1", "  repetitions: 15"))


@pytest.fixture
def events_of() -> Callable[[Path], list[dict[str, Any]]]:
    """Return the complete lines of the only session log in a folder."""

    def read(results: Path) -> list[dict[str, Any]]:
        log = next(results.rglob("session.jsonl"))
        lines = log.read_text(encoding="utf-8").splitlines(keepends=True)
        return [json.loads(line) for line in lines if line.endswith("\n")]

    return read
