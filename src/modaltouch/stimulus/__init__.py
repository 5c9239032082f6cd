"""Physics of the stimulus, in NumPy alone: from a target field to codes, and from codes to the motion of the beam.

`design_stimulus` takes the modes of a beam (`ModalModel`), the velocity field at one instant (`TargetField`), the clock
(`Timing`) and the `Amplifier`, and returns a `Stimulus`: voltages, codes and amplitudes (`Burst`), and the resulting
motion at every level. `focus_sensitivity`, `scatter` and `cheapest_samples` tell how accurately the beam must be
identified and how few samples are enough. `DiagonalSystem`, `BlockKernel` and `BlockStates` compute the response to
arbitrary voltages for the simulated rig. `Probe` identifies the beam, with fingers on it, from measured responses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.stimulus.burst import Burst, Converter, Correction, Timing
    from modaltouch.stimulus.drive import Law, Release
    from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem
    from modaltouch.stimulus.fingers import Finger
    from modaltouch.stimulus.modes import ModalModel
    from modaltouch.stimulus.other_shapes import MeasuredShapes, TimoshenkoBeam
    from modaltouch.stimulus.probe import Probe
    from modaltouch.stimulus.reachability import Taper
    from modaltouch.stimulus.shapes import characteristic_root, mode_shapes
    from modaltouch.stimulus.stimulus import Stimulus, design_stimulus
    from modaltouch.stimulus.target_field import TargetField
    from modaltouch.stimulus.tolerances import cheapest_samples, focus_sensitivity, scatter
    from modaltouch.stimulus.vibration import BlockKernel, BlockStates
else:
    __getattr__ = lazily(
        __name__,
        {
            "burst": "Burst Converter Correction Timing",
            "drive": "Law Release",
            "fingers": "Finger",
            "dynamics": "Amplifier DiagonalSystem",
            "modes": "ModalModel",
            "other_shapes": "MeasuredShapes TimoshenkoBeam",
            "probe": "Probe",
            "reachability": "Taper",
            "shapes": "characteristic_root mode_shapes",
            "stimulus": "Stimulus design_stimulus",
            "target_field": "TargetField",
            "tolerances": "cheapest_samples focus_sensitivity scatter",
            "vibration": "BlockKernel BlockStates",
        },
    )

__all__ = [
    "Amplifier",
    "BlockKernel",
    "BlockStates",
    "Burst",
    "Converter",
    "Correction",
    "DiagonalSystem",
    "Finger",
    "Law",
    "MeasuredShapes",
    "ModalModel",
    "Probe",
    "Release",
    "Stimulus",
    "Taper",
    "TargetField",
    "Timing",
    "TimoshenkoBeam",
    "characteristic_root",
    "cheapest_samples",
    "design_stimulus",
    "focus_sensitivity",
    "mode_shapes",
    "scatter",
]
