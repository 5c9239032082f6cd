"""The program as its user meets it: a command line in, exit status and words out."""

from __future__ import annotations

import io
import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from modaltouch.__main__ import main

ROOT = Path(__file__).parents[2]
RECORDS = ROOT / "tests" / "record" / "format_2"
COMPLETE = "records/simulated/demo/sub-sim01/ses-1"
UNFINISHED = "records/simulated/demo/sub-p02/ses-1"


@dataclass(frozen=True)
class Outcome:
    """What a command line came to."""

    status: int
    stdout: str
    stderr: str


class _Stream(io.TextIOWrapper):
    """Text kept in memory, also from those who write bytes; Ctrl-C is pressed as soon as certain words are in it."""

    def __init__(self, interrupt_at: str = "") -> None:
        self._kept = io.BytesIO()
        self._awaited = interrupt_at
        super().__init__(self._kept, encoding="utf-8", newline="", write_through=True)

    def write(self, text: str) -> int:
        written = super().write(text)
        if self._awaited and self._awaited in self.text:
            self._awaited = ""
            signal.raise_signal(signal.SIGINT)
        return written

    @property
    def text(self) -> str:
        self.flush()
        return self._kept.getvalue().decode()


def call(line: str, *, interrupt_at: str = "") -> Outcome:
    """Return what ``modaltouch`` does with the words of a line, in this process and without a terminal.

    Parameters
    ----------
    line : str
        The words after ``modaltouch``, as a shell reads them.
    interrupt_at : str
        Words on standard error at which Ctrl-C is pressed.
    """
    stdout, stderr = _Stream(), _Stream(interrupt_at)
    environment = {"COLUMNS": "100", "TERM": "dumb", "NO_COLOR": "1"}
    if line == "doctor --json":
        # It opens a window on a display of its own, and no further one could be opened in this process.
        command = [sys.executable, "-m", "modaltouch", *shlex.split(line)]
        done = subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, check=False)
        return Outcome(done.returncode, done.stdout, done.stderr)
    status: object = 0
    with (
        mock.patch.dict(os.environ, environment),
        mock.patch.object(sys, "argv", ["modaltouch"]),
        mock.patch.object(
            sys.modules["__main__"], "__package__", None, create=True
        ),  # by which usage names the program
        redirect_stdout(stdout),
        redirect_stderr(stderr),
    ):
        try:
            main(shlex.split(line))
        except SystemExit as left:
            status = left.code or 0
    assert isinstance(status, int), f"modaltouch {line}: the exit status is {status!r}"
    return Outcome(status, stdout.text, stderr.text)


@contextmanager
def workplace(folder: Path) -> Iterator[Path]:
    """Work in a new folder with copies of the shipped ``protocols`` and of ``records`` made by an earlier version."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copytree(ROOT / "protocols", folder / "protocols")
    shutil.copytree(RECORDS, folder / "records")
    with chdir(folder):
        yield folder


def change(file: Path, *changes: tuple[str, str]) -> Path:
    """Replace texts in a file, each of which stands there once, and return it."""
    text = file.read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in {file.name}"
        text = text.replace(old, new)
    file.write_text(text, encoding="utf-8", newline="\n")
    return file
