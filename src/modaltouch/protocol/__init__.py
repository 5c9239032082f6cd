"""YAML -> Protocol: what is presented, asked and repeated, with the apparatus and texts that it names.

``sections``    the protocol file's keys
``texts``       the words the participant reads
``masking``     the keys of the masking noise
``stimulus_sections``  the keys of the stimulus, and of several
``adaptive``    the keys of adaptive runs
``sensation``   the keys of levels calibrated by participant
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
from modaltouch.protocol.checks import check_protocol
from modaltouch.protocol.experiment import (
    Experiment,
    Findings,
    Sources,
    examine_files,
    examine_sources,
    read_protocol,
    restore_experiment,
)
from modaltouch.protocol.fit import check_fit
from modaltouch.protocol.keys import END_KEY, KEY_NAMES, PAUSE_KEY, RESERVED_KEYS
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
)
from modaltouch.protocol.sensation import SensationLevelsSection
from modaltouch.protocol.stimulus_sections import StimulusSection, StimulusVariant, WishedField
from modaltouch.protocol.texts import Texts

__all__ = [
    "END_KEY",
    "KEY_NAMES",
    "PAUSE_KEY",
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
    "SensationLevelsSection",
    "Sources",
    "StaircaseSection",
    "StimulusSection",
    "StimulusVariant",
    "Texts",
    "WishedField",
    "check_fit",
    "check_protocol",
    "examine_files",
    "examine_sources",
    "read_protocol",
    "restore_experiment",
]
