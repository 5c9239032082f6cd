"""The reference of the site covers every key, field, event, command and exit status of the program."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from check_pages import WRITTEN, blocks
from generator import commands, fields, keys
from ruamel.yaml import YAML

from modaltouch import examine

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("kind", keys.FILES)
def test_every_key_has_an_example_from_a_real_file(kind):
    """If this fails, add the key to a file of docs/examples whose name begins with the kind of file."""
    assert keys.without_example(kind) == []


@pytest.mark.parametrize("file", sorted(keys.EXAMPLES.glob("*.yaml")), ids=lambda file: file.stem)
def test_every_example_is_read_by_the_program(file):
    """It fits its schema, and a protocol passes the whole check."""
    values = YAML(typ="safe", pure=True).load(file)
    schema = json.loads((ROOT / "protocols" / "schema" / f"{file.stem.partition('_')[0]}.json").read_text())
    jsonschema.validate(values, schema)
    if file.stem.startswith("protocol"):
        assert examine(file).problems == ()


def unknown(value: Any, path: keys.Path_, known: set[keys.Path_]) -> Iterator[str]:
    """Yield the keys of a piece of YAML that are not known."""
    for name, each in value.items() if isinstance(value, dict) else (("[]", item) for item in value):
        below = next((one for one in ((*path, str(name)), (*path, "<name>")) if one in known), None)
        within = below or next((one for one in ((*path, str(name)), (*path, "<name>")) if _leads(one, known)), None)
        if within is None:
            yield ".".join((*path, str(name)))
        elif isinstance(each, dict | list) and _leads(within, known):
            yield from unknown(each, within, known)


def _leads(path: keys.Path_, known: set[keys.Path_]) -> bool:
    return any(one[: len(path)] == path and len(one) > len(path) for one in known)


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.stem)
def test_every_key_in_a_piece_of_yaml_on_a_page_is_known(page):
    """The keys belong to a protocol or an apparatus file; whole files are checked by `make docs-check`."""
    known = {key.path for kind in ("protocol", "apparatus") for key in keys.keys(kind)}
    pieces = [YAML(typ="safe", pure=True).load(text) for language, _, text in blocks(page) if language == "yaml"]
    assert [key for piece in pieces for key in unknown(piece, (), known)] == []


def test_every_json_field_is_described():
    """It covers the golden outputs and those beside the site; if this fails, describe the field in docs/fields.yaml."""
    assert fields.missing(fields.outputs()) == []


def test_every_event_of_the_log_is_described():
    """It covers the events that the source writes, with the fields that it writes by name."""
    found = {kind: dict.fromkeys(names) for kind, names in fields.written_events().items()}
    assert {kind for kind in found if kind not in fields.meanings()["kinds"]} == set()
    assert fields.missing(found, "log") == []


def test_every_command_and_every_exit_status_has_its_page(tmp_path):
    """Every command of the list has a page with every option of its help."""
    commands.write_commands(tmp_path)
    commands.write_statuses(tmp_path)
    assert {file.stem.split("_")[0] for file in tmp_path.glob("*.md")} >= set(commands.MODULES)
    assert "--with-marked-calibration" in (tmp_path / "check.md").read_text(encoding="utf-8")
    assert "| `130` |" in (tmp_path / "exit_statuses.md").read_text(encoding="utf-8")
