"""Fonts: which of those at hand draws a character."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

_ALSO = ("DejaVuSans", "NotoSansCJK-Regular", "wqy-microhei", "DroidSansFallbackFull")
"""Asked after Noto Sans and the Noto font of a script; the first comes with matplotlib, the rest have CJK."""
_COME_ALONG = {"NotoSans": ("psychopy", "assets/fonts"), "DejaVuSans": ("matplotlib", "mpl-data/fonts/ttf")}
"""Fonts that packages bring along, so that every machine shows the same picture."""


@dataclass(frozen=True)
class Font:
    """A font file.

    Attributes
    ----------
    path : str
        The file.
    is_emboldened : bool
        Whether it has no bold companion and is to be drawn with thicker strokes.
    """

    path: str
    is_emboldened: bool = False

    def has(self, character: str) -> bool:
        """Return whether the font has a glyph for a character; spaces and what is never seen need none."""
        return unicodedata.category(character) in ("Cc", "Cf", "Zs") or ord(character) in _coverage(self.path)


@dataclass(frozen=True)
class Fonts:
    """The fonts for the texts of one language.

    Attributes
    ----------
    named : str
        File name of an installed font that is asked first, such as ``Amiri-Regular.ttf``, or its absolute path.
    """

    named: str = ""

    @property
    def file(self) -> Font | None:
        """The named font; None where it is not installed."""
        return find_font(self.named)

    def choose(self, text: str, *, bold: bool = False) -> list[Font | None]:
        """Return the font of each character; None where no font has it.

        Spaces, digits and punctuation are in the font of the letters before them, where it has them.
        """
        letters = (self._first(character, bold) for character in text if unicodedata.category(character)[0] == "L")
        last = next((font for font in letters if font is not None), self._first("-", bold))
        chosen = []
        for character in text:
            is_letter = unicodedata.category(character)[0] == "L"
            font = self._first(character, bold) if is_letter or last is None or not last.has(character) else last
            last = font if is_letter and font is not None else last
            chosen.append(font)
        return chosen

    def _first(self, character: str, bold: bool) -> Font | None:
        return next((font for font in self._candidates(character, bold) if font.has(character)), None)

    def _candidates(self, character: str, bold: bool) -> Iterator[Font]:
        # The first word of a letter's Unicode name is its script.
        script = unicodedata.name(character, "").partition(" ")[0].title()
        for name in (*([self.named] if self.named else []), "NotoSans", f"NotoSans{script}", *_ALSO):
            font = find_font(name, bold=bold)
            if font is not None:
                yield font


@cache
def find_font(name: str, *, bold: bool = False) -> Font | None:
    """Return a font that comes along or is installed, or None.

    Parameters
    ----------
    name : str
        Name of its file with or without ``-Regular`` and suffix, or the absolute path of the file.
    bold : bool
        Whether its bold companion is wanted.
    """
    stem = name.removesuffix(Path(name).suffix).removesuffix("-Regular")
    regular = _find_file(name) or _find_file(f"{stem}-Regular")
    if not bold or regular is None:
        return None if regular is None else Font(regular)
    companion = _find_file(f"{stem}-Bold{Path(name).suffix}")
    return Font(regular, is_emboldened=True) if companion is None else Font(companion)


def _find_file(name: str) -> str | None:
    """Return the file of a font that comes along or is installed, by its name."""
    from PIL import ImageFont

    stem = name.removesuffix(".ttf")
    package, folder = _COME_ALONG.get(stem.partition("-")[0], ("", ""))
    spec = find_spec(package) if package else None
    file = Path(spec.origin).parent / folder / f"{stem}.ttf" if spec is not None and spec.origin else Path(name)
    try:
        # Pillow looks in the folders where each system keeps its fonts.
        return str(ImageFont.truetype(file, 10).path)
    except OSError:
        return None


@cache
def _coverage(path: str) -> frozenset[int]:
    """Return the characters for which a font has glyphs."""
    from fontTools.ttLib import TTFont

    with TTFont(path, fontNumber=0, lazy=True) as font:
        return frozenset(font.getBestCmap())
