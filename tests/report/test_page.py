"""Pages that hold everything they show."""

from __future__ import annotations

import base64
import html
import re
from pathlib import Path

import pytest

from modaltouch.report.page import render_page


def test_a_picture_is_held_by_the_page_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """RFC 2397: the address of a picture is its bytes in base 64."""
    package = tmp_path / "leaflet"
    (package / "templates").mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "templates" / "leaf.html.j2").write_text('<img src="{{ picture | data_uri }}">')
    monkeypatch.syspath_prepend(tmp_path)
    page = html.unescape(render_page("leaflet", "leaf.html.j2", picture=b"<svg/>"))
    (content,) = re.findall(r'src="data:image/svg\+xml;base64,([^"]*)"', page)
    assert base64.b64decode(content) == b"<svg/>"
