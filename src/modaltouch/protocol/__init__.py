"""Protocol files: validation of the YAML with line-accurate problems, and the schedule of a participant.

Input: a protocol and the files that it names (apparatus, texts, calibration, points of a target field), or the copies
in a record. Output: `Findings`, with the valid parts of each file and every `Problem` with its line, and an
`Experiment` if there are no problems. A `Schedule` is drawn from the protocol; `Levels` sets the levels of an
adaptive run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.protocol.apparatus import Apparatus
    from modaltouch.protocol.calibration import Calibration
    from modaltouch.protocol.findings import Experiment, Findings
    from modaltouch.protocol.levels import Levels
    from modaltouch.protocol.observers import ObserverFile
    from modaltouch.protocol.questions import ScaleSection
    from modaltouch.protocol.schedule import Schedule, Turn, judge_round
    from modaltouch.protocol.sections import AnswersSection, Protocol
    from modaltouch.protocol.source import InputError, Problem, Source, Sources, suggest
    from modaltouch.protocol.stimulus_sections import MaskingSection, StimulusSection
    from modaltouch.protocol.texts import Texts
    from modaltouch.protocol.trial import TIME_OUT, AnswerList, Response, Trial
else:
    __getattr__ = lazily(
        __name__,
        {
            "apparatus": "Apparatus",
            "calibration": "Calibration",
            "findings": "Experiment Findings",
            "levels": "Levels",
            "observers": "ObserverFile",
            "questions": "ScaleSection",
            "schedule": "Schedule Turn judge_round",
            "sections": "AnswersSection Protocol",
            "source": "InputError Problem Source Sources suggest",
            "stimulus_sections": "MaskingSection StimulusSection",
            "texts": "Texts",
            "trial": "AnswerList Response TIME_OUT Trial",
        },
    )

__all__ = [
    "AnswerList",
    "AnswersSection",
    "Apparatus",
    "Calibration",
    "Experiment",
    "Findings",
    "InputError",
    "Levels",
    "MaskingSection",
    "ObserverFile",
    "Problem",
    "Protocol",
    "Response",
    "ScaleSection",
    "Schedule",
    "Source",
    "Sources",
    "StimulusSection",
    "TIME_OUT",
    "Texts",
    "Trial",
    "Turn",
    "judge_round",
    "suggest",
]
