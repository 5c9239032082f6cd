"""The reference of the site knows every key, field, event, command and exit status of the program."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest
from generator import commands, fields, keys
from ruamel.yaml import YAML

from modaltouch import examine

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("kind", keys.FILES)
def test_every_key_has_an_example_from_a_real_file(kind):
    """Else write one into a file of docs/examples whose name begins with the kind of file."""
    assert keys.without_example(kind) == []


@pytest.mark.parametrize("file", sorted(keys.EXAMPLES.glob("*.yaml")), ids=lambda file: file.stem)
def test_every_example_is_read_by_the_program(file):
    """By its schema, and protocols by the whole check."""
    values = YAML(typ="safe", pure=True).load(file)
    schema = json.loads((ROOT / "protocols" / "schema" / f"{file.stem.partition('_')[0]}.json").read_text())
    jsonschema.validate(values, schema)
    if file.stem.startswith("protocol"):
        assert examine(file).problems == ()


def test_every_field_of_json_has_its_meaning():
    """Of the frozen outputs and those beside the site; else say in docs/fields.yaml what it means."""
    assert fields.missing(fields.outputs()) == []


def test_every_event_of_the_log_has_its_meaning():
    """Of the events that the source writes, with the fields that stand there by name."""
    found = {kind: dict.fromkeys(names) for kind, names in fields.written_events().items()}
    assert {kind for kind in found if kind not in fields.meanings()["kinds"]} == set()
    assert fields.missing(found, "log") == []


def test_every_command_and_every_exit_status_has_its_page(tmp_path):
    """The pages are those of the list of commands, with every option that a help page has."""
    commands.write_commands(tmp_path)
    commands.write_statuses(tmp_path)
    assert {file.stem.split("_")[0] for file in tmp_path.glob("*.md")} >= set(commands.MODULES)
    assert "--with-marked-calibration" in (tmp_path / "check.md").read_text(encoding="utf-8")
    assert "| `130` |" in (tmp_path / "exit_statuses.md").read_text(encoding="utf-8")
