"""YAML -> Protocol: what is presented, asked and repeated, with the apparatus and texts that it names.

``sections``    the protocol file's keys
``texts``       the words the participant reads
``masking``     the keys of the masking noise
``adaptive``    the keys of adaptive runs
``observers``   the keys of an observer file
``keys``        names of the keys that can answer
``checks``      faults between the keys of a protocol
``fit``         faults between a protocol and its apparatus
``calibration_sections``  the keys of a calibration file
``calibration_file``      whether a calibration fits protocol and apparatus, and what it makes of them
``experiment``  read_protocol: all three files, every fault at once
``schemas``     JSON Schemas for editors
"""

from modaltouch.protocol.adaptive import AdaptiveSection, StaircaseSection
from modaltouch.protocol.experiment import (
    Experiment,
    Findings,
    Sources,
    examine_files,
    examine_sources,
    read_protocol,
    restore_experiment,
)
from modaltouch.protocol.keys import END_KEY, KEY_NAMES, RESERVED_KEYS
from modaltouch.protocol.masking import MaskingSection
from modaltouch.protocol.sections import (
    AnswersSection,
    CalibrationSection,
    ConditionsSection,
    FingerCondition,
    Placement,
    Protocol,
    ResumeSection,
    ScheduleSection,
    StimulusSection,
    WishedField,
)
from modaltouch.protocol.texts import Texts

__all__ = [
    "END_KEY",
    "KEY_NAMES",
    "RESERVED_KEYS",
    "AdaptiveSection",
    "AnswersSection",
    "CalibrationSection",
    "ConditionsSection",
    "Experiment",
    "Findings",
    "FingerCondition",
    "MaskingSection",
    "Placement",
    "Protocol",
    "ResumeSection",
    "ScheduleSection",
    "Sources",
    "StaircaseSection",
    "StimulusSection",
    "Texts",
    "WishedField",
    "examine_files",
    "examine_sources",
    "read_protocol",
    "restore_experiment",
]
