"""Every shipped text is as wide in the window as Chromium sets it in the same font."""

import html
import json
from pathlib import Path

import pytest
from browser import CHROMIUM, Browser
from ruamel.yaml import YAML

from modaltouch.window.typesetting import Typesetter

TEXTS = Path(__file__).parents[2] / "protocols" / "texts"
OTHERS = {
    "hebrew": ["איפה הרגשת את הרטט?", "הניחו את האצבע המורה הימנית על האזור"],
    "hindi": ["आपको कंपन कहाँ महसूस हुआ?", "कृपया अपनी दाहिनी तर्जनी को क्षेत्र पर रखें", "विद्यार्थी", "र्क"],
    "japanese": ["どこに振動を感じましたか？", "人差し指"],
    "thai": ["คุณรู้สึกสั่นที่ไหน", "ขวา"],
}
PAGE = """<!doctype html><meta charset=utf-8><style>{fonts} span{{font-size:100px; white-space:pre}}</style>
<body style="width:99999px">{words}"""
MEASURE = """document.fonts.ready.then(() =>
  [...document.querySelectorAll("span")].map((each) => each.getBoundingClientRect().width))"""


def lines_of(language):
    """Return every line of a language's texts."""
    if language in OTHERS:
        return OTHERS[language]
    texts = YAML(typ="safe", pure=True).load((TEXTS / f"{language}.yaml").read_text(encoding="utf-8"))
    return [line for text in texts.values() if isinstance(text, str) for line in text.splitlines() if line]


@pytest.mark.parametrize("language", ["arabic", "chinese", "english", "french", "german", *OTHERS])
def test_every_text_is_as_wide_as_in_a_browser(language, tmp_path):
    """Widths agree within 0.1 % for texts of a single font; Chromium shapes, and orders letters by ICU's UAX 9."""
    if CHROMIUM is None:
        pytest.skip("no Chromium: apt-get install chromium")
    fonts = {line: {font.path for font in Typesetter().choose_fonts(line)} for line in lines_of(language)}
    lines = [line for line, paths in fonts.items() if len(paths) == 1]
    assert len(lines) >= 0.5 * len(fonts), "less than half of the texts use a single font"
    files = sorted(set.union(*(fonts[line] for line in lines)))
    faces = "".join(f"@font-face {{font-family: f{n}; src: url('file://{file}')}}" for n, file in enumerate(files))
    spans = (
        f"<div><span style='font-family:f{files.index(*fonts[line])}' dir=auto>{html.escape(line)}</span></div>"
        for line in lines
    )
    page = tmp_path / "words.html"
    page.write_text(PAGE.format(fonts=faces, words="".join(spans)), encoding="utf-8")
    with Browser() as browser:
        browser.open(page)
        widths = browser.run(MEASURE)
    found = {line: 100 * Typesetter().measure(line) for line in lines}
    assert found == pytest.approx(dict(zip(lines, widths, strict=True)), rel=1e-3, abs=0.2), json.dumps(files)
