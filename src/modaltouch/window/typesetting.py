"""Typesetting of texts in any script, shaped by HarfBuzz through Pillow's Raqm.

Each character is set in the first bundled or installed font that has it. Lines break at spaces, between ideographs, and
where a text has zero-width spaces or soft hyphens, without which a word of Thai, Lao or Khmer is as long as its phrase;
characters are ordered by the Unicode bidirectional algorithm (UAX 9, by FriBidi), each paragraph in the direction of
its first letter.
"""

from __future__ import annotations

import ctypes
import math
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib.util import find_spec
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from modaltouch.window.layout import Coverage, Words

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont


_ALSO = ("DejaVuSans", "NotoSansCJK-Regular", "wqy-microhei", "DroidSansFallbackFull")
"""Fonts tried after Noto Sans and the Noto font of a script; the first comes with matplotlib, the others have CJK."""
_COME_ALONG = {"NotoSans": ("psychopy", "assets/fonts"), "DejaVuSans": ("matplotlib", "mpl-data/fonts/ttf")}
"""Fonts bundled with packages, so that pictures are the same on every machine."""


@dataclass(frozen=True)
class Font:
    """A font file."""

    path: str  # path of the file
    is_emboldened: bool = False  # whether it lacks a bold companion and must be drawn with thicker strokes

    def has(self, character: str) -> bool:
        """Return whether the font has a glyph for a character; True for spaces, line breaks and format characters."""
        is_blank = character == "\n" or unicodedata.category(character) in ("Cf", "Zs")
        return is_blank or ord(character) in _coverage(self.path)


@cache
def _first(named: str, character: str, bold: bool) -> Font:
    """Return the first font that has a character, else that of a hyphen."""
    # The Unicode name of a letter begins with its script.
    script = unicodedata.name(character, "").partition(" ")[0].title()
    names = (*([named] if named else []), "NotoSans", f"NotoSans{script}", *_ALSO)
    fonts = (font for name in names if (font := find_font(name, bold=bold)) and font.has(character))
    return next(fonts, None) or _first(named, "-", bold)


@cache
def find_font(name: str, *, bold: bool = False) -> Font | None:
    """Find a bundled or installed font; None if there is none.

    Parameters
    ----------
    name : str
        File name, with or without ``-Regular`` and suffix, or absolute path.
    bold : bool
        Whether to use its bold companion.
    """
    stem = name.removesuffix(Path(name).suffix).removesuffix("-Regular")
    regular = _find_file(name) or _find_file(f"{stem}-Regular")
    if not bold or regular is None:
        return None if regular is None else Font(regular)
    companion = _find_file(f"{stem}-Bold{Path(name).suffix}")
    return Font(regular, is_emboldened=True) if companion is None else Font(companion)


def _find_file(name: str) -> str | None:
    from PIL import ImageFont

    stem = name.removesuffix(".ttf")
    package, folder = _COME_ALONG.get(stem.partition("-")[0], ("", ""))
    spec = find_spec(package) if package else None
    file = Path(spec.origin).parent / folder / f"{stem}.ttf" if spec is not None and spec.origin else Path(name)
    try:
        # Pillow searches the font folders of the system.
        return str(ImageFont.truetype(file, 10).path)
    except OSError:
        return None


@cache
def _coverage(path: str) -> frozenset[int]:
    from fontTools.ttLib import TTFont

    with TTFont(path, fontNumber=0, lazy=True) as font:
        return frozenset(font.getBestCmap())


FRIBIDI = {"darwin": "libfribidi.0.dylib", "win32": "fribidi-0.dll"}.get(sys.platform, "libfribidi.so.0")
"""Library of the bidirectional algorithm, also used by Pillow."""
_RTL, _LTR = 0x111, 0x110
"""FriBidi's constants for the direction of a paragraph."""
_ASCENT, _DESCENT, _LEADING = 0.93, 0.22, 0.21
"""Extent of a line above and below its baseline, symmetric about the middle of its capitals and larger where letters
protrude, and the leading between two lines [em]."""
_OVERHANG = 0.04
"""Allowed protrusion of letters such as descenders from that extent, so that adjacent texts share a baseline [em]."""
_STEP, _SMALLEST = 0.05, 0.4
"""Step of reductions of the type size until a text fits, and its minimum share of the intended size [1]."""
_NEVER_FIRST = frozenset("ぁぃぅぇぉっゃゅょゎァィゥェォッャュョヮ々")
"""Small kana and the repetition mark, which must not begin a line."""


@dataclass(frozen=True)
class GlyphRun:
    """Characters of one font and direction."""

    text: str  # the characters in reading order
    font: Font  # their font
    is_rtl: bool  # whether they run from right to left


@dataclass(frozen=True)
class Line:
    """A line of text."""

    runs: tuple[GlyphRun, ...]  # runs from left to right
    # width, ascent, descent: extent [pixels]
    width: float
    ascent: float = 0.0
    descent: float = 0.0


