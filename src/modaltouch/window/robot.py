"""A robot that types into the real window, through the window's own event queue.

Its keys take the same path as every key press: pyglet's queue, the event tap, the window's rules. A session that it
answers therefore tests the whole path, on every platform and without a display server's help.
"""

from __future__ import annotations

from collections.abc import Callable

from modaltouch.protocol import Protocol, Texts
from modaltouch.window.display_loop import Moment, WindowUser
from modaltouch.window.events import canonical_key
from modaltouch.window.interface import WindowError
from modaltouch.window.rating import Entry, as_read
from modaltouch.window.simulated import Answerer

_HOLD = 0.06
"""Least time for which a key stays down, and then up before the next press [s]."""
_SHORTEST_VIEW = 0.12
"""An answer never comes sooner than this after the question is on the screen [s]."""
_AGAIN = 1.0
"""A key that was not taken is typed again after this long [s]."""
_TRIES = 60
"""Most times it is typed: a minute's worth. Counted, not timed, so that an hour's suspension does not use them up."""


class Robot(WindowUser):
    """Types what an observer answers, at the observer's reaction time, until the window takes it.

    Parameters
    ----------
    answerer : Answerer
        Who answers.
    protocol : Protocol
        Which key gives which answer, and which one goes on.
    patience : float
        Time it takes to read a screen [s].
    texts : Texts, optional
        What it reads: scales run from right to left if the texts do.
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
        """Decide what to type at the picture that appeared at `shown` [s]."""
        if (moment, picture) == self._seen:
            return
        self._seen, self._wanted, self._tries = (moment, picture), "", 0
        if moment.wants in ("go_on", "confirm"):
            self._wanted = self._continue_key if moment.wants == "go_on" else self._key(moment)
            self._due = shown + self._patience
        elif moment.wants == "feel" and moment.trial is not None:
            # Felt now: by the time of the question the stimulus may have stopped.
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
        """Return the key that answers, or brings what has been entered on a scale nearer to the answer."""
        asked, (answer, value, _) = self._asked[moment.asked], self._felt
        if asked.scale is not None and value is not None:
            answer = Entry(asked.scale, text=moment.entered).towards(value)
        return canonical_key(asked.actions[answer][0])

    def act(self, now: float, type_key: Callable[..., None]) -> None:
        """Press or release the key that is due; raise `WindowError` if the window has not taken one for a minute."""
        # What was typed before has been read: had it been accepted, something else would be wanted.
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
