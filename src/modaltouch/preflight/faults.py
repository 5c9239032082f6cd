"""What the stimulus engine refuses, with its place in the files."""

from __future__ import annotations

import re

from modaltouch.document import Problem
from modaltouch.protocol import Findings

_PLACES: tuple[tuple[str, str], ...] = (
    (r"sampled field", "field"),
    (r"projects to|centred at", "focus"),
    (r"decomposed on", "decomposed_modes"),
    (r"selected", "selected_modes"),
    (r"focusing instant", "focusing_instant_ms"),
    (r"period|duration|repetition", "duration_ms"),
    (r"samples|sampling", "n_samples"),
    (r"base of the field|shape", "field"),
)
"""Words of the engine's messages and the key of the stimulus section that they are about, first match first."""


def locate(error: Exception, findings: Findings) -> Problem:
    """Return what the engine refused as a problem of the file that asked for it.

    Parameters
    ----------
    error : Exception
        What the engine raised.
    findings : Findings
        The files; the protocol and apparatus must have been opened.

    Raises
    ------
    ValueError
        If the protocol or the apparatus was not opened.
    """
    protocol, apparatus = findings.protocol, findings.apparatus
    if protocol is None or apparatus is None:
        raise ValueError("there is no file in which to find the fault: open protocol and apparatus first")
    message = " ".join(str(error).split())
    given, _, remedy = message.rpartition(": ") if ": " in message else (message, "", "")
    given = f"a stimulus that cannot be made, {given}"
    mode = re.search(r"mode (\d+)", message)
    if mode is not None and re.search(r"gain|damping|frequency", message):
        labels = {label: index for index, label in _labels(findings)}
        index = labels.get(int(mode.group(1)))
        key = next(key for word, key in _MODE_KEYS if word in message)
        if index is not None:
            return apparatus.problem(("modes", index, key), given, "", remedy)
    if re.search(r"linearly dependent|scan grid|zero at every point", message):
        return apparatus.problem(("beam", "measured_shapes"), given, "", remedy)
    if re.search(r"samples are fewer", message) and _is_late(findings):
        return apparatus.problem(
            ("amplifier", "delay_us"), given, "", "shorten the delay, or move the focusing instant"
        )
    key = next((key for words, key in _PLACES if re.search(words, message)), "")
    return protocol.problem(("stimulus", key) if key else ("stimulus",), given, "", remedy)


_MODE_KEYS = (
    ("gain", "gain_mm_s2_per_V"),
    ("damping", "damping_ratio"),
    ("frequency", "natural_frequency_Hz"),
)


def _is_late(findings: Findings) -> bool:
    """Return whether the amplifier's delay takes most of the time before the focusing instant."""
    if findings.protocol is None or findings.apparatus is None:
        return False
    delay = findings.apparatus.sound("amplifier", "delay_us")
    instant = findings.protocol.sound("stimulus", "focusing_instant_ms")
    return delay is not None and instant is not None and delay > 500 * instant


def _labels(findings: Findings) -> list[tuple[int, int]]:
    reading = findings.apparatus
    if reading is None:
        return []
    return [(index, mode.label) for index, mode in reading.items("modes")]
