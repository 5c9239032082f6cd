"""Which answers count as success."""

from __future__ import annotations

from modaltouch.protocol import Protocol
from modaltouch.trial import Condition


def is_success(protocol: Protocol, condition: Condition, answer: str) -> bool:
    """Return whether an answer counts as success in an adaptive run.

    ``focus_named``: the answer is the finger on the zone in focus, alone. "both" and "none" are failures like the
    other finger: what is asked is the level from which the focus is told apart, not from which something is felt.
    ``felt``: any answer but "none".

    Parameters
    ----------
    protocol : Protocol
        With a section ``adaptive``.
    condition : Condition
        What was presented.
    answer : str
        What was answered.

    Raises
    ------
    ValueError
        If the protocol is not adaptive.
    """
    if protocol.adaptive is None:
        raise ValueError("the protocol has no section adaptive, so no answer counts as success; give one that has")
    if protocol.adaptive.success == "felt":
        return answer != "none"
    return answer == ("left" if condition.zone_left == protocol.stimulus.focus else "right")
