"""A session of one participant, from its set-up to its verified record.

In come a checked experiment, a participant and a place for the record; out come the record and, meanwhile, its events.
``wiring`` puts the parts together, ``setup`` opens and closes them in order, ``loop`` runs the trials.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.session.console.interface import Console, Consoles
    from modaltouch.session.console.lines import EventLines, PlainLines
    from modaltouch.session.console.terminal import TerminalConsole
    from modaltouch.session.setup import Setup, begin, resume
    from modaltouch.session.simulation import simulate_session
    from modaltouch.session.wiring import mode_of, wire_resume, wire_run
    from modaltouch.session.wiring.parts import SIMULATED
else:
    __getattr__ = lazily(
        __name__,
        {
            "console.interface": "Console Consoles",
            "console.lines": "EventLines PlainLines",
            "console.terminal": "TerminalConsole",
            "setup": "Setup begin resume",
            "simulation": "simulate_session",
            "wiring": "mode_of wire_resume wire_run",
            "wiring.parts": "SIMULATED",
        },
    )

__all__ = [
    "Console",
    "Consoles",
    "EventLines",
    "PlainLines",
    "SIMULATED",
    "Setup",
    "TerminalConsole",
    "begin",
    "mode_of",
    "resume",
    "simulate_session",
    "wire_resume",
    "wire_run",
]
