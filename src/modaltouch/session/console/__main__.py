"""Console process: draws the state of the session, reads single keys, and sends the experimenter's requests.

``python -m modaltouch.session.console KEYS SCREEN EMERGENCY`` takes the descriptors of the terminal's input and output
and the names of the emergency keys. States are read from standard input and requests written to standard output, one
JSON object per line. The process ends with standard input, so that the terminal is restored even if the session is
killed.

Most keys act at once; a note is typed as text, and stopping requires confirmation. If the experimenter enters the
answers, their keys work here too while a trial is on. The console's keys keep their meaning then: `x` is always the
emergency stop.
"""

from __future__ import annotations

import codecs
import json
import os
import queue
import re
import select
import signal
import sys
import termios
import textwrap
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, TextIO

from rich.console import Console, ConsoleDimensions, Group, RenderableType
from rich.live import Live
from rich.rule import Rule
from rich.text import Text

from modaltouch.session.console import AT_ONCE, Command, Request, SessionState, describe_last, describe_time
from modaltouch.session.console.consoles import restore_terminal
from modaltouch.system import SYSTEM_CLOCK

STATES = {
    "waiting": "between trials",
    "trial": "trial on",
    "paused": "PAUSED",
    "break": "break",
    "ended": "ended",
}
HELP = ("p pause", "space go on", "r repeat", "n note", "b end after block", "q stop")
_DIRECTIONS = ("up", "down", "right", "left")
_ARROWS = {name: f"{name} arrow" for name in _DIRECTIONS}
_NAMES = 14
"""Width of the column of names [characters]."""


def draw_session(
    facts: SessionState, prompt: str, *, width: int, height: int = 24, since_s: float = 0.0, emergency: str = "f12"
) -> RenderableType:
    """Render the state of a session, `since_s` seconds after it was sent, for a terminal of a size in characters.

    `prompt` is the line that prompts the experimenter or echoes a key, and `emergency` the name of the emergency key.
    """
    mode = "" if facts["mode"] == "real" else f"[{facts['mode'].upper()}] "
    head = f"{mode}{facts['participant']}, session {facts['session']}, {facts['protocol']}"
    state = STATES.get(str(facts["state"]), str(facts["state"]))
    foot = [
        *_wrap("   ".join(key.replace(" ", "\N{NO-BREAK SPACE}") for key in HELP), width, "dim"),
        *_wrap(f"{emergency.upper()} or x   EMERGENCY STOP{': outputs off at once' * (width >= 60)}", width, "bold"),
        *(_wrap(prompt, width, "bold") or [Text("")]),
    ]
    trial, fingers, predicted = describe_trial(facts["trial"])
    generator, outputs, error = _describe_generator(facts)
    # The most important rows come first, since short terminals leave out the last ones.
    rows = [
        ("state", f"{state}{_describe_cause(facts)}"),
        *([("answer by", _describe_question(facts["question"]))] if facts["question"] is not None else []),
        ("progress", describe_progress(facts, since_s, width - _NAMES)),
        trial,
        error,
        fingers,
        ("last answer", describe_last(facts["last"])),
        outputs,
        ("asked", _describe_requests(facts)),
        predicted,
        ("answers", ", ".join(f"{answer} {count}" for answer, count in sorted(facts["answers"].items())) or "-"),
        generator,
    ]
    # Besides the table: two rules, a line for the cursor, and the warnings (only the first on short terminals).
    room = height - 3 - len(foot)
    warnings = _describe_warnings(facts["warnings"][: 4 if height >= 24 else 1], width)
    table = [line for name, words in rows for line in _draw_row(name, words, width)][: max(room - len(warnings), 1)]
    return Group(Rule(Text(head, style="bold"), style="dim"), *table, Rule(style="dim"), *warnings, *foot)


def _draw_row(name: str, words: str, width: int) -> list[Text]:
    most = 7 if name in ("answer by", "answers") else 3  # answers must be listed in full
    lines = textwrap.wrap(words, max(width - _NAMES - 1, 20), max_lines=most, placeholder=" ...") or ["-"]
    style = {"state": "bold reverse" if words.startswith(STATES["paused"]) else "bold", "last error": "bold"}.get(
        name, ""
    )
    return [
        Text.assemble((f" {'' if place else name:{_NAMES - 1}}", "dim"), (line, style), no_wrap=True)
        for place, line in enumerate(lines)
    ]


