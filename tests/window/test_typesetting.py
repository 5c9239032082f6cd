"""Typesetting: shapes, order and lines of every script, against tables of the fonts and of Unicode.

Expected widths come from the fonts' own tables, read by fontTools, without HarfBuzz.
"""

from __future__ import annotations

import unicodedata
from typing import Any

import numpy as np
import pytest
from fontTools.ttLib import TTFont

from modaltouch.protocol import AnswerList
from modaltouch.window.layout import Box, Words, lay_out
from modaltouch.window.typesetting import Font, TypeBlock, Typesetter, find_font


def set_type(text: str, *, width: float = 1.0, height: float = 1.0, size: float = 0.1, bold: bool = False) -> TypeBlock:
    """Return a text as typeset in a window of 1000 pixels."""
    return Typesetter().set_type(Words(text, Box(0, 0, width, height), size, "#FFFFFF", bold), 1000)


def lines(block: TypeBlock) -> list[str]:
    """Return the letters of each line from left to right, each run in reading order."""
    return ["|".join(run.text for run in line.runs) for line in block.lines]


def font_of(letter: str) -> TTFont:
    """Return the tables of the font used for a letter."""
    (font,) = Typesetter().choose_fonts(letter)
    return TTFont(font.path, fontNumber=0)


def advances(font: TTFont, glyphs: list[str]) -> float:
    """Return the width of adjacent glyphs [em]."""
    return sum(font["hmtx"][glyph][0] for glyph in glyphs) / font["head"].unitsPerEm


@pytest.mark.parametrize(
    ("word", "forms"),
    [
        ("بيت", "ﺑﻴﺖ"),
        ("سلام", "ﺳﻼﻡ"),
        ("قلم", "ﻗﻠﻢ"),
    ],
)
def test_arabic_letters_join(word: str, forms: str) -> None:
    """Initial, medial and final forms, and the ligature of lam and alef, as in Unicode's presentation forms."""
    assert "".join(unicodedata.normalize("NFKC", form) for form in forms) == word
    font = font_of(word[0])
    expected = advances(font, [font.getBestCmap()[ord(form)] for form in forms])
    assert Typesetter().measure(word) == pytest.approx(expected, abs=0.02 * len(forms))
    apart = sum(Typesetter().measure(letter) for letter in word)
    assert abs(apart - expected) > 0.1, "letters that do not join are wider"


def test_hebrew_is_as_wide_as_its_letters() -> None:
    """The sum of advances; Hebrew has neither joining nor ligatures."""
    font = font_of("ש")
    expected = advances(font, [font.getBestCmap()[ord(letter)] for letter in "שלום"])
    assert Typesetter().measure("שלום") == pytest.approx(expected, abs=0.05)


def ligature(font: TTFont, feature: str, glyphs: list[str]) -> str:
    """Return the glyph that a feature of the font substitutes for several."""
    table = font["GSUB"].table
    indices = {
        i
        for each in table.FeatureList.FeatureRecord
        if each.FeatureTag == feature
        for i in each.Feature.LookupListIndex
    }
    subtables = [each for i in indices for each in table.LookupList.Lookup[i].SubTable]
    subtables = [getattr(each, "ExtSubTable", each) for each in subtables]
    first, *rest = glyphs
    return next(each.LigGlyph for sub in subtables for each in sub.ligatures.get(first, ()) if each.Component == rest)


def test_devanagari_consonants_form_conjuncts() -> None:
    """The font's akhand ligature of ka, virama, ssa."""
    font = font_of("क")
    letters = [font.getBestCmap()[ord(letter)] for letter in "क्ष"]
    expected = advances(font, [ligature(font, "akhn", letters)])
    assert Typesetter().measure("क्ष") == pytest.approx(expected, abs=0.02)


def test_a_devanagari_vowel_sign_is_drawn_before_its_consonant() -> None:
    """कि ends like क; PsychoPy's own text lost the sign."""

    def ink(text: str) -> Any:
        return Typesetter().cover(Words(text, Box(0, 0, 1, 1), 0.2, "#FFFFFF"), (1000, 1000))

    with_sign, plain = ink("कि"), ink("क")
    n = round(0.4 * plain.alpha.shape[1])
    bottom = plain.bottom - with_sign.bottom
    ends = with_sign.alpha[bottom : bottom + 80, -n:], plain.alpha[:80, -n:]
    assert float(np.abs(ends[0] - ends[1]).mean()) < 0.05
    assert with_sign.alpha.shape[1] > 1.2 * plain.alpha.shape[1]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ضع السبابة على المنطقة B", ["B|ضع السبابة على المنطقة "]),
        ("5 من 24", ["24| من |5"]),
        ("Press مفتاح now", ["Press |مفتاح| |now"]),
        ("5 of 24", ["5 of 24"]),
    ],
)
def test_the_order_of_letters_is_that_of_uax_9(text: str, expected: list[str]) -> None:
    """Rules P2, W2, N1 and L2, applied by hand."""
    assert lines(set_type(text, width=9)) == expected


def test_brackets_between_runs_have_the_direction_of_the_paragraph() -> None:
    """Rule N1 by hand; the bracket is a separate run if the letters' font lacks it."""
    (line,) = lines(set_type("اضغط (Esc)", width=9))
    assert line in (")|Esc|(|اضغط ", ")|Esc|اضغط (")