@dataclass(frozen=True)
class TypeBlock:
    """A text broken into lines at a type size."""

    lines: tuple[Line, ...]  # lines from the top
    size: float  # type size, em [pixels]
    share: float  # type size relative to the intended one [1]

    @property
    def width(self) -> float:
        """Width of the longest line [pixels]."""
        return max(line.width for line in self.lines)

    @property
    def height(self) -> float:
        """Height from the top of the first line to the bottom of the last [pixels]."""
        leading = _LEADING * self.size * (len(self.lines) - 1)
        return leading + sum(line.ascent + line.descent for line in self.lines)

    def fits(self, width: float, height: float) -> bool:
        """Return whether the text fits a box [pixels]."""
        return self.width <= width and self.height <= height


@dataclass(frozen=True)
class Typesetter:
    """Typesetter of the texts of one language."""

    font: str = ""  # file name or absolute path of an installed font to try first; empty to choose fonts by script
    language: str = ""  # BCP 47 code, for which a font may have specific glyphs; empty if unknown

    def choose_fonts(self, text: str, *, bold: bool = False) -> list[Font]:
        """Return the font of each character: one that has it, else that of a hyphen.

        Spaces, digits and punctuation use the font of the preceding letters if it has them.
        """
        letters = [character for character in text if unicodedata.category(character)[0] == "L"]
        last, chosen = _first(self.font, letters[0] if letters else "-", bold), []
        for character in text:
            is_letter = unicodedata.category(character)[0] == "L"
            font = _first(self.font, character, bold) if is_letter or not last.has(character) else last
            last = font if is_letter else last
            chosen.append(font)
        return chosen

    def lacking(self, text: str) -> str:
        """Return the characters that no font has; Western European texts, covered by bundled fonts, are not checked."""
        with suppress(UnicodeEncodeError):
            text.encode("cp1252")
            return "".join(letter for letter in text if letter != "\n" and unicodedata.category(letter) == "Cc")
        return "".join(
            letter for letter, font in zip(text, self.choose_fonts(text), strict=True) if not font.has(letter)
        )

    def set_type(self, words: Words, window_height: int) -> TypeBlock:
        """Set a text at its intended size, or the largest that fits its box.

        Parameters
        ----------
        words : Words
            Text, box and intended size.
        window_height : int
            Height of the window, which is the unit of box and size [pixels].
        """
        width, height = words.box.width * window_height, words.box.height * window_height
        share = 1.0
        while True:
            size = words.size * share * window_height
            block = TypeBlock(tuple(self._break_lines(words.text, size, width, bold=words.bold)), size, share)
            if share <= _SMALLEST or block.fits(width, height):
                return block
            share -= _STEP

    def measure(self, text: str, *, bold: bool = False) -> float:
        """Return the width of a text on one line [em]."""
        return self._line(text, 100.0, bold=bold, is_rtl=first_letter_is_rtl(text)).width / 100.0

    def cover(self, words: Words, window: tuple[int, int]) -> Coverage:
        """Return the pixels of a text, centred in its box.

        Parameters
        ----------
        words : Words
            Text, box and intended size.
        window : (width, height) of int
            Size of the window [pixels].
        """
        from PIL import Image, ImageDraw

        block = self.set_type(words, window[1])
        # Swashes and marks may protrude from the extent of a line.
        margin = math.ceil(block.size)
        columns, rows = math.ceil(block.width) + 2 * margin, math.ceil(block.height) + 2 * margin
        image = Image.new("L", (columns, rows))
        pen = ImageDraw.Draw(image)
        baseline = float(margin)
        for line in block.lines:
            baseline += line.ascent
            x = float(round((columns - line.width) / 2))
            for run in line.runs:
                font, shaping = _load(run.font.path, block.size), self._shaping(run)
                stroke = 0.02 * block.size * run.font.is_emboldened
                pen.text((x, round(baseline)), run.text, 255, font, "ls", stroke_width=stroke, **shaping)
                x += font.getlength(run.text, **shaping)
            baseline += line.descent + _LEADING * block.size
        left, top, right, bottom = image.getbbox() or (0, 0, 1, 1)
        alpha = np.asarray(image, dtype=np.float32)[top:bottom, left:right][::-1] / np.float32(255)
        x0 = round(window[0] / 2 + words.box.x * window[1] - columns / 2)
        y0 = round(window[1] / 2 + words.box.y * window[1] - rows / 2)
        return Coverage(x0 + left, y0 + rows - bottom, alpha)

    def _shaping(self, run: GlyphRun) -> dict[str, Any]:
        return {"direction": "rtl" if run.is_rtl else "ltr", "language": self.language or None}

    def _break_lines(self, text: str, size: float, width: float, *, bold: bool) -> Iterator[Line]:
        """Yield the lines of a text, broken within the width if possible, of similar length in each paragraph."""
        for paragraph in text.split("\n"):
            lines = self._fill(paragraph, size, width, bold=bold)
            # A narrower column avoids a single word on the last of several lines.
            shares = (0.6, 0.7, 0.8, 0.9) if len(lines) > 1 else ()
            narrower = (self._fill(paragraph, size, width * share, bold=bold) for share in shares)
            yield from next((fewer for fewer in narrower if len(fewer) == len(lines)), lines)

    def _fill(self, paragraph: str, size: float, width: float, *, bold: bool) -> list[Line]:
        """Return the lines of a paragraph, each with as many words as fit."""
        is_rtl = first_letter_is_rtl(paragraph)
        lines, begun = [self._line("", size, bold=bold, is_rtl=is_rtl)], ""
        for piece in _pieces(paragraph):
            longer = self._line(_ended(begun + piece), size, bold=bold, is_rtl=is_rtl)
            if begun and longer.width > width:
                begun, longer = "", self._line(_ended(piece), size, bold=bold, is_rtl=is_rtl)
                lines.append(longer)
            lines[-1], begun = longer, begun + piece
        return [self._extended(line, size) for line in lines]

    def _line(self, text: str, size: float, *, bold: bool, is_rtl: bool) -> Line:
        chosen = zip(*_levels(text, is_rtl=is_rtl), self.choose_fonts(text, bold=bold), text, strict=True)
        placed = {}
        for (level, font), group in groupby(chosen, key=itemgetter(0, 2)):
            _, places, _, letters = zip(*group, strict=True)
            placed[min(places)] = GlyphRun("".join(letters), font, is_rtl=level % 2 == 1)
        runs = tuple(run for _, run in sorted(placed.items(), key=itemgetter(0)))
        return Line(runs, sum(_load(run.font.path, size).getlength(run.text, **self._shaping(run)) for run in runs))

    def _extended(self, line: Line, size: float) -> Line:
        inks = [_load(run.font.path, size).getbbox(run.text, anchor="ls", **self._shaping(run)) for run in line.runs]
        over = _OVERHANG * size
        ascent, descent = (max(-ink[1] for ink in inks), max(ink[3] for ink in inks)) if inks else (0.0, 0.0)
        return replace(line, ascent=max(_ASCENT * size, ascent - over), descent=max(_DESCENT * size, descent - over))


