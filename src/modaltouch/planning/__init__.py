"""Power, sample size and preregistration, by simulating a protocol and analysing the answers like real data.

For an examined protocol and an `Observer`, `designs_for` returns the design of each stimulus, `Study` specifies a
simulation, and `plan` estimates its `Power`, which `write_power` writes as tables and a figure. `preregister` renders a
preregistration, and `fit_answers` fits an observer to recorded answers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.planning.design import designs_for
    from modaltouch.planning.experiments import Study
    from modaltouch.planning.felt import felt_per_level
    from modaltouch.planning.fitting import fit_answers
    from modaltouch.planning.observer import Observer
    from modaltouch.planning.power import Power, plan, write_power
    from modaltouch.planning.preregistration import preregister
else:
    __getattr__ = lazily(
        __name__,
        {
            "design": "designs_for",
            "experiments": "Study",
            "fitting": "fit_answers",
            "felt": "felt_per_level",
            "observer": "Observer",
            "power": "Power plan write_power",
            "preregistration": "preregister",
        },
    )

__all__ = [
    "Observer",
    "Power",
    "Study",
    "designs_for",
    "felt_per_level",
    "fit_answers",
    "plan",
    "preregister",
    "write_power",
]
