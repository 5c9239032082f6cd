"""Fonts: a letter is drawn in the first font that has it, of those that are bundled or installed."""

from __future__ import annotations

import unicodedata
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

_ALSO = ("DejaVuSans", "NotoSansCJK-Regular", "wqy-microhei", "DroidSansFallbackFull")
"""Tried after Noto Sans and the Noto font of a script; the first comes with matplotlib, the rest have CJK."""
_COME_ALONG = {"NotoSans": ("psychopy", "assets/fonts"), "DejaVuSans": ("matplotlib", "mpl-data/fonts/ttf")}
"""Fonts bundled with packages, so that every machine shows the same picture."""


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
        """Return whether the font has a glyph for a character; spaces and invisible characters need none."""
        return unicodedata.category(character) in ("Cc", "Cf", "Zs") or ord(character) in _coverage(self.path)


@dataclass(frozen=True)
class Fonts:
    """The fonts for the texts of one language.

    Attributes
    ----------
    named : str
        File name of an installed font that is tried first, such as ``Amiri-Regular.ttf``, or its absolute path.
    """

    named: str = ""

    def choose(self, text: str, *, bold: bool = False) -> list[Font]:
        """Return the font of each character: one that has it, else that of a hyphen.

        Spaces, digits and punctuation are in the font of the letters before them, if it has them.
        """
        letters = [character for character in text if unicodedata.category(character)[0] == "L"]
        last, chosen = _first(self.named, letters[0] if letters else "-", bold), []
        for character in text:
            is_letter = unicodedata.category(character)[0] == "L"
            font = _first(self.named, character, bold) if is_letter or not last.has(character) else last
            last = font if is_letter else last
            chosen.append(font)
        return chosen

    def lacking(self, text: str) -> str:
        """Return the characters that no font has; for Western European texts, which bundled fonts cover, read none."""
        with suppress(UnicodeEncodeError):
            text.encode("cp1252")
            return ""
        return "".join(letter for letter, font in zip(text, self.choose(text), strict=True) if not font.has(letter))


@cache
def _first(named: str, character: str, bold: bool) -> Font:
    """Return the first font that has a character, else that of a hyphen."""
    # The first word of a letter's Unicode name is its script.
    script = unicodedata.name(character, "").partition(" ")[0].title()
    names = (*([named] if named else []), "NotoSans", f"NotoSans{script}", *_ALSO)
    fonts = (font for name in names if (font := find_font(name, bold=bold)) and font.has(character))
    return next(fonts, None) or _first(named, "-", bold)


@cache
def find_font(name: str, *, bold: bool = False) -> Font | None:
    """Return a font that is bundled or installed, or None.

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
    """Return the file of a font that is bundled or installed, by its name."""
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
