"""Measurements of the beam: identification, calibration, validation, and a comparison with other methods of focusing.

Each command takes an apparatus or a protocol and measures on a rig or on the twin. It returns a report that contains
the result and writes its files: an apparatus file (`identify`), a calibration file (`calibrate`), a file of fingers
(`probe_fingers`), or a page with figures and tables (`validate`, `compare`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.lab.calibration.command import calibrate
    from modaltouch.lab.comparison import compare
    from modaltouch.lab.fingers import Prober, probe_fingers
    from modaltouch.lab.identification.command import IdentifyOptions, identify
    from modaltouch.lab.identification.responses import ResponseFormat
    from modaltouch.lab.laboratory import Laboratory, MeasurementProgress
    from modaltouch.lab.validation.command import validate
else:
    __getattr__ = lazily(
        __name__,
        {
            "calibration.command": "calibrate",
            "comparison": "compare",
            "fingers": "Prober probe_fingers",
            "identification.command": "IdentifyOptions identify",
            "identification.responses": "ResponseFormat",
            "laboratory": "Laboratory MeasurementProgress",
            "validation.command": "validate",
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
    "identify",
    "probe_fingers",
    "validate",
]
