"""Fonts: choice of the first bundled or installed font that has a character."""

from __future__ import annotations

import unicodedata
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

_ALSO = ("DejaVuSans", "NotoSansCJK-Regular", "wqy-microhei", "DroidSansFallbackFull")
"""Fonts tried after Noto Sans and the Noto font of a script; the first comes with matplotlib, the others have CJK."""
_COME_ALONG = {"NotoSans": ("psychopy", "assets/fonts"), "DejaVuSans": ("matplotlib", "mpl-data/fonts/ttf")}
"""Fonts bundled with packages, so that pictures are the same on every machine."""


@dataclass(frozen=True)
class Font:
    """A font file.

    Attributes
    ----------
    path : str
        Path of the file.
    is_emboldened : bool
        Whether it lacks a bold companion and must be drawn with thicker strokes.
    """

    path: str
    is_emboldened: bool = False

    def has(self, character: str) -> bool:
        """Return whether the font has a glyph for a character; True for spaces and invisible characters."""
        return unicodedata.category(character) in ("Cc", "Cf", "Zs") or ord(character) in _coverage(self.path)


@dataclass(frozen=True)
class Fonts:
    """Fonts for the texts of one language.

    Attributes
    ----------
    named : str
        File name of an installed font to try first, such as ``Amiri-Regular.ttf``, or its absolute path.
    """

    named: str = ""

    def choose(self, text: str, *, bold: bool = False) -> list[Font]:
        """Return the font of each character: one that has it, else that of a hyphen.

        Spaces, digits and punctuation use the font of the preceding letters if it has them.
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
        """Return the characters that no font has; Western European texts, covered by bundled fonts, are not checked."""
        with suppress(UnicodeEncodeError):
            text.encode("cp1252")
            return ""
        return "".join(letter for letter, font in zip(text, self.choose(text), strict=True) if not font.has(letter))


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
    """Find the file of a bundled or installed font by name."""
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
    """Return the code points for which a font has glyphs."""
    from fontTools.ttLib import TTFont

    with TTFont(path, fontNumber=0, lazy=True) as font:
        return frozenset(font.getBestCmap())
