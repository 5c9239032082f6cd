"""Errors of a design as problems of the files: the key at fault follows from the words of the message."""

from __future__ import annotations

import re

from modaltouch.protocol import Findings, Problem

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
"""Patterns of `stimulus` error messages and the key of the stimulus section at fault; the first match counts."""

_MODE_KEYS = (("gain", "gain_mm_s2_per_V"), ("damping", "damping_ratio"), ("frequency", "natural_frequency_Hz"))
"""Words of `stimulus` error messages and the key of the table of modes at fault."""


def located(error: Exception, findings: Findings) -> Problem:
    """Return an error of the design as a problem of the file and key that caused it."""
    protocol, apparatus = findings.protocol, findings.apparatus
    if protocol is None or apparatus is None:
        raise error
    message = " ".join(str(error).split())
    given, _, remedy = message.rpartition(": ") if ": " in message else (message, "", "")
    given = f"a stimulus that cannot be made, {given}"
    mode = re.search(r"mode (\d+)", message)
    key = next((key for word, key in _MODE_KEYS if word in message), "")
    if mode is not None and key:
        index = next((index for index, each in apparatus.items("modes") if each.label == int(mode.group(1))), None)
        if index is not None:
            return apparatus.problem(("modes", index, key), given, "", remedy)
    if re.search(r"linearly dependent|scan grid|zero at every point", message):
        return apparatus.problem(("beam", "measured_shapes"), given, "", remedy)
    # The delay is the cause if it exceeds half the time before the focusing instant.
    delay, instant = apparatus.sound("amplifier", "delay_us"), protocol.sound("stimulus", "focusing_instant_ms")
    if "samples are fewer" in message and delay is not None and instant is not None and delay > 500 * instant:
        remedy = "shorten the delay, or move the focusing instant"
        return apparatus.problem(("amplifier", "delay_us"), given, "", remedy)
    key = next((key for words, key in _PLACES if re.search(words, message)), "")
    return protocol.problem(("stimulus", key) if key else ("stimulus",), given, "", remedy)