def test_a_paragraph_has_one_direction() -> None:
    """A second line that begins with Latin letters still runs from right to left."""
    width = 0.1 * Typesetter().measure("اضغط على مفتاح") + 0.01
    assert lines(set_type("اضغط على مفتاح Esc من فضلك", width=width)) == ["اضغط على مفتاح", "من فضلك| |Esc"]


def test_ideographs_break_anywhere_but_before_and_after_their_punctuation() -> None:
    """UAX 14 classes CL, EX, NS and OP: none at the wrong end of a line; no letter is lost."""
    text = "答案没有对错之分，请说出（您的）感觉。「はい」とこたえてくだ​さい。ちょっとまって！"
    for width in np.arange(0.3, 1.2, 0.1):
        found = lines(set_type(text, width=float(width), height=9))
        assert "".join(found).replace("|", "").replace("\u200b", "") == text.replace("\u200b", "")
        assert not [line for line in found if line[0] in "，。！）」っょ" or line[-1] in "（「"]
        assert len(found) > 3


def test_words_break_only_at_spaces_and_where_they_may() -> None:
    """As few lines as possible, of similar lengths; a no-break space holds its word, a soft hyphen shows at a break."""
    assert lines(set_type("Außer\u00adordentlich", width=0.5)) == ["Außer-", "ordentlich"]
    assert lines(set_type("Außer\u00adordentlich", width=2)) == ["Außer\u00adordentlich"]
    assert lines(set_type("ทั้งสองนิ้ว\u200bเท่ากัน", width=0.55)) == ["ทั้งสองนิ้ว\u200b", "เท่ากัน"]
    assert lines(set_type("Where did you feel the vibration", width=1.5)) == ["Where did you feel", "the vibration"]
    assert lines(set_type("la vibration\u00a0?", width=0.5)) == ["la", "vibration\u00a0?"]
    assert lines(set_type("one\n\ntwo")) == ["one", "", "two"]


@pytest.mark.parametrize("bold", [False, True])
def test_adjacent_words_share_a_baseline(bold: bool) -> None:
    """Also if only one has a letter with a descender, as in Left and Right."""
    extents = [set_type(word, bold=bold).lines[0] for word in ("Left", "Right", "Both", "Gauche", "Gleich stark (j)")]
    assert len({(line.ascent, line.descent) for line in extents}) == 1


def test_digits_and_punctuation_are_in_the_font_of_their_letters() -> None:
    """Arabic comma and digits in the Arabic font, Latin in Noto Sans, an ideographic full stop in its own."""

    def names(text: str) -> list[str]:
        return [font.path.rpartition("/")[2].partition("-")[0] for font in Typesetter().choose_fonts(text)]

    arabic = names("من 5،")
    assert arabic[0] in ("NotoSansArabic", "DejaVuSans.ttf")
    assert set(arabic) == set(arabic[:1])
    assert names("按 Esc。") == ["wqy", "wqy", "NotoSans", "NotoSans", "NotoSans", "wqy"]
    assert Typesetter().lacking("A \U0010fffd") == "\U0010fffd"
    assert Typesetter().lacking("a\tb\n\x07") == Typesetter().lacking("按\t\n\x07") == "\t\x07"


@pytest.mark.parametrize("name", ["NotoSans", "DejaVuSans"])
@pytest.mark.parametrize("bold", [False, True])
def test_the_bundled_fonts_have_the_letters_of_western_europe(name: str, bold: bool) -> None:
    """All of code page 1252, by the fonts' tables, so that no other font is read."""
    font = find_font(name, bold=bold)
    assert font is not None
    letters = bytes(range(32, 256)).decode("cp1252", errors="ignore")
    known = TTFont(font.path).getBestCmap()
    missing = [each for each in letters if ord(each) not in known]
    assert missing in ([], ["\x7f"])


def test_a_named_font_comes_first_and_may_be_emboldened() -> None:
    """DejaVu Sans for Latin and Arabic; a font without a bold companion gets thicker strokes."""
    assert {font.path.rpartition("/")[2] for font in Typesetter("DejaVuSans.ttf").choose_fonts("قلم A")} == {
        "DejaVuSans.ttf"
    }
    (bold,) = Typesetter("DejaVuSans.ttf").choose_fonts("A", bold=True)
    assert bold.path.endswith("DejaVuSans-Bold.ttf")
    (stroked,) = Typesetter().choose_fonts("中", bold=True)
    assert isinstance(stroked, Font)
    assert stroked.is_emboldened
    assert find_font("NoSuchFont-Regular.ttf") is None


@pytest.mark.parametrize(
    "label", ["明显在左手食指下面更强一些", "أقوى بوضوح تحت السبابة اليسرى", "Clearly stronger here"]
)
def test_a_long_answer_takes_two_lines_before_it_shrinks(label: str) -> None:
    """Two or three lines on one of four buttons, in larger type than one line would allow."""
    answers = AnswerList.of({"keys": [f"answer_{number}" for number in range(4)]})
    button = lay_out(1280, 800, {"A": (-0.5, 0.5)}, answers).buttons["answer_0"]
    box = Box(0, 0, 0.86 * button.width, 0.6 * button.height)
    block = set_type(label, width=box.width, height=box.height, size=0.062, bold=True)
    assert block.fits(1000 * box.width, 1000 * box.height)
    assert len(block.lines) in (2, 3)
    assert block.size / 1000 > 1.35 * box.width / Typesetter().measure(label, bold=True)
