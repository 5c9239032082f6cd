"""The PsychoPy window that asks the participant, a simulated participant with the same interface, and masking noise.

Takes a protocol, its texts and, trial by trial, the stimulus; returns the answers and their times. `WindowOptions`
opens the window, checks whether texts can be read in it and measures how accurately it keeps time; `Answerer` opens a
simulated participant, `MaskingNoise` the noise. `examine_machine` says whether a machine is fit for a session.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.window.environment import some_display
    from modaltouch.window.interface import (
        AnswerWindow,
        Event,
        Masking,
        Presentation,
        SessionStopped,
        TrialInterrupted,
        WindowError,
    )
    from modaltouch.window.machine import examine_machine
    from modaltouch.window.masking import MaskingNoise
    from modaltouch.window.opening import WindowOptions
    from modaltouch.window.simulated import Answerer
else:
    __getattr__ = lazily(
        __name__,
        {
            "environment": "some_display",
            "interface": "AnswerWindow Event Masking Presentation SessionStopped TrialInterrupted WindowError",
            "machine": "examine_machine",
            "masking": "MaskingNoise",
            "opening": "WindowOptions",
            "simulated": "Answerer",
        },
    )

__all__ = [
    "AnswerWindow",
    "Answerer",
    "Event",
    "Masking",
    "MaskingNoise",
    "Presentation",
    "SessionStopped",
    "TrialInterrupted",
    "WindowError",
    "WindowOptions",
    "examine_machine",
    "some_display",
]