def _pieces(text: str) -> Iterator[str]:
    """Yield the unbreakable pieces of a text: words with trailing spaces, ideographs with their punctuation.

    A small part of UAX 14, for words separated by spaces, with zero-width spaces and soft hyphens, and for Chinese and
    Japanese.
    """
    start = 0
    for place in range(1, len(text)):
        before, after = text[place - 1], text[place]
        kinds = unicodedata.category(before), unicodedata.category(after)
        begins = kinds[1] in ("Ll", "Lu", "Lo", "Nd", "No", "So", "Ps", "Pi") and after not in _NEVER_FIRST
        is_ideograph = "W" in map(unicodedata.east_asian_width, (before, after))
        between_ideographs = is_ideograph and begins and kinds[0] not in ("Ps", "Pi", "Cf", "Zs")
        if between_ideographs or (before in " \u200b\u00ad" and after != " "):
            yield text[start:place]
            start = place
    yield text[start:]


def _ended(line: str) -> str:
    """Return the characters of a line as it ends: without spaces, and with a hyphen for a soft one."""
    line = line.rstrip(" ")
    return f"{line[:-1]}-" if line.endswith("\u00ad") else line


def first_letter_is_rtl(text: str) -> bool:
    """Return whether a paragraph runs from right to left, by rules P2 and P3 of UAX 9."""
    return next((way for way in map(unicodedata.bidirectional, text) if way in ("L", "R", "AL")), "L") != "L"


@cache
def _fribidi() -> ctypes.CDLL:
    from PIL import features

    if not features.check("raqm"):
        from modaltouch.window.interface import WindowError

        raise WindowError(
            "the texts cannot be set: Pillow finds no FriBidi on this machine; install the Debian package "
            "libfribidi0, or its equivalent on this system"
        )
    return ctypes.CDLL(FRIBIDI)


def _levels(text: str, *, is_rtl: bool) -> tuple[list[int], list[int]]:
    """Return each character's embedding level by UAX 9, odd for right to left, and its position from the left."""
    n = len(text)
    letters, places, levels = (ctypes.c_uint32 * n)(*map(ord, text)), (ctypes.c_int * n)(), (ctypes.c_int8 * n)()
    direction = ctypes.c_uint32(_RTL if is_rtl else _LTR)
    _fribidi().fribidi_log2vis(letters, n, ctypes.byref(direction), None, places, None, levels)
    return list(levels), list(places)


@lru_cache(256)
def _load(path: str, size: float) -> FreeTypeFont:
    from PIL import ImageFont

    return ImageFont.truetype(path, size, layout_engine=ImageFont.Layout.RAQM)
