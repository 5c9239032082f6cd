"""The answer window (PsychoPy), a simulated participant with the same interface, and masking noise.

`WindowOptions` opens the window, checks the legibility of texts in it and measures its timing; `Answerer` opens a
simulated participant, and `MaskingNoise` the noise. `examine_machine` checks whether a machine is fit for a session.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.window.interface import (
        AnswerWindow,
        Event,
        Masking,
        Presentation,
        SessionStopped,
        TrialInterrupted,
        WindowError,
    )
    from modaltouch.window.machine import some_display
    from modaltouch.window.masking import MaskingNoise
    from modaltouch.window.opening import WindowOptions, examine_machine
    from modaltouch.window.simulated import Answerer
else:
    __getattr__ = lazily(
        __name__,
        {
            "interface": "AnswerWindow Event Masking Presentation SessionStopped TrialInterrupted WindowError",
            "machine": "some_display",
            "masking": "MaskingNoise",
            "opening": "WindowOptions examine_machine",
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
