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

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.protocol.adaptive import SensationLevelsSection
    from modaltouch.protocol.apparatus import (
        Apparatus,
        Sound,
        Zone,
        examine_apparatus,
        offered_gains,
        read_apparatus,
        zone_edges,
    )
    from modaltouch.protocol.calibration import (
        CalibratedAmplifier,
        CalibratedApparatus,
        CalibratedLevel,
        CalibratedMode,
        CalibratedStimulus,
        Calibration,
        CalibrationFile,
        CalibrationOfSeveral,
        Instruments,
        IterationFigures,
        MeasuringChain,
        apparatus_hash,
        calibrated_apparatus,
        calibration_alone,
        check_calibration,
        generator_problem,
        in_calibration,
    )
    from modaltouch.protocol.checks import check_fit, check_protocol
    from modaltouch.protocol.findings import (
        Experiment,
        Findings,
        Sources,
        examine_files,
        examine_sources,
        read_protocol,
    )
    from modaltouch.protocol.keys import END_KEY, KEY_ALIASES, PAUSE_KEY
    from modaltouch.protocol.levels import Levels, describe_rule, is_success, to_dB
    from modaltouch.protocol.masking import MaskingSection
    from modaltouch.protocol.observers import ObserverFile
    from modaltouch.protocol.practice import expected_answer, judge_round
    from modaltouch.protocol.problems import InputError, Problem, suggest
    from modaltouch.protocol.reading import Reading, read
    from modaltouch.protocol.schedule import Schedule, Turn, draw_schedule, period_of_turns, recorded_turn, turn_of
    from modaltouch.protocol.section import Section
    from modaltouch.protocol.sections import AnswersSection, Protocol, ResumeSection
    from modaltouch.protocol.source import Source, find, load_source, shipped
    from modaltouch.protocol.stimulus_sections import Points, StimulusSection, read_points
    from modaltouch.protocol.streams import random_generator
    from modaltouch.protocol.texts import Texts
    from modaltouch.protocol.tree import Node
    from modaltouch.protocol.trial import ANSWERS, ANSWERS_WITH_NONE, TIME_OUT, Answer, Condition, Response, Trial
    from modaltouch.protocol.twin import Fingers, UnlistedMode
else:
    __getattr__ = lazily(
        __name__,
        {
            "adaptive": "SensationLevelsSection",
            "apparatus": "Apparatus Sound Zone examine_apparatus offered_gains read_apparatus zone_edges",
            "calibration": "CalibratedAmplifier CalibratedApparatus CalibratedLevel CalibratedMode CalibratedStimulus Calibration CalibrationFile CalibrationOfSeveral Instruments IterationFigures MeasuringChain apparatus_hash calibrated_apparatus calibration_alone check_calibration generator_problem in_calibration",
            "checks": "check_fit check_protocol",
            "findings": "Experiment Findings Sources examine_files examine_sources read_protocol",
            "keys": "END_KEY KEY_ALIASES PAUSE_KEY",
            "levels": "Levels describe_rule is_success to_dB",
            "masking": "MaskingSection",
            "observers": "ObserverFile",
            "practice": "expected_answer judge_round",
            "problems": "InputError Problem suggest",
            "reading": "Reading read",
            "schedule": "Schedule Turn draw_schedule period_of_turns recorded_turn turn_of",
            "section": "Section",
            "sections": "AnswersSection Protocol ResumeSection",
            "source": "Source find load_source shipped",
            "stimulus_sections": "Points StimulusSection read_points",
            "streams": "random_generator",
            "texts": "Texts",
            "tree": "Node",
            "trial": "ANSWERS ANSWERS_WITH_NONE Answer Condition Response TIME_OUT Trial",
            "twin": "Fingers UnlistedMode",
        },
    )

__all__ = [
    "ANSWERS",
    "ANSWERS_WITH_NONE",
    "Answer",
    "AnswersSection",
    "Apparatus",
    "CalibratedAmplifier",
    "CalibratedApparatus",
    "CalibratedLevel",
    "CalibratedMode",
    "CalibratedStimulus",
    "Calibration",
    "CalibrationFile",
    "CalibrationOfSeveral",
    "Condition",
    "END_KEY",
    "Experiment",
    "Findings",
    "Fingers",
    "InputError",
    "Instruments",
    "IterationFigures",
    "KEY_ALIASES",
    "Levels",
    "MaskingSection",
    "MeasuringChain",
    "Node",
    "ObserverFile",
    "PAUSE_KEY",
    "Points",
    "Problem",
    "Protocol",
    "Reading",
    "Response",
    "ResumeSection",
    "Schedule",
    "Section",
    "SensationLevelsSection",
    "Sound",
    "Source",
    "Sources",
    "StimulusSection",
    "TIME_OUT",
    "Texts",
    "Trial",
    "Turn",
    "UnlistedMode",
    "Zone",
    "apparatus_hash",
    "calibrated_apparatus",
    "calibration_alone",
    "check_calibration",
    "check_fit",
    "check_protocol",
    "describe_rule",
    "draw_schedule",
    "examine_apparatus",
    "examine_files",
    "examine_sources",
    "expected_answer",
    "find",
    "generator_problem",
    "in_calibration",
    "is_success",
    "judge_round",
    "load_source",
    "offered_gains",
    "period_of_turns",
    "random_generator",
    "read",
    "read_apparatus",
    "read_points",
    "read_protocol",
    "recorded_turn",
    "shipped",
    "suggest",
    "to_dB",
    "turn_of",
    "zone_edges",
]
