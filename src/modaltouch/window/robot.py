"""A robot that sits before the real window and types, by the window's own event queue.

What it types takes the road of every key press: pyglet's queue, the event tap, the window's rules. So a
session that it answers proves the whole path, on every platform and without a display server's help.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from modaltouch.protocol import AnswersSection
from modaltouch.trial import Answer
from modaltouch.window.events import canonical_key
from modaltouch.window.simulated import Answerer
from modaltouch.window.stage import Moment

_HOLD = 0.06
"""How long a key stays down [s]."""
_GLANCE = 0.12
"""An answer never comes sooner than this after the question is on the screen [s]."""


class Robot:
    """Types what an observer answers, at the observer's reaction time.

    Parameters
    ----------
    answerer : Answerer
        Who answers.
    answers : AnswersSection
        Which key gives which answer, and which one goes on.
    patience : float
        Time it takes to read a screen [s].
    """

    def __init__(self, answerer: Answerer, answers: AnswersSection, *, patience: float = 0.6) -> None:
        self._answerer = answerer
        self._keys = {answer: canonical_key(keys[0]) for answer, keys in answers.keys.items()}
        self._continue_key = canonical_key(answers.continue_keys[0])
        self._counts_from_question = answers.stimulus_until == "question"
        self._patience = patience
        self._felt: tuple[Answer, float] = ("both", 0.0)
        self._plan: deque[tuple[float, str, bool]] = deque()

    def see(self, moment: Moment, shown: float) -> None:
        """Decide what to type at what is on the screen since `shown` [s]."""
        is_down = bool(self._plan) and not self._plan[0][2]
        self._plan = deque([self._plan[0]] if is_down else [])
        if moment.wants == "go_on":
            self._type(self._continue_key, shown + self._patience)
        elif moment.wants == "feel" and moment.trial is not None:
            # Felt now: by the time of the question the stimulus may have stopped.
            self._felt = self._answerer.answer(moment.trial)
        elif moment.wants in ("answer", "confirm"):
            answer, reaction_time = self._felt
            start = shown if self._counts_from_question else moment.onset
            due = start + reaction_time if moment.wants == "answer" else shown
            self._type(self._keys[answer], max(due, shown + _GLANCE))

    def act(self, now: float, type_key: Callable[..., None]) -> None:
        """Press or release the key that is due."""
        while self._plan and self._plan[0][0] <= now:
            _, key, down = self._plan.popleft()
            type_key(key, down=down)

    def _type(self, key: str, when: float) -> None:
        self._plan.append((when, key, True))
        self._plan.append((when + _HOLD, key, False))
