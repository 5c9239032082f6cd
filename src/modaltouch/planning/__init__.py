"""Power, sample size and preregistration, by simulating a protocol and analysing the answers like real data.

For an examined protocol and an `Observer`, `designs_for` returns the design of each stimulus, `Study` specifies a
simulation, and `plan` estimates its `Power`, which `write_power` writes as tables and a figure. `preregister` renders a
preregistration, and `fit_answers` fits an observer to recorded answers.
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
