"""Console process: draws the state of the session, and sends the experimenter's requests.

``python -m modaltouch.session.console KEYS SCREEN EMERGENCY`` takes the descriptors of the terminal's input and output
and the names of the emergency keys. States are read from standard input and requests written to standard output, one
JSON object per line. The process ends with standard input, so that the terminal is restored even if the session is
killed.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
import time
from contextlib import suppress
from typing import Any, TextIO

from rich.console import Console, ConsoleDimensions
from rich.live import Live

from modaltouch.session.console.drawing import draw_session
from modaltouch.session.console.keyboard import Dialogue, Keyboard, open_keyboard
from modaltouch.system import SYSTEM_CLOCK

_KEY_WAIT = 0.1
"""Maximum wait for a key [s]."""
_REFRESH = 1.0
"""Interval of redraws, which update times and cover other output to the terminal [s]."""


News = queue.Queue[dict[str, Any] | None]
"""States to show; empty after a key press; None at the end."""


def main() -> None:
    """Run the console until the session ends."""
    keys, screen, emergency = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3].split(",")
    # Ctrl-C reaches every process of the terminal; the session handles it and then ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), _end)
    target = "CONOUT$" if sys.platform == "win32" else screen
    news: News = queue.Queue()
    dialogue = Dialogue(emergency)
    threading.Thread(target=_listen, args=(news, dialogue), daemon=True).start()
    with open(target, "w", encoding="utf-8", closefd=sys.platform == "win32") as file, open_keyboard(keys) as keyboard:
        # Read keys in a separate thread, so that they do not wait for drawing.
        threading.Thread(target=_read, args=(keyboard, dialogue, news), daemon=True).start()
        with suppress(OSError):  # the terminal is gone
            _show(news, file, dialogue)


def _show(news: News, file: TextIO, dialogue: Dialogue) -> None:
    """Draw new states until the end."""
    console = Console(file=file, force_terminal=True)
    known, came = None, 0.0
    with Live(console=console, screen=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False) as live:
        while True:
            try:
                said = [news.get(timeout=_REFRESH)]
            except queue.Empty:
                said = []
            while not news.empty():
                said.append(news.get())
            if None in said:
                return
            facts = [each for each in said if each]
            if facts:
                known, came = facts[-1], time.monotonic()
            if known is not None:
                size = os.get_terminal_size(file.fileno()) if sys.platform != "win32" else console.size
                console.size = ConsoleDimensions(max(size[0], 40), max(size[1], 12))
                since = time.monotonic() - came
                width, height = console.size
                picture = draw_session(
                    known, dialogue.prompt, width=width, height=height, since_s=since, emergency=dialogue.emergency
                )
                live.update(picture, refresh=True)


def _read(keyboard: Keyboard, dialogue: Dialogue, news: News) -> None:
    """Turn keys into requests until the terminal is gone."""
    try:
        while True:
            for key in keyboard.read(_KEY_WAIT):
                at = SYSTEM_CLOCK.now()
                request = dialogue.press(key)
                if request is not None:
                    said = {"command": request.command, "text": request.text, "at": at}
                    sys.stdout.write(json.dumps(said) + "\n")
                    sys.stdout.flush()
                news.put({})
    except (EOFError, OSError):
        news.put(None)


def _listen(news: News, dialogue: Dialogue) -> None:
    """Read states from standard input until it ends."""
    try:
        for line in sys.stdin:
            facts = json.loads(line)
            dialogue.hear(facts)
            news.put(facts)
    finally:
        news.put(None)


def _end(*_: object) -> None:
    sys.exit(0)


if __name__ == "__main__":
    main()
