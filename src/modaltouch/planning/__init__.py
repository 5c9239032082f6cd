"""How many participants: the very protocol, simulated by the thousand and analysed as the real data will be.

``design``        the cells of a design, and what fingers feel in them
``presented``     what a protocol presents to an observer: its design
``significance``  the exact tests, thousands at once
``questions``     the families of tests and the widths of intervals, as in the analysis
``experiments``   participants and answers drawn, significant tests counted, job by job
``power``         plan: all jobs -> Power; the fewest participants that can tell anything
``pictures``      contours of power over participants and repetitions
``writing``       tables and pictures into a folder
``fitting``       an observer fitted to recorded answers
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.planning.experiments import Study
    from modaltouch.planning.files import COMMAND, write_power
    from modaltouch.planning.fitting import NOT_IDENTIFIABLE, fit_answers
    from modaltouch.planning.observer.felt import FeltSpeeds
    from modaltouch.planning.observer.file import read_observer, usual_observer, write_observer
    from modaltouch.planning.observer.population import Observer
    from modaltouch.planning.power import Power, plan
    from modaltouch.planning.presented import designs_for
    from modaltouch.planning.questions import FAMILIES
else:
    __getattr__ = lazily(
        __name__,
        {
            "experiments": "Study",
            "files": "COMMAND write_power",
            "fitting": "NOT_IDENTIFIABLE fit_answers",
            "observer.felt": "FeltSpeeds",
            "observer.file": "read_observer usual_observer write_observer",
            "observer.population": "Observer",
            "power": "Power plan",
            "presented": "designs_for",
            "questions": "FAMILIES",
        },
    )

__all__ = [
    "COMMAND",
    "FAMILIES",
    "FeltSpeeds",
    "NOT_IDENTIFIABLE",
    "Observer",
    "Power",
    "Study",
    "designs_for",
    "fit_answers",
    "plan",
    "read_observer",
    "usual_observer",
    "write_observer",
    "write_power",
]
