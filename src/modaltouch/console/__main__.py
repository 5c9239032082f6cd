"""The console's own process: draws how the session stands, and sends what the experimenter types.

``python -m modaltouch.console KEYS SCREEN EMERGENCY`` with the descriptors of the terminal's two sides and the names
of the keys for emergencies. Facts come on standard input and requests go to standard output, a JSON object a line.
It ends when standard input does: so the terminal is given back even if the session was killed.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
import time
from typing import Any, TextIO

from rich.console import Console, ConsoleDimensions
from rich.live import Live

from modaltouch.console.dialogue import Dialogue
from modaltouch.console.drawing import draw_session
from modaltouch.console.keyboard import Keyboard, open_keyboard

_GLANCE = 0.1
"""How soon what has changed is drawn, if no key comes first [s]."""
_REFRESH = 1.0
"""The picture is drawn anew this often, for its clock, and over what else was written to the terminal [s]."""


def main() -> None:
    """Show and ask until the session ends."""
    keys, screen, emergency = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3].split(",")
    # Ctrl-C goes to every process of the terminal; it is the session that ends by it, and ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), _end)
    facts: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(facts,), daemon=True).start()
    target = "CONOUT$" if sys.platform == "win32" else screen
    with open(target, "w", encoding="utf-8", closefd=sys.platform == "win32") as file, open_keyboard(keys) as keyboard:  # noqa: PTH123
        try:
            _show(facts, file, keyboard, Dialogue(emergency))
        except (EOFError, OSError):
            return  # the terminal is gone


def _show(
    facts: queue.SimpleQueue[dict[str, Any] | None], file: TextIO, keyboard: Keyboard, dialogue: Dialogue
) -> None:
    console = Console(file=file, force_terminal=True)
    known = facts.get()
    with Live(console=console, screen=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False) as live:
        came = drawn = 0.0
        is_new = True
        while known is not None:
            now = time.monotonic()
            if is_new:
                came = now
            if is_new or now - drawn > _REFRESH:
                size = os.get_terminal_size(file.fileno()) if sys.platform != "win32" else console.size
                console.size = ConsoleDimensions(max(size[0], 40), max(size[1], 12))
                picture = draw_session(
                    known, dialogue.prompt, width=console.size[0], since_s=now - came, emergency=dialogue.emergency
                )
                live.update(picture, refresh=True)
                drawn, is_new = now, False
            for key in keyboard.read(_GLANCE):
                is_new = True
                request = dialogue.press(key)
                if request is not None:
                    sys.stdout.write(json.dumps({"command": request.command, "text": request.text}) + "\n")
                    sys.stdout.flush()
            while not facts.empty():
                known, is_new = facts.get(), True
                if known is None:
                    return


def _listen(facts: queue.SimpleQueue[dict[str, Any] | None]) -> None:
    """Take facts from standard input until it ends."""
    try:
        for line in sys.stdin:
            facts.put(json.loads(line))
    finally:
        facts.put(None)


def _end(*_: object) -> None:
    sys.exit(0)


if __name__ == "__main__":
    main()
