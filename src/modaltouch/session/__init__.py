"""Sessions with one participant, from setup to the finished record.

`wire_run` and `wire_resume` assemble the `Setup` of a new or an interrupted session, `begin` and `resume` run it, and
`simulate_session` does both for a simulated participant.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.session.assignment import propose_participant
    from modaltouch.session.console.consoles import open_console
    from modaltouch.session.overview import survey_results
    from modaltouch.session.resumption import resume, wire_resume
    from modaltouch.session.setup import Setup, begin
    from modaltouch.session.wiring import SIMULATED, mode_of, simulate_session, wire_run
else:
    __getattr__ = lazily(
        __name__,
        {
            "assignment": "propose_participant",
            "console.consoles": "open_console",
            "overview": "survey_results",
            "setup": "Setup begin",
            "resumption": "resume wire_resume",
            "wiring": "SIMULATED mode_of simulate_session wire_run",
        },
    )

__all__ = [
    "SIMULATED",
    "Setup",
    "begin",
    "mode_of",
    "open_console",
    "propose_participant",
    "resume",
    "simulate_session",
    "survey_results",
    "wire_resume",
    "wire_run",
]
