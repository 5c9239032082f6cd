"""Answers given with the beam turned end to end, told as if it had not been: zones stay, left and right change."""

from __future__ import annotations

import pandas as pd

_EXCHANGED = {"left": "right", "right": "left", "both": "both", "none": "none"}
_SIDES = (("zone_left", "zone_right"), ("speed_left_mm_s", "speed_right_mm_s"))


def unmirror(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a tidy table with the zones of mirrored rows, and their answers, in the order of the beam.

    Someone who felt zone C at the left end of a turned beam answered "left"; beside those who felt it on the right,
    the answer is C all the same. The column ``placement`` stays and tells the side.

    Parameters
    ----------
    frame : DataFrame
        Tidy answers; rows whose column ``placement`` begins with "mirrored" are turned.
    """
    if "placement" not in frame.columns:
        return frame
    turned = frame["placement"].astype(str).str.startswith("mirrored").to_numpy()
    if not turned.any():
        return frame
    words = frame["response"].astype(str)
    changed = {"response": words.where(~turned, words.map(_EXCHANGED))}
    for left, right in _SIDES:
        if left in frame.columns and right in frame.columns:
            changed[left] = frame[left].where(~turned, frame[right])
            changed[right] = frame[right].where(~turned, frame[left])
    return frame.assign(**changed)
