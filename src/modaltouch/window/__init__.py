"""The PsychoPy window that asks the participant, a simulated participant with the same interface, and masking noise.

Takes a protocol, its texts and, trial by trial, the stimulus; returns the answers and their times.
``examine_surroundings`` and ``measure_timing`` say whether a machine is fit for a session.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.window.environment import some_display
    from modaltouch.window.fonts import Fonts, find_font
    from modaltouch.window.interface import (
        AnswerWindow,
        Event,
        Intervention,
        Masking,
        Presentation,
        SessionStopped,
        Tick,
        TrialInterrupted,
        WindowError,
    )
    from modaltouch.window.legibility import smallest_type
    from modaltouch.window.machine import MachineCheck, examine_environment, measure_timing
    from modaltouch.window.masking import highest_level, open_masking
    from modaltouch.window.opening import AnswersBy, WindowOptions, open_window
    from modaltouch.window.simulated import Answerer
else:
    __getattr__ = lazily(
        __name__,
        {
            "environment": "some_display",
            "fonts": "Fonts find_font",
            "interface": (
                "AnswerWindow Event Intervention Masking Presentation SessionStopped Tick TrialInterrupted WindowError"
            ),
            "legibility": "smallest_type",
            "machine": "MachineCheck examine_environment measure_timing",
            "masking": "highest_level open_masking",
            "opening": "AnswersBy WindowOptions open_window",
            "simulated": "Answerer",
        },
    )

__all__ = [
    "AnswerWindow",
    "Answerer",
    "AnswersBy",
    "Event",
    "Fonts",
    "Intervention",
    "MachineCheck",
    "Masking",
    "Presentation",
    "SessionStopped",
    "Tick",
    "TrialInterrupted",
    "WindowError",
    "WindowOptions",
    "examine_environment",
    "highest_level",
    "find_font",
    "measure_timing",
    "open_masking",
    "open_window",
    "smallest_type",
    "some_display",
]
