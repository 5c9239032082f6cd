"""Power and sample size: the protocol is simulated thousands of times and analysed as the real data will be.

For an examined protocol and an `Observer`, `designs_for` returns the cells of each stimulus, a `Study` says what is
simulated in them, and `plan` returns its `Power`, which `write_power` writes as tables and a figure. `fit_answers` fits
an observer to recorded answers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.planning.experiments import Study
    from modaltouch.planning.files import write_power
    from modaltouch.planning.fitting import fit_answers
    from modaltouch.planning.observer.felt import FeltSpeeds
    from modaltouch.planning.observer.population import Observer
    from modaltouch.planning.power import Power, plan
    from modaltouch.planning.preregistration import preregister
    from modaltouch.planning.presented import designs_for
else:
    __getattr__ = lazily(
        __name__,
        {
            "experiments": "Study",
            "files": "write_power",
            "fitting": "fit_answers",
            "observer.felt": "FeltSpeeds",
            "observer.population": "Observer",
            "power": "Power plan",
            "preregistration": "preregister",
            "presented": "designs_for",
        },
    )

__all__ = [
    "FeltSpeeds",
    "Observer",
    "Power",
    "Study",
    "designs_for",
    "fit_answers",
    "plan",
    "preregister",
    "write_power",
]
