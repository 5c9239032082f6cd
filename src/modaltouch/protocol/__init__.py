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
    from modaltouch.protocol.adaptive_rules.levels import Levels, describe_rule, to_dB
    from modaltouch.protocol.adaptive_rules.staircase import is_success
    from modaltouch.protocol.apparatus import examine_apparatus, read_apparatus
    from modaltouch.protocol.apparatus.checks import zone_edges
    from modaltouch.protocol.apparatus.offered import offered_gains
    from modaltouch.protocol.apparatus.sections import Apparatus, Sound, Zone
    from modaltouch.protocol.apparatus.twin import Fingers, UnlistedMode
    from modaltouch.protocol.calibration_file import (
        apparatus_hash,
        calibrated_apparatus,
        calibration_alone,
        check_calibration,
        generator_problem,
        in_calibration,
    )
    from modaltouch.protocol.calibration_sections import (
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
    )
    from modaltouch.protocol.checks import check_protocol
    from modaltouch.protocol.document.problems import InputError, Problem, suggest
    from modaltouch.protocol.document.reading import Reading, read
    from modaltouch.protocol.document.section import Section
    from modaltouch.protocol.document.shipped_files import find, shipped
    from modaltouch.protocol.document.source import Source, load_source
    from modaltouch.protocol.document.tree import Node
    from modaltouch.protocol.experiment import (
        Experiment,
        Findings,
        Sources,
        examine_files,
        examine_sources,
        read_protocol,
    )
    from modaltouch.protocol.field_points import Points, read_points
    from modaltouch.protocol.fit import check_fit
    from modaltouch.protocol.keys import END_KEY, KEY_ALIASES, PAUSE_KEY
    from modaltouch.protocol.masking import MaskingSection
    from modaltouch.protocol.observers import ObserverFile
    from modaltouch.protocol.practice import expected_answer, judge_round
    from modaltouch.protocol.schedule.draw import Schedule, Turn, draw_schedule, period_of_turns, recorded_turn, turn_of
    from modaltouch.protocol.schedule.streams import random_generator
    from modaltouch.protocol.sections import AnswersSection, Protocol, ResumeSection
    from modaltouch.protocol.sensation import SensationLevelsSection
    from modaltouch.protocol.stimulus_sections import StimulusSection
    from modaltouch.protocol.texts import Texts
    from modaltouch.protocol.trial import ANSWERS, ANSWERS_WITH_NONE, TIME_OUT, Answer, Condition, Response, Trial
else:
    __getattr__ = lazily(
        __name__,
        {
            "adaptive_rules.levels": "Levels describe_rule to_dB",
            "adaptive_rules.staircase": "is_success",
            "apparatus": "examine_apparatus read_apparatus",
            "apparatus.checks": "zone_edges",
            "apparatus.offered": "offered_gains",
            "apparatus.sections": "Apparatus Sound Zone",
            "apparatus.twin": "Fingers UnlistedMode",
            "calibration_file": (
                "apparatus_hash calibrated_apparatus calibration_alone "
                "check_calibration generator_problem in_calibration"
            ),
            "calibration_sections": (
                "CalibratedAmplifier CalibratedApparatus CalibratedLevel CalibratedMode "
                "CalibratedStimulus Calibration CalibrationFile CalibrationOfSeveral Instruments "
                "IterationFigures MeasuringChain"
            ),
            "checks": "check_protocol",
            "document.problems": "InputError Problem suggest",
            "document.reading": "Reading read",
            "document.section": "Section",
            "document.shipped_files": "find shipped",
            "document.source": "Source load_source",
            "document.tree": "Node",
            "experiment": "Experiment Findings Sources examine_files examine_sources read_protocol",
            "field_points": "Points read_points",
            "fit": "check_fit",
            "keys": "END_KEY KEY_ALIASES PAUSE_KEY",
            "masking": "MaskingSection",
            "observers": "ObserverFile",
            "practice": "expected_answer judge_round",
            "schedule.draw": "Schedule Turn draw_schedule period_of_turns recorded_turn turn_of",
            "schedule.streams": "random_generator",
            "sections": "AnswersSection Protocol ResumeSection",
            "sensation": "SensationLevelsSection",
            "stimulus_sections": "StimulusSection",
            "texts": "Texts",
            "trial": "ANSWERS ANSWERS_WITH_NONE Answer Condition Response TIME_OUT Trial",
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
    "suggest",
    "to_dB",
    "turn_of",
    "shipped",
    "zone_edges",
]
