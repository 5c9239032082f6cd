"""Run ``modaltouch`` with simulated participants who answer twenty times as fast as the model."""

from modaltouch.__main__ import main
from modaltouch.window.simulated import Answerer

HASTE = 20.0


def hasten():
    """Make every simulated participant of this process answer faster; the answers are unchanged."""
    answer = Answerer.answer

    def quickly(self, trial):
        given, reaction_time = answer(self, trial)
        return given, reaction_time / HASTE

    if answer.__name__ != "quickly":
        Answerer.answer = quickly


def run(words):
    """Run ``modaltouch`` with some arguments."""
    hasten()
    return main(words)
