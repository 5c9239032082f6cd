"""Recorded answers against the questions of the protocol: of a trial, after it, and of the form at the end."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from modaltouch.protocol import TIME_OUT, AnswersSection, Protocol

Event = dict[str, Any]

_INSTANT = 5e-6
"""Instants are written to the microsecond [s]."""


def check_answers(event: Event, asked: AnswersSection) -> Iterator[str]:
    """Yield where the answers of a line cannot have been given; further questions follow a confirmed stimulus alone."""
    response = event["response"]
    yield from _check_response(response, asked)
    is_asked = event["confirmed"]["confirmed"] and response["answer"] != TIME_OUT
    wanted = asked.further if event["event"] == "trial" and is_asked else {}
    further = response.get("further", {})
    if list(further) != list(wanted):
        yield f"answers the further questions {', '.join(further) or '-'}; asked were {', '.join(wanted) or '-'}"
        return
    before = 0.0
    if wanted:
        # What was asked counts from the last interval; the line itself is about the comparison's.
        onset = (event.get("intervals") or [event])[-1]["confirmed"]["onset"]
        before = max(event["instants"]["answer"]["earliest_s"] - onset, before)
    for name, how in wanted.items():
        came = further[name].get("question_after")
        if came is not None and came < before - _INSTANT:
            yield f"{name}: was asked {came:.6g} s after the stimulus began, before the answer at {before:.6g} s"
        before = before if came is None else came + further[name]["reaction_time"]
        yield from (f"{name}: {fault}" for fault in _check_response(further[name], how))


def check_form(event: Event, protocol: Protocol, done: set[str]) -> Iterator[str]:
    """Yield where an answer to the form at the end cannot have been given.

    Parameters
    ----------
    event : dict
        Its line.
    protocol : Protocol
        What is asked.
    done : set of str
        Questions that were answered before, to which this one is added.
    """
    name, asked = event["name"], protocol.closing
    if name not in asked or name in done:
        yield f"the form {'has no question' if name not in asked else 'has an answer already to'} {name!r}"
        return
    done.add(name)
    yield from (f"{name} of the form: {fault}" for fault in _check_response(event["response"], asked[name]))


def _check_response(response: Event, asked: AnswersSection) -> Iterator[str]:
    if not asked.takes(response["answer"], response.get("value")):
        value = f" {response['value']}" if "value" in response else ""
        yield f"was answered {response['answer']!r}{value}; allowed: {asked.allowed}, {TIME_OUT}"
    if not 0 <= response["reaction_time"] < math.inf:
        yield f"has a reaction time of {response['reaction_time']} s"
