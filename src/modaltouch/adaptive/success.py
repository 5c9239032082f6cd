"""Which answers count as success."""

from __future__ import annotations


def is_success(rule: str, focus: str, zone_left: str, answer: str) -> bool:
    """Return whether an answer counts as success in an adaptive run.

    ``focus_named``: the answer is the finger on the zone in focus, alone. "both" and "none" are failures like the
    other finger: what is asked is the level from which the focus is told apart, not from which something is felt.
    ``felt``: any answer but "none".

    Parameters
    ----------
    rule : str
        ``adaptive.success`` of the protocol.
    focus : str
        Zone in focus.
    zone_left : str
        Zone under the left finger.
    answer : str
        What was answered.
    """
    if rule == "felt":
        return answer != "none"
    return answer == ("left" if zone_left == focus else "right")
