"""Asks the participant: the PsychoPy window, and a simulated participant behind the same interface."""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.window.environment import LIBRARIES, is_loadable, missing_libraries
    from modaltouch.window.events import canonical_key
    from modaltouch.window.interface import (
        AnswerWindow,
        Presentation,
        Progress,
        SessionStopped,
        Tick,
        TrialInterrupted,
        TypedAnswer,
        WindowError,
        Wish,
    )
    from modaltouch.window.masking.interface import Masking, MaskingError, NoMasking
    from modaltouch.window.masking.noise import highest_level
    from modaltouch.window.masking.player import DeviceError, default_device, open_masking
    from modaltouch.window.opening import AnswersBy, WindowOptions, open_window
    from modaltouch.window.screen import Screen
    from modaltouch.window.shapes import Box, Picture, Words
    from modaltouch.window.simulated import Answerer
    from modaltouch.window.timing import WindowTiming, measure_timing
    from modaltouch.window.virtual_display import some_display
else:
    __getattr__ = lazily(
        __name__,
        {
            "opening": "AnswersBy WindowOptions open_window",
            "environment": "LIBRARIES is_loadable missing_libraries",
            "events": "canonical_key",
            "interface": (
                "AnswerWindow Presentation Progress SessionStopped Tick TrialInterrupted TypedAnswer WindowError Wish"
            ),
            "masking.interface": "Masking MaskingError NoMasking",
            "masking.noise": "highest_level",
            "masking.player": "DeviceError default_device open_masking",
            "screen": "Screen",
            "shapes": "Box Picture Words",
            "simulated": "Answerer",
            "timing": "WindowTiming measure_timing",
            "virtual_display": "some_display",
        },
    )

__all__ = [
    "AnswerWindow",
    "Answerer",
    "AnswersBy",
    "Box",
    "DeviceError",
    "LIBRARIES",
    "Masking",
    "MaskingError",
    "NoMasking",
    "Picture",
    "Presentation",
    "Progress",
    "Screen",
    "SessionStopped",
    "Tick",
    "TrialInterrupted",
    "TypedAnswer",
    "WindowError",
    "WindowOptions",
    "WindowTiming",
    "Wish",
    "Words",
    "canonical_key",
    "default_device",
    "highest_level",
    "is_loadable",
    "measure_timing",
    "missing_libraries",
    "open_masking",
    "open_window",
    "some_display",
]
