"""Whether the participant can read the texts: a glyph for every character, in type that is large enough."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from modaltouch.preflight.checked import Preflight
from modaltouch.protocol import Findings, Problem, Schedule
from modaltouch.window import Fonts, find_font

LEAST_ANGLE = 20.0
"""Smallest visual angle of the height of a capital; ISO 9241-303 recommends 20 to 22 [arcmin]."""
_NOT_SHOWN = {"protocol", "title", "apparatus", "texts", "language", "language_code", "font", "stimulus", "stimuli"}


def check_legibility(preflight: Preflight, window: tuple[int, int] | None = None) -> Preflight:
    """Return the preflight with texts that cannot be read among its problems.

    Parameters
    ----------
    preflight : Preflight
        The examined protocol.
    window : (width, height) of int, optional
        Size of the answer window [pixels]; by default the whole screen.
    """
    problems = [*preflight.problems, *_check_letters(preflight.findings)]
    if not problems:
        problems += _check_type(preflight.findings, window)
    return replace(preflight, problems=tuple(sorted(problems)))


def _check_letters(findings: Findings) -> Iterator[Problem]:
    """Yield the characters that no installed font has, and a named font that is not installed."""
    if findings.texts is None:
        return
    fonts = Fonts(findings.texts.sound("font") or "")
    if fonts.named and find_font(fonts.named) is None:
        given, allowed = f"{fonts.named}, which is not installed", "the file of an installed font"
        yield findings.texts.problem(("font",), given, allowed, "install it, or leave the key out")
    for reading in (findings.texts, findings.protocol):
        for path, text in _strings((), None if reading is None else reading.root):
            if reading is not None and (lacking := fonts.lacking(text)):
                name = unicodedata.name(lacking[0], "no letter of Unicode")
                given, allowed = f"'{lacking[0]}' ({name}), which no installed font has", "letters of installed fonts"
                remedy = "use another character, or install a font that has it (`modaltouch doctor` names packages)"
                yield reading.problem(path, given, allowed, remedy)


def _strings(path: tuple[str | int, ...], node: Any) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Yield every text below a node of a file that may be shown, with its path."""
    content = None if node is None else node.content
    if isinstance(content, str):
        yield path, content
    elif isinstance(content, dict | list):
        for step, child in content.items() if isinstance(content, dict) else enumerate(content):
            yield from () if not path and step in _NOT_SHOWN else _strings((*path, step), child)


def _check_type(findings: Findings, window: tuple[int, int] | None) -> Iterator[Problem]:
    """Yield the smallest text if it is too small to be read well at the stated distance."""
    experiment, reading = findings.experiment(), findings.apparatus
    protocol, screen = experiment.protocol, experiment.apparatus.screen
    if screen is None or reading is None:
        return
    from modaltouch.window import smallest_type

    size = window or (screen.width_px, screen.height_px)
    placements = {
        (each.condition.finger_condition, each.condition.zones, each.condition.placement): each
        for each in Schedule.draw_from(findings, "p01", 0).trials
    }
    pixels, text = smallest_type(
        protocol, experiment.texts, experiment.apparatus.zone_spans, [*placements.values()], size
    )
    angle = math.degrees(2 * math.atan(pixels * screen.width_mm / screen.width_px / 2 / screen.distance_mm)) * 60
    if angle < LEAST_ANGLE:
        given = f"a window of {size[0]} x {size[1]} pixels in which a capital of '{text}' is {angle:.1f} arcmin high"
        remedy = "shorten the text, take a larger window (--fullscreen), or sit nearer"
        yield reading.problem(("screen",), given, f"at least {LEAST_ANGLE:g} arcmin", remedy)
