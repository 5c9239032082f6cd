"""The notebook of the site: its cells run, and print and draw what its page shows."""

from __future__ import annotations

import json
import re

import pytest
from generator import notebook


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    """The cells, executed in an empty folder."""
    return notebook.execute(notebook.PAGE, tmp_path_factory.mktemp("notebook"))


def squeezed(text):
    """Return a text without the spaces that only align it."""
    return "\n".join(" ".join(line.split()) for line in text.splitlines())


def test_every_cell_prints_what_its_page_shows(executed):
    """`...` in the page matches any text."""
    shown = [said for _, _, said in notebook.cells(notebook.PAGE)]
    assert sum(map(bool, shown)) >= 6
    for expected, (_, source, said, _) in zip(shown, executed, strict=True):
        pattern = ".*".join(map(re.escape, squeezed(expected).split("...")))
        assert re.fullmatch(pattern, squeezed(said)), source


def test_the_notebook_contains_the_cells_with_their_outputs(executed):
    """Every cell of the page is there in order, in nbformat 4.5; one of them draws."""
    whole = json.loads(notebook.notebook(executed))
    assert (whole["nbformat"], whole["nbformat_minor"]) == (4, 5)
    assert [(cell["cell_type"], cell["source"]) for cell in whole["cells"]] == [
        (kind, source.rstrip("\n")) for kind, source, _, _ in executed
    ]
    outputs = [output for cell in whole["cells"] for output in cell.get("outputs", ())]
    pictures = [output["data"]["image/svg+xml"] for output in outputs if output["output_type"] == "display_data"]
    assert len(pictures) == 1
    assert pictures[0].count("<path") > 20
    assert "{image}" not in json.dumps(whole)
