"""A screen that nobody sees, for machines without one: Xvfb for as long as it is needed."""

from __future__ import annotations

import os
import select
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from modaltouch.window.interface import WindowError

_PATIENCE = 60.0
"""Longest time Xvfb may take to say which display it serves, and a tenth of it to end [s]."""


@contextmanager
def some_display(size: tuple[int, int] = (1920, 1080)) -> Iterator[str]:
    """Keep the display there is, or start a virtual one and take it down again.

    Parameters
    ----------
    size : (width, height) of int
        Size of the virtual screen [pixels].

    Yields
    ------
    str
        What is used, in words.

    Raises
    ------
    WindowError
        If there is neither a display nor Xvfb.
    """
    if sys.platform != "linux" or os.environ.get("DISPLAY"):
        yield "the screen"
        return
    with virtual_display(size) as name:
        before = os.environ.get("DISPLAY")
        os.environ["DISPLAY"] = name
        try:
            yield f"a virtual display ({name}), as there is no screen"
        finally:
            os.environ.pop("DISPLAY")
            if before is not None:
                os.environ["DISPLAY"] = before


@contextmanager
def virtual_display(size: tuple[int, int] = (1920, 1080), *options: str) -> Iterator[str]:
    """Run Xvfb on a display number of its own choice and give its name, such as ``:1``.

    Parameters
    ----------
    size : (width, height) of int
        Size of the screen [pixels].
    *options : str
        Further options of Xvfb.

    Raises
    ------
    WindowError
        If Xvfb is absent or does not start.
    """
    program = shutil.which("Xvfb")
    if program is None:
        raise WindowError("there is no display, and no Xvfb to make one: install xvfb, or log in at a screen")
    reading, writing = os.pipe()
    # -noreset keeps it alive between clients.
    command = [
        program,
        "-displayfd",
        str(writing),
        "-screen",
        "0",
        f"{size[0]}x{size[1]}x24",
        "-nolisten",
        "tcp",
        "-noreset",
        *options,
    ]
    server = subprocess.Popen(command, pass_fds=(writing,), stderr=subprocess.DEVNULL)
    os.close(writing)
    try:
        ready, _, _ = select.select([reading], [], [], _PATIENCE)
        number = os.read(reading, 16).decode().strip() if ready else ""
        if not number:
            how = "ended at once" if ready else f"did not start within {_PATIENCE:g} s"
            raise WindowError(f"{program} {how}; run `{program} -displayfd 1` by hand to see why")
        yield f":{number}"
    finally:
        os.close(reading)
        server.terminate()
        try:
            server.wait(_PATIENCE / 10)
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()
