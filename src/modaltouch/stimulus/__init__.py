"""The physics of the stimulus: from a wished velocity field to a generator's codes, and back. NumPy only."""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.stimulus.alternative_designs import least_norm, least_peak, trade
    from modaltouch.stimulus.blocks import BlockKernel
    from modaltouch.stimulus.burst import MID_CODE, Burst, round_amplitude
    from modaltouch.stimulus.correction import Correction
    from modaltouch.stimulus.design import design_stimulus
    from modaltouch.stimulus.designed import Stimulus
    from modaltouch.stimulus.drive import Law, Release
    from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem, modal_system
    from modaltouch.stimulus.measured import MeasuredShapes
    from modaltouch.stimulus.modes import ModalModel
    from modaltouch.stimulus.patches import patch_gains
    from modaltouch.stimulus.quantisation import full_scale, round_to_codes, signed_codes, unsigned_codes
    from modaltouch.stimulus.reachability import Taper
    from modaltouch.stimulus.recursion import SHORT
    from modaltouch.stimulus.sample_count import cheapest_samples
    from modaltouch.stimulus.sensitivity import focus_sensitivity, scatter
    from modaltouch.stimulus.shapes import characteristic_root, mode_shapes
    from modaltouch.stimulus.synthesis import synthesise
    from modaltouch.stimulus.target_field import TargetField
    from modaltouch.stimulus.timing import Timing
    from modaltouch.stimulus.timoshenko import TimoshenkoBeam
    from modaltouch.stimulus.vibration import moments, peak_velocity, states_by_channel, velocity_history
else:
    __getattr__ = lazily(
        __name__,
        {
            "alternative_designs": "least_norm least_peak trade",
            "blocks": "BlockKernel",
            "burst": "Burst MID_CODE round_amplitude",
            "correction": "Correction",
            "design": "design_stimulus",
            "designed": "Stimulus",
            "drive": "Law Release",
            "dynamics": "Amplifier DiagonalSystem modal_system",
            "measured": "MeasuredShapes",
            "modes": "ModalModel",
            "patches": "patch_gains",
            "quantisation": "full_scale round_to_codes signed_codes unsigned_codes",
            "reachability": "Taper",
            "recursion": "SHORT",
            "sample_count": "cheapest_samples",
            "sensitivity": "focus_sensitivity scatter",
            "shapes": "characteristic_root mode_shapes",
            "synthesis": "synthesise",
            "target_field": "TargetField",
            "timing": "Timing",
            "timoshenko": "TimoshenkoBeam",
            "vibration": "moments peak_velocity states_by_channel velocity_history",
        },
    )

__all__ = [
    "Amplifier",
    "BlockKernel",
    "Burst",
    "Correction",
    "DiagonalSystem",
    "Law",
    "MID_CODE",
    "MeasuredShapes",
    "ModalModel",
    "Release",
    "SHORT",
    "Stimulus",
    "Taper",
    "Timing",
    "TimoshenkoBeam",
    "TargetField",
    "characteristic_root",
    "cheapest_samples",
    "design_stimulus",
    "focus_sensitivity",
    "full_scale",
    "least_norm",
    "least_peak",
    "modal_system",
    "mode_shapes",
    "moments",
    "patch_gains",
    "peak_velocity",
    "round_amplitude",
    "round_to_codes",
    "scatter",
    "signed_codes",
    "states_by_channel",
    "synthesise",
    "trade",
    "unsigned_codes",
    "velocity_history",
]
