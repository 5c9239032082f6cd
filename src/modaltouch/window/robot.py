"""Robot that types into the real window through the window's event queue.

Its keys take the same path as any key press: pyglet's queue, the event tap, the window's rules. A session that it
answers therefore tests the whole path, on every platform and independently of the display server.
"""

from __future__ import annotations

from collections.abc import Callable

from modaltouch.protocol import Protocol, Texts
from modaltouch.window.controls import Entry, as_read
from modaltouch.window.display_loop import Moment, WindowUser
from modaltouch.window.events import canonical_key
from modaltouch.window.interface import WindowError
from modaltouch.window.simulated import Answerer

_HOLD = 0.06
"""Minimum time for which a key is held down, and up before the next press [s]."""
_SHORTEST_VIEW = 0.12
"""Minimum time from the appearance of a question to its answer [s]."""
_AGAIN = 1.0
"""Time after which a key that had no effect is typed again [s]."""
_TRIES = 60
"""Maximum number of attempts, about a minute; counted, not timed, so that suspending the machine does not matter."""


class Robot(WindowUser):
    """Window user that types an observer's answers at its reaction times, until the window accepts them.

    Parameters
    ----------
    answerer : Answerer
        Source of the answers.
    protocol : Protocol
        Protocol with the keys.
    patience : float
        Time to read a screen [s].
    texts : Texts, optional
        Texts on the screen; scales run from right to left if the texts do.
    """

    def __init__(
        self, answerer: Answerer, protocol: Protocol, *, patience: float = 0.6, texts: Texts | None = None
    ) -> None:
        answers = protocol.answers
        self._answerer = answerer
        asked = {"": answers, **answers.further, **protocol.closing}
        self._asked = {name: each if texts is None else as_read(each, texts) for name, each in asked.items()}
        self._continue_key = canonical_key(answers.continue_keys[0])
        self._counts_from_question = answers.stimulus_until == "question"
        self._patience = patience
        self._felt: tuple[str, float | None, float] = ("", None, 0.0)
        self._seen: tuple[Moment, str] = (Moment(), "")
        self._wanted, self._due, self._tries = "", 0.0, 0
        self._down, self._moved = "", 0.0

    def see(self, moment: Moment, shown: float, picture: str) -> None:
        """Choose the key for the picture that appeared at `shown` [s]."""
        if (moment, picture) == self._seen:
            return
        self._seen, self._wanted, self._tries = (moment, picture), "", 0
        if moment.wants in ("go_on", "confirm"):
            self._wanted = self._continue_key if moment.wants == "go_on" else self._key(moment)
            self._due = shown + self._patience
        elif moment.wants == "feel" and moment.trial is not None:
            # Feel now, since the stimulus may have stopped by the time of the question.
            if moment.interval:
                self._answerer.feel(moment.trial, moment.interval)
            else:
                self._felt = self._answerer.first(moment.trial)
        elif moment.wants == "answer":
            if moment.asked and not moment.entered:
                asked = self._asked[moment.asked]
                self._felt = self._answerer.rate(moment.trial, asked.scale, asked.offered.names, moment.asked)
            start = shown if self._counts_from_question or moment.asked else moment.onset
            due = max(start + self._felt[2], shown + _SHORTEST_VIEW)
            self._wanted, self._due = self._key(moment), shown if moment.entered else due

    def _key(self, moment: Moment) -> str:
        """Return the key that answers, or moves the number on a scale towards the answer."""
        asked, (answer, value, _) = self._asked[moment.asked], self._felt
        if asked.scale is not None and value is not None:
            answer = Entry(asked.scale, text=moment.entered).towards(value)
        return canonical_key(asked.actions[answer][0])

    def act(self, now: float, type_key: Callable[..., None]) -> None:
        """Press or release the key that is due; raise `WindowError` if the window accepts none for a minute."""
        # The previous key has been read; had it been accepted, another key would be due.
        if self._down and now >= self._moved + _HOLD:
            type_key(self._down, down=False)
            self._down, self._moved = "", now
        elif self._wanted and not self._down and now >= max(self._due, self._moved + _HOLD):
            if self._tries == _TRIES:
                raise WindowError(
                    f"nothing has moved for {_TRIES * _AGAIN:g} s: the screen {self._seen[1]!r} stays, though the "
                    f"robot typed {self._wanted!r} {_TRIES} times; test keys with `modaltouch doctor --timing`"
                )
            type_key(self._wanted, down=True)
            self._down, self._moved, self._due = self._wanted, now, now + _AGAIN
            self._tries += 1