def _wrap(words: str, width: int, style: str) -> list[Text]:
    return [Text(f" {line}", style=style, no_wrap=True) for line in textwrap.wrap(words, max(width - 2, 20))]


def describe_progress(facts: SessionState, since_s: float = 0.0, width: int = 80) -> str:
    """Return the progress bar (if it fits the width [characters]), the count, and the time left."""
    done, total = facts["n_answered"], max(facts["n_trials"], 1)
    ticking = since_s if facts["state"] != "ended" else 0.0
    left = max(facts["time_left_s"] - (ticking if facts["state"] == "trial" else 0.0), 0.0)
    text = f"{done} of {facts['n_trials']}, {describe_time(left)} left"
    length = min(40, width - len(text) - 3)
    full = round(length * min(done / total, 1))
    return f"{'#' * full}{'.' * (length - full)} {text}" if length > 5 else text


def describe_trial(trial: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Return three rows that describe a trial."""
    if trial is None:
        return [("trial", "-"), ("fingers", "-"), ("predicted", "-")]
    number = f"practice {trial['number']}" if trial["practice"] else f"{trial['number']}, block {trial['block']}"
    which = f"{trial['stimulus']} at " if trial.get("stimulus") else ""
    level = "catch trial" if trial["velocity_mm_s"] == 0 else f"{which}{trial['velocity_mm_s']:g} mm/s"
    level += f" in interval {trial['interval']}" if trial.get("interval") else ""
    placed = "" if trial["placement"] == "normal" else f" ({trial['placement'].replace('_', ' ')})"
    sides = [side for side in ("left", "between", "right") if f"zone_{side}" in trial]
    fingers = ", ".join(f"{trial[f'finger_{side}']} on {trial[f'zone_{side}']}" for side in sides)
    predicted = ", ".join(f"{side} {trial[f'predicted_{side}_mm_s']:.3g} mm/s" for side in sides)
    return [
        ("trial", f"{number}, {level}"),
        ("fingers", f"{fingers}{placed}"),
        ("predicted", predicted),
    ]


def _describe_cause(facts: SessionState) -> str:
    """Return the suffix of the state: why a session is paused or ended, or the interval being played."""
    if facts["state"] == "paused" and facts["paused_by"] == "lost focus":
        return ": the window lost the keyboard focus; click in it"
    if facts["state"] == "paused":
        return f" by the {facts['paused_by']}"
    if facts["state"] == "trial" and (facts["trial"] or {}).get("plays"):
        return f": interval {facts['trial']['plays']}"
    return f": {facts['stopped_by']}" if facts["stopped_by"] else ""


def _describe_generator(facts: SessionState) -> list[tuple[str, str]]:
    generator = facts["generator"]
    volts = " and ".join(f"{value:.3g}" for value in generator["amplitude_Vpp"])
    played = f", {volts} Vpp" if generator["outputs"] == "on" and volts else ""
    sure = {True: ", confirmed", False: ", NOT CONFIRMED", None: ""}[generator["confirmed"]]
    name = ", ".join(part.strip() for part in generator["identity"].split(",")[:3])
    return [
        ("generator", name or "-"),
        ("outputs", f"{generator['outputs'].upper()}{played}{sure}"),
        ("last error", generator["last_error"] or "none"),
    ]


def _describe_question(question: dict[str, Any]) -> str:
    """Return the console keys of each answer while a trial is on."""
    if not question["open"]:
        return "-"
    named = {
        answer: " or ".join(_ARROWS.get(key, key) for key in keys)
        for answer, keys in question["keys"].items()
        if not (answer.isdecimal() and answer in keys)
    }
    typed = ["digits"] if len(named) < len(question["keys"]) else []
    return "; ".join([*typed, *(f"{answer}: {keys}" for answer, keys in named.items())])


def _describe_requests(facts: SessionState) -> str:
    requests = []
    if facts["too_early"]:
        requests.append(f"{facts['too_early']} came before the question and does not count")
    if facts["repeats_trial"] is not None:
        kind = "practice" if facts["repeats_practice"] else "trial"
        requests.append(f"repeat {kind} {facts['repeats_trial']} after this one (r takes it back)")
    elif facts["nothing_to_repeat"]:
        requests.append("nothing to repeat: no trial of this part is answered yet")
    if facts["ends_after_block"]:
        requests.append("end after this block (b takes it back)")
    if facts["n_notes"]:
        requests.append(f"{facts['n_notes']} note{'s' * (facts['n_notes'] > 1)} kept")
    return ", ".join(requests) or "-"


def _describe_warnings(warnings: list[str], width: int) -> list[Text]:
    if not warnings:
        return [Text(" no warnings", style="dim")]
    shortened = [textwrap.shorten(f"! {warning}", max(width - 2, 20), placeholder="...") for warning in warnings]
    return [Text(f" {words}", style="yellow", no_wrap=True) for words in shortened]


_NAMED_KEYS = {
    **{"\r": "enter", "\n": "enter", "\x7f": "backspace", "\b": "backspace", "\x1b": "escape"},
    **{f"\x1b{opening}{letter}": name for opening in "[O" for letter, name in zip("ABCD", _DIRECTIONS, strict=True)},
    **{f"\x1bO{letter}": f"f{number}" for number, letter in enumerate("PQRS", start=1)},
    **{
        f"\x1b[{code}~": f"f{number}" for number, code in enumerate((11, 12, 13, 14, 15, 17, 18, 19, 20, 21, 23, 24), 1)
    },
}
"""Control characters and sequences of terminals (xterm and VT220) for keys that print nothing."""
_KEY = re.compile(r"\x1b[\[O][^@-~]*[@-~]?|.", re.DOTALL)
"""Input of a key: an escape sequence or a character."""


@contextmanager
def open_keyboard(descriptor: int) -> Iterator[Callable[[float], list[str]]]:
    """Yield a function that returns the keys pressed within a time [s]: printable ones, and names such as `f12`.

    Ctrl-C remains a signal, but Ctrl-Z and Ctrl-S do not stop the session. The descriptor is that of the terminal.
    """
    before, settings = termios.tcgetattr(descriptor), termios.tcgetattr(descriptor)
    settings[0] &= ~(termios.IXON | termios.ICRNL)
    settings[3] &= ~(termios.ICANON | termios.ECHO)
    for name in ("VSUSP", "VQUIT"):
        settings[6][getattr(termios, name)] = b"\0"
    settings[6][termios.VMIN], settings[6][termios.VTIME] = 1, 0
    try:
        termios.tcsetattr(descriptor, termios.TCSANOW, settings)
        yield partial(read_keys, descriptor, codecs.getincrementaldecoder("utf-8")(errors="replace").decode)
    finally:
        restore_terminal(descriptor, before)


def read_keys(descriptor: int, decode: Callable[[bytes], str], patience: float) -> list[str]:
    """Return the keys pressed within `patience` [s]; raise EOFError or OSError if the terminal is gone."""
    text = ""
    while select.select([descriptor], [], [], 0.05 if text else patience)[0]:
        if not (data := os.read(descriptor, 1024)):
            raise EOFError
        text += decode(data)
        # On a slow line, a sequence may arrive in pieces; after 50 ms, the key is Escape itself.
        if not re.search(r"\x1b([\[O][^@-~]*)?\Z", text):
            break
    return split_keys(text)


def split_keys(text: str) -> list[str]:
    r"""Decode the characters sent by a terminal into keys; unknown sequences are dropped.

    Examples
    --------
    >>> split_keys("p\x1b[24~\r\x1b[A\x1b[Z")
    ['p', 'f12', 'enter', 'up']
    """
    keys = (_NAMED_KEYS.get(typed, typed) for typed in _KEY.findall(text))
    return [key for key in keys if key.isprintable()]


LONGEST_NOTE = 500
"""Maximum length of a note [characters]."""


class Dialogue:
    """Interpretation of keys as requests; emergency keys act even while a note is typed, and the first is shown."""

    def __init__(self, emergency: Sequence[str] = ("f12",)) -> None:
        self._emergency = frozenset(key for key in emergency if len(key) > 1)
        self.emergency = next(iter(emergency), "x")
        self._note: str | None = None
        self._asks_to_stop = False
        self._answers: dict[str, str] = {}
        self._is_open = False
        self.prompt = ""
        """Line with the last request or the text being typed."""

    def hear(self, facts: SessionState) -> None:
        """Update the keys of answers, and whether a question is open, from the state of the session."""
        question = facts.get("question") or {"open": False, "keys": {}}
        self._answers = {key: answer for answer, keys in question["keys"].items() for key in keys}
        self._is_open = question["open"]

    def press(self, key: str) -> Request | None:
        """Process a key and return the resulting request, if any."""
        if key in self._emergency:
            return self._ask("emergency_stop", "EMERGENCY STOP")
        if self._note is not None:
            return self._type(key)
        if self._asks_to_stop:
            self._asks_to_stop, self.prompt = False, ""
            return self._ask("stop", "stopping") if key in ("y", "Y") else None
        if key in AT_ONCE:
            return self._ask(*AT_ONCE[key])
        self.prompt = ""
        match key:
            case "n":
                self._note, self.prompt = "", "note (Enter keeps it, Escape drops it): _"
            case "q":
                self._asks_to_stop, self.prompt = True, "stop the session now? y: yes, any other key: no"
            case _ if key in self._answers and self._is_open:
                self.prompt = f"typed: {self._answers[key]}"
                return Request("answer", key)
            case _ if key in self._answers:
                self.prompt = f"{self._answers[key]} is not accepted: no trial is running"
        return None

    def _ask(self, command: Command, prompt: str) -> Request:
        self.prompt = prompt
        return Request(command)

    def _type(self, key: str) -> Request | None:
        note = self._note or ""
        if key in ("enter", "escape"):
            self._note, self.prompt = None, ""
            return Request("note", note.strip()) if key == "enter" and note.strip() else None
        if key == "backspace":
            note = note[:-1]
        elif len(key) == 1:
            note = (note + key)[:LONGEST_NOTE]
        self._note = note
        # Keep the end of a long note visible.
        full = f", full at {LONGEST_NOTE} characters" if len(note) == LONGEST_NOTE else ""
        self.prompt = f"note (Enter keeps it, Escape drops it{full}): {note[-34:]}_"
        return None


News = queue.Queue[dict[str, Any] | None]
"""States to show; empty after a key press; None at the end."""


def main() -> None:
    """Run the console until the session ends."""
    keys, screen, emergency = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3].split(",")
    # Ctrl-C reaches every process of the terminal; the session handles it and then ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: sys.exit(0))
    news: News = queue.Queue()
    dialogue = Dialogue(emergency)
    threading.Thread(target=_listen, args=(news, dialogue), daemon=True).start()
    with open(screen, "w", encoding="utf-8", closefd=False) as file, open_keyboard(keys) as read:
        # Read keys in a separate thread, so that they do not wait for drawing.
        threading.Thread(target=_read, args=(read, dialogue, news), daemon=True).start()
        with suppress(OSError):  # the terminal is gone
            _show(news, file, dialogue)


def _show(news: News, file: TextIO, dialogue: Dialogue) -> None:
    console = Console(file=file, force_terminal=True)
    known, came = None, 0.0
    with Live(console=console, screen=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False) as live:
        while True:
            received = []
            with suppress(queue.Empty):
                # Redraw every second, which updates times and covers other output to the terminal.
                received.append(news.get(timeout=1.0))
            while not news.empty():
                received.append(news.get())
            if None in received:
                return
            if facts := [each for each in received if each]:
                known, came = facts[-1], time.monotonic()
            if known is not None:
                size = os.get_terminal_size(file.fileno())
                console.size = ConsoleDimensions(max(size[0], 40), max(size[1], 12))
                picture = draw_session(
                    known,
                    dialogue.prompt,
                    width=console.width,
                    height=console.height,
                    since_s=time.monotonic() - came,
                    emergency=dialogue.emergency,
                )
                live.update(picture, refresh=True)


def _read(read: Callable[[float], list[str]], dialogue: Dialogue, news: News) -> None:
    """Turn keys into requests until the terminal is gone."""
    try:
        while True:
            for key in read(0.1):
                at = SYSTEM_CLOCK.now()
                if (request := dialogue.press(key)) is not None:
                    message = {"command": request.command, "text": request.text, "at": at}
                    sys.stdout.write(json.dumps(message) + "\n")
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


if __name__ == "__main__":
    main()
