"""Measurements of the beam: identification, calibration, validation, and a comparison with other methods of focusing.

Each command takes an apparatus or a protocol, measures on a rig or on the twin, and writes its files: an apparatus file
(`identify`), a calibration file (`calibrate`), a file of fingers (`probe_fingers`), or a page with figures and tables
(`validate`, `compare`). It returns the results as plain values with the paths of the files.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.lab.calibration import calibrate
    from modaltouch.lab.comparison import compare, comparison_table
    from modaltouch.lab.fingers import Prober, probe_fingers
    from modaltouch.lab.identification.command import IdentifyOptions, identify
    from modaltouch.lab.identification.responses import ResponseFormat
    from modaltouch.lab.laboratory import Laboratory, MeasurementProgress
    from modaltouch.lab.validation import validate
    from modaltouch.lab.validation.key_figures import validation_table
else:
    __getattr__ = lazily(
        __name__,
        {
            "calibration": "calibrate",
            "comparison": "compare comparison_table",
            "fingers": "Prober probe_fingers",
            "identification.command": "IdentifyOptions identify",
            "identification.responses": "ResponseFormat",
            "laboratory": "Laboratory MeasurementProgress",
            "validation": "validate",
            "validation.key_figures": "validation_table",
        },
    )

__all__ = [
    "IdentifyOptions",
    "Laboratory",
    "MeasurementProgress",
    "Prober",
    "ResponseFormat",
    "calibrate",
    "compare",
    "comparison_table",
    "identify",
    "probe_fingers",
    "validate",
    "validation_table",
]
