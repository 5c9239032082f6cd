"""An observer as the text of a YAML file."""

from __future__ import annotations

import json
import math

from modaltouch.planning.observer.population import Observer


def write_observer(observer: Observer, name: str, description: str) -> str:
    """Return the text of an observer's file.

    Parameters
    ----------
    observer : Observer
        The observer.
    name, description : str
        What the file calls it.
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
