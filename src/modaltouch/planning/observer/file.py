"""Reading and writing of observers in YAML files, shipped or the user's own."""

from __future__ import annotations

import json
import math
from pathlib import Path

from modaltouch.planning.observer.participant import Participant
from modaltouch.planning.observer.population import Observer
from modaltouch.protocol import ObserverFile, Protocol


def read_observer(name: Path | str) -> Observer:
    """Return an observer from its file.

    Parameters
    ----------
    name : path
        A YAML file, or the name of a shipped observer, such as ``paper``.

    Raises
    ------
    InputError
        With every fault of the file and its position; or with the shipped names, if there is no such file.
    """
    file = ObserverFile.read(name)
    typical, spread = file.typical, file.spread
    return Observer(
        typical=Participant(
            noise=math.log1p(typical.weber_fraction),
            criterion=typical.criterion,
            suppression=typical.suppression.one_hand,
            suppression_across_hands=typical.suppression.two_hands,
            side_bias=typical.side_bias,
            lapse_rate=typical.lapse_rate,
            detection_speed=typical.detection_speed_mm_s * 1e-3,
            quickest=typical.reaction.quickest_s,
            decision_time=typical.reaction.decision_s,
            hesitation=typical.reaction.hesitation,
            decision_spread=typical.reaction.spread,
            near_miss=typical.near_miss,
            internal_noise=typical.internal_noise_mm_s * 1e-3,
        ),
        side_bias_spread=spread.side_bias,
        noise_spread=spread.weber_fraction,
        criterion_spread=spread.criterion,
        suppression_spread=spread.suppression,
        pace_spread=spread.pace,
        front_end=file.front_end,
        name=file.observer,
    )


def usual_observer(protocol: Protocol) -> str:
    """Return the name of the shipped observer that simulates a protocol by default.

    Adaptive runs, levels that follow from their thresholds, silent standards, and answers felt or not need `fingertip`,
    whose thresholds lie within a beam's range; `paper` feels any level, and tells the zones apart.

    Parameters
    ----------
    protocol : Protocol
        The protocol.
    """
    at_thresholds = protocol.adaptive is not None or protocol.conditions.sensation_levels is not None
    is_silent = protocol.intervals is not None and protocol.intervals.standard.velocity_mm_s == 0
    offered = protocol.answers.offered
    is_detected = len(offered) == 2 and offered.naming() is not None
    return "fingertip" if at_thresholds or is_silent or is_detected else "paper"


def write_observer(observer: Observer, name: str, description: str) -> str:
    """Return the text of an observer's file.

    Parameters
    ----------
    observer : Observer
        The observer.
    name, description : str
        Name and description in the file.
    """
    typical = observer.typical
    return f"""\
observer: {name}
description: {json.dumps(description, ensure_ascii=False)}
front_end: {observer.front_end}
typical:
  weber_fraction: {math.expm1(typical.noise):.4g}
  near_miss: {typical.near_miss:.4g}
  criterion: {typical.criterion:.4g}
  suppression: {{one_hand: {typical.suppression:.4g}, two_hands: {typical.suppression_across_hands:.4g}}}
  side_bias: {typical.side_bias:.4g}
  lapse_rate: {typical.lapse_rate:.4g}
  detection_speed_mm_s: {typical.detection_speed * 1e3:.4g}
  internal_noise_mm_s: {typical.internal_noise * 1e3:.4g}
  reaction:
    quickest_s: {typical.quickest:.4g}
    decision_s: {typical.decision_time:.4g}
    hesitation: {typical.hesitation:.4g}
    spread: {typical.decision_spread:.4g}
spread:
  weber_fraction: {observer.noise_spread:.4g}
  criterion: {observer.criterion_spread:.4g}
  suppression: {observer.suppression_spread:.4g}
  side_bias: {observer.side_bias_spread:.4g}
  pace: {observer.pace_spread:.4g}
"""
