"""What the experimenter's keys mean: most ask at once, a note is typed, the end is asked twice.

Where the experimenter gives the answers, the keys of the answers are typed here too, while a trial is on. The console's
own keys keep their meaning then: `x` has to be the emergency at every moment.
"""

from __future__ import annotations

from collections.abc import Sequence

from modaltouch.session.console.interface import Command, Facts, Request

_AT_ONCE: dict[str, tuple[Command, str]] = {
    "p": ("pause", ""),
    "r": ("repeat", ""),
    "b": ("end_after_block", ""),
    " ": ("go_on", ""),
    "enter": ("go_on", ""),
    "x": ("emergency_stop", "EMERGENCY STOP"),
}
OWN_KEYS = frozenset({*_AT_ONCE, "n", "q", "space", "escape"})
"""Keys that never answer."""
LONGEST_NOTE = 500
"""A note is a remark, not a protocol [characters]."""


class Dialogue:
    """Turns keys into requests.

    Parameters
    ----------
    emergency : sequence of str
        Names of keys that stop everything at once, even while a note is typed; the first is shown.
    """

    def __init__(self, emergency: Sequence[str] = ("f12",)) -> None:
        self._emergency = frozenset(key for key in emergency if len(key) > 1)
        self.emergency = next(iter(emergency), "x")
        self._note: str | None = None
        self._asks_to_stop = False
        self._answers: dict[str, str] = {}
        self._is_open = False
        self.prompt = ""
        """The line that tells what was asked, or is being typed."""

    def hear(self, facts: Facts) -> None:
        """Take in how the session stands: by which keys is answered, and whether now."""
        question = facts.get("question") or {"open": False, "keys": {}}
        self._answers = {key: answer for answer, keys in question["keys"].items() for key in keys}
        self._is_open = question["open"]

    def press(self, key: str) -> Request | None:
        """Take in a key and return what it asks for, if anything.

        Parameters
        ----------
        key : str
            As `keyboard.Keyboard` names it.
        """
        if key in self._emergency:
            return self._ask("emergency_stop", "EMERGENCY STOP")
        if self._note is not None:
            return self._type(key)
        if self._asks_to_stop:
            self._asks_to_stop, self.prompt = False, ""
            return self._ask("stop", "stopping") if key in ("y", "Y") else None
        if key in _AT_ONCE:
            return self._ask(*_AT_ONCE[key])
        self.prompt = ""
        if key == "n":
            self._note, self.prompt = "", "note (Enter keeps it, Escape drops it): _"
        elif key == "q":
            self._asks_to_stop, self.prompt = True, "stop the session now? y: yes, any other key: no"
        elif key in self._answers and self._is_open:
            self.prompt = f"typed: {self._answers[key]}"
            return Request("answer", key)
        elif key in self._answers:
            self.prompt = f"{self._answers[key]} is not taken: no trial is on"
        return None

    def _ask(self, command: Command, prompt: str) -> Request:
        self.prompt = prompt
        return Request(command)

    def _type(self, key: str) -> Request | None:
        note = self._note or ""
        if key == "enter":
            self._note, self.prompt = None, ""
            return Request("note", note.strip()) if note.strip() else None
        if key == "escape":
            self._note, self.prompt = None, ""
            return None
        if key == "backspace":
            note = note[:-1]
        elif len(key) == 1:
            note = (note + key)[:LONGEST_NOTE]
        self._note = note
        # The end of a long note stays in sight.
        full = f", full at {LONGEST_NOTE} characters" if len(note) == LONGEST_NOTE else ""
        self.prompt = f"note (Enter keeps it, Escape drops it{full}): {note[-34:]}_"
        return None
