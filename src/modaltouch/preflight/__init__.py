"""Check of a protocol before a session, without hardware.

`examine` takes the files of a protocol, `examine_findings` their parsed contents. Both return a `Preflight`: all faults
with their positions, or the stimulus and the predicted response of the beam at each level. `design` computes a stimulus
from `DesignInputs`, the valid parts of the files.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.preflight.checked import Preflight
    from modaltouch.preflight.designs import delivered_figures, has_drifted, with_measured
    from modaltouch.preflight.examination import check_legibility, examine, examine_findings
    from modaltouch.preflight.single_design import DesignInputs, design, design_to_fit, estimated_duration, finite
else:
    __getattr__ = lazily(
        __name__,
        {
            "checked": "Preflight",
            "examination": "check_legibility examine examine_findings",
            "single_design": "DesignInputs design design_to_fit estimated_duration finite",
            "designs": "delivered_figures has_drifted with_measured",
        },
    )

__all__ = [
    "DesignInputs",
    "Preflight",
    "check_legibility",
    "delivered_figures",
    "design",
    "design_to_fit",
    "estimated_duration",
    "examine",
    "examine_findings",
    "finite",
    "has_drifted",
    "with_measured",
]
