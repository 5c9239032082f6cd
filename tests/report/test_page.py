"""Report pages are self-contained and legible."""

from __future__ import annotations

import base64
import html
import re
from pathlib import Path

import pytest

from modaltouch.report import page
from modaltouch.report.page import render_page


def test_a_picture_is_embedded_in_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A data URL holds the bytes of the picture in base 64 (RFC 2397)."""
    package = tmp_path / "leaflet"
    (package / "templates").mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "templates" / "leaf.html.j2").write_text('<img src="{{ picture | data_uri }}">')
    monkeypatch.syspath_prepend(tmp_path)
    shown = html.unescape(render_page("leaflet", "leaf.html.j2", picture=b"<svg/>"))
    (content,) = re.findall(r'src="data:image/svg\+xml;base64,([^"]*)"', shown)
    assert base64.b64decode(content) == b"<svg/>"


def test_the_text_of_a_page_has_enough_contrast() -> None:
    """Every text colour has a contrast of at least 4.5 on white (WCAG 2.2, success criterion 1.4.3)."""
    text = (Path(page.__file__).parent / "templates" / "base.html.j2").read_text(encoding="utf-8")
    named = dict(re.findall(r"--(\w+): (#\w{6})", text))
    used = re.findall(r"(?<![-\w])color: (?:var\(--(\w+)\)|(#\w+))", text)
    colours = {named.get(name, code) for name, code in used}
    assert len(colours) >= 4
    for colour in colours:
        shares = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in shares]
        luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
        assert 1.05 / (luminance + 0.05) >= 4.5, colour
