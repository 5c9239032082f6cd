"""Everything that can fail before the participant sits down: files, limits, predicted speeds; no hardware.

``ground``   the sound parts of the files that a stimulus needs
``figures``  what each level does to the beam
``advice``   where the field does not go, what was taken by default
``examine``  the whole check: limits at every level, and what the engine refuses, with its place
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.preflight.checked import Preflight
    from modaltouch.preflight.design_inputs import DesignInputs, design
    from modaltouch.preflight.examination import design_to_fit, examine, examine_findings
    from modaltouch.preflight.exploration import design_figures, sample_figures, sensitivity_figures
    from modaltouch.preflight.figures import estimated_duration, finite
    from modaltouch.preflight.several_stimuli import at_stimulus
else:
    __getattr__ = lazily(
        __name__,
        {
            "checked": "Preflight",
            "design_inputs": "DesignInputs design",
            "examination": "design_to_fit examine examine_findings",
            "exploration": "design_figures sample_figures sensitivity_figures",
            "figures": "estimated_duration finite",
            "several_stimuli": "at_stimulus",
        },
    )

__all__ = [
    "DesignInputs",
    "Preflight",
    "at_stimulus",
    "design",
    "design_figures",
    "design_to_fit",
    "estimated_duration",
    "examine",
    "examine_findings",
    "finite",
    "sample_figures",
    "sensitivity_figures",
]
